"""The true disparities of a set: a dataset of this program in any layout, or a benchmark's own folder."""

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from pathlib import Path, PurePosixPath
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs import read_bytes
from semisynth_gl.codecs.calib import calib_values
from semisynth_gl.codecs.disparity_map import MAP_EXTENSIONS, read_disparity_map
from semisynth_gl.codecs.png import GREY8
from semisynth_gl.codecs.png16 import KITTI_DISPARITY, DisparityPng16
from semisynth_gl.dataset.names import INDEX, PLAN
from semisynth_gl.dataset.reader import Dataset, open_dataset
from semisynth_gl.dataset.root import path_of, read_whole
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.inputs.errors import InputError, ReadError, cut, no_folder
from semisynth_gl.judge.protocol import UNLIMITED, Limits, ProtocolName, shown_size
from semisynth_gl.seeds.splits import SplitName

_PROTOCOL_OF_LAYOUT: Mapping[str, ProtocolName] = {"kitti": "kitti", "eth3d": "eth3d"}
_OBJECTS_ROLE = "objects"
_OCC, _NOC, _OBJECTS = "disp_occ_0", "disp_noc_0", "obj_map"
# The folder of results that KITTI's kit asks for.
_KITTI_RESULTS = "disp_0"
SCENE_STEMS = ("disp0GT", "disp0")
"""Names of the truth in a scene's folder, without extension; a set's truth is the first of these that it has."""
_SCENE_TRUTHS = tuple(f"{stem}.pfm" for stem in SCENE_STEMS)
_MASK = "mask0nocc"
_ETH3D = "two_view_training_gt"
_LARGEST_CALIB = 1 << 16
_LARGEST_NDISP = 1_000_000

