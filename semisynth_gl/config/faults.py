"""Messages on faults of a config: the file and line, or the option, at fault, and what to set instead."""

import re
from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from semisynth_gl.config.fields import reason_of
from semisynth_gl.config.keys import by_form, config_keys, members_of
from semisynth_gl.config.merge import Document
from semisynth_gl.config.model import Config
from semisynth_gl.config.yaml_values import Key
from semisynth_gl.inputs.errors import cut, did_you_mean, near, shown

OVERRIDE, OVERRIDES = "override", "overrides"
"""Places of overrides in messages: `OVERRIDE`, before the key, for texts ``"KEY=VALUE"``; `OVERRIDES` for the rest."""

SCENES = "scenes"
TARGET: Final = ("disparity", "target")
TARGET_FILE = "file"

# Largest number of keys of one name that a message suggests, and the similarity of keys that differ by a letter or two.
_KEYS_SHOWN, _BY_A_LETTER = 3, 0.9


def named_place(key: Key, document: Document) -> str:
    """Return the place where a key was set, if known, and the dotted key, such as ``a.yaml:3: camera.focal_px``."""
    place, dotted = _place(key, document), _dotted(key) or "config"
    return place if place == f"{OVERRIDE} {dotted}" else ": ".join(part for part in (place, dotted) if part)


def is_override(place: str) -> bool:
    """Return whether a place is an override and not a file."""
    return place == OVERRIDES or place.startswith(f"{OVERRIDE} ")


def explain_fault(fault: ErrorDetails, document: Document) -> str:
    """Return the message on a fault that pydantic found in a document's values: place, dotted key, reason and value."""
    key, section = _locate(fault["loc"])
    kind = fault["type"]
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _explain_form((*key, "form"), by_form(section.model_fields[str(key[-1])].annotation), fault, document)
    prefix = named_place(key, document)
    if kind == "extra_forbidden" and key[0] == SCENES:
        known_key = next((each for each in config_keys() if each.parts == key[2:] and not each.of_form), None)
        if known_key is not None and known_key.parts != (SCENES,):
            hint = f"set {known_key.dotted} beside {SCENES}"
            return f"{prefix}: a recipe cannot change this key, which holds for all pairs: {hint}"
    if kind == "extra_forbidden":
        known = sorted(section.model_fields)
        hint = did_you_mean(_meant_keys(key, known, fault["input"]), f"expected one of: {', '.join(known)}")
        return f"{prefix}: unknown key; {hint}"
    if kind == "missing":
        return f"{prefix}: missing; this key has no default"
    if kind in ("model_type", "model_attributes_type"):
        return f"{prefix}: expected a section with keys of its own, got {shown(fault['input'])}"
    value = "" if isinstance(fault["input"], (dict, BaseModel)) else f", got {shown(fault['input'])}"
    return _blamed(key, reason_of(fault), value, document)


def _blamed(key: Key, reason: str, value: str, document: Document) -> str:
    """Return a reason after the place at fault, and before the places of the other keys that it names.

    Of the keys that a reason names, the key that was set last is at fault: an extended file, or a file with overrides,
    was right by itself.
    """
    own, named = _place(key, document), _named_keys(key, reason, document)
    places = {each: document.places[each] for each in named}
    blamed = max(named, key=lambda each: _rank(places[each], document), default=key)
    if _rank(places.get(blamed, ""), document) <= _rank(own, document):
        blamed = key
    lead, behind = _place(blamed, document), dict[str, str]()
    prefix = named_place(blamed, document)
    if not blamed and document.files and not any(map(is_override, document.places.values())):
        prefix = document.files[-1]
    if blamed != key:
        prefix = lead if reason.startswith(_dotted(blamed)) else prefix
        if key != blamed[: len(key)]:
            prefix += f": {_dotted(key)}"
            if not any(each[: len(key)] == key for each in named):
                behind[_dotted(key)] = own
    behind |= {_dotted(each): place for each, place in places.items() if each != blamed}
    elsewhere = {
        place if place.startswith(OVERRIDE) else f"{dotted} of {place}": None
        for dotted, place in behind.items()
        if place != lead and (is_override(place) or _file(place) != _file(lead))
    }
    said = f" (with {', '.join([*elsewhere][:_KEYS_SHOWN])})" if elsewhere else ""
    return f"{prefix}: {reason}{value}{said}"


