"""Reads a rig from one or several calibration files."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from semisynth_gl.calibration.adapters import ADAPTERS, Adapter
from semisynth_gl.calibration.aliases import find_arrays, key_and_camera
from semisynth_gl.calibration.finder import UNITS, StereoArrays, find_stereo_arrays
from semisynth_gl.calibration.rig import RectifiedRig, make_rig
from semisynth_gl.calibration.sizes import ImageSize
from semisynth_gl.calibration.tree import EXTENSIONS, FormatError, Name, Tree, joined, listing, read_tree
from semisynth_gl.frame.camera import EYES
from semisynth_gl.inputs.arguments import check_one_of
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.textures.image_files import find_files

# The name that a value gets for each key of --calib-keys.
_NAMES: Mapping[str, Name] = {
    **{f"{kind}{number}": (eye, kind) for number, eye in enumerate(EYES, 1) for kind in "KDRP"},
    **{name: (name,) for name in ("R", "T", "Q", "size")},
}

Find = Callable[[Tree, str], StereoArrays | None]
"""Called as find(tree, source); returns None if the tree describes no rig."""


def read_rig(
    sources: Sequence[str | Path],
    *,
    size: ImageSize | None = None,
    photographed: ImageSize | None = None,
    unit: str | None = None,
    alpha: float | None = None,
    cameras: tuple[str, str] | None = None,
    calib_keys: Mapping[str, str] | None = None,
) -> RectifiedRig:
    """Read a rectified rig from the calibration files that the sources name.

    If one of several files describes the whole rig, only that file is used. Otherwise the files are joined: one file
    per camera, the left one first unless names say otherwise, or intrinsics and extrinsics.

    ``photographed`` is the size of the rig's photographs: it selects one of several stated sizes, and replaces a
    missing size. `calibrate` explains the other arguments.

    Raises:
        InputError: if there are no files or several rigs, the rig is not rectified, or OpenCV is needed but missing.
        ReadError: if a file describes no rig, or contradicts itself.
    """
    trees: dict[str, Tree] = {}
    for source in sources:
        paths = find_files([source], EXTENSIONS)
        if not paths:
            text = f"{source}: no such file, nor a file with {', '.join(EXTENSIONS)} there"
            raise InputError(text, argument="calib")
        trees |= {str(path): read_tree(path) for path in paths if str(path) not in trees}
    if unit is not None:
        check_one_of("unit", unit, UNITS)
    find = partial(_find, cameras=_cameras_of(cameras), unit=unit, size=size or photographed)
    if calib_keys:
        arrays = find(_renamed(_whole(trees), calib_keys), " and ".join(trees), cameras=None, adapters=())
    else:
        arrays = _find_in_files(trees, find)
    if arrays is None:
        raise ReadError(
            Path(" and ".join(trees)),
            "describes no pair of cameras. Expected P of both, or K, D, R and T, or K and a baseline. It has "
            f"{listing(_whole(trees))}. Add the file that has the rest; or say which value is which, such as "
            "--calib-keys K1=left.camera_matrix,D1=left.dist,K2=...,R=...,T=...",
        )
    stated = arrays.size
    if stated is not None and size not in {None, stated}:
        text = f"{arrays.source} is for images of {stated}, not {size}: do not give a size, or give --scale"
        raise InputError(text, argument="size")
    if stated is None and size is None and photographed is not None:
        arrays.notes.append(f"images are taken to have {photographed} px, as the photographs have")
    known = stated or size or photographed
    if known is None:
        text = f"missing in {arrays.source}, and the photographs of these cameras have no common size: give it"
        raise InputError(text, argument="size")
    return make_rig(arrays, known, alpha)


def _cameras_of(names: tuple[str, str] | None) -> tuple[str, str] | None:
    """Return the two cameras of names such as cam1 and cam2, as in `Arrays`: ("1", "2").

    Raises InputError if a name has neither a number nor an eye, or both are the same camera.
    """
    if names is None:
        return None
    left, right = (key_and_camera((name,))[1] for name in names)
    if "" in {left, right} or left == right:
        text = f"expected two cameras by number or eye, such as cam1,cam2, got {','.join(names)}"
        raise InputError(text, argument="cameras")
    return left, right


def _find_in_files(trees: Mapping[str, Tree], find: Find) -> StereoArrays | None:
    """Return the arrays of the one file that describes a rig, or else of all files, joined by name or by number."""
    rigs = [found for source, tree in trees.items() if (found := find(tree, source)) is not None]
    if len(rigs) < len(trees):
        # Beside other files, a file with only P or with K and a baseline may describe only one camera.
        rigs = [each for each in rigs if each.d and (each.pose is not None or each.rectification)]
    if len(rigs) > 1:
        text = f"{rigs[0].source} and {rigs[1].source} describe a rig each: give the files of one rig"
        raise InputError(text, argument="calib")
    if rigs or len(trees) == 1:
        return rigs[0] if rigs else None
    source, by_number = " and ".join(trees), joined([*trees.values()], [str(n) for n in range(1, len(trees) + 1)])
    return find(_whole(trees), source) or find(by_number, source)


def _renamed(tree: Tree, keys: Mapping[str, str]) -> Tree:
    """Return the values that ``keys`` select, under names that `aliases` knows, and the tree's texts.

    If no key selects a size, the sizes in the tree are returned too.
    """
    values = {".".join(name): value for name, value in tree.items()}
    for key, name in keys.items():
        if key not in _NAMES:
            raise InputError(f"{key}: expected one of {', '.join(_NAMES)}", argument="calib_keys")
        if name not in values:
            raise InputError(f"{key}: no value {name}; there are {listing(tree)}", argument="calib_keys")
    renamed: Tree = {name: value for name, value in tree.items() if isinstance(value, str)}
    if "size" not in keys:
        renamed |= {(camera, "size"): size for camera, size in find_arrays(tree).get("size", {}).items()}
    return renamed | {_NAMES[key]: values[name] for key, name in keys.items()}


def _whole(trees: Mapping[str, Tree]) -> Tree:
    """Return the values of all files; of several files, each value's name begins with its file's name."""
    if len(trees) == 1:
        return next(iter(trees.values()))
    names = [Path(source).stem for source in trees]
    if len({*names}) < len(names):
        names = [f"{Path(source).absolute().parent.name}.{Path(source).stem}" for source in trees]
    return joined([*trees.values()], names)


def _find(
    tree: Tree,
    source: str,
    *,
    cameras: tuple[str, str] | None,
    unit: str | None,
    size: ImageSize | None,
    adapters: Sequence[Adapter] = ADAPTERS,
) -> StereoArrays | None:
    """Return the arrays of a rig in a tree; None if it describes none."""
    try:
        if known := next((found for adapter in adapters if (found := adapter(tree, size)) is not None), None):
            if unit is not None and known.unit is not None:
                raise InputError(f"{source} states the unit: do not give one", argument="unit")
            tree, cameras, unit = known.tree, cameras or known.cameras, unit or known.unit
        arrays = find_stereo_arrays(tree, source, cameras, unit, size)
    except FormatError as error:
        raise ReadError(Path(source), str(error)) from None
    return arrays if arrays.is_rig else None
