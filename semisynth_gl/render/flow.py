"""The flow pass: where the points that one eye sees are at another moment, and whether the same eye sees them then."""

from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.render.instance_transforms import InstanceTransforms, TransformComposer
from semisynth_gl.render.listed_steps import ListedSteps
from semisynth_gl.render.model_buffers import refill
from semisynth_gl.render.pair_targets import DrawnPair
from semisynth_gl.render.programs import link_meshes
from semisynth_gl.render.state import RenderState
from semisynth_gl.render.targets import FLOW, Targets
from semisynth_gl.scene.scene import Motion

MOVE = np.dtype([("turn_and_shift", "<f4", (3, 4)), ("centre", "<f4", 3), ("", "<f4"), ("then", "<u4"), ("", "<u4", 3)])
"""The struct Move of flow.comp, std430."""

_MOVES_BINDING, _FEWEST_MOVES = 4, 256
# Largest entry of a rotation and scaling, which float32 can hold; an instance that is enlarged more was too small to
# see.
_LARGEST_TURN = 1e30


def place_moved(
    transforms: InstanceTransforms, motion: Motion, composer: TransformComposer
) -> tuple[InstanceTransforms, NDArray[np.void]]:
    """Return the instances that are drawn at another moment, and how each of the scene's N instances moves, as `MOVE`.

    Moves are (N,) and as the left eye sees them. Raises InputError where the motion is not that of the scene's
    instances.
    """
    now, then = transforms.scene, motion.scene
    if len(motion.instance) != len(now):
        raise InputError(
            f"motion: expected {counted(len(now), 'instance')}, those of the scene, got {len(motion.instance)}"
        )
    moved = replace(now, camera_from_world=then.camera_from_world, world_from_model=motion.world_from_model)
    view_from_model = moved.view_from_model()
    moves = np.zeros(len(now), MOVE)
    # Use the pseudo-inverse, since the matrix of a flat model may flatten it.
    turn = view_from_model[:, :3, :3] @ np.linalg.pinv(transforms.view_from_model[:, :3, :3]) - np.eye(3)
    # The flow of an instance that stays is exactly 0, without rounding errors.
    turn[(view_from_model[:, :3, :3] == transforms.view_from_model[:, :3, :3]).all(axis=(1, 2))] = 0
    if now.sky.any():
        # The sky moves by directions, which span three dimensions even for a flat instance: points have no position at
        # infinity.
        before, after = transforms.view_from_model[now.sky, :3], view_from_model[now.sky, :3]
        still = (before == after).all(axis=(1, 2))[:, None, None]
        turn[now.sky] = np.where(still, 0.0, after @ np.linalg.pinv(before) - np.eye(3))
    centre = transforms.view_from_model[:, :3, 3]
    moves["turn_and_shift"][:, :, :3] = np.clip(turn, -_LARGEST_TURN, _LARGEST_TURN)
    moves["turn_and_shift"][:, :, 3] = view_from_model[:, :3, 3] - centre
    moves["centre"] = centre
    moves["then"] = motion.instance.astype(np.uint32)  # -1 becomes GONE
    return composer.compose(then), moves


class FlowPass:
    """Draws the depth and surfaces of another moment, and compares them with the pair's in two steps; see flow.comp."""

    def __init__(self, state: RenderState) -> None:
        self._state, context = state, state.context
        self._draw_program = link_meshes(context, {"DEPTH": 0, "SURFACE": 1})
        # Tiles are single pixels, and there is one list of them.
        self._steps = ListedSteps(context, "flow.comp", 2, tile_px=1, entries=1)
        self._moves = context.gl.buffer(reserve=_FEWEST_MOVES * MOVE.itemsize, dynamic=True)

    def draw(self, pair: DrawnPair, then: InstanceTransforms, moves: NDArray[np.void], eye: Eye) -> Targets:
        """Find the flow of one eye's view, to the result of `place_moved`; return the targets of `FLOW` that hold it.

        The next call overwrites the targets.
        """
        drawn, targets = pair.sized.drawn("then", ("depth", "surface")), pair.sized.computed("flow", FLOW)
        context, models, constants = self._state.context, self._state.models, self._state.constants
        scene = pair.transforms.scene
        filled = models.fill(then, eye)
        context.gl.enable_only(moderngl.DEPTH_TEST)
        context.gl.depth_func = ">"
        constants.write(then.scene, eye)
        drawn.clear()
        for part in filled:
            models.draw(self._draw_program, part)

        moves = moves.copy()
        moves["centre"][:, 0] -= scene.offset_m(eye).astype(np.float32)
        turn = scene.camera.turn(eye)
        if turn is not None:
            moves["turn_and_shift"][:, :, :3] = turn @ moves["turn_and_shift"][:, :, :3] @ turn.T
            moves["turn_and_shift"][:, :, 3] = moves["turn_and_shift"][:, :, 3] @ turn.T
            moves["centre"] = moves["centre"] @ turn.T
        refill(self._moves, moves)
        self._moves.bind_to_storage_buffer(_MOVES_BINDING)
        models.bind_triangles(then, eye)
        pair.eyes[eye].bind(depth=0, surface=1)
        drawn.bind(depth=2, surface=3)
        targets.bind_to_images(flow=0, disparity_change=1, flow_visibility=2)
        constants.write(scene, eye)
        self._steps.run(pair.area)
        return targets
