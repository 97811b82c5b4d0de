"""The lenses of a dataset's pairs: drawn per sequence, and their maps kept while they stay the same."""

from collections.abc import Callable
from math import radians

import numpy as np

from semisynth_gl.config.fields import Range
from semisynth_gl.config.rig_sections import LensSection, RawEyeSection
from semisynth_gl.frame.camera import EYES, Eye, StereoCamera
from semisynth_gl.lens.chain import LensChain
from semisynth_gl.lens.raw_camera import RawCamera, rotation_of


def draw_raw_camera(section: LensSection, eye: Eye, rng: np.random.Generator) -> RawCamera:
    """Draw one eye's camera: every range once, always in the same order."""
    values: RawEyeSection = getattr(section, eye)

    def draw(key: Range | None, default: float) -> float:
        return (key or Range(default, default)).draw(rng)

    fx_px = values.fx_px.draw(rng)
    fy_px = draw(values.fy_px, fx_px)
    cx_px, cy_px = (
        draw(key, (side - 1) / 2)
        for key, side in ((values.cx_px, section.raw_width_px), (values.cy_px, section.raw_height_px))
    )
    distortion = tuple(each.draw(rng) for each in values.distortion)
    x, y, z = (radians(each.draw(rng)) for each in values.rotation_deg)
    return RawCamera(
        section.raw_width_px,
        section.raw_height_px,
        fx_px,
        fy_px,
        cx_px,
        cy_px,
        section.model,
        distortion,
        rotation_of((x, y, z)),
    )


class Lenses:
    """The lens chains of a config's pairs.

    Args:
        section: the ranges from which raw cameras are drawn.
        rng_of: returns the generator of a sequence and an eye.
    """

    def __init__(self, section: LensSection, rng_of: Callable[[int, Eye], np.random.Generator]) -> None:
        self._section, self._rng_of = section, rng_of
        self._latest: dict[Eye, LensChain] = {}

    def chains(self, sequence: int, camera: StereoCamera) -> dict[Eye, LensChain]:
        """Return both eyes' chains for a sequence, whose rectified pair is ``camera``.

        Raises:
            InputError: where OpenCV is missing, or a lens cannot be inverted over the rectified image.
        """
        for eye in EYES:
            raw = draw_raw_camera(self._section, eye, self._rng_of(sequence, eye))
            size = camera.width_px, camera.height_px
            latest = self._latest.get(eye)
            same = (
                latest is not None
                and latest.raw == raw
                and (latest.camera.width_px, latest.camera.height_px) == size
                and latest.camera.lens_px(eye) == camera.lens_px(eye)
            )
            if not same:
                self._latest[eye] = LensChain(raw, camera, eye, self._section.border)
        return dict(self._latest)
