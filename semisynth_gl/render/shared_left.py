"""A left view that is drawn, uploaded and read once, for as many pairs as there are cameras that share it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from semisynth_gl.frame.camera import Crop, StereoCamera
from semisynth_gl.frame.frame import CHANNELS, Frame
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene.scene import Motion, Scene


class SharedLeft:
    """A scene before several cameras that differ in the right eye alone; `Renderer.share_left` makes it.

    The pair of each is what `Renderer.render` gives of the scene with that camera, bit for bit. What the left views
    have in common is one array object in all of them, which is read-only therefore.

    Attributes:
        scenes: the scene with each of the cameras.
        crop: as in `Renderer.render`.
        motions: the motions, "future" and "past", to another moment seen by the scene's own camera.
        channels: what was read of the left view and belongs to all pairs; see `keep`.

    Raises:
        InputError: where there is no camera, or one differs from the scene's in the left eye.
    """

    def __init__(
        self,
        draw: Callable[["SharedLeft", int], Frame],
        scene: Scene,
        cameras: Sequence[StereoCamera],
        crop: Crop | None,
        future: Motion | None,
        past: Motion | None,
    ) -> None:
        if not cameras:
            raise InputError("cameras: expected at least one, got none")
        for camera in cameras:
            check_type("a camera", camera, StereoCamera)
            if camera.left_alone != scene.camera.left_alone:
                raise InputError(
                    f"cameras: expected cameras that differ from the scene's in the right eye alone, {scene.camera}, "
                    f"got {camera}"
                )
        self._draw = draw
        self.scenes = tuple(replace(scene, camera=camera) for camera in cameras)
        self.crop = crop
        self.motions: Mapping[str, Motion | None] = {"future": future, "past": past}
        self.channels: dict[str, Any] = {}

    def __len__(self) -> int:
        return len(self.scenes)

    def render(self, number: int) -> Frame:
        """Draw the pair of the camera of a number.

        The left view is drawn by the first call, and again where the renderer has drawn another shared left view or
        images of another size in between.

        Raises:
            InputError: where there is no camera of that number.
            BackendError: see `Renderer.render`.
        """
        number = to_whole("the number of a camera", number, least=0)
        if number >= len(self):
            raise InputError(f"the number of a camera: expected 0 to {len(self) - 1}, got {number}")
        return self._draw(self, number)

    def keep(self, left: Mapping[str, Any]) -> None:
        """Keep what all pairs have of a left view's channels: arrays, since a reader may reuse what else it makes.

        Arrays become read-only, since several frames have them.
        """
        for name, array in left.items():
            if CHANNELS[name].of_own_view and isinstance(array, np.ndarray):
                array.flags.writeable = False
                self.channels[name] = array