_Values = TypeVar("_Values", bound=np.generic)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The truth of a pair's left view; all arrays are (H, W).

    Attributes:
        disparity: px, inf where unknown.
        visible: True where the right view sees the point too; None where the set has no mask.
        objects: 0 in the background, the number of an object elsewhere, as in KITTI's obj_map; None without such a map.
        limits: the limits of the disparities.
    """

    disparity: NDArray[np.float32]
    visible: NDArray[np.bool_] | None = None
    objects: NDArray[np.uint8] | None = None
    limits: Limits = UNLIMITED


@dataclass(frozen=True, slots=True, eq=False)
class TruePair:
    """A pair with its truth.

    Attributes:
        name: unique in the set.
        source: the truth's file, for messages.
        stems: paths that a prediction may have, without extension, the most specific first.
        read: reads the truth; raises ReadError where a file cannot be read.
        png_scale: levels of a 16-bit PNG with a prediction per pixel of disparity.
        signed: whether disparities of 0 and below are valid.
    """

    name: str
    source: str
    stems: Sequence[str]
    read: Callable[[], Truth]
    png_scale: float = KITTI_DISPARITY.steps
    signed: bool = False


@dataclass(frozen=True, slots=True)
class TrueSet:
    """The pairs of a set, and the benchmark whose layout it has."""

    pairs: Sequence[TruePair]
    protocol: ProtocolName


def find_truth(address: str, split: SplitName | None = None, masks: Path | None = None) -> TrueSet:
    """Find the true disparities of a set.

    Args:
        address: a dataset of this program, in any layout, in a folder or at an address that fsspec knows; KITTI 2015's
            ``training`` folder or its parent; a folder with a disp0GT.pfm (or disp0.pfm) in each scene's subfolder, as
            in Middlebury and ETH3D; or a folder with a disparity map for each pair.
        split: a split of a dataset of this program; None for all pairs.
        masks: a folder of 8-bit masks, 255 where not occluded, to use instead of the set's own masks.

    Raises:
        InputError: where there is no such set or split, names are not unique, or a mask is missing.
    """
    folder = Path(address)
    if "://" in address or (folder / INDEX).is_file() or (folder / PLAN).is_file():
        truths = _dataset_truths(open_dataset(address, split), split)
    else:
        if not folder.is_dir():
            raise no_folder(folder, "truth")
        if split is not None:
            raise InputError(f"{address} has no splits, since this program did not write it", argument="split")
        truths = _folder_truths(folder)
    # A name that several pairs have, such as disp0GT, identifies none of them.
    counts = Counter(stem for pair in truths.pairs for stem in pair.stems)
    pairs = [replace(pair, stems=[stem for stem in pair.stems if counts[stem] == 1]) for pair in truths.pairs]
    return replace(truths, pairs=pairs if masks is None else [_with_mask(pair, masks) for pair in pairs])


def _dataset_truths(dataset: Dataset, only_split: SplitName | None) -> TrueSet:
    index = dataset.about
    codec = index.plan.encodings.disparity
    png_scale = codec.steps if isinstance(codec, DisparityPng16) else KITTI_DISPARITY.steps
    several = len(index.plan.pairs) > 1
    pairs, root = [], index.root
    for place in range(len(dataset)):
        split, number = dataset.pair(place)
        scene = index.plan.key(split, number).name
        path = index.plan.files(split, number)["disparity_left"]
        stems = _named(f"{split}/{scene}" if several else scene, scene, *_path_stems(PurePosixPath(path)))
        name = f"{split}/{scene}" if several and only_split is None else scene
        read = partial(_read_pair, dataset, place)
        pairs.append(TruePair(name, str(path_of(root, path)), stems, read, png_scale, index.signed))
    return TrueSet(pairs, _PROTOCOL_OF_LAYOUT.get(index.plan.layout_name, "middlebury"))


def _read_pair(dataset: Dataset, place: int) -> Truth:
    index, frame = dataset.about, dataset[place]
    disparity, visibility = frame.left.disparity, frame.left.get("visibility")
    # A frame has no array for KITTI's map of objects.
    name = index.plan.files(*dataset.pair(place)).get(_OBJECTS_ROLE)
    objects = None
    if name is not None:
        path = path_of(index.root, name)
        objects = _same_size(GREY8.decode(read_whole(index.root, name), path), disparity, path, "its disparity")
    if frame.calibration is not None:
        limits = Limits(frame.calibration.ndisp, signed=index.signed)
    else:
        # In layouts without calib.txt, ndisp is the number that calib.txt would have.
        limits = Limits(max(1, ceil(index.plan.config.disparity.max_px)), signed=index.signed)
    return Truth(disparity, None if visibility is None else visibility == VISIBLE, objects, limits)


def _folder_truths(folder: Path) -> TrueSet:
    protocol: ProtocolName = "middlebury"
    root = next((root for root in (folder, folder / "training") if (root / _OCC).is_dir()), None)
    if root is not None:
        pairs = [_kitti_pair(root, path) for path in sorted((root / _OCC).glob("*.png"))]
        protocol = "kitti"
    elif scenes := _find_scenes(folder):
        pairs = [_scene_pair(folder, path) for path in scenes]
        if any(_ETH3D in path.absolute().parts for path in scenes):
            protocol = "eth3d"
    else:
        pairs = [_map_pair(path) for path in sorted(folder.iterdir()) if path.suffix.lower() in MAP_EXTENSIONS]
    if not pairs:
        raise InputError(
            f"{folder}: no true disparities there: expected a dataset of this program, KITTI's {_OCC}, a "
            f"{_SCENE_TRUTHS[0]} in each scene's folder, or .pfm, .npy or 16-bit .png files",
            argument="truth",
        )
    for name, count in Counter(pair.name for pair in pairs).items():
        if count > 1:
            sources = [pair.source for pair in pairs if pair.name == name]
            raise InputError(
                f"{folder}: {count} truths for {name}: {', '.join(sources[:3])}: give the folder of one size, or keep "
                "one file",
                argument="truth",
            )
    return TrueSet(pairs, protocol)


def _find_scenes(folder: Path) -> list[Path]:
    """Return the file of each scene's truth below a folder, sorted; folders may be links, each is visited once."""
    found: dict[str, list[Path]] = {name: [] for name in _SCENE_TRUTHS}
    seen: set[Path] = set()
    for parent, folders, files in os.walk(folder, followlinks=True):
        place = Path(parent)
        if place.resolve() in seen:
            folders.clear()
            continue
        seen.add(place.resolve())
        for name in found.keys() & set(files):
            found[name].append(place / name)
    return next((sorted(paths) for paths in found.values() if paths), [])


def _kitti_pair(root: Path, path: Path) -> TruePair:
    stems = _named(f"{_KITTI_RESULTS}/{path.stem}", *_path_stems(PurePosixPath(_OCC, path.name)))
    return TruePair(path.stem, str(path), stems, partial(_read_kitti, root, path))


