"""The photographs that are used where none are given: free ones that the scikit-image package ships."""

from importlib.util import find_spec
from pathlib import Path

from ruamel.yaml import YAML

from semisynth_gl.errors import InputError
from semisynth_gl.resources import data_root


def _listed() -> list[dict[str, str]]:
    listed = YAML(typ="safe", pure=True).load(data_root("assets").joinpath("photographs.yaml").read_text("utf-8"))
    photographs: list[dict[str, str]] = listed["photographs"]
    return photographs


def builtin_licences() -> dict[str, str]:
    """Return what is known of the rights in each of `builtin_photographs`, by file name."""
    return {photograph["file"]: photograph["licence"] for photograph in _listed()}


def builtin_photographs() -> list[Path]:
    """Return the photographs of the installed scikit-image package that ``assets/photographs.yaml`` lists.

    The package is found without importing it, and nothing is ever downloaded.

    Returns:
        Their paths, in the order of the list.

    Raises:
        InputError: where scikit-image is not installed, or lacks a file of the list.
    """
    spec = find_spec("skimage")
    if spec is None or not spec.submodule_search_locations:
        raise InputError(
            "no photographs: scikit-image, whose photographs are used where none are given, is not installed; "
            "pass --images with your own, or install it: pip install 'semisynth-gl[photographs]'"
        )
    folder = Path(spec.submodule_search_locations[0]) / "data"
    paths = [folder / photograph["file"] for photograph in _listed()]
    missing = [path.name for path in paths if not path.is_file()]
    if missing:
        raise InputError(
            f"the installed scikit-image lacks {', '.join(missing)}: expected them in {folder}; "
            f"pass --images with your own photographs, or reinstall: pip install 'semisynth-gl[photographs]'"
        )
    return paths
