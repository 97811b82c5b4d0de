"""The targets of the latest image sizes, which a renderer keeps from pair to pair."""

from collections.abc import Callable
from traceback import clear_frames
from typing import TypeVar

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.render.loaded import Loaded
from semisynth_gl.render.pair_targets import ImageTargets, PairTargets

_Targets = TypeVar("_Targets", bound=ImageTargets)


class KeptTargets:
    """Targets for pairs of one size, and for images without truth of two other ones, such as denser ones for lenses.

    Use it while its context is current.

    Args:
        loaded: the renderer's context, and what it is to draw.
    """

    def __init__(self, loaded: Loaded) -> None:
        self._loaded = loaded
        self._pairs: PairTargets | None = None
        # Of the two latest sizes, the newest last: eyes may differ.
        self._images: list[ImageTargets] = []

    def for_pairs(self, camera: StereoCamera, *, shared: bool) -> PairTargets:
        """Return targets for a camera's pairs; make new ones where the size differs, or they cannot be shared.

        Raises:
            BackendError: where the driver refuses the size; the earlier targets are then kept.
        """
        latest, size = self._pairs, (camera.width_px, camera.height_px)
        if latest is not None and latest.size == size and (latest.shared is not None or not shared):
            return latest
        self._pairs = made = self._made(lambda: PairTargets(self._loaded, size, shared=shared), latest)
        return made

    def for_images(self, camera: StereoCamera) -> ImageTargets:
        """Return targets for a camera's images without truth: the pairs' targets, where they have that size.

        Raises:
            BackendError: as `for_pairs`.
        """
        size = camera.width_px, camera.height_px
        for latest in (self._pairs, *self._images):
            if latest is not None and latest.size == size:
                return latest
        outgrown = self._images[0] if len(self._images) == len(EYES) else None
        made = self._made(lambda: ImageTargets(self._loaded, size), outgrown)
        self._images = [*(each for each in self._images if each is not outgrown), made]
        return made

    def _made(self, make: Callable[[], _Targets], outgrown: _Targets | None) -> _Targets:
        gl = self._loaded.context.gl
        gl.gc_mode = "auto"
        try:
            targets = make()
            # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
            targets.framebuffer.use()
        except BaseException as error:
            # Clearing the frames frees the objects that were made so far, which must happen while the context is
            # current.
            clear_frames(error.__traceback__)
            raise
        finally:
            gl.gc_mode = None  # type: ignore[assignment]  # moderngl's own default
        if outgrown is not None:
            outgrown.release()
        return targets
