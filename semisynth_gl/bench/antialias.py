"""Antialiasing modes: PSNR against a reference of 64 samples a pixel, shift against the truth, and time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.bench.scenes import BenchScenes, grown
from semisynth_gl.bench.summary import front
from semisynth_gl.bench.timing import alternated, compare_times
from semisynth_gl.camera import EYES, Eye, StereoCamera
from semisynth_gl.errors import BackendError
from semisynth_gl.render.context import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import Scene, make_scene

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

# Patch of the scene that shifts are measured on: waves, (cycles along u, along v) of red, green and blue.
_PATCH_PX = 256
_WAVES = ((8, 0), (0, 7), (5, -6))
_AMPLITUDE = 100.0
# A square whose u and v run along x and y lies on the plane normal . p = distance.
_NORMAL = np.array([0.2, -0.15, 1.0])
_DISTANCE_M = 2.0
_SIDE_M = 8.0
_REPEATS = 8.0


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
        shift_px: between image and truth, from a picture that is known in closed form.
        outline_shift_px: at outlines, between image and reference; None for the reference itself.
        on_front: no other mode is both faster and nearer to the reference; False for the reference.
    """

    name: str
    text: str
    seconds_per_pair: float
    time_ratio: float
    psnr_db: float | None
    psnr_outline_db: float | None
    psnr_inside_db: float | None
    shift_px: float
    outline_shift_px: float | None
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
    images, shifts, left_out = {}, {}, {}
    for mode in (*MODES, REFERENCE):
        try:
            with _open(bench, mode, backend) as renderer:
                frames = [renderer.render(scene) for scene in bench.scenes]
            images[mode] = [image for frame in frames for image in (frame.left, frame.right)]
            shifts[mode] = truth_shift_px(mode, backend)
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
    best = front({mode: (times[mode].ratio, 10 ** (-psnr[0] / 10)) for mode, (psnr, _) in measured.items()})
    rows = []
    for mode in images:
        psnr, outline_shift = measured.get(mode, ((None, None, None), None))
        own = times[mode]
        rows.append(
            ModeRow(
                mode, MODE_TEXTS[mode], own.seconds, own.ratio, psnr[0], psnr[1], psnr[2], shifts[mode],
                outline_shift, mode in best,
            )
        )  # fmt: skip
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


def shift_px(
    image: NDArray[np.float64],
    expected: NDArray[np.float64],
    along_x: NDArray[np.float64],
    along_y: NDArray[np.float64],
) -> tuple[float, float]:
    """Least-squares shift of an image to the right and downwards, px.

    Contrast and brightness are free, so a blur that is the same on both sides counts as none.

    Args:
        image: (N,) float64 values.
        expected: (N,) float64 values without a shift.
        along_x: (N,) float64 change of ``expected`` per px along x.
        along_y: (N,) float64 change per px along y.
    """
    columns = np.stack([expected, np.ones_like(expected), along_x, along_y], axis=-1)
    (contrast, _, x, y), *_ = np.linalg.lstsq(columns, image, rcond=None)
    return float(-x / contrast), float(-y / contrast)


def truth_shift_px(mode: str, backend: Backend) -> float:
    """Measure the shift between an image and the truth at the same pixel, px, the larger of both eyes'.

    A slanted plane with a picture of waves is drawn. The ray through a pixel's centre meets the plane at the point
    whose disparity the pixel has, and the colour of that point follows from the equation of the waves.
    """
    camera = StereoCamera(480, 320, 500.0, 0.1, 236.0, 247.0, 158.3)
    corner = np.array([-_SIDE_M / 2, -_SIDE_M / 2])
    matrix = np.eye(4)
    for column, edge in enumerate(np.eye(2) * _SIDE_M):
        matrix[:3, column] = *edge, -(_NORMAL[:2] @ edge) / _NORMAL[2]
    matrix[:3, 3] = *corner, (_DISTANCE_M - _NORMAL[:2] @ corner) / _NORMAL[2]
    scene = make_scene(camera, model=[0], world_from_model=[matrix], layer=[0], uv_scale=_REPEATS)
    texel = (np.arange(_PATCH_PX) + 0.5) / _PATCH_PX
    layer = np.full((1, _PATCH_PX, _PATCH_PX, 4), 255, np.uint8)
    layer[0, ..., :3] = np.rint(_waves(*np.meshgrid(texel, texel)))
    with Renderer([FACE], layer, wrap="repeat", outputs=(), antialias=mode, backend=backend) as renderer:
        frame = renderer.render(scene)

    def expected(eye: Eye, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        eye_m = np.array([camera.offset_m(eye), 0, 0])
        rays = camera.rays(eye, x, y)
        point = eye_m + rays * ((_DISTANCE_M - _NORMAL @ eye_m) / (rays @ _NORMAL))[..., None]
        u, v = ((point[..., axis] - corner[axis]) / _SIDE_M * _REPEATS for axis in (0, 1))
        return _waves(u, v)

    y, x = np.mgrid[: camera.height_px, : camera.width_px].astype(np.float64)
    largest = 0.0
    for eye, image in zip(EYES, (frame.left, frame.right), strict=True):
        shift = shift_px(
            image.astype(np.float64).ravel(),
            expected(eye, x, y).ravel(),
            (expected(eye, x + 0.5, y) - expected(eye, x - 0.5, y)).ravel(),
            (expected(eye, x, y + 0.5) - expected(eye, x, y - 0.5)).ravel(),
        )
        largest = max(largest, float(np.hypot(*shift)))
    return largest


def _waves(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (..., 3) of the shift's picture at patch coordinates."""
    return np.stack([127.5 + _AMPLITUDE * np.sin(2 * np.pi * (a * u + b * v)) for a, b in _WAVES], axis=-1)


def _open(bench: BenchScenes, mode: str, backend: Backend) -> Renderer:
    return bench.open_renderer(backend, outputs=(), antialias=mode)


def _render_all(renderer: Renderer, scenes: Sequence[Scene]) -> None:
    for scene in scenes:
        renderer.render(scene)


def _quality(
    images: Sequence[NDArray[np.uint8]], references: Sequence[NDArray[np.uint8]], outlines: Sequence[NDArray[np.bool_]]
) -> tuple[tuple[float, float | None, float | None], float | None]:
    """Measure the PSNR of all pixels, at outlines and elsewhere, and the shift at outlines."""
    image, reference = (np.concatenate([pixels.reshape(-1, 3) for pixels in part]) for part in (images, references))
    outline = np.concatenate([mask.ravel() for mask in outlines])
    gradients = [np.gradient(pixels.astype(np.float64), axis=(0, 1)) for pixels in references]
    y, x = (np.concatenate([gradient[axis].reshape(-1, 3) for gradient in gradients])[outline] for axis in (0, 1))
    psnr = (
        psnr_db(image, reference),
        psnr_db(image[outline], reference[outline]) if outline.any() else None,
        psnr_db(image[~outline], reference[~outline]) if not outline.all() else None,
    )
    if not outline.any():
        return psnr, None
    shift = shift_px(
        image[outline].astype(np.float64).ravel(), reference[outline].astype(np.float64).ravel(), x.ravel(), y.ravel()
    )
    return psnr, float(np.hypot(*shift))
