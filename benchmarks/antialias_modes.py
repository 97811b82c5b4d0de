"""Antialiasing modes: PSNR against a reference of 64 samples a pixel, and time."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from timing import alternated, alternative_rows, compare_times

from semisynth_gl.bench.scenes import BenchScenes, grown
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.scene import Scene

MODES: Mapping[str, str] = {
    "none": "one sample at the pixel's centre",
    "edges": "shares of pixels along outlines",
    "ssaa2": "4 samples, averaged",
    "ssaa3": "9 samples, averaged",
}
"""The measured antialiasing modes, with their descriptions in reports."""
DEFAULT_MODE = "none"
REFERENCE = "ssaa8"
_REFERENCE_TEXT = "64 samples, averaged: the reference"


def measure_modes(
    bench: BenchScenes, outlines: Sequence[NDArray[np.bool_]], backend: Backend, repeats: int
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Measure all antialiasing modes that the driver supports.

    In turns, each mode draws all scenes ``repeats`` times. The reference draws them once.

    Args:
        bench: the scenes.
        outlines: for each scene, the left and then the right eye's (H, W) mask of pixels that touch another instance.
        backend: as of `Renderer`.
        repeats: how often each mode is timed.

    Returns:
        A row of `alternative_rows` for each mode and the reference; and, by the name of each mode that is left out, the
        driver's reason. The time is that of drawing and reading back both images with both disparities, without
        visibility. "psnr_db", "psnr_outline_db" and "psnr_inside_db" are against the reference: over all pixels, over
        outline pixels and their eight neighbours, and over the rest; the reference has None. The front weighs time and
        "psnr_db".

    Raises:
        BackendError: where the driver does not support the default mode or the reference.
    """
    bench = with_worn_patches(bench)
    renderers, left_out = {}, {}
    with ExitStack() as stack:
        for mode in (*MODES, REFERENCE):
            try:
                renderer = stack.enter_context(bench.open_renderer(backend, outputs=(), antialias=mode))
                renderer.render(bench.scenes[0])
            except BackendError as error:
                if mode in (DEFAULT_MODE, REFERENCE):
                    raise
                left_out[mode] = str(error)
            else:
                renderers[mode] = renderer
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
    # On a front, smaller values are better: so it weighs the mean squared error and not the PSNR.
    weighed = {mode: [10 ** (-psnr[0] / 10)] for mode, psnr in measured.items()}
    texts = {mode: MODES.get(mode, _REFERENCE_TEXT) for mode in images}
    return alternative_rows(texts, times, figures, weighed), left_out


def with_worn_patches(bench: BenchScenes) -> BenchScenes:
    """Return scenes without the patches that none of them wears, so that renderers take less memory."""
    small = len(bench.layers)
    # Layer 0 always stays: a renderer needs at least one patch.
    worn = np.union1d(0, np.concatenate([scene.layer for scene in bench.scenes]))
    return replace(
        bench,
        layers=bench.layers[worn[worn < small]],
        large_layers=bench.large_layers[worn[worn >= small] - small],
        scenes=[replace(scene, layer=np.searchsorted(worn, scene.layer)) for scene in bench.scenes],
    )


def _images(renderer: Renderer, scenes: Sequence[Scene]) -> list[NDArray[np.uint8]]:
    frames = [renderer.render(scene) for scene in scenes]
    return [frame.view(eye).image for frame in frames for eye in EYES]


def psnr_db(image: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Return the peak signal-to-noise ratio of two arrays of 8-bit values of one shape, dB; inf if they are equal."""
    mean_square = float(((image.astype(np.float64) - reference) ** 2).mean())
    return float(10 * np.log10(255**2 / mean_square)) if mean_square > 0 else float("inf")


def _quality(
    images: Sequence[NDArray[np.uint8]], references: Sequence[NDArray[np.uint8]], outlines: Sequence[NDArray[np.bool_]]
) -> tuple[float, float | None, float | None]:
    """Return the PSNR over all pixels, at outlines and elsewhere, dB; None where there are no such pixels."""
    image, reference = (
        np.concatenate([as_rgb(pixels).reshape(-1, 3) for pixels in part]) for part in (images, references)
    )
    outline = np.concatenate([mask.ravel() for mask in outlines])
    return (
        psnr_db(image, reference),
        psnr_db(image[outline], reference[outline]) if outline.any() else None,
        psnr_db(image[~outline], reference[~outline]) if not outline.all() else None,
    )
