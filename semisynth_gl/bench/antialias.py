"""Antialiasing modes: PSNR against a reference of 64 samples a pixel, and time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.scenes import BenchScenes, grown
from semisynth_gl.bench.summary import front
from semisynth_gl.bench.timing import alternated, compare_times
from semisynth_gl.errors import BackendError
from semisynth_gl.render.context import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import Scene

MODES = ("none", "msaa4", "ssaa2", "ssaa3")
DEFAULT_MODE = "none"
REFERENCE = "ssaa8"

MODE_TEXTS: Mapping[str, str] = {
    "none": "one sample at the pixel's centre",
    "msaa4": "4 coverage samples, one colour a surface",
    "ssaa2": "4 samples, averaged",
    "ssaa3": "9 samples, averaged",
    "ssaa8": "64 samples, averaged: the reference",
}


@dataclass(frozen=True, slots=True)
class ModeRow:
    """Measurements of one antialiasing mode.

    Attributes:
        name: the mode's name.
        text: its description.
        seconds_per_pair: both images drawn and read back, with both disparities, without visibility.
        time_ratio: time relative to the default's.
        psnr_db: of all pixels against the reference; None for the reference itself.
        psnr_outline_db: of pixels within 1 px of another instance.
        psnr_inside_db: of the other pixels, inside textures.
        on_front: no other mode is both faster and nearer to the reference; False for the reference.
    """

    name: str
    text: str
    seconds_per_pair: float
    time_ratio: float
    psnr_db: float | None
    psnr_outline_db: float | None
    psnr_inside_db: float | None
    on_front: bool


def measure_modes(
    bench: BenchScenes, outlines: Sequence[NDArray[np.bool_]], backend: Backend, repeats: int
) -> tuple[list[ModeRow], dict[str, str]]:
    """Measure every mode that the driver can do.

    Args:
        bench: the scenes.
        outlines: (H, W) bool masks of both eyes of each scene, pixels that touch another instance.
        backend: "auto", "egl" or "osmesa".
        repeats: how often each mode draws all scenes, in turns; the reference draws them once.

    Returns:
        A row of each mode and one of the reference, and the driver's reason for each mode that is left out.
    """
    images, left_out = {}, {}
    for mode in (*MODES, REFERENCE):
        try:
            with _open(bench, mode, backend) as renderer:
                frames = [renderer.render(scene) for scene in bench.scenes]
            images[mode] = [image for frame in frames for image in (frame.left, frame.right)]
        except BackendError as error:
            if mode in (DEFAULT_MODE, REFERENCE):
                raise
            left_out[mode] = str(error)
    seconds = _alternated_renderers(bench, [mode for mode in images if mode != REFERENCE], backend, repeats)
    reference_seconds = _alternated_renderers(bench, [REFERENCE], backend, 1)[REFERENCE]
    times = compare_times(
        seconds | {REFERENCE: np.full(repeats, reference_seconds[0])}, DEFAULT_MODE, len(bench.scenes)
    )
    near = [grown(outline, 1) for outline in outlines]
    measured = {mode: _quality(images[mode], images[REFERENCE], near) for mode in images if mode != REFERENCE}
    # A front has smaller values as the better ones: mean squared error rather than PSNR.
    best = front({mode: (times[mode].ratio, 10 ** (-psnr[0] / 10)) for mode, psnr in measured.items()})
    rows = []
    for mode in images:
        psnr, outline_psnr, inside_psnr = measured.get(mode, (None, None, None))
        row = (MODE_TEXTS[mode], times[mode].seconds, times[mode].ratio, psnr, outline_psnr, inside_psnr, mode in best)
        rows.append(ModeRow(mode, *row))
    return rows, left_out


def _alternated_renderers(
    bench: BenchScenes, modes: Sequence[str], backend: Backend, repeats: int
) -> dict[str, NDArray[np.float64]]:
    """Time modes in turns, each in a renderer of its own that has drawn a pair before.

    To open a context takes longer than to draw a pair, so only the drawing is timed.

    Returns:
        (repeats,) float64 seconds of each mode.
    """
    seconds = {mode: np.zeros(repeats) for mode in modes}
    for number in range(repeats):
        for mode in modes:
            with _open(bench, mode, backend) as renderer:
                renderer.render(bench.scenes[0])
                draw = partial(_render_all, renderer, bench.scenes)
                seconds[mode][number] = alternated({mode: draw}, 1)[mode][0]
    return seconds


def psnr_db(image: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Peak signal to noise ratio of 8-bit values of any shape, dB; inf where they are equal."""
    mean_square = float(((image.astype(np.float64) - reference) ** 2).mean())
    return float(10 * np.log10(255**2 / mean_square)) if mean_square > 0 else float("inf")


def _open(bench: BenchScenes, mode: str, backend: Backend) -> Renderer:
    return bench.open_renderer(backend, outputs=(), antialias=mode)


def _render_all(renderer: Renderer, scenes: Sequence[Scene]) -> None:
    for scene in scenes:
        renderer.render(scene)


def _quality(
    images: Sequence[NDArray[np.uint8]], references: Sequence[NDArray[np.uint8]], outlines: Sequence[NDArray[np.bool_]]
) -> tuple[float, float | None, float | None]:
    """Measure the PSNR of all pixels, at outlines and elsewhere."""
    image, reference = (np.concatenate([pixels.reshape(-1, 3) for pixels in part]) for part in (images, references))
    outline = np.concatenate([mask.ravel() for mask in outlines])
    return (
        psnr_db(image, reference),
        psnr_db(image[outline], reference[outline]) if outline.any() else None,
        psnr_db(image[~outline], reference[~outline]) if not outline.all() else None,
    )