def _read_kitti(root: Path, path: Path) -> Truth:
    disparity, not_occluded = read_disparity_map(path), root / _NOC / path.name
    visible = None
    if not_occluded.is_file():
        visible = np.isfinite(_same_size(read_disparity_map(not_occluded), disparity, not_occluded, path))
    return Truth(disparity, visible, _grey_map(root / _OBJECTS / path.name, disparity, path))


def _scene_pair(folder: Path, path: Path) -> TruePair:
    name = path.absolute().parent.name
    if path.parent == folder:
        stems = _named(name, path.stem)
    else:
        stems = _named(*_path_stems(PurePosixPath(path.relative_to(folder).as_posix())), name)
    return TruePair(name, str(path), stems, partial(_read_scene, path))


def _read_scene(path: Path) -> Truth:
    disparity, calibration = read_disparity_map(path), path.with_name("calib.txt")
    mask = _grey_map(path.with_name(f"{_MASK}.png"), disparity, path)
    limits = read_limits(calibration) if calibration.is_file() else UNLIMITED
    return Truth(disparity, None if mask is None else mask == VISIBLE, limits=limits)


def _map_pair(path: Path) -> TruePair:
    return TruePair(path.stem, str(path), [path.stem], partial(_read_map, path))


def _read_map(path: Path) -> Truth:
    return Truth(read_disparity_map(path))


def read_limits(path: Path) -> Limits:
    """Read ndisp and isint from a calib.txt of Middlebury or ETH3D; either may be missing.

    Raises:
        ReadError: where the file cannot be read, or a value is not a whole number or out of range.
    """
    values = calib_values(read_bytes(path, _LARGEST_CALIB).decode("utf-8", "replace"))
    ndisp, isint = (_whole(path, key, values[key]) if key in values else None for key in ("ndisp", "isint"))
    if ndisp is not None and not 0 < ndisp <= _LARGEST_NDISP:
        raise ReadError(
            path, f"ndisp: expected a number from 1 to {_LARGEST_NDISP}, got {cut(values['ndisp'].strip())}"
        )
    return Limits(ndisp, bool(isint))


def _whole(path: Path, key: str, text: str) -> int:
    try:
        # Some programs write a whole number as 64.0.
        number = float(text)
        if number.is_integer():
            return int(number)
    except ValueError:
        pass
    raise ReadError(path, f"{key}: expected a whole number, got {cut(text.strip())}")


def _with_mask(pair: TruePair, masks: Path) -> TruePair:
    stems = map(PurePosixPath, pair.stems)
    paths = [masks / f"{stem.with_name(_MASK) if stem.name in SCENE_STEMS else stem}.png" for stem in stems]
    mask = next((path for path in paths if path.is_file()), None)
    if mask is None:
        raise InputError(f"{masks}: no mask for {pair.name}: expected {paths[0]}", argument="masks")

    def read() -> Truth:
        truth = pair.read()
        return replace(truth, visible=_same_size(GREY8.read(mask), truth.disparity, mask, pair.source) == VISIBLE)

    return replace(pair, read=read)


def _same_size(
    values: NDArray[_Values], truth: NDArray[np.float32], path: Path, beside: Path | str
) -> NDArray[_Values]:
    if values.shape != truth.shape:
        sizes = f"has {shown_size(values)} pixels, {beside} {shown_size(truth)}"
        raise ReadError(path, f"{sizes}: expected the same size")
    return values


def _grey_map(path: Path, truth: NDArray[np.float32], beside: Path) -> NDArray[np.uint8] | None:
    """Return the 8-bit map of a file, which must have the truth's size; None where there is no such file."""
    return _same_size(GREY8.read(path), truth, path, beside) if path.is_file() else None


def _path_stems(path: PurePosixPath) -> list[str]:
    """Return a path without extension, with all of its folders, without the first, and so on."""
    parts = (*path.parts[:-1], path.stem)
    stems = ["/".join(parts[first:]) for first in range(len(parts))]
    # "000000_left.disp" is also the disparity of "000000_left".
    return [*stems, path.name.partition(".")[0]]


def _named(*stems: str) -> list[str]:
    """Return names in their order, each once."""
    return list(dict.fromkeys(stems))
