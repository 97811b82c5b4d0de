"""Write the table of all keys into docs/config.md, from the docstrings that ``semisynth-gl configs NAME`` prints.

python docs/make_config.py
"""

from pathlib import Path

from marked import replaced

from semisynth_gl.config.explain import ExplainedKey, explained_keys

DOCS = Path(__file__).resolve().parent
BEGIN = "<!-- The table comes from the docstrings of the config's sections: python docs/make_config.py -->\n"


def keys_table() -> str:
    """Return all keys as the rows of a Markdown table, a bold row before each section's."""
    rows = ["| key | default | meaning |", "|---|---|---|", *map(_row, explained_keys())]
    return "\n".join(rows) + "\n"


def _row(key: ExplainedKey) -> str:
    name = f"**`{key.dotted}`**" if key.is_section else f"`{key.dotted.rpartition('.')[2]}`"
    name += ", range" if key.is_range else ""
    default, meaning = (text.replace("``", "`").replace("|", "\\|") for text in (key.default, key.meaning))
    return f"| {name} | {default} | {meaning} |"


def page_with_keys(page: str) -> str:
    """Return the page with the table between its two markers."""
    return replaced(page, BEGIN, keys_table())


if __name__ == "__main__":
    path = DOCS / "config.md"
    path.write_text(page_with_keys(path.read_text("utf-8")), "utf-8")
