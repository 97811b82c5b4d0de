"""The flow pass: where the points that one eye sees are at a target moment, and whether the same eye sees them then."""

from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.render.instance_transforms import InstanceTransforms, TransformComposer
from semisynth_gl.render.model_buffers import refill
from semisynth_gl.render.programs import link_meshes
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.target_set import DrawnPair
from semisynth_gl.render.targets import FLOW, Targets
from semisynth_gl.render.work_list_steps import WorkListSteps
from semisynth_gl.scene.scene import Motion

MOVE = np.dtype([("turn_and_shift", "<f4", (3, 4)), ("centre", "<f4", 3), ("", "<f4"), ("then", "<u4"), ("", "<u4", 3)])
"""The struct Move of flow.comp, std430."""

_MOVES_BINDING, _FEWEST_MOVES = 4, 256
# Entries of a turn are clipped to this value, so that they fit into float32. An instance that grows by more than this
# was too small to be visible before.
_LARGEST_TURN = 1e30


def place_moved(
    transforms: InstanceTransforms, motion: Motion, composer: TransformComposer
) -> tuple[InstanceTransforms, NDArray[np.void]]:
    """Return the transforms of the target moment, and how each of the scene's N instances moves until then.

    Moves are (N,) of `MOVE`, in the left eye's frame. Raises InputError where the motion does not fit the scene's
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
    # The turn is rotation and scaling minus 1. Use the pseudo-inverse: the matrix of a flat model may be singular.
    turn = view_from_model[:, :3, :3] @ np.linalg.pinv(transforms.view_from_model[:, :3, :3]) - np.eye(3)
    # An instance that does not move has a flow of exactly 0, without rounding errors.
    turn[(view_from_model[:, :3, :3] == transforms.view_from_model[:, :3, :3]).all(axis=(1, 2))] = 0
    if now.sky.any():
        # Points of the sky are directions, not positions. So the turn is fitted to the 3 x 4 matrix, which has rank 3
        # even for a flat instance.
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
    """Draws depth and surfaces of the target moment, and compares them with the pair's in two steps; see flow.comp."""

    def __init__(self, resources: RenderResources) -> None:
        self._resources, context = resources, resources.context
        self._draw_program = link_meshes(context, {"DEPTH": 0, "SURFACE": 1})
        # Tiles are single pixels, and there is one list of them.
        self._steps = WorkListSteps(context, "flow.comp", 2, tile_px=1, entries=1)
        self._moves = context.gl.buffer(reserve=_FEWEST_MOVES * MOVE.itemsize, dynamic=True)

    def draw(self, pair: DrawnPair, then: InstanceTransforms, moves: NDArray[np.void], eye: Eye) -> Targets:
        """Compute the flow of one eye's view towards the moment that `place_moved` prepared.

        Returns the targets of `FLOW`, which the next call overwrites.
        """
        drawn, targets = pair.targets.with_depth("then", ("depth", "surface")), pair.targets.without_depth("flow", FLOW)
        context, models, constants = self._resources.context, self._resources.models, self._resources.constants
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
        eye_from_left = scene.camera.turn(eye)
        if eye_from_left is not None:
            moves["turn_and_shift"][:, :, :3] = eye_from_left @ moves["turn_and_shift"][:, :, :3] @ eye_from_left.T
            moves["turn_and_shift"][:, :, 3] = moves["turn_and_shift"][:, :, 3] @ eye_from_left.T
            moves["centre"] = moves["centre"] @ eye_from_left.T
        refill(self._moves, moves)
        self._moves.bind_to_storage_buffer(_MOVES_BINDING)
        models.bind_triangles(then, eye)
        pair.eyes[eye].bind(depth=0, surface=1)
        drawn.bind(depth=2, surface=3)
        targets.bind_to_images(flow=0, disparity_change=1, flow_visibility=2)
        constants.write(scene, eye)
        self._steps.run(pair.area)
        return targets
