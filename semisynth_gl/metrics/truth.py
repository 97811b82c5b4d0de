"""The true disparities of a set: a dataset of this program in any layout, or a benchmark's own folder."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from pathlib import Path, PurePosixPath
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.dataset.places import Place
from semisynth_gl.dataset.reader import INDEX, PLAN, Dataset, Index, open_dataset
from semisynth_gl.errors import InputError
from semisynth_gl.frame import VISIBLE
from semisynth_gl.metrics.protocol import UNLIMITED, Limits, ProtocolName
from semisynth_gl.read.calib import Calibration
from semisynth_gl.read.disparity import KITTI_PNG_SCALE, MAP_EXTENSIONS, read_disparity
from semisynth_gl.read.error import ReadError, read_bytes
from semisynth_gl.read.png import decode_grey, read_grey
from semisynth_gl.splits import SplitName

_CRESTEREO_PNG_SCALE = 32.0
_PROTOCOL_OF_LAYOUT: Mapping[str, ProtocolName] = {"kitti": "kitti", "eth3d": "eth3d"}
_OBJECTS_ROLE = "objects"
_OCC, _NOC, _OBJECTS = "disp_occ_0", "disp_noc_0", "obj_map"
# A folder of results, as KITTI's kit wants it.
_KITTI_RESULTS = "disp_0"
_SCENE_TRUTHS = ("disp0GT.pfm", "disp0.pfm")
_MASK = "mask0nocc"
_ETH3D = "two_view_training_gt"
_LARGEST_CALIB = 1 << 16

_Values = TypeVar("_Values", bound=np.generic)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is known of a pair's left view.

    Attributes:
        disparity: (H, W) float32 px, inf where there is none.
        visible: (H, W) bool, where the right view sees the point too; None where nothing says so.
        objects: (H, W) uint8, 0 in the background, as KITTI's obj_map; None where there is no such map.
        limits: of its disparities.
    """

    disparity: NDArray[np.float32]
    visible: NDArray[np.bool_] | None = None
    objects: NDArray[np.uint8] | None = None
    limits: Limits = UNLIMITED


@dataclass(frozen=True, slots=True, eq=False)
class TruePair:
    """A pair whose truth is there to be read.

    Attributes:
        name: one of a kind in its set.
        source: the truth's file, for messages.
        stems: names that a prediction for it may have, below the folder of predictions and without their ending, the
            most telling first; each with the levels of a 16-bit PNG of that name per pixel.
        read: reads it.
    """

    name: str
    source: str
    stems: Mapping[str, float]
    read: Callable[[], Truth]


@dataclass(frozen=True, slots=True)
class TrueSet:
    """The pairs of a set.

    Attributes:
        pairs: in their order.
        protocol: that of the benchmark whose form the set has.
        local: the folder, where it is a dataset of this program in one; None else.
    """

    pairs: Sequence[TruePair]
    protocol: ProtocolName
    local: Path | None = None


def find_truth(address: str, split: SplitName | None = None, masks: Path | None = None) -> TrueSet:
    """Find the true disparities of a set.

    Args:
        address: a dataset of this program, in any layout, in a folder or at an address that fsspec knows; KITTI 2015's
            ``training`` folder or the one above it; a folder with a disp0GT.pfm (or disp0.pfm) in each scene's folder,
            as Middlebury and ETH3D have; or a folder of disparity maps, one a pair.
        split: of a dataset of this program, which pairs; None for all.
        masks: folder of 8-bit masks, 255 where a pixel is not occluded, to be taken instead of the set's own.

    Raises:
        InputError: where there is nothing of this, names are not one of a kind, or a mask is missing.
    """
    folder = Path(address)
    if "://" in address or (folder / INDEX).is_file() or (folder / PLAN).is_file():
        found = _own(open_dataset(address, split), split)
    else:
        if not folder.is_dir():
            raise InputError(f"--gt {address}: {'is a file' if folder.exists() else 'there is no such folder'}")
        if split is not None:
            raise InputError(f"--split {split}: only datasets of this program have splits, and --gt {address} is none")
        found = _foreign(folder)
    pairs = _without_shared_stems(found.pairs)
    if masks is not None:
        pairs = [_masked(pair, masks) for pair in pairs]
    return replace(found, pairs=pairs)


