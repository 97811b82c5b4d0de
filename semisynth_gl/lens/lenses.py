"""The lenses of a dataset's pairs: sampled per sequence, and their maps kept while they stay the same."""

from collections.abc import Callable

import numpy as np

from semisynth_gl.config.rig_sections import LensSection
from semisynth_gl.frame.camera import EYES, Eye, StereoCamera
from semisynth_gl.lens.chain import LensChain


class Lenses:
    """The lens chains of a config's pairs.

    Args:
        section: the ranges from which raw cameras are sampled.
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
            raw = self._section.sample(eye, self._rng_of(sequence, eye))
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
