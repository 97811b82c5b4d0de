"""Plug-ins: layouts, texture sources, families of models and scene recipes from other installed packages.

A package declares its plug-ins as entry points, with one group for each sort. Names are found without importing any
package; a plug-in is imported when its value is first used. Each process finds the plug-ins by itself.
"""

import hashlib
import traceback
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

from semisynth_gl.inputs.errors import InputError, SemisynthError, described, did_you_mean, near, shown

Group = Literal["layouts", "textures", "models", "recipes"]
"""The sorts of plug-ins; layouts are the entry points of the group ``semisynth_gl.layouts``, and so on."""

GROUPS: tuple[Group, ...] = get_args(Group)

NOUNS: Final[Mapping[str, str]] = MappingProxyType(
    {"layouts": "layout", "textures": "texture source", "models": "family of models", "recipes": "scene recipe"}
)
"""The noun for a plug-in of each group, for messages."""

Used = Iterable[tuple[Group, str]]
"""Group and name of each plug-in that a dataset uses."""

Records = Mapping[str, Mapping[str, Mapping[str, str]]]
"""The package of each plug-in, ``{"package": NAME, "version": VERSION}``, by group and name, in JSON's types."""


class MissingPluginError(InputError):
    """A plug-in that is asked for by name is not installed."""


@dataclass(frozen=True)
class Plugin:
    """One entry point of an installed package; users ask for it by ``name``."""

    group: Group
    name: str
    package: str
    version: str
    entry: EntryPoint = field(repr=False)

    def __str__(self) -> str:
        return (
            f"{NOUNS[self.group]} {self.name!r} of the package {self.package} {self.version} "
            f"(entry point {self.name} = {self.entry.value})"
        )

    @cached_property
    def value(self) -> Any:  # noqa: ANN401 - what it should be depends on the group
        """The object that the entry point refers to, imported at the first use; raises InputError where that fails."""
        with self.blamed("cannot be imported"):
            return self.entry.load()

    @property
    def record(self) -> dict[str, str]:
        """The plug-in's package and its version, as datasets record them; see `Records`."""
        return {"package": self.package, "version": self.version}

    @property
    def code_sha256(self) -> str:
        """SHA-256 of all modules of the entry point's top package, or of its single module.

        Raises OSError where the code is not in files.
        """
        spec = find_spec(self.entry.module.partition(".")[0])
        if spec is None or (spec.origin is None and not spec.submodule_search_locations):
            raise FileNotFoundError(self.entry.module)
        path = Path(next(iter(spec.submodule_search_locations or (spec.origin or "",))))
        digest = hashlib.sha256()
        for module in sorted(path.rglob("*.py")) or [path]:
            content = module.read_bytes()
            digest.update(f"{module.relative_to(path.parent).as_posix()} {len(content)}\n".encode() + content)
        return digest.hexdigest()

    def fault(self, fault: str) -> InputError:
        """Return an error about the plug-in; ``fault`` says what its group expects, and what the plug-in gave."""
        return InputError(f"{self}: {fault}")

    @contextmanager
    def blamed(self, what: str) -> Iterator[None]:
        """Turn any error in the ``with`` block into an `InputError` that names the plug-in and the line of its code.

        ``what`` says what the plug-in did, such as ``"cannot be imported"``. MemoryError and KeyboardInterrupt pass.
        """
        try:
            yield
        except (MemoryError, KeyboardInterrupt):
            raise
        except BaseException as error:  # sys.exit() too
            if isinstance(error, SemisynthError):
                raise self.fault(f"{what}: {error}") from error
            frames = traceback.extract_tb(error.__traceback__)[1:]
            own = [frame for frame in frames if frame.filename != __file__ and "importlib" not in frame.filename]
            where = f", in {own[-1].filename}, line {own[-1].lineno}" if own else ""
            raise self.fault(f"{what}: {described(error)}{where}") from error


@cache
def installed_plugins() -> tuple[Plugin, ...]:
    """Return the plug-ins of all installed packages, sorted by group, name and package, without importing them."""
    everything = entry_points()
    found = [
        Plugin(group, entry.name, entry.dist.name, entry.dist.version, entry)
        for group in GROUPS
        for entry in everything.select(group=f"semisynth_gl.{group}")
        if entry.dist is not None
    ]
    return tuple(sorted(found, key=lambda each: (GROUPS.index(each.group), each.name, each.package)))


def plugin_names(group: Group) -> tuple[str, ...]:
    """Return the names of the installed plug-ins of a group, sorted, without importing the plug-ins."""
    return tuple(dict.fromkeys(each.name for each in installed_plugins() if each.group == group))


def _called(group: Group, name: str) -> list[Plugin]:
    return [each for each in installed_plugins() if each.group == group and each.name == name]


def find_plugin(group: Group, name: str, built_in: Collection[str] = ()) -> Plugin:
    """Return the plug-in of a name, without importing it.

    Args:
        group: the sort of plug-in.
        name: the entry point's name.
        built_in: names of the program's own, which the message lists beside those of plug-ins.

    Raises:
        MissingPluginError: where no installed package has the plug-in.
        InputError: where two packages have a plug-in of this name.
    """
    found = _called(group, name)
    if not found:
        known = sorted({*built_in, *plugin_names(group)})
        expected = f"expected one of {', '.join(known)}" if known else "no installed package has any"
        hint = did_you_mean(near(str(name), known))
        raise MissingPluginError(f"{NOUNS[group]}: {expected}, got {shown(name)}{'; ' if hint else ''}{hint}")
    if len(found) > 1:
        listed = " and ".join(f"{each.package} {each.version} ({each.entry.value})" for each in found)
        raise InputError(
            f"{NOUNS[group]} {name!r}: expected one package with an entry point of this name, got {listed}: "
            "pip uninstall one of them"
        )
    return found[0]


def refuse_clash(group: Group, name: str) -> None:
    """Raise InputError where a plug-in has the name of the built-in layout, source, ... that is asked for."""
    for each in _called(group, name):
        raise each.fault(
            f"expected a name of its own, got that of a built-in {NOUNS[group]}: rename the entry point, or "
            f"pip uninstall {each.package}"
        )


def plugin_records(used: Used) -> dict[str, dict[str, dict[str, str]]]:
    """Return the records of the plug-ins that a dataset uses, see `Records`; raises as `find_plugin` does."""
    records: dict[str, dict[str, dict[str, str]]] = {}
    for group, name in sorted(used, key=lambda each: (GROUPS.index(each[0]), each[1])):
        records.setdefault(group, {})[name] = find_plugin(group, name).record
    return records


def require_plugins(records: Records, groups: Collection[Group] = GROUPS, *, same: bool = False) -> None:
    """Check that the plug-ins of a dataset's records are installed, for some groups.

    Where ``same`` is set, they must come from the same packages in the same versions. Raises MissingPluginError, with
    the command to install it, where a plug-in is missing.
    """
    for group in groups:
        for name, record in records.get(group, {}).items():
            here = [each.record for each in _called(group, name)]
            if (record not in here) if same else not here:
                package, needed = record["package"], record["version"]
                raise MissingPluginError(
                    f"{NOUNS[group]} {name!r} comes from the plug-in package {package} {needed}, {_state(package)}: "
                    f"pip install {package}=={needed}"
                )


def _state(package: str) -> str:
    try:
        return f"and {version(package)} is installed"
    except PackageNotFoundError:
        return "which is not installed"
