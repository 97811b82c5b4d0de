"""Antialiasing modes: PSNR against a reference of 64 samples a pixel, and time."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.scenes import BenchScenes, grown
from semisynth_gl.bench.summary import alternative_rows
from semisynth_gl.bench.timing import alternated, compare_times
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import Scene

MODES: Mapping[str, str] = {
    "none": "one sample at the pixel's centre",
    "edges": "shares of pixels along outlines",
    "msaa4": "4 coverage samples, one colour a surface",
    "ssaa2": "4 samples, averaged",
    "ssaa3": "9 samples, averaged",
}
"""The measured modes with their descriptions."""
DEFAULT_MODE = "none"
REFERENCE = "ssaa8"
_REFERENCE_TEXT = "64 samples, averaged: the reference"


def measure_modes(
    bench: BenchScenes, outlines: Sequence[NDArray[np.bool_]], backend: Backend, repeats: int
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Measure every mode that the driver can do; each draws all scenes ``repeats`` times, in turns, the reference once.

    Outlines are (H, W) bool masks of both eyes of each scene: pixels that touch another instance.

    Returns:
        A row of each mode and one of the reference, and the driver's reason for each mode that is left out. A mode's
        time is the time to draw and read back both images with both disparities, without visibility. PSNRs are against
        the reference: of all pixels, of pixels within 1 px of another instance, and of the rest. The front weighs time
        and PSNR of all pixels.
    """
    bench = bench.with_worn_patches()
    options = {mode: {"outputs": (), "antialias": mode} for mode in (*MODES, REFERENCE)}
    with bench.open_renderers(backend, options) as (renderers, left_out):
        for mode in (DEFAULT_MODE, REFERENCE):
            if mode in left_out:
                raise BackendError(left_out[mode])
        images = {mode: _images(renderer, bench.scenes) for mode, renderer in renderers.items()}
        calls = {mode: partial(_images, renderer, bench.scenes) for mode, renderer in renderers.items()}
        draw_reference = calls.pop(REFERENCE)
        seconds = alternated(calls, repeats)
        reference_seconds = alternated({REFERENCE: draw_reference}, 1)[REFERENCE]
    times = compare_times(seconds | {REFERENCE: reference_seconds.repeat(repeats)}, DEFAULT_MODE, len(bench.scenes))
    near = [grown(outline, 1) for outline in outlines]
    measured = {mode: _quality(images[mode], images[REFERENCE], near) for mode in seconds}
    keys = ("psnr_db", "psnr_outline_db", "psnr_inside_db")
    figures = {mode: dict(zip(keys, measured.get(mode, [None] * 3), strict=True)) for mode in images}
    # A front has smaller values as the better ones: mean squared error rather than PSNR.
    weighed = {mode: [10 ** (-psnr[0] / 10)] for mode, psnr in measured.items()}
    texts = {mode: MODES.get(mode, _REFERENCE_TEXT) for mode in images}
    return alternative_rows(texts, times, figures, weighed), left_out


def _images(renderer: Renderer, scenes: Sequence[Scene]) -> list[NDArray[np.uint8]]:
    frames = [renderer.render(scene) for scene in scenes]
    return [frame.view(eye).image for frame in frames for eye in EYES]


def psnr_db(image: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Peak signal to noise ratio of 8-bit values of any shape, dB; inf where they are equal."""
    mean_square = float(((image.astype(np.float64) - reference) ** 2).mean())
    return float(10 * np.log10(255**2 / mean_square)) if mean_square > 0 else float("inf")


def _quality(
    images: Sequence[NDArray[np.uint8]], references: Sequence[NDArray[np.uint8]], outlines: Sequence[NDArray[np.bool_]]
) -> tuple[float, float | None, float | None]:
    """Measure the PSNR of all pixels, at outlines and elsewhere."""
    image, reference = (
        np.concatenate([as_rgb(pixels).reshape(-1, 3) for pixels in part]) for part in (images, references)
    )
    outline = np.concatenate([mask.ravel() for mask in outlines])
    return (
        psnr_db(image, reference),
        psnr_db(image[outline], reference[outline]) if outline.any() else None,
        psnr_db(image[~outline], reference[~outline]) if not outline.all() else None,
    )
