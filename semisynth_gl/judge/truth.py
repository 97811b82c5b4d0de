"""Finds the true disparities of a dataset or a benchmark, and the files with predictions for its pairs."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from glob import glob
from math import ceil
from pathlib import Path, PurePath, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.codecs import read_bytes
from semisynth_gl.codecs.calib import calib_values
from semisynth_gl.codecs.disparity_map import MAP_EXTENSIONS, is_disparity_map, read_disparity_map
from semisynth_gl.codecs.png import GREY8, GREY16
from semisynth_gl.codecs.png16 import KITTI_DISPARITY, DisparityPng16
from semisynth_gl.dataset.documents import INDEX, PLAN
from semisynth_gl.dataset.reader import Dataset, open_dataset
from semisynth_gl.dataset.root import read_whole, shown_path
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.inputs.errors import InputError, ReadError, abbreviate, counted, cut
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.judge.protocol import ProtocolName, Truth
from semisynth_gl.seeds.splits import SplitName

# Names of the true map in scenes' folders. The first name that a benchmark's folder has is used for all its scenes.
_SCENE_TRUTHS = ("disp0GT.pfm", "disp0.pfm")
_OCC = "disp_occ_0"
# The protocol for the layouts of a benchmark; for other layouts, Middlebury's.
_PROTOCOLS: dict[str, ProtocolName] = {"kitti": "kitti", "eth3d": "eth3d"}
_LARGEST_CALIB = 1 << 16


class TruthSource(NamedTuple):
    """The truth of a pair: the pair's unique ``name``, the ``source`` file, and ``read``, which may raise ReadError.

    A prediction for the pair may have any of the ``keys`` as its name, see `find_predictions`.
    """

    name: str
    source: str
    keys: Sequence[str]
    read: Callable[[], Truth]


class TruthSet(NamedTuple):
    """The truths of several pairs, the default protocol, and the levels per px of predictions in 16-bit PNG."""

    pairs: Sequence[TruthSource]
    protocol: ProtocolName = "middlebury"
    png_scale: float = KITTI_DISPARITY.steps


def find_truth(address: str, split: SplitName | None = None) -> TruthSet:
    """Find the true disparities of a dataset or a benchmark.

    The ``address`` is a dataset of this program, in any layout, in a folder or at an address that fsspec knows; KITTI
    2015's ``training`` folder or its parent; a folder with a disp0GT.pfm (or disp0.pfm) in each scene's subfolder, as
    in Middlebury and ETH3D; or a folder with a disparity map for each pair. Only a dataset of this program can have a
    ``split``. Raises InputError without true disparities or without the split, and if pairs' names are not unique.
    """
    folder = expanded(address)
    if "://" in address or (folder / INDEX).is_file() or (folder / PLAN).is_file():
        found = _dataset_truth(open_dataset(address, split), split)
    elif split is not None:
        raise InputError(f"{address} has no splits, since this program did not write it", argument="split")
    else:
        found = _folder_truth(folder)
    if not found.pairs:
        expected = f"a dataset of this program, KITTI's {_OCC}, a {_SCENE_TRUTHS[0]} in each scene's folder, or maps"
        raise InputError(f"{folder}: no true disparities there: expected {expected}", argument="truth")
    name, count = Counter(pair.name for pair in found.pairs).most_common(1)[0]
    if count > 1:
        raise InputError(
            f"{folder}: {count} truths for {name}: give the folder of one size, such as trainingF", argument="truth"
        )
    return found


def find_predictions(folder: Path, pairs: Sequence[TruthSource]) -> list[Path]:
    """Return the file of the prediction for each pair.

    A prediction's path in the folder is one of the pair's keys, with the extension .pfm, .npy or .png (16-bit grey). If
    files have several of the keys, the first key is used. Instead of ``KEY.pfm``, the path may also be
    ``KEY/disp0<METHOD>.pfm``, as Middlebury asks for; a true map in that folder is ignored.

    Raises:
        InputError: where the folder does not exist, or a pair has several predictions or none.
        ReadError: where the only file for a pair is a PNG that is not 16-bit grey.
    """
    files: dict[str, list[Path]] = {}
    for path in disparity_maps(folder, "predictions"):
        files.setdefault(_keys(path.relative_to(folder))[0], []).append(path)
    # A key that several pairs share identifies none of them.
    pairs_with = Counter(key for pair in pairs for key in set(pair.keys))
    found, missing = list[Path](), list[str]()
    for pair in pairs:
        paths = next((files[key] for key in pair.keys if key in files and pairs_with[key] == 1), [])
        paths = [path for path in paths if path.name not in _SCENE_TRUTHS] or paths
        if len(paths) > 1:
            names = abbreviate([path.name for path in paths])
            raise InputError(f"{len(paths)} predictions for {pair.name}: {names}: keep one", argument="predictions")
        found += paths
        missing += [] if paths else [pair.name]
    if missing:
        candidates = [path for path in _files(folder, "*.*") if path.suffix.lower() in MAP_EXTENSIONS]
        keys = {key for pair in pairs if pair.name in missing for key in pair.keys}
        for path in candidates:
            if _keys(path.relative_to(folder))[0] in keys and not is_disparity_map(path):
                GREY16.read(path)  # raises ReadError, which says what the PNG is instead
        spare = (f"; {path.relative_to(folder)} has no pair's name" for path in candidates if path not in found)
        raise InputError(
            f"{folder}: no prediction for {len(missing)} of {counted(len(pairs), 'pair')}: {abbreviate(missing)}: "
            f"expected {missing[0]}.pfm, .npy or 16-bit .png{next(spare, '')}",
            argument="predictions",
        )
    return found


def disparity_maps(folder: Path, argument: str) -> list[Path]:
    """Return the disparity maps of a folder and its subfolders, sorted.

    Raises InputError about ``argument`` if the folder does not exist, and ReadError if a PNG cannot be read.
    """
    if not folder.is_dir():
        found = "is a file" if folder.exists() else "there is no such folder"
        raise InputError(f"{folder}: {found}", argument=argument)
    return [path for path in _files(folder, "*.*") if path.suffix.lower() in MAP_EXTENSIONS and is_disparity_map(path)]


def _files(folder: Path, pattern: str) -> list[Path]:
    """Return the files that match a pattern in a folder, its subfolders and linked folders, sorted."""
    # `Path.glob` does not follow links.
    return [folder / name for name in sorted(glob(f"**/{pattern}", root_dir=folder, recursive=True))]  # noqa: PTH207


def _dataset_truth(dataset: Dataset, only_split: SplitName | None) -> TruthSet:
    root, plan = dataset.index.root, dataset.index.plan
    pairs = []
    for position in range(len(dataset)):
        split, number = dataset.pair(position)
        plain, path = plan.key(split, number).name, plan.files(split, number)["disparity_left"]
        name = plain if only_split or len(plan.pairs) == 1 else f"{split}/{plain}"
        keys = [f"{split}/{plain}", plain, *_keys(PurePosixPath(path))]
        pairs.append(TruthSource(name, str(shown_path(root, path)), keys, partial(_read_pair, dataset, position)))
    codec = plan.encodings.disparity
    png_scale = codec.steps if isinstance(codec, DisparityPng16) else KITTI_DISPARITY.steps
    return TruthSet(pairs, _PROTOCOLS.get(plan.layout_name, "middlebury"), png_scale)


def _read_pair(dataset: Dataset, position: int) -> Truth:
    index, left = dataset.index, dataset[position].left
    visibility = left.get("visibility")
    # A frame has no array for KITTI's map of objects.
    name = index.plan.files(*dataset.pair(position)).get("objects")
    objects = None if name is None else GREY8.decode(read_whole(index.root, name), shown_path(index.root, name))
    visible = None if visibility is None else visibility == VISIBLE
    ndisp = max(1, ceil(index.plan.config.disparity.max_px))
    return Truth(left.disparity, visible, objects, ndisp, signed=index.plan.encodings.signed)


def _folder_truth(folder: Path) -> TruthSet:
    def pairs(paths: Sequence[Path], read: Callable[[Path], Truth]) -> list[TruthSource]:
        keys = [_keys(path.absolute()) for path in paths]
        return [TruthSource(of[-1], str(path), of, partial(read, path)) for path, of in zip(paths, keys, strict=True)]

    for root in (folder, folder / "training"):
        if paths := sorted((root / _OCC).glob("*.png")):
            return TruthSet(pairs(paths, _read_kitti), "kitti")
    for name in _SCENE_TRUTHS:
        if paths := _files(folder, name):
            eth3d = any("two_view_training_gt" in path.absolute().parts for path in paths)
            return TruthSet(pairs(paths, _read_scene), "eth3d" if eth3d else "middlebury")
    maps = [path for path in disparity_maps(folder, "truth") if path.parent == folder]
    return TruthSet(pairs(maps, lambda path: Truth(read_disparity_map(path))))


def _read_kitti(path: Path) -> Truth:
    not_occluded, objects = (path.parents[1] / folder / path.name for folder in ("disp_noc_0", "obj_map"))
    return Truth(
        read_disparity_map(path),
        np.isfinite(read_disparity_map(not_occluded)) if not_occluded.is_file() else None,
        GREY8.read(objects) if objects.is_file() else None,
    )


def _read_scene(path: Path) -> Truth:
    mask, calibration = path.with_name("mask0nocc.png"), path.with_name("calib.txt")
    return Truth(
        read_disparity_map(path),
        GREY8.read(mask) == VISIBLE if mask.is_file() else None,
        **(read_limits(calibration) if calibration.is_file() else {}),
    )


def read_limits(path: Path) -> dict[str, Any]:
    """Read ``ndisp`` and ``isint`` of a `Truth` from a calib.txt of Middlebury or ETH3D; either may be missing.

    Raises ReadError if the file cannot be read, or a value is not a whole number of at most six digits.
    """
    values = calib_values(read_bytes(path, _LARGEST_CALIB).decode("utf-8", "replace"))
    for key in ("ndisp", "isint"):
        # Some programs write a whole number as 64.0.
        if not re.fullmatch(r"\d{1,6}(\.0*)?", values.setdefault(key, "0")):
            raise ReadError(path, f"{key}: expected a whole number, got {cut(values[key])}")
    return {"ndisp": int(float(values["ndisp"])) or None, "isint": bool(float(values["isint"]))}


def _keys(path: PurePath) -> list[str]:
    """Return the keys of a map: a/b/c.pfm has a/b/c, b/c and c.

    A map a/b/disp0<METHOD>.pfm has a/b and b. A name of disp and two or more digits is a number, not a method. The
    .disp of c.disp.pfm is dropped.
    """
    named_by_folder = path.stem.startswith("disp0") and not re.fullmatch(r"disp\d{2,}", path.stem)
    path = path.parent if named_by_folder else path.with_suffix("")
    parts = str(path.as_posix()).removesuffix(".disp").split("/")
    return ["/".join(parts[first:]) for first in range(len(parts))]
