"""Calibration files to rigs: any file becomes a tree of names, an adapter or the names give the arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from semisynth_gl.calibration.adapters import ADAPTERS, Format, kitti
from semisynth_gl.calibration.arrays import UNITS, StereoArrays, model_of
from semisynth_gl.calibration.finder import KEYS, Finder
from semisynth_gl.calibration.kinds import Size
from semisynth_gl.calibration.rig import Rig, rectified, stereo_rectify
from semisynth_gl.calibration.tree import EXTENSIONS, FormatError, Tree, joined, prefixes_of, read_tree
from semisynth_gl.inputs.arguments import check_one_of
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.textures.image_files import find_files


def read_rigs(
    sources: Sequence[str | Path],
    *,
    size: Size | None = None,
    photographed: Size | None = None,
    unit: str | None = None,
    alpha: float | None = None,
    cameras: tuple[str, str] | None = None,
    keys: Mapping[str, str] | None = None,
) -> list[Rig]:
    """Read rectified rigs from calibration files and globs, in the order of the files.

    A file that describes a rig by itself is one. Where one of several files does not, all files together are one rig:
    one file for each camera, the left one first where their names do not tell, or intrinsics and extrinsics.

    Args:
        sources: names of files, and globs.
        size: size of the images, for files that do not state it; where a file does, both must be equal.
        photographed: size of the rig's photographs, which chooses or stands for the size where files do not state it.
        unit: as `calibrate` takes it, like all that follow.
        alpha: see `stereo_rectify`.
        cameras: of a file with more than two.
        keys: names of values in the files by `KEYS`.

    Raises:
        InputError: where there is no file, a rig is not rectified, or OpenCV is needed and missing.
        ReadError: where a file describes no rig, or contradicts itself.
    """
    paths = _found(sources)
    if unit is not None:
        check_one_of("unit", unit, UNITS)
    for key in keys or {}:
        if key not in KEYS:
            raise InputError(
                f"{key}: expected one of {', '.join(KEYS)}, equal to a name in the file", argument="calib_keys"
            )

    def arrays_of(names: Sequence[Path], tree: Tree) -> StereoArrays | None:
        source = " and ".join(map(str, names))
        try:
            arrays = _arrays(tree, size or photographed, cameras, unit, keys or {})
        except FormatError as error:
            raise ReadError(Path(source), str(error)) from None
        return arrays and replace(arrays, source=source)

    trees = [read_tree(path) for path in paths]
    found = [arrays_of([path], tree) for path, tree in zip(paths, trees, strict=True)] if len(paths) > 1 else [None]
    rigs = [each for each in found if each is not None]
    if len(rigs) < len(paths):
        whole = trees[0] if len(paths) == 1 else joined(trees, prefixes_of(paths))
        rig = arrays_of(paths, whole)
        if rig is None and len(paths) > 1:  # no name tells the eyes: the left camera's file comes first
            rig = arrays_of(paths, joined(trees, [(str(number),) for number in range(1, len(paths) + 1)]))
        if rig is None:
            raise _nothing_found(paths, whole, cameras)
        rigs = [rig]
    return [_rig(each, size, photographed, alpha) for each in rigs]


def _found(sources: Sequence[str | Path]) -> list[Path]:
    paths: dict[Path, None] = {}
    for source in sources:
        matches = find_files([source], EXTENSIONS)
        if not matches:
            raise InputError(f"{source}: no such file, nor a file with {', '.join(EXTENSIONS)} there", argument="calib")
        paths |= dict.fromkeys(matches)
    return [*paths]


def _arrays(
    tree: Tree, size: Size | None, cameras: tuple[str, str] | None, unit: str | None, keys: Mapping[str, str]
) -> StereoArrays | None:
    found = (adapter(tree, size) for adapter in ((kitti,) if keys else ADAPTERS))
    known = next((each for each in found if each is not None), Format(tree))
    if known.unit is not None and unit is not None:
        raise FormatError("its format states the unit: leave the unit out")
    arrays = Finder(known.tree, keys, cameras or known.cameras, known.unit or unit, size).arrays()
    return arrays and replace(arrays, bounds=known.bounds)


def _nothing_found(paths: Sequence[Path], tree: Tree, cameras: tuple[str, str] | None) -> ReadError:
    source = Path(" and ".join(map(str, paths)))
    try:
        model_of(value for value in tree.values() if isinstance(value, str))
    except FormatError as error:
        return ReadError(source, str(error))
    chosen = "" if cameras is None else f" {' and '.join(cameras)}"
    return ReadError(
        source,
        f"describes no pair of cameras{chosen}. Expected P of both, or K, D, R and T, or K and a baseline. It has "
        f"{Finder(tree).listing()}. Add the file that has the rest; or say which value is which (--calib-keys), such "
        "as K1=left.camera_matrix,D1=left.dist,K2=...,R=...,T=...; or give the focal length, the baseline and the size "
        "of rectified images as numbers",
    )


def _rig(arrays: StereoArrays, size: Size | None, photographed: Size | None, alpha: float | None) -> Rig:
    if arrays.size is None and size is None and photographed is not None:
        size = photographed
        arrays = replace(arrays, notes=(*arrays.notes, f"images are taken to be of {size}, as the photographs are"))
    if arrays.size is not None and size is not None and arrays.size != size:
        raise InputError(
            f"{arrays.source} is for images of {arrays.size}, not {size}: leave the size out, or give the scale if "
            "your images are reduced",
            argument="size",
        )
    size = arrays.size or size
    if size is None:
        raise InputError(f"{arrays.source}: does not say how large the images are: give it", argument="size")
    if arrays.p is not None and alpha is not None:
        raise InputError(f"{arrays.source} states how its images are rectified: leave it out", argument="alpha")
    return rectified(stereo_rectify(arrays, size, alpha) if arrays.p is None else arrays, size)
