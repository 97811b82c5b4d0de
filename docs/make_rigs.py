"""Draw the pictures of docs/rigs.md.

Run it as ``python docs/make_rigs.py docs/images``.
"""

import sys
from collections.abc import Callable
from pathlib import Path

DRAWN: dict[str, Callable[[Path], None]] = {}
"""What draws each picture, by the picture's name."""

if __name__ == "__main__":
    for name, draw in DRAWN.items():
        draw(Path(sys.argv[1]) / name)