def _own(dataset: Dataset, split_only: SplitName | None) -> TrueSet:
    about = dataset.about
    png_scale = _CRESTEREO_PNG_SCALE if about.encodings.disparity == "png16-32" else KITTI_PNG_SCALE
    several = len(about.pairs) > 1
    # The order of `Dataset`.
    keys = [
        (name, index) for name, count in about.pairs.items() if split_only in (None, name) for index in range(count)
    ]
    pairs = []
    for number, (split, index) in enumerate(keys):
        scene = about.key(split, index).scene
        path = about.files(split, index)["disparity_left"]
        stems = {f"{split}/{scene}": KITTI_PNG_SCALE} if several else {}
        stems |= {scene: KITTI_PNG_SCALE} | _tails(PurePosixPath(path), png_scale)
        pairs.append(
            TruePair(
                name=f"{split}/{scene}" if several and split_only is None else scene,
                source=str(about.place.path(path)),
                stems=stems,
                read=partial(_read_own, dataset, number, split, index),
            )
        )
    return TrueSet(pairs, _PROTOCOL_OF_LAYOUT.get(about.values["layout"], "middlebury"), about.place.local)


def _read_own(dataset: Dataset, number: int, split: SplitName, index: int) -> Truth:
    about = dataset.about
    frame = dataset[number]
    seen = frame.visibility_left
    # KITTI's map of objects is no array of a frame.
    path = about.files(split, index).get(_OBJECTS_ROLE)
    objects = None if path is None else _read_objects(about.place, path, frame.disparity_left)
    return Truth(
        disparity=frame.disparity_left,
        visible=None if seen is None else seen == VISIBLE,
        objects=objects,
        limits=_own_limits(frame.calibration, about),
    )


def _own_limits(calibration: Calibration | None, about: Index) -> Limits:
    if calibration is not None:
        return Limits(calibration.ndisp)
    # Layouts without calib.txt: what would stand there.
    largest = about.number("disparity", "max_px")
    return UNLIMITED if largest is None else Limits(ceil(largest))


def _read_objects(place: Place, name: str, disparity: NDArray[np.float32]) -> NDArray[np.uint8]:
    path = place.path(name)
    try:
        data = place.read(name)
    except FileNotFoundError:
        raise ReadError(path, "is missing") from None
    return _same_size(decode_grey(data, path), disparity, path, "its disparity")


def _foreign(folder: Path) -> TrueSet:
    for root in (folder, folder / "training"):
        if (root / _OCC).is_dir():
            pairs = [_kitti_pair(root, path) for path in sorted((root / _OCC).glob("*.png"))]
            return _checked(pairs, folder, "kitti")
    for name in _SCENE_TRUTHS:
        paths = sorted(folder.rglob(name))
        if paths:
            pairs = [_scene_pair(folder, path) for path in paths]
            is_eth3d = any(_ETH3D in path.absolute().parts for path in paths)
            return _checked(pairs, folder, "eth3d" if is_eth3d else "middlebury")
    pairs = [
        TruePair(path.stem, str(path), {path.stem: KITTI_PNG_SCALE}, partial(_read_plain, path))
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in MAP_EXTENSIONS
    ]
    return _checked(pairs, folder, "middlebury")


def _checked(pairs: list[TruePair], folder: Path, protocol: ProtocolName) -> TrueSet:
    if not pairs:
        raise InputError(
            f"--gt {folder}: no true disparities there: expected a dataset of this program, KITTI's {_OCC}, a "
            f"{_SCENE_TRUTHS[0]} in each scene's folder, or .pfm, .npy or 16-bit .png files"
        )
    for name, count in Counter(pair.name for pair in pairs).items():
        if count > 1:
            sources = [pair.source for pair in pairs if pair.name == name]
            raise InputError(
                f"--gt {folder}: {count} truths for {name}: {', '.join(sources[:3])}: give the folder of one size, or "
                "keep one file"
            )
    return TrueSet(pairs, protocol)


def _kitti_pair(root: Path, path: Path) -> TruePair:
    stems = {f"{_KITTI_RESULTS}/{path.stem}": KITTI_PNG_SCALE} | _tails(PurePosixPath(_OCC, path.name), KITTI_PNG_SCALE)
    return TruePair(path.stem, str(path), stems, partial(_read_kitti, root, path))


