"""Write the list of all keys into docs/config.md, from the docstrings that ``semisynth-gl configs NAME`` prints too.

python docs/make_config.py
"""

import textwrap
from pathlib import Path

from marked import replaced

from semisynth_gl.config.keys import ConfigKey, config_keys

DOCS = Path(__file__).resolve().parent
BEGIN = "<!-- The keys come from the docstrings of the config's sections: python docs/make_config.py -->\n"
_COLUMNS = 120


def keys_list() -> str:
    """Return all keys as Markdown's lists, one per section, with the section's name and meaning in front."""
    lines = list[str]()
    for key in config_keys():
        lines += ["", *_wrapped(_section(key), ""), ""] if key.is_section else _wrapped(_item(key), "  ")
    return "\n".join(lines) + "\n\n"


def _section(key: ConfigKey) -> str:
    return f"**`{key.dotted}`**: {key.meaning.replace('``', '`')}"


def _item(key: ConfigKey) -> str:
    notes = ", ".join(filter(None, ("range" if key.is_range else "", key.default)))
    name = f"- `{key.dotted.rpartition('.')[2]}`" + (f" ({notes})" if notes else "")
    return f"{name}: {key.meaning.replace('``', '`')}"


def _wrapped(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, _COLUMNS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def page_with_keys(page: str) -> str:
    """Return the page with the list between its two markers."""
    return replaced(page, BEGIN, keys_list())


if __name__ == "__main__":
    path = DOCS / "config.md"
    path.write_text(page_with_keys(path.read_text("utf-8")), "utf-8")
