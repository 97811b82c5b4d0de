"""Calibration files to rigs: any file becomes a tree of names, an adapter or the names give the arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from semisynth_gl.calibration.adapters import ADAPTERS, Adapter
from semisynth_gl.calibration.finder import UNITS, Finder, Given
from semisynth_gl.calibration.rig import Rig, StereoArrays, make_rig
from semisynth_gl.calibration.sizes import Size
from semisynth_gl.calibration.tree import EXTENSIONS, FormatError, Name, Tree, joined, listing, read_tree
from semisynth_gl.frame.camera import EYES
from semisynth_gl.inputs.arguments import check_one_of
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.textures.image_files import find_files

KEYS: Mapping[str, Name] = {
    **{f"{kind}{number}": (eye, kind) for number, eye in enumerate(EYES, 1) for kind in "KDRP"},
    **{name: (name,) for name in ("R", "T", "Q", "size")},
}
"""The names that `read_rig` finds values by, for each key of ``keys``."""


def read_rig(
    sources: Sequence[str | Path],
    *,
    size: Size | None = None,
    photographed: Size | None = None,
    unit: str | None = None,
    alpha: float | None = None,
    cameras: tuple[str, str] | None = None,
    keys: Mapping[str, str] | None = None,
) -> Rig:
    """Read a rectified rig from the calibration files that the sources name.

    Of several files, one may have K, D and R of both cameras. If none has, they are one file a camera, left first
    unless names say otherwise, or intrinsics and extrinsics.

    ``photographed`` is the size of the rig's photographs, which chooses or stands for the size where files do not state
    it. ``keys`` are the ``calib_keys`` of `calibrate`, which explains the other arguments.

    Raises:
        InputError: where there is no file, or several rigs, the rig is not rectified, or OpenCV is needed and missing.
        ReadError: where a file describes no rig, or contradicts itself.
    """
    paths = [*dict.fromkeys(path for source in sources for path in _found(source))]
    if unit is not None:
        check_one_of("unit", unit, UNITS)
    given = Given(cameras, unit, size or photographed)
    trees = [read_tree(path) for path in paths]
    if keys:
        return _rig(_joined(paths, trees, given._replace(cameras=None), keys), size, photographed, alpha)
    rigs = [each for tree, path in zip(trees, paths, strict=True) if (each := _arrays(tree, str(path), given))]
    if len(rigs) < len(paths):
        rigs = [each for each in rigs if each.d and (each.pose_m is not None or each.rectification)]
    if len(rigs) > 1:
        text = f"{rigs[0].source} and {rigs[1].source} describe a rig each: give the files of one"
        raise InputError(text, argument="calib")
    return _rig(rigs[0] if rigs else _joined(paths, trees, given), size, photographed, alpha)


def _found(source: str | Path) -> list[Path]:
    if matches := find_files([source], EXTENSIONS):
        return matches
    raise InputError(f"{source}: no such file, nor a file with {', '.join(EXTENSIONS)} there", argument="calib")


def _arrays(tree: Tree, source: str, given: Given, adapters: Sequence[Adapter] = ADAPTERS) -> StereoArrays | None:
    try:
        if known := next((each for adapter in adapters if (each := adapter(tree, given.size)) is not None), None):
            if given.unit is not None:
                raise InputError(f"{source} states the unit: leave it out", argument="unit")
            tree, pair = known
            given = given._replace(cameras=given.cameras or pair, unit="m")
        arrays = Finder(tree, given).arrays()
    except FormatError as error:
        raise ReadError(Path(source), str(error)) from None
    return arrays and replace(arrays, source=source)


def _joined(
    paths: Sequence[Path], trees: Sequence[Tree], given: Given, keys: Mapping[str, str] | None = None
) -> StereoArrays:
    """Return what files say together; where no name tells the eyes, the left camera's file comes first."""
    source, names = " and ".join(map(str, paths)), [path.stem for path in paths]
    if len({*names}) < len(names):
        names = [f"{path.absolute().parent.name}.{path.stem}" for path in paths]
    numbers = [str(number) for number in range(1, len(paths) + 1)]
    wholes = [*trees] if len(paths) == 1 else [joined(trees, names), joined(trees, numbers)]
    if keys:
        wholes = [_chosen(wholes[0], keys, given)]
    for whole in wholes:
        if (arrays := _arrays(whole, source, given, () if keys else ADAPTERS)) is not None:
            return arrays
    if keys:
        named = listing({(key,): wholes[0][name] for key, name in KEYS.items() if name in wholes[0]})
        text = f"{source}: no pair of cameras in {named}: name P1 and P2, or K1, D1, K2, D2, R and T"
        raise InputError(text, argument="calib_keys")
    chosen = "" if given.cameras is None else f" {' and '.join(given.cameras)}"
    raise ReadError(
        Path(source),
        f"describes no pair of cameras{chosen}. Expected P of both, or K, D, R and T, or K and a baseline. It has "
        f"{listing(wholes[0])}. Add the file that has the rest; or say which value is which (--calib-keys), such as "
        "K1=left.camera_matrix,D1=left.dist,K2=...,R=...,T=...",
    )


def _chosen(tree: Tree, keys: Mapping[str, str], given: Given) -> Tree:
    """Return the values that keys name, under names that tell what they are, all texts, and the size."""
    values = {".".join(name): value for name, value in tree.items()}
    for key, name in keys.items():
        if key not in KEYS:
            raise InputError(f"{key}: expected one of {', '.join(KEYS)}", argument="calib_keys")
        if name not in values:
            raise InputError(f"{key}: no value {name}; there are {listing(tree)}", argument="calib_keys")
    sizes = [] if "size" in keys else Finder(tree, given).found.get("size", [])
    return {
        **{name: value for name, value in tree.items() if isinstance(value, str)},
        **{("size", str(number)): value for number, (_, value) in enumerate(sizes)},
        **{KEYS[key]: values[name] for key, name in keys.items()},
    }


def _rig(arrays: StereoArrays, size: Size | None, photographed: Size | None, alpha: float | None) -> Rig:
    stated = arrays.size
    if stated is not None and size not in {None, stated}:
        text = f"{arrays.source} is for images of {stated}, not {size}: leave it out, or give --scale"
        raise InputError(text, argument="size")
    if stated is None and size is None and photographed is not None:
        arrays = replace(arrays, notes=(*arrays.notes, f"images are taken to be of {photographed}, as photographs are"))
    size = stated or size or photographed
    if size is None:
        raise InputError(f"{arrays.source}: does not say how large the images are: give it", argument="size")
    return make_rig(arrays, size, alpha)
