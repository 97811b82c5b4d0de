"""The flow pass: where what one eye sees is at another moment, and whether the same eye sees it then."""

from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Crop, Eye
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.render.constants import ConstantsBuffer
from semisynth_gl.render.context import GraphicsContext
from semisynth_gl.render.listed_steps import ListedSteps
from semisynth_gl.render.model_buffers import ModelBuffers, refill
from semisynth_gl.render.placing import Placed, Placing
from semisynth_gl.render.programs import link_program
from semisynth_gl.render.readers import Reader
from semisynth_gl.render.structs import BLOCKS, MOVE
from semisynth_gl.render.targets import FLOW, EyeTargets, Targets
from semisynth_gl.scene.scene import Motion

_FEWEST_MOVES = 256
# float32 holds it; anything turned and scaled by more was too small to be seen.
_LARGEST_TURN = 1e30
# Texture units of flow.comp, and its image units.
_OWN_DEPTH, _OWN_SURFACE, _THEN_DEPTH, _THEN_SURFACE = range(4)
_IMAGES = {"flow": 0, "disparity_change": 1, "flow_visibility": 2}


class FlowPass:
    """Draws other moments' depth and surfaces, and compares in two compute steps; see flow.comp.

    Args:
        context: the open context.
        constants: its buffer of constants.
        read: what takes pixels.
    """

    def __init__(self, context: GraphicsContext, constants: ConstantsBuffer, read: Reader) -> None:
        self._context = context
        self._read = read
        self._gl = context.gl
        self._draw_program = link_program(context, "mesh.vert", "mesh.frag", {"DEPTH": 0, "SURFACE": 1})
        self._constants = constants
        # Pixel by pixel, with one list of pixels.
        self._steps = ListedSteps(context, "flow.comp", 2, tile_px=1, entries=1)
        self._moves = context.gl.buffer(reserve=_FEWEST_MOVES * MOVE.itemsize, dynamic=True)
        self._then: EyeTargets | None = None
        self._targets: Targets | None = None

    def resize(self, size: tuple[int, int]) -> None:
        """Make room for another image size; a size that the driver refuses leaves the pass as it was."""
        then = EyeTargets(self._context, size, ("depth", "surface"), visibility=False)
        # No pass reads or writes depth there, so it shares the other moment's depth buffer.
        targets = Targets(self._context, size, FLOW, self._read, then.depth_buffer)
        # moderngl binds the framebuffer in use again after making a new one, so the old ones go last.
        targets.framebuffer.use()
        for outgrown in (self._targets, self._then):
            if outgrown is not None:
                outgrown.release()
        self._then, self._targets = then, targets

    def place(self, placed: Placed, motion: Motion, placing: Placing) -> tuple[Placed, NDArray[np.void]]:
        """Place the other moment's instances, and compose how each instance moves: (N,) of `MOVE`, for the left eye.

        Raises:
            InputError: where the motion is of another scene, or its camera of other intrinsics.
        """
        now, then = placed.scene, motion.scene
        if len(motion.instance) != len(now):
            raise InputError(
                f"motion: expected {counted(len(now), 'instance')}, those of the scene, got {len(motion.instance)}"
            )
        if then.camera != now.camera:
            raise InputError(f"motion: expected the scene's camera, {now.camera}, got {then.camera}")
        view_from_model = placing.view_from_model(
            replace(now, camera_from_world=then.camera_from_world, world_from_model=motion.world_from_model)
        )
        moves = np.zeros(len(now), MOVE)
        # The pseudo-inverse, since a flat model may be placed by a matrix that flattens it.
        turn = view_from_model[:, :3, :3] @ np.linalg.pinv(placed.view_from_model[:, :3, :3]) - np.eye(3)
        # What stays has no flow at all, not one of rounding errors.
        turn[(view_from_model[:, :3, :3] == placed.view_from_model[:, :3, :3]).all(axis=(1, 2))] = 0
        if now.sky.any():
            # By directions, of which a flat instance has three dimensions: only they have a place at infinity.
            before, after = placed.view_from_model[now.sky, :3], view_from_model[now.sky, :3]
            still = (before == after).all(axis=(1, 2))[:, None, None]
            turn[now.sky] = np.where(still, 0.0, after @ np.linalg.pinv(before) - np.eye(3))
        centre = placed.view_from_model[:, :3, 3]
        moves["turn_and_shift"][:, :, :3] = np.clip(turn, -_LARGEST_TURN, _LARGEST_TURN)
        moves["turn_and_shift"][:, :, 3] = view_from_model[:, :3, 3] - centre
        moves["centre"] = centre
        moves["then"] = motion.instance.astype(np.uint32)  # -1 becomes GONE
        return placing.place(then), moves

    def draw(
        self,
        placed: Placed,
        moved: tuple[Placed, NDArray[np.void]],
        eye: Eye,
        own: EyeTargets,
        models: ModelBuffers,
        crop: Crop | None,
    ) -> Targets:
        """Find the flow of what one eye's targets show; return the targets that hold it until the next call."""
        if self._then is None or self._targets is None:
            raise RuntimeError("the flow pass has no targets yet")
        scene, camera, (then, moves) = placed.scene, placed.scene.camera, moved
        filled = models.fill(then, eye)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">"
        self._constants.write(camera, eye, then.scene.near_of(eye))
        with self._context.clock.timed("moment", eye):
            self._then.clear()
            for part in filled:
                models.draw(self._draw_program, part)

        moves = moves.copy()
        moves["centre"][:, 0] -= scene.offset_m(eye).astype(np.float32)
        turn = camera.turn(eye)
        if turn is not None:
            moves["turn_and_shift"][:, :, :3] = turn @ moves["turn_and_shift"][:, :, :3] @ turn.T
            moves["turn_and_shift"][:, :, 3] = moves["turn_and_shift"][:, :, 3] @ turn.T
            moves["centre"] = moves["centre"] @ turn.T
        refill(self._moves, moves)
        self._moves.bind_to_storage_buffer(BLOCKS["Moves"].binding)
        models.bind_triangles(then, eye)
        own.bind("depth", _OWN_DEPTH)
        own.bind("surface", _OWN_SURFACE)
        self._then.bind("depth", _THEN_DEPTH)
        self._then.bind("surface", _THEN_SURFACE)
        for name, unit in _IMAGES.items():
            self._targets.bind_to_image(name, unit)
        self._constants.write(camera, eye, scene.near_of(eye))
        with self._context.clock.timed("flow", eye):
            self._steps.run(crop or Crop(0, 0, *own.framebuffer.size))
        return self._targets
