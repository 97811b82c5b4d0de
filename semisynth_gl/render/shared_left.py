"""A left view that is drawn, uploaded and read once for all pairs whose cameras share it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from semisynth_gl.frame.camera import Crop, StereoCamera
from semisynth_gl.frame.channels import CHANNELS
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene.scene import Motion, Scene


class SharedLeft:
    """A scene with several cameras that differ only in the right eye; `Renderer.share_left` makes it.

    The pair of each camera is the one that `Renderer.render` draws of the scene with that camera, bit for bit. Channels
    that all left views have in common are the same array object in all of them, which is therefore read-only.

    Attributes:
        scenes: the scene with each of the cameras.
        crop: the part of the images to draw; see `Renderer.render`.
        motions: the motions "future" and "past" to other moments, with the scene's own camera.
        channels: the channels of the left view that belong to all pairs and have been read; see `keep`.

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
            raise InputError("expected at least one, got none", argument="cameras")
        for camera in cameras:
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
        """Draw the pair of the camera with a number, 0 or more; see `Renderer.render` for what comes back.

        The left view is drawn by the first call, and again where the renderer has drawn another shared left view or
        images of another size in between.

        Raises:
            InputError: where there is no camera of that number.
            BackendError: see `Renderer.render`.
        """
        number = to_whole("number", number, least=0)
        if number >= len(self):
            raise InputError(f"the number of a camera: expected 0 to {len(self) - 1}, got {number}")
        return self._draw(self, number)

    def keep(self, left: Mapping[str, Any]) -> None:
        """Keep those of a left view's channels that all pairs have in common, for the pairs that follow.

        Only arrays are kept, since readers may reuse other objects; they become read-only, since frames share them.
        """
        for name, array in left.items():
            if CHANNELS[name].of_own_view and isinstance(array, np.ndarray):
                array.flags.writeable = False
                self.channels[name] = array
