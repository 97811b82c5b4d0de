"""The wanted distribution of disparity, from the forms that a config may give it."""

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.model import CameraSection, DisparitySection
from semisynth_gl.config.target import (
    GammaTarget,
    HistogramTarget,
    MixtureTarget,
    UniformDepthTarget,
    UniformTarget,
    gamma_weights,
)
from semisynth_gl.errors import InputError
from semisynth_gl.histogram import Histogram, mixed

_BINS = 24

_Form = UniformTarget | UniformDepthTarget | GammaTarget | HistogramTarget | MixtureTarget


def target_of(section: DisparitySection, camera: CameraSection) -> Histogram:
    """Return the wanted distribution as a histogram.

    A histogram keeps its bins; all other forms get 24 of equal width from ``min_px`` to ``max_px``.

    Raises:
        InputError: where depths beyond infinity are asked for.
    """
    if isinstance(section.target, HistogramTarget):
        return _histogram(section.target)
    edges = np.linspace(section.min_px, section.max_px, _BINS + 1, dtype=np.float64)
    return _of_form(section.target, edges, camera)


def _of_form(form: _Form, edges: NDArray[np.float64], camera: CameraSection) -> Histogram:
    match form:
        case HistogramTarget():
            return _histogram(form).rebinned(edges)
        case UniformTarget():
            low = edges[0] if form.low_px is None else form.low_px
            high = edges[-1] if form.high_px is None else form.high_px
            return Histogram.of([low, high], [1.0]).rebinned(edges)
        case UniformDepthTarget():
            # d + doffs = f B / Z: between two disparities lies the share of depths that 1 / (d + doffs) tells.
            doffs_px = _mean_doffs_px(camera)
            if edges[0] + doffs_px <= 0:
                raise InputError(
                    f"disparity.min_px: {edges[0]:g} px lies beyond infinity for cameras whose doffs is {doffs_px:g} "
                    f"px on average: for a target uniform in depth raise it above {-doffs_px:g}"
                )
            return Histogram.of(edges, -np.diff(1 / (edges + doffs_px)))
        case GammaTarget():
            return Histogram.of(edges, gamma_weights(form, edges))
        case MixtureTarget():
            whole = sum(part.weight for part in form.parts)
            return mixed(((part.weight / whole, _of_form(part.target, edges, camera)) for part in form.parts), edges)


def _histogram(form: HistogramTarget) -> Histogram:
    return Histogram.of(form.first_px + np.arange(len(form.shares) + 1) * form.bin_px, form.shares)


def _mean_doffs_px(camera: CameraSection) -> float:
    def middle(low: float, high: float) -> float:
        return (low + high) / 2

    if camera.doffs_px is not None:
        return middle(camera.doffs_px.low, camera.doffs_px.high)
    if camera.cx_left_px is not None and camera.cx_right_px is not None:
        return middle(camera.cx_right_px.low, camera.cx_right_px.high) - middle(
            camera.cx_left_px.low, camera.cx_left_px.high
        )
    return 0.0
