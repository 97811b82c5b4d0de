"""Pairs with truth on which a network is evaluated, and a figure of its prediction for a pair."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from skimage.data import stereo_motorcycle
from torch.utils.data import Dataset

from semisynth_gl.dataset.reader import INDEX, open_dataset
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.protocol import ProtocolName, Truth
from semisynth_gl.judge.truth import find_truth

COLUMNS = ("avgerr", "rms", "bad-1", "bad-2", "bad-4", "D1-all")
_LARGEST_ERROR_PX = 4.0
Images = tuple[NDArray[np.uint8], NDArray[np.uint8]]


class JudgedPairs(Dataset[dict[str, Any]]):
    """Pairs that are evaluated together; each access reads a pair.

    An item has the ``name`` of the pair, the title of its ``set``, the ``protocol``, ``left`` and ``right`` as
    (3, H, W) uint8, and the ``truth`` of the left view.

    Args:
        title: name of the set.
        protocol: the benchmark whose error measures are used.
        pairs: for each pair its name, a function that reads its images (H, W, 3), and one that reads its truth.
    """

    def __init__(
        self, title: str, protocol: ProtocolName, pairs: Sequence[tuple[str, Callable[[], Images], Callable[[], Truth]]]
    ) -> None:
        self.title, self.protocol, self._pairs = title, protocol, pairs

    def __len__(self) -> int:
        return len(self._pairs)

    def __getitem__(self, number: int) -> dict[str, Any]:
        """Read a pair; raise InputError if its images and its truth differ in size."""
        name, read_images, read_truth = self._pairs[number]
        images, truth = read_images(), read_truth()
        sizes = {each.shape[:2] for each in (*images, truth.disparity)}
        if len(sizes) > 1:
            raise InputError(f"{self.title}, {name}: expected images and truth of one size, got {sorted(sizes)}")
        left, right = (torch.from_numpy(np.ascontiguousarray(each.transpose(2, 0, 1))) for each in images)
        return {
            "name": name, "set": self.title, "protocol": self.protocol, "left": left, "right": right, "truth": truth,
        }  # fmt: skip


def motorcycle() -> JudgedPairs:
    """Return Middlebury's Motorcycle at a quarter of its size, 741 x 500 px, from scikit-image.

    The built-in photographs (``assets/photographs.yaml``) do not show this scene.
    """
    left, right, disparity = stereo_motorcycle()
    # Pixels without truth are inf; scikit-image's documentation says NaN.
    truth = Truth(np.where(np.isfinite(disparity), disparity, np.inf).astype(np.float32))
    return JudgedPairs("Motorcycle", "middlebury", [("Motorcycle", lambda: (left, right), lambda: truth)])


def folder(path: Path) -> JudgedPairs:
    """Return the scenes of a folder: a dataset of this program in any layout, or a folder of Middlebury or ETH3D.

    In the latter, such as ``MiddEval3/trainingQ``, each scene has im0.png and im1.png beside its truth. Raises
    InputError if there is no truth.
    """
    found = find_truth(str(path))
    read_images: list[Callable[[], Images]]
    if (path / INDEX).is_file():
        frames = open_dataset(path)
        read_images = [partial(_rendered, frames, number) for number in range(len(found.pairs))]
    else:
        read_images = [partial(_photographed, Path(pair.source).parent) for pair in found.pairs]
    pairs = [(pair.name, read, pair.read) for pair, read in zip(found.pairs, read_images, strict=True)]
    return JudgedPairs(str(path), found.protocol, pairs)


def _rendered(frames: Any, number: int) -> Images:  # noqa: ANN401 - a dataset as open_dataset opens it
    frame = frames[number]
    left, right = (np.atleast_3d(view.image) for view in (frame.left, frame.right))
    return np.broadcast_to(left, (*left.shape[:2], 3)), np.broadcast_to(right, (*right.shape[:2], 3))


def _photographed(scene: Path) -> Images:
    try:
        left, right = (np.asarray(Image.open(scene / name).convert("RGB")) for name in ("im0.png", "im1.png"))
    except OSError as error:
        raise InputError(f"{scene}: expected im0.png and im1.png beside the truth: {error}") from None
    return left, right


def picture(pair: dict[str, Any], found: NDArray[np.float32]) -> Figure:
    """Return a figure of the left image, the truth, a predicted disparity (H, W) px, and its error."""
    truth = pair["truth"].disparity
    known = np.isfinite(truth)
    height, width = truth.shape
    figure = Figure(figsize=(12, 1 + 12 * height / width), dpi=60, layout="constrained")
    disparity: dict[str, Any] = {"cmap": "turbo", "vmin": 0.0, "vmax": float(truth[known].max())}
    error = np.ma.masked_where(~known, np.abs(found - np.where(known, truth, 0)))
    panels = (
        ("left", pair["left"].cpu().numpy().transpose(1, 2, 0), {}),
        ("truth, px", np.ma.masked_where(~known, truth), disparity),
        ("predicted, px", found, disparity),
        (f"error, px, to {_LARGEST_ERROR_PX:g}", error, {"cmap": "inferno", "vmin": 0.0, "vmax": _LARGEST_ERROR_PX}),
    )
    for axes, (title, values, options) in zip(figure.subplots(2, 2).flat, panels, strict=True):
        image = axes.imshow(values, interpolation="nearest", **options)
        axes.set_title(title)
        axes.set_axis_off()
        if options:
            figure.colorbar(image, ax=axes, shrink=0.8)
    return figure
