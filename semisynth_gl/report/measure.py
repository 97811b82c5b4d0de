"""A sample of a dataset's pairs, measured: from their files, and with rays through their scenes made again."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import sqrt
from typing import cast

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from semisynth_gl import oracle
from semisynth_gl.config import Config
from semisynth_gl.dataset.reader import Dataset, Index
from semisynth_gl.dataset.remake import RemadeScenes
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.errors import InputError, SemisynthError
from semisynth_gl.frame import OCCLUDED
from semisynth_gl.histogram import Histogram, PixelCount
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.report.redraws import PairKey
from semisynth_gl.report.surfaces import diameters_px, surfaces_at
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.structures import STILL_MODELS
from semisynth_gl.scene.target import target_of
from semisynth_gl.splits import SplitName
from semisynth_gl.textures.crops import texture_measure

RAYS = 1000
"""About how many rays are cast in each pair, on a square grid over the left view."""

# So many scenes are made again at most: casting rays takes several times as long as reading a pair.
_SCENES = 64
# What the renderer promises for disparity at a pixel's centre.
_ERROR_PX = 1e-3
# Pixels beside edges may show the surface on the other side. Of another scene, a few rays agree by chance.
_LEAST_AGREEING = 0.9
# Disparities are counted in bins so narrow that the distance of two distributions does not depend on them.
_BINS = 1024


@dataclass(frozen=True, slots=True)
class PairMeasures:
    """What is said of one pair.

    Attributes:
        position: its number in the sequence of all pairs.
        key: its split, and its number there.
        name: what the reader calls it, with the split where there are several.
        median_px: median disparity of the left view; NaN where no pixel has one.
        occluded: share of the left view's pixels that something hides from the right one; None without a mask.
        invalid: share of the left view's pixels without disparity.
        texture: texture measure of the flatter image as it is stored, in levels; the config's ``checks.min_texture``
            takes the same before imperfections.
        redraws: how often it was drawn again.
    """

    position: int
    key: PairKey
    name: str
    median_px: float
    occluded: float | None
    invalid: float
    texture: float
    redraws: int


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """What the rays through the remade scenes have found, in the sampled pairs together.

    Attributes:
        asked: how many scenes were to be made again, evenly spread over the measured pairs.
        pairs: in how many of them rays were cast.
        cast: how many rays.
        agreeing: how many found the disparity that the file has; the others are left out.
        spacing_px: their distance in the pair's pixels.
        slant_deg: (R,) float64, of each agreeing ray; see `Surfaces`.
        texels_per_pixel: (R,) float64, likewise.
        diameter_px: (I,) float64, of each falling model that a ray hits, once for each pair; see `diameters_px`.
        faults: why scenes were left out, and how many pairs for each reason.
    """

    asked: int
    pairs: int
    cast: int
    agreeing: int
    spacing_px: int
    slant_deg: NDArray[np.float64]
    texels_per_pixel: NDArray[np.float64]
    diameter_px: NDArray[np.float64]
    faults: Mapping[str, int]


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """A measured sample of a dataset.

    Attributes:
        of_pairs: how many pairs it was taken from.
        pairs: what each sampled pair has, those that could not be read left out.
        unread: what was wrong with those.
        disparity: of all pixels of the left views that have one; None where none has.
        target: what the config asks for; None where this version cannot tell.
        target_fault: why it cannot.
        depth_m: (D,) float64 planar depth of the grid's pixels, from the stored disparity.
        rays: what was found in the scenes.
    """

    of_pairs: int
    pairs: tuple[PairMeasures, ...]
    unread: tuple[str, ...]
    disparity: Histogram | None
    target: Histogram | None
    target_fault: str | None
    depth_m: NDArray[np.float64]
    rays: Rays


def spread(count: int, wanted: int) -> list[int]:
    """Return ``wanted`` numbers below ``count``, or all of them, evenly spread and rising."""
    wanted = min(count, wanted)
    return [(2 * number + 1) * count // (2 * wanted) for number in range(wanted)]


def target_histogram(index: Index) -> Histogram:
    """Return the distribution of disparity that a dataset's config asks for.

    Raises:
        InputError: where the config in the index is none of this version's.
    """
    try:
        config = Config.model_validate(index.config)
    except ValidationError as error:
        reason = "; ".join(str(error).splitlines()[:3])
        raise InputError(f"the config in the index is not one of this version: {reason}") from None
    return target_of(config.disparity, config.camera)


def measure(
    dataset: Dataset,
    positions: Sequence[int],
    redraws: Mapping[PairKey, Sequence[str]],
    listener: Listener | None = None,
) -> Measurement:
    """Read pairs and measure them.

    Args:
        dataset: the dataset, or a split of it.
        positions: which pairs.
        redraws: what was wrong with failed attempts, by pair.
        listener: hears the number of pairs, and each measured pair.

    Raises:
        InputError: where no pair can be read.
    """
    index = dataset.about
    listener = listener or Listener()
    listener.on_total(len(positions))
    target, fault = None, None
    try:
        target = target_histogram(index)
    except InputError as error:
        fault = str(error)
    caster = _RayCaster(index)
    count: PixelCount | None = None
    pairs, unread, depths = [], [], []
    with_rays = {positions[number] for number in spread(len(positions), _SCENES)}
    for position in positions:
        try:
            frame = dataset[position]
        except SemisynthError as error:
            unread.append(str(error))
        else:
            count = count or PixelCount(_edges(index, target, frame))
            count.add(frame.disparity_left)
            pairs.append(_measure_pair(index, position, frame, redraws))
            x, y = grid_of(frame)
            disparity = frame.disparity_left[y, x].astype(np.float64)
            depths.append(frame.camera.depth_m(disparity[np.isfinite(disparity)]))
            if position in with_rays:
                caster.cast(frame, x, y)
        listener.on_pair(FinishedPair(*dataset.pair(position)))
    if not pairs:
        raise InputError(
            f"{index.place.address}: no pair could be read; of the first: {(unread or ['there is none'])[0]}"
        )
    return Measurement(
        of_pairs=len(dataset),
        pairs=tuple(pairs),
        unread=tuple(unread),
        disparity=count.histogram if count is not None and count.counts.any() else None,
        target=target,
        target_fault=fault,
        depth_m=np.concatenate(depths),
        rays=caster.rays(),
    )


def grid_of(frame: StoredFrame) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return columns and rows of about `RAYS` pixels of a frame on a square grid, both (R,) int64."""
    height, width = frame.disparity_left.shape
    step = spacing_px(height, width)
    x, y = np.meshgrid(np.arange(step // 2, width, step), np.arange(step // 2, height, step))
    return x.ravel(), y.ravel()


def spacing_px(height: int, width: int) -> int:
    """Return the distance of the grid's pixels."""
    return max(1, round(sqrt(height * width / RAYS)))


def _edges(index: Index, target: Histogram | None, frame: StoredFrame) -> NDArray[np.float64]:
    """Bins from 0 to the config's limit, or to the image's width where it names none, and the target's edges."""
    of_target = [] if target is None else target.edges_px.tolist()
    high = max([index.number("disparity", "max_px") or frame.disparity_left.shape[1], *of_target])
    low = min([0.0, *of_target])
    return np.union1d(np.linspace(low, high, _BINS + 1), of_target)


def _measure_pair(
    index: Index, position: int, frame: StoredFrame, redraws: Mapping[PairKey, Sequence[str]]
) -> PairMeasures:
    split = cast("SplitName", frame.split)
    valid = frame.disparity_left[np.isfinite(frame.disparity_left)]
    mask = frame.visibility_left
    texture = min(texture_measure(np.ascontiguousarray(image[::2, ::2])) for image in (frame.left, frame.right))
    return PairMeasures(
        position=position,
        key=(split, frame.index),
        name=frame.name if len(index.pairs) == 1 else f"{split} {frame.name}",
        median_px=float(np.median(valid)) if valid.size else float("nan"),
        occluded=None if mask is None else float((mask == OCCLUDED).mean()),
        invalid=1 - valid.size / frame.disparity_left.size,
        texture=texture,
        redraws=len(redraws.get((split, frame.index), ())),
    )


@dataclass(slots=True)
class _RayCaster:
    """Casts rays through remade scenes and collects what they find."""

    index: Index
    asked: int = 0
    pairs: int = 0
    total: int = 0
    agreeing: int = 0
    spacing_px: int = 0
    slants: list[NDArray[np.float64]] = field(default_factory=list)
    texels: list[NDArray[np.float64]] = field(default_factory=list)
    diameters: list[NDArray[np.float64]] = field(default_factory=list)
    faults: Counter[str] = field(default_factory=Counter)
    remade: dict[str, RemadeScenes | str] = field(default_factory=dict)

    def cast(self, frame: StoredFrame, x: NDArray[np.int64], y: NDArray[np.int64]) -> None:
        self.asked += 1
        remade = self._scenes_of(frame)
        if isinstance(remade, str):
            self.faults[remade] += 1
            return
        scene = remade.scene(frame)
        if scene is None:
            self.faults["config and seed of the index give another camera than the pair's provenance has"] += 1
            return
        x_px, y_px = x.astype(np.float64), y.astype(np.float64)
        hits = cast_rays(scene, remade.models, "left", x_px, y_px)
        found, stored = oracle.disparity_px(scene.camera, hits), frame.disparity_left[y, x].astype(np.float64)
        with np.errstate(invalid="ignore"):
            same = np.abs(found - stored) <= _ERROR_PX + frame.rounding_px(stored)
        same |= found == stored
        if same.mean() < _LEAST_AGREEING:
            self.faults["the scene made again is another than the files show: made by another version, or of other "
                        "models"] += 1  # fmt: skip
            return
        self.pairs += 1
        self.total += len(x)
        self.agreeing += int(same.sum())
        self.spacing_px = spacing_px(*frame.disparity_left.shape)
        surfaces = surfaces_at(scene, remade.models, remade.config.textures.patch_px, x_px, y_px, hits)
        hit = same & (hits.instance >= 0)
        self.slants.append(surfaces.slant_deg[hit])
        self.texels.append(surfaces.texels_per_pixel[hit])
        seen = np.unique(hits.instance[hit])
        objects = seen[scene.model[seen] >= len(STILL_MODELS)]
        self.diameters.append(diameters_px(scene, remade.models, objects))

    def _scenes_of(self, frame: StoredFrame) -> RemadeScenes | str:
        if frame.split not in self.remade:
            try:
                self.remade[frame.split] = RemadeScenes(self.index, cast("SplitName", frame.split))
            except InputError as error:
                self.remade[frame.split] = str(error)
        return self.remade[frame.split]

    def rays(self) -> Rays:
        def joined(parts: list[NDArray[np.float64]]) -> NDArray[np.float64]:
            return np.concatenate(parts) if parts else np.empty(0)

        return Rays(
            asked=self.asked,
            pairs=self.pairs,
            cast=self.total,
            agreeing=self.agreeing,
            spacing_px=self.spacing_px,
            slant_deg=joined(self.slants),
            texels_per_pixel=joined(self.texels),
            diameter_px=joined(self.diameters),
            faults=dict(self.faults),
        )