def _read_kitti(root: Path, path: Path) -> Truth:
    disparity = read_disparity(path)
    not_occluded, objects = root / _NOC / path.name, root / _OBJECTS / path.name
    seen = None
    if not_occluded.is_file():
        seen = np.isfinite(_same_size(read_disparity(not_occluded), disparity, not_occluded, path))
    held = _same_size(read_grey(objects), disparity, objects, path) if objects.is_file() else None
    return Truth(disparity, seen, held)


def _scene_pair(folder: Path, path: Path) -> TruePair:
    name = path.absolute().parent.name
    stems = {name: KITTI_PNG_SCALE} | _tails(PurePosixPath(path.relative_to(folder).as_posix()), KITTI_PNG_SCALE)
    if path.parent == folder:
        stems = {name: KITTI_PNG_SCALE, path.stem: KITTI_PNG_SCALE}
    return TruePair(name, str(path), stems, partial(_read_scene, path))


def _read_scene(path: Path) -> Truth:
    disparity = read_disparity(path)
    mask, calibration = path.with_name(f"{_MASK}.png"), path.with_name("calib.txt")
    seen = _same_size(read_grey(mask), disparity, mask, path) == VISIBLE if mask.is_file() else None
    return Truth(disparity, seen, None, read_limits(calibration) if calibration.is_file() else UNLIMITED)


def _read_plain(path: Path) -> Truth:
    return Truth(read_disparity(path))


def read_limits(path: Path) -> Limits:
    """Read ndisp and isint of a calib.txt of Middlebury or ETH3D, which may lack either.

    Raises:
        ReadError: where they are no numbers.
    """
    text = read_bytes(path)[:_LARGEST_CALIB].decode("utf-8", "replace")
    values = dict(re.findall(r"^[ \t]*(ndisp|isint)[ \t]*=[ \t]*(.*?)[ \t\r]*$", text, re.MULTILINE))
    try:
        numbers = {key: int(value) for key, value in values.items()}
    except ValueError:
        raise ReadError(path, f"expected whole numbers as ndisp and isint, got {values}") from None
    if numbers.get("ndisp", 1) <= 0:
        raise ReadError(path, f"ndisp: expected a number above 0, got {values['ndisp']}")
    return Limits(numbers.get("ndisp"), bool(numbers.get("isint")))


def _masked(pair: TruePair, masks: Path) -> TruePair:
    stems = [
        str(PurePosixPath(stem).with_name(_MASK)) if PurePosixPath(stem).name in ("disp0GT", "disp0") else stem
        for stem in pair.stems
    ]
    found = next((path for path in (masks / f"{stem}.png" for stem in stems) if path.is_file()), None)
    if found is None:
        raise InputError(f"--mask {masks}: no mask for {pair.name}: expected {masks / f'{stems[0]}.png'}")
    return replace(pair, read=partial(_read_masked, pair, found))


def _read_masked(pair: TruePair, mask: Path) -> Truth:
    truth = pair.read()
    return replace(truth, visible=_same_size(read_grey(mask), truth.disparity, mask, Path(pair.source)) == VISIBLE)


def _same_size(
    values: NDArray[_Values], truth: NDArray[np.float32], path: Path, beside: Path | str
) -> NDArray[_Values]:
    if values.shape != truth.shape:
        (height, width), (true_height, true_width) = values.shape, truth.shape
        raise ReadError(
            path, f"has {width} x {height} pixels, {beside} {true_width} x {true_height}: expected the same size"
        )
    return values


def _tails(path: PurePosixPath, png_scale: float) -> dict[str, float]:
    """A file's path without its ending, then without its first folder, and so on."""
    parts = (*path.parts[:-1], path.stem)
    tails = {"/".join(parts[first:]): png_scale for first in range(len(parts))}
    # "000000_left.disp" is also the disparity of "000000_left".
    return tails | {path.name.partition(".")[0]: KITTI_PNG_SCALE} if "." in path.stem else tails


def _without_shared_stems(pairs: Sequence[TruePair]) -> list[TruePair]:
    """Drop names that would be of several pairs, such as disp0GT."""
    shared = Counter(stem for pair in pairs for stem in pair.stems)
    return [
        replace(pair, stems={stem: png_scale for stem, png_scale in pair.stems.items() if shared[stem] == 1})
        for pair in pairs
    ]
