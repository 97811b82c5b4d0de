"""What became of every image and crop: counts of kept and rejected crops, and a few rejected crops to look at."""

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, zip_longest
from typing import Literal, NamedTuple, get_args

from semisynth_gl.inputs.errors import Skipped, abbreviate, counted
from semisynth_gl.textures.crops import Square
from semisynth_gl.textures.shares import patch_chances
from semisynth_gl.textures.subjects import of_subjects

Reason = Literal["flat", "blurred", "duplicate"]
Outcome = Literal[Reason, "surplus", "kept"]
REASONS: tuple[Reason, ...] = get_args(Reason)
REJECTIONS: tuple[Outcome, ...] = (*REASONS, "surplus")

_EXAMPLES = 12
# The summary notes when there are fewer subjects than this, and subjects with less than this part of an equal share.
_FEW, _UNEVEN = 4, 0.5
_MOST_NAMED = 5


class JudgedCrop(NamedTuple):
    """A crop, the reason against it or None, and ``like``: for a duplicate, the crop that it hardly differs from."""

    reason: Reason | None
    square: Square
    like: Square | None = None

    @property
    def squares(self) -> list[Square]:
        """The square, after that of the crop that it hardly differs from, if there is one."""
        return [self.square] if self.like is None else [self.like, self.square]


@dataclass(frozen=True, slots=True)
class JudgedClip:
    """All crops, at least one, of a still image or of a clip of ``frame_count`` successive frames."""

    frame_count: int
    crops: Sequence[JudgedCrop]

    @property
    def source(self) -> str:
        """Name of the image, as in `Square`."""
        return self.crops[0].square.source


@dataclass(frozen=True, slots=True)
class CropCount:
    """Numbers of crops of one side in one image; a square that is followed through several frames counts once.

    ``kept`` counts the crops that became patches. The other numbers count rejected crops: by `Reason`, or as
    ``surplus`` where there were more than wanted.
    """

    source: str
    side_px: int
    kept: int = 0
    flat: int = 0
    blurred: int = 0
    duplicate: int = 0
    surplus: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureReport:
    """What became of all images and their crops. Each frame of an image sequence counts as an image.

    ``images_used + images_unused + len(too_small) + len(images_skipped) + images_not_opened`` is the number of given
    images, and ``counts`` has every crop of the images that were opened.

    Attributes:
        images_used: images with at least one patch in the atlas.
        images_unused: images that were read, but have no patch in the atlas.
        too_small: names of the images that are smaller than a patch along a side.
        images_skipped: images that could not be read, and why.
        images_not_opened: number of images that were not needed, because there were enough patches.
        counts: one entry for each image and each side of its squares, in this order.
        subjects: the subject's name by the image's name, for images that share their subject; see `Patch`.
        examples: a few rejected crops, from different images where possible.
        patch_px: side of a patch.
        min_texture: least `texture_measure` of a patch.
        longest_clip: largest number of layers of a patch.
    """

    images_used: int
    images_unused: int = 0
    too_small: tuple[str, ...] = ()
    images_skipped: tuple[Skipped, ...] = ()
    images_not_opened: int = 0
    counts: tuple[CropCount, ...]
    subjects: Mapping[str, str] = field(default_factory=dict)
    examples: tuple[JudgedCrop, ...] = ()
    patch_px: int
    min_texture: float = 0.0
    longest_clip: int = 1

    @property
    def surface_shares(self) -> dict[str, float]:
        """The share of the surfaces that wear patches of an image, by its name, sum 1; without large patches."""
        kept = [count.source for count in self.counts for _ in range(count.kept)]
        chances = patch_chances([self.subjects.get(source, source) for source in kept])
        shares: dict[str, float] = defaultdict(float)
        for source, chance in zip(kept, chances.tolist(), strict=True):
            shares[source] += chance
        return dict(shares)

    @property
    def subject_shares(self) -> dict[str, float]:
        """The shares of `surface_shares` by subject, which is one image or several."""
        shares: dict[str, float] = defaultdict(float)
        for source, share in self.surface_shares.items():
            shares[self.subjects.get(source, source)] += share
        return dict(shares)

    def total(self, outcome: Outcome) -> int:
        """Return the number of crops of all images with an outcome."""
        return count_crops(self.counts, outcome)

    @property
    def scale_names(self) -> dict[int, str]:
        """The scales of the crops, such as ``{256: "1x", 512: "2x"}``, by side."""
        return {side: f"{side / self.patch_px:g}x" for side in sorted({count.side_px for count in self.counts})}

    @property
    def named_images(self) -> set[str]:
        """The names of the images that examples come from, and of the images that are too small."""
        return {square.source for example in self.examples for square in example.squares} | set(self.too_small)

    @property
    def grouped_counts(self) -> dict[str, list[CropCount]]:
        """The counts by `patch_group`, in their order."""
        groups: dict[str, list[CropCount]] = defaultdict(list)
        for count in self.counts:
            groups[patch_group(count.source)].append(count)
        return dict(groups)

    def summary(self) -> str:
        """Return a few lines: patches, rejected crops, subjects with uneven shares, and images that were not used."""
        kept = self.total("kept")
        frames = f" of up to {self.longest_clip} frames" if self.longest_clip > 1 else ""
        shared = of_subjects(self.images_used, len(self.subject_shares)) if self.subjects else ""
        text = (
            f"{counted(kept, 'patch')} of {self.patch_px} x {self.patch_px} pixels{frames} from "
            f"{counted(self.images_used, 'image')}{shared}; "
            f"{counted(self.total('flat'), 'crop')} left out as flat (median over 8 x 8 cells of the standard "
            f"deviation of luminance, 8-bit levels, below {self.min_texture:g}), "
            f"{self.total('blurred')} as blurred, {self.total('duplicate')} as duplicates, "
            f"{self.total('surplus')} as more than wanted"
        )
        lines = [text, *self._uneven()]
        unused = {
            "not readable": len(self.images_skipped),
            f"smaller than {self.patch_px} pixels": len(self.too_small),
            "without a patch in the atlas": self.images_unused,
            "not opened, enough patches had been found": self.images_not_opened,
        }
        if any(unused.values()):
            lines.append(f"images left out: {'; '.join(f'{count} {why}' for why, count in unused.items() if count)}")
        return "\n".join([*lines, *(f"not readable: {skipped}" for skipped in self.images_skipped)])

    def _uneven(self) -> list[str]:
        """Return notes for the user where subjects are few, or some have much less than an equal share."""
        shares, noun = self.subject_shares, "subject" if self.subjects else "image"
        equal, lines = 1 / max(len(shares), 1), list[str]()
        if 0 < len(shares) < _FEW:
            lines.append(
                f"note: only {counted(len(shares), noun)}, each on about {equal:.0%} of the surfaces: give a few "
                "dozen photographs"
            )
        few = sorted((share, subject) for subject, share in shares.items() if share < _UNEVEN * equal)
        if few:
            named = abbreviate([f"{subject} {share:.1%}" for share, subject in few], _MOST_NAMED)
            lines.append(
                f"note: {counted(len(few), noun)} with few patches, on less than half of an equal share of the "
                f"surfaces ({equal:.1%}): {named}; lower textures.patch_px, or give larger photographs"
            )
        return lines


