"""Write the list of rooms into docs/contributing.md, from docs/rooms.toml.

python docs/make_rooms.py
"""

import tomllib
from pathlib import Path

from marked import replaced

DOCS = Path(__file__).resolve().parent
PACKAGE = DOCS.parent / "semisynth_gl"
BEGIN = "<!-- The list comes from rooms.toml: python docs/make_rooms.py -->\n"


def rooms_list() -> str:
    """Return the rooms as the items of a Markdown list."""
    items = []
    for room in tomllib.loads((DOCS / "rooms.toml").read_text("utf-8"))["room"]:
        suffix = "/" if (PACKAGE / room["name"]).is_dir() else ".py"
        items.append(f"- `{room['name']}{suffix}`: {room['idea']}")
    return "\n".join(items) + "\n"


def page_with_rooms(page: str) -> str:
    """Return the page with the list of rooms between its two markers."""
    return replaced(page, BEGIN, rooms_list())


if __name__ == "__main__":
    path = DOCS / "contributing.md"
    path.write_text(page_with_rooms(path.read_text("utf-8")), "utf-8")
