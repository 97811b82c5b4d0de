"""What predictions of a network are worth: real pairs with their truth, figures as benchmarks count them, a picture."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from skimage.data import stereo_motorcycle

from semisynth_gl.dataset.reader import INDEX, Dataset, open_dataset
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge import Score, score
from semisynth_gl.judge.protocol import ProtocolName
from semisynth_gl.judge.score import mean_figures
from semisynth_gl.judge.truth import TruePair, Truth, find_truth

COLUMNS = ("avgerr", "rms", "bad-1", "bad-2", "bad-4", "D1-all")
_LARGEST_ERROR_PX = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A pair to judge a network by.

    Attributes:
        left: (H, W, 3) uint8.
        right: (H, W, 3) uint8.
        truth: of the left view.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    truth: Truth


@dataclass(frozen=True, slots=True, eq=False)
class Judges:
    """Pairs that a network is judged by together.

    Attributes:
        title: what they are.
        protocol: by whose definitions.
        views: how to read each pair, by name; large ones are not kept.
    """

    title: str
    protocol: ProtocolName
    views: Mapping[str, Callable[[], View]]


def motorcycle() -> Judges:
    """Middlebury's Motorcycle at a quarter of its size, 741 x 500 px, as the scikit-image package ships it.

    No photograph that the program takes from that package shows it; ``assets/photographs.yaml`` has their list.
    """
    left, right, disparity = stereo_motorcycle()
    # Pixels without truth are inf here and NaN in the package's documentation.
    truth = np.where(np.isfinite(disparity), disparity, np.inf).astype(np.float32)
    view = View(left, right, Truth(truth))
    return Judges("Motorcycle, 741 x 500 px", "middlebury", {"Motorcycle": lambda: view})


def folder(path: Path) -> Judges:
    """Take the scenes of a folder: Middlebury's or ETH3D's form, or a dataset of this program in any layout.

    Args:
        path: such as ``MiddEval3/trainingQ``: each scene has im0.png and im1.png beside its truth.

    Raises:
        InputError: where there is no truth, or a scene lacks an image.
    """
    try:
        found = find_truth(str(path))
    except InputError as error:
        raise InputError(error.text, argument="--evaluate") from None
    if (path / INDEX).is_file():
        frames = open_dataset(path)
        views = {pair.name: partial(_read_own, frames, number, pair) for number, pair in enumerate(found.pairs)}
        return Judges(str(path), found.protocol, views)
    for pair in found.pairs:
        for image in _images(pair):
            if not image.is_file():
                raise InputError(
                    f"--evaluate {path}: no {image}: expected im0.png and im1.png beside each truth, as Middlebury has"
                )
    return Judges(str(path), found.protocol, {pair.name: partial(_read, pair) for pair in found.pairs})


def _read_own(frames: Dataset, number: int, pair: TruePair) -> View:
    frame = frames[number]
    return View(frame.left.image, frame.right.image, pair.read())


def _images(pair: TruePair) -> tuple[Path, Path]:
    truth = Path(pair.source)
    return truth.with_name("im0.png"), truth.with_name("im1.png")


def _read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image of any kind: benchmarks have grey ones too."""
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except OSError as error:
        raise InputError(f"{path}: expected an image, got what cannot be read as one: {error}") from None


def _read(pair: TruePair) -> View:
    left, right = map(_read_image, _images(pair))
    truth = pair.read()
    for image, path in zip((left, right), _images(pair), strict=True):
        if image.shape[:2] != truth.disparity.shape:
            (height, width), (true_height, true_width) = image.shape[:2], truth.disparity.shape
            raise InputError(
                f"{path}: has {width} x {height} pixels, {pair.source} {true_width} x {true_height}: expected one size"
            )
    return View(left, right, truth)


Predictor = Callable[[View], NDArray[np.float32]]
"""From a pair to a disparity (H, W), px."""