def crop_counts(clips: Sequence[JudgedClip], kept: Collection[Square]) -> tuple[CropCount, ...]:
    """Count the crops of each clip by side; ``kept`` are the squares that became patches."""
    counts = []
    for clip in clips:
        outcomes: Counter[tuple[int, Outcome]] = Counter()
        for crop in clip.crops:
            outcome: Outcome = "kept" if crop.square in kept else crop.reason or "surplus"
            outcomes[crop.square.side_px, outcome] += 1
        counts += [
            CropCount(
                clip.source,
                side,
                kept=outcomes[side, "kept"],
                **{outcome: outcomes[side, outcome] for outcome in REJECTIONS},
            )
            for side in sorted({side for side, _ in outcomes})
        ]
    return tuple(counts)


def rejected_examples(clips: Sequence[JudgedClip]) -> tuple[JudgedCrop, ...]:
    """Choose a few rejected crops for each reason, one from each clip in turn."""
    examples: list[JudgedCrop] = []
    for reason in REASONS:
        rejected = [[crop for crop in clip.crops if crop.reason == reason] for clip in clips]
        # Evenly spread: the first crops would all show the upper border. Duplicates are in random order already.
        spread = [crops if reason == "duplicate" else crops[:: -(-len(crops) // _EXAMPLES) or 1] for crops in rejected]
        in_turn = [crop for crop in chain.from_iterable(zip_longest(*spread)) if crop is not None]
        examples += sorted(in_turn[:_EXAMPLES])
    return tuple(examples)


def count_crops(counts: Collection[CropCount], outcome: Outcome, side_px: int | None = None) -> int:
    """Return the number of crops with an outcome, of one side or of all sides."""
    return sum(getattr(count, outcome) for count in counts if side_px in (None, count.side_px))


def patch_group(source: str) -> str:
    """Return the group that a patch is shown in: its image, or the kind of a procedural patch."""
    return source.rsplit("/", 1)[0] if source.startswith("procedural/") else source
