"""What became of the crops of each image: counts, and a few examples to look at."""

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, zip_longest

from semisynth_gl.textures.atlas import CropCount, LeftOut, Reason, Square
from semisynth_gl.textures.crops import CropBox
from semisynth_gl.textures.duplicates import Found

_EXAMPLES = 12


@dataclass(frozen=True, slots=True)
class Outcome:
    """How the squares of one image were judged, or of one run of frames.

    Attributes:
        source: its name, of the first frame.
        frames: how many images it was.
        boxes: all squares.
        flat: indexes of those that are flat.
        blurred: indexes of those that are blurred.
        duplicates: indexes of those that are duplicates, and what each is like.
    """

    source: str
    frames: int
    boxes: Sequence[CropBox]
    flat: Sequence[int]
    blurred: Sequence[int]
    duplicates: Mapping[int, Found]


def crop_counts(
    outcomes: Mapping[int, Outcome],
    kept: Mapping[int, Collection[CropBox]],
    kept_flat: Mapping[int, Collection[CropBox]],
) -> tuple[CropCount, ...]:
    """Count the squares of each image and side.

    Args:
        outcomes: by run.
        kept: the squares that became patches, by run.
        kept_flat: those of them that are flat.
    """
    counts = []
    for run, outcome in sorted(outcomes.items()):
        total = _by_side(outcome.boxes)
        staying, staying_flat = _by_side(kept.get(run, ())), _by_side(kept_flat.get(run, ()))
        flat, blurred, duplicate = (
            _by_side([outcome.boxes[i] for i in which]) for which in (outcome.flat, outcome.blurred, outcome.duplicates)
        )
        counts += [
            CropCount(
                source=outcome.source,
                side_px=side,
                kept=staying[side],
                kept_flat=staying_flat[side],
                flat=flat[side] - staying_flat[side],
                blurred=blurred[side],
                duplicate=duplicate[side],
                surplus=total[side]
                - flat[side]
                - blurred[side]
                - duplicate[side]
                - (staying[side] - staying_flat[side]),
            )
            for side in sorted(total)
        ]
    return tuple(counts)


def left_out_examples(
    outcomes: Mapping[int, Outcome], kept_flat: Mapping[int, Collection[CropBox]]
) -> tuple[LeftOut, ...]:
    """Choose crops that were left out: for each reason as many from each image, as far as they go."""
    by_reason: dict[Reason, list[list[LeftOut]]] = defaultdict(list)
    for run, outcome in sorted(outcomes.items()):
        flat = [i for i in outcome.flat if outcome.boxes[i] not in kept_flat.get(run, ())]
        reasons: tuple[tuple[Reason, Sequence[int]], ...] = (("flat", flat), ("blurred", outcome.blurred))
        for reason, which in reasons:
            # Evenly spread: the first ones would all show the upper border.
            spread = which[:: -(-len(which) // _EXAMPLES) or 1]
            by_reason[reason].append([LeftOut(reason, Square(outcome.source, *outcome.boxes[i])) for i in spread])
        alike = list(outcome.duplicates.items())[:_EXAMPLES]
        by_reason["duplicate"].append(
            [
                LeftOut("duplicate", Square(outcome.source, *outcome.boxes[i]), Square(outcomes[of].source, *box))
                for i, (of, box) in alike
            ]
        )
    chosen: list[LeftOut] = []
    for lists in by_reason.values():
        in_turn = [each for each in chain.from_iterable(zip_longest(*lists)) if each is not None]
        chosen += sorted(in_turn[:_EXAMPLES])
    return tuple(chosen)


def _by_side(boxes: Collection[CropBox]) -> Counter[int]:
    return Counter(box.side_px for box in boxes)
