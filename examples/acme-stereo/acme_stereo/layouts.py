"""Acme's layout."""

from semisynth_gl.layouts import Layout, view_stems

NAMES = view_stems({"image": "{view}", "visibility": "seen_{view}"}, "{channel}_{view}")
NAMES |= {"calibration": "calib", "provenance": "pair"}

# All files in one folder, for Acme's loader.
FLAT = Layout(
    stems={role: "pairs/{index:06d}_" + name for role, name in NAMES.items()},
    lists={"pairs.txt": "{left}\n"},
    needs=frozenset({"visibility"}),  # an output that Acme's loader wants in any case
)