def _named_keys(key: Key, reason: str, document: Document) -> list[Key]:
    """Return the keys that a reason on ``key`` names, where their places are known."""
    found: dict[Key, None] = {}
    for word in re.findall(r"\b[a-z]\w*(?:\.\w+)*", reason):
        parts = tuple(word.split("."))
        # A word without a dot counts only if it names a key of this section.
        known = [each for each in ((*key, *parts), parts) if len(each) > 1 and each in document.places]
        found |= dict.fromkeys(known[:1])
    return list(found)


def _rank(place: str, document: Document) -> int:
    """Return a rank that rises in the order of reading: an extended file, the file that extends it, overrides."""
    if is_override(place):
        return len(document.files)
    return document.files.index(_file(place)) if _file(place) in document.files else -1


def _file(place: str) -> str:
    return place if is_override(place) else place.rpartition(":")[0]


def _dotted(key: Key) -> str:
    return ".".join(map(str, key))


def _explain_form(key: Key, names: Iterable[str], fault: ErrorDetails, document: Document) -> str:
    """Return the message on a missing or wrong key ``form``, with the forms that a target may have."""
    is_part = key[-3:-1] != TARGET
    names = [*names, *(() if is_part else (TARGET_FILE,))]
    prefix, listed = named_place(key, document), f"expected one of: {', '.join(names)}"
    if fault["type"] == "union_tag_not_found":
        return f"{prefix}: missing; {listed}"
    form = cut(fault["ctx"]["tag"])
    if form == TARGET_FILE and is_part:
        return f"{prefix}: a part of a mixture cannot be a file, only a whole target can; {listed}"
    hint = did_you_mean(near(form, names))
    return f"{prefix}: unknown form {form}; {hint}{' ' if hint else ''}{listed}"


def _meant_keys(key: Key, siblings: Collection[str], value: object) -> list[str]:
    """Return the dotted keys that an unknown key may have been meant for, in its section or another.

    ``siblings`` are the keys of its section. If a misspelt section holds a single key, that key helps to find it.
    """
    *above, last = map(str, key)
    inner: list[str] = []
    while isinstance(value, Mapping) and len(value) == 1:
        ((name, value),) = value.items()
        inner.append(str(name))
    whole, known = ".".join([*above, last, *inner]), [each.dotted for each in config_keys()]
    alike = [".".join([*above, name]) for name in near(last, siblings)]
    if key[0] == SCENES:  # a recipe has sections too
        return alike
    if inner:
        alike = near(whole, known) or alike
    # The same key of another section, unless a sibling differs from it by a letter or two.
    leaf = whole.rpartition(".")[2]
    elsewhere = [name for name in known if name.rpartition(".")[2] == leaf and name != whole][:_KEYS_SHOWN]
    if not elsewhere:
        return alike
    return list(dict.fromkeys([*near(whole, alike, least_ratio=_BY_A_LETTER), *elsewhere]))


def _place(key: Key, document: Document) -> str:
    """Return where a key was set, or the nearest key above it whose place is known; "" where none is known."""
    return next((document.places[key[:n]] for n in range(len(key), 0, -1) if key[:n] in document.places), "")


def _locate(location: tuple[int | str, ...]) -> tuple[Key, type[BaseModel]]:
    """Return the document's key for one of pydantic's locations, and the class of the section that holds the key.

    Pydantic's locations also contain names of forms, of other members of unions and of validators.
    """
    key: Key = ()
    section: type[BaseModel] = Config
    annotation: Any = Config
    for part in location:
        forms, members = by_form(annotation), members_of(annotation)
        kind = members[0] if len(members) == 1 else None
        if forms:
            annotation = forms.get(str(part))
        elif isinstance(kind, type) and issubclass(kind, BaseModel):
            section, key = kind, (*key, part)
            known = kind.model_fields.get(str(part))
            annotation = None if known is None else known.annotation
        elif get_origin(kind) in (tuple, dict):
            key = (*key, part)
            annotation = get_args(kind)[0 if get_origin(kind) is tuple else 1]
    return key, section