def figures(judges: Judges, predict: Predictor) -> dict[str, float]:
    """Predict all pairs, and return the figures over all their pixels as the benchmark averages them."""
    scores: dict[str, Score] = {}
    for name, read in judges.views.items():
        view = read()
        scores[name] = score(predict(view), view.truth.disparity, judges.protocol, limits=view.truth.limits)
    found = mean_figures(scores)
    return {column: found[column] for column in COLUMNS}


def constant(disparity_px: float) -> Predictor:
    """Predict the same everywhere."""
    return lambda view: np.full(view.truth.disparity.shape, disparity_px, np.float32)


def best_constant(view: View) -> NDArray[np.float32]:
    """Predict the median of the pair's own truth, which no constant beats in avgerr."""
    truth = view.truth.disparity
    return np.full(truth.shape, np.median(truth[np.isfinite(truth)]), np.float32)


def table(judges: Judges, rows: Mapping[str, Mapping[str, float]]) -> str:
    """Return figures as a Markdown table, which terminals show well enough."""
    first = max(map(len, rows))
    unit = "%" if judges.protocol in ("middlebury", "paper") else "fractions"
    heading = " | ".join(column.rjust(7) for column in COLUMNS)
    lines = [
        f"{judges.title}: all pixels, {judges.protocol}'s definitions; shares in {unit}, errors in px",
        "",
        f"| {'':{first}} | {heading} |",
        f"| {'-' * first} | {' | '.join('-' * 6 + ':' for _ in COLUMNS)} |",
    ]
    lines += [
        f"| {name:{first}} | {' | '.join(f'{row[column]:7.2f}' for column in COLUMNS)} |" for name, row in rows.items()
    ]
    return "\n".join(lines)


def picture(view: View, before: NDArray[np.float32], now: NDArray[np.float32], losses: Sequence[float]) -> Figure:
    """Draw left image, truth and error, the network before and after, and how its loss fell.

    Args:
        view: the pair.
        before: (H, W) px, predicted before training.
        now: (H, W) px, predicted after it, or on the way.
        losses: of each step.
    """
    truth = view.truth.disparity
    known = np.isfinite(truth)
    height, width = truth.shape
    drawn = Figure(figsize=(13.5, 1.0 + 9.0 * height / width), dpi=60, layout="constrained")
    FigureCanvasAgg(drawn)
    axes = drawn.subplots(2, 3)
    disparity: dict[str, Any] = {"cmap": "turbo", "vmin": 0.0, "vmax": float(truth[known].max())}
    error = np.ma.masked_where(~known, np.abs(now - np.where(known, truth, 0)))
    panels: list[tuple[str, Any, dict[str, Any]]] = [
        ("left", view.left, {}),
        ("truth, px", np.ma.masked_where(~known, truth), disparity),
        (
            f"error, px, {_LARGEST_ERROR_PX:g} and above yellow",
            error,
            {"cmap": "inferno", "vmin": 0.0, "vmax": _LARGEST_ERROR_PX},
        ),
        ("before, px", before, disparity),
        ("now, px", now, disparity),
    ]
    for axis, (title, values, options) in zip(axes.flat, panels, strict=False):
        image = axis.imshow(values, interpolation="nearest", **options)
        axis.set_title(title, fontsize=11)
        axis.set_xticks([])
        axis.set_yticks([])
        # White is no value: without truth nothing is right or wrong.
        if options:
            drawn.colorbar(image, ax=axis, shrink=0.8)
    last = axes[1, 2]
    last.plot(np.arange(1, len(losses) + 1), losses, color="#c5c9d0", linewidth=0.8)
    span = max(1, len(losses) // 30)
    smooth = np.convolve(losses, np.full(span, 1 / span), "valid")
    last.plot(np.arange(len(smooth)) + span, smooth, color="#1f5fa8")
    last.set_ylim(bottom=0)
    last.set_title("loss by step", fontsize=11)
    return drawn
