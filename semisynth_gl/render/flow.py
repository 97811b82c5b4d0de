"""The flow pass: where what one eye sees is at another moment, and whether the same eye sees it then."""

from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import Crop, Eye
from semisynth_gl.errors import InputError
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.model_buffers import ModelBuffers, Placed
from semisynth_gl.render.programs import link_program, set_uniform
from semisynth_gl.render.projection import clip_from_view
from semisynth_gl.render.readers import Reader
from semisynth_gl.render.targets import EyeTargets, FlowTargets
from semisynth_gl.scene.scene import Motion

# The struct Move of flow.frag, std430.
_MOVE = np.dtype(
    [("turn_and_shift", "<f4", (3, 4)), ("centre", "<f4", (3,)), ("", "<f4"), ("then", "<u4"), ("", "<u4", (3,))]
)
_MOVES = 4
_FEWEST_MOVES = 256
# Texture units.
_OWN_DEPTH, _OWN_SURFACE, _THEN_DEPTH, _THEN_SURFACE = range(4)


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """A motion as the renderer needs it.

    Attributes:
        then: the other moment's instances.
        moves: (N,) of `_MOVE`, relative to the left eye.
    """

    then: Placed
    moves: NDArray[np.void]


class FlowPass:
    """Draws other moments' depth and surfaces, and compares.

    Args:
        context: the open context.
        read: what takes pixels.
    """

    def __init__(self, context: GraphicsContext, read: Reader) -> None:
        self._context = context
        self._read = read
        self._gl = context.gl
        self._draw_program = link_program(context, "mesh.vert", "mesh.frag", {"DEPTH": 0, "SURFACE": 1})
        self._draws: list[tuple[moderngl.Program, moderngl.VertexArray]] = []
        for defines in ({}, {"TRACE": 1}):
            program = link_program(context, "whole_image.vert", "flow.frag", defines)
            units = {"own_depth": _OWN_DEPTH, "own_surface": _OWN_SURFACE}
            units |= {"then_depth": _THEN_DEPTH, "then_surface": _THEN_SURFACE}
            for name, unit in units.items():
                set_uniform(program, name, unit)
            self._draws.append((program, context.gl.vertex_array(program, [])))
        self._moves = context.gl.buffer(reserve=_FEWEST_MOVES * _MOVE.itemsize, dynamic=True)
        self._then: EyeTargets | None = None
        self._targets: FlowTargets | None = None

    def resize(self, width_px: int, height_px: int) -> None:
        """Make room for another image size; a size that the driver refuses leaves the pass as it was."""
        then = EyeTargets(self._context, width_px, height_px, ("depth", "surface"), visibility=False)
        targets = FlowTargets(self._context, width_px, height_px, self._read)
        # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
        targets.drawing.use()
        self.release()
        self._then, self._targets = then, targets

    def place(self, placed: Placed, motion: Motion, models: ModelBuffers) -> Moved:
        """Compose how each instance moves, in float64.

        Raises:
            InputError: where the motion is of another scene, or its camera of other intrinsics.
        """
        now, then = placed.scene, motion.scene
        if len(motion.instance) != len(now):
            raise InputError(f"motion: expected {len(now)} instances, those of the scene, got {len(motion.instance)}")
        if then.camera != now.camera:
            raise InputError(f"motion: expected the scene's camera, {now.camera}, got {then.camera}")
        view_from_model = then.camera_from_world @ motion.world_from_model
        moves = np.zeros(len(now), _MOVE)
        # The pseudo-inverse, since a flat model may be placed by a matrix that flattens it.
        turn = view_from_model[:, :3, :3] @ np.linalg.pinv(placed.view_from_model[:, :3, :3]) - np.eye(3)
        # What stays has no flow at all, not one of rounding errors.
        turn[(view_from_model[:, :3, :3] == placed.view_from_model[:, :3, :3]).all(axis=(1, 2))] = 0
        centre = placed.view_from_model[:, :3, 3]
        moves["turn_and_shift"][:, :, :3] = turn
        moves["turn_and_shift"][:, :, 3] = view_from_model[:, :3, 3] - centre
        moves["centre"] = centre
        moves["then"] = motion.instance.astype(np.uint32)  # -1 becomes GONE
        return Moved(models.place(then), moves)

    def draw(
        self, placed: Placed, moved: Moved, eye: Eye, own: EyeTargets, models: ModelBuffers, crop: Crop | None
    ) -> FlowTargets:
        """Find the flow of what one eye's targets show; return what holds it until the next call."""
        if self._then is None or self._targets is None:
            raise RuntimeError("the flow pass has no targets yet")
        scene, camera, then = placed.scene, placed.scene.camera, moved.then
        filled = models.fill(then, eye)
        self._then.clear()
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">"
        projection = clip_from_view(camera, eye, then.scene.near_m)
        set_uniform(self._draw_program, "clip_from_view", tuple(projection.T.ravel().tolist()))
        models.draw(self._draw_program, filled)

        self._bind_moves(moved, camera.offset_m(eye))
        models.bind_for_tracing(then, eye)
        own.use("depth", _OWN_DEPTH)
        own.use("surface", _OWN_SURFACE)
        self._then.use("depth", _THEN_DEPTH)
        self._then.use("surface", _THEN_SURFACE)
        self._targets.clear(crop)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        # As in the visibility pass: what the first draw discards keeps the depth that the clearing gave it.
        for number, (program, vao) in enumerate(self._draws):
            self._gl.depth_func = "1" if number == 0 else "!="
            set_uniform(program, "focal_baseline", camera.focal_baseline)
            set_uniform(program, "doffs_px", camera.doffs_px)
            set_uniform(program, "focal_px", camera.focal_px)
            set_uniform(program, "near_m", scene.near_m)
            set_uniform(program, "traced_centre_px", (camera.cx_px(eye), camera.cy_px))
            vao.render(moderngl.TRIANGLES, 3)
        return self._targets

    def _bind_moves(self, moved: Moved, offset_m: float) -> None:
        moves = moved.moves.copy()
        moves["centre"][:, 0] -= offset_m
        if moves.nbytes > self._moves.size:
            self._moves.orphan(2 * moves.nbytes)
        else:
            self._moves.orphan()
        if len(moves):
            self._moves.write(moves)
        self._moves.bind_to_storage_buffer(_MOVES)

    def release(self) -> None:
        """Free the targets."""
        for targets in (self._then, self._targets):
            if targets is not None:
                targets.release()
        self._then = self._targets = None
