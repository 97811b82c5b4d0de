"""Write the list of all keys into docs/config.md, from the docstrings that ``semisynth-gl configs NAME`` prints too.

python docs/make_config.py
"""

import textwrap
from pathlib import Path

from marked import replaced

from semisynth_gl.config.explain import ConfigKey, config_keys

DOCS = Path(__file__).resolve().parent
BEGIN = "<!-- The keys come from the docstrings of the config's sections: python docs/make_config.py -->\n"
_COLUMNS = 120


def keys_list() -> str:
    """Return all keys as Markdown's lists, one per section, with its name and meaning in front."""
    lists: list[tuple[list[ConfigKey], list[str]]] = [([], [])]
    for key in config_keys():
        if key.is_section:
            lists.append(([key], []))
        else:
            lists[-1][1].extend(_wrapped(_item(key), "  "))
    lines = list[str]()
    for number, (sections, items) in enumerate(lists):
        if items in [earlier for _, earlier in lists[:number]]:
            continue  # lens.right has the keys of lens.left, which the page lists
        names = ", ".join(f"`{each[0].dotted}`" for each, same in lists if each and same == items)
        lines += ["", *(_wrapped(f"**{names}**: {_text(sections[0])}", "") if sections else []), "", *items]
    return "\n".join(lines[1:]) + "\n\n"


def _item(key: ConfigKey) -> str:
    notes = ", ".join(filter(None, ("range" if key.is_range else "", key.default)))
    name = f"- `{key.dotted.rpartition('.')[2]}`" + (f" ({notes})" if notes else "")
    return f"{name}: {_text(key)}"


def _text(key: ConfigKey) -> str:
    return " ".join(key.meaning.replace("``", "`").split())


def _wrapped(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, _COLUMNS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def page_with_keys(page: str) -> str:
    """Return the page with the list between its two markers."""
    return replaced(page, BEGIN, keys_list())


if __name__ == "__main__":
    path = DOCS / "config.md"
    path.write_text(page_with_keys(path.read_text("utf-8")), "utf-8")
