"""Acme's layout."""

from collections.abc import Sequence

from semisynth_gl.codecs import Encodings
from semisynth_gl.layouts import Key, Layout, view_stems


class Flat(Layout):
    """All files in one folder: Acme's loader."""

    needs = frozenset({"visibility"})  # outputs that Acme's loader wants in any case

    def stems(self, key: Key) -> dict[str, str]:
        """Name the files of a pair, without their endings, by role."""
        names = view_stems({"image": "{view}", "visibility": "seen_{view}"}, "{channel}_{view}")
        names |= {"calibration": "calib", "provenance": "pair"}
        return {role: f"pairs/{key.index:06d}_{name}" for role, name in names.items()}

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """List the left images."""
        lines = [self.files(key, encodings)["left"] for key in keys]
        return {"pairs.txt": "".join(f"{line}\n" for line in lines).encode()}
