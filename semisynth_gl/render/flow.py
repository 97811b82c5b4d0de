"""The flow pass: for each pixel of one eye, where that eye sees the same surface point at a target moment.

It also finds whether the point is visible then. The target moment is the next or the previous frame.
"""

from dataclasses import replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import Eye
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.model_buffers import refill
from semisynth_gl.render.programs import link_meshes
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.target_set import DrawnPair
from semisynth_gl.render.targets import FLOW, Targets
from semisynth_gl.render.work_list_shader import WorkListShader
from semisynth_gl.scene.scene import SceneMotion

MOVE = np.dtype([
    ("change_and_shift", "<f4", (3, 4)), ("centre", "<f4", 3), ("", "<f4"), ("then", "<u4"), ("", "<u4", 3),
])  # fmt: skip
"""The struct Move of flow.comp, std430: the point c + q moves to c + s + (I + C) q; C is the change, s the shift."""

_MOVES_BINDING = 4
_FEWEST_MOVES = 256  # initial capacity of the buffer
# Entries of C are clipped to this value, to fit into float32. An instance that grows by more was invisible before.
_LARGEST_CHANGE = 1e30


def compose_moves(transforms: InstanceTransforms, motion: SceneMotion) -> NDArray[np.void]:
    """Return how each of the scene's N instances moves to the target moment, (N,) of `MOVE`, in the left eye's frame.

    Raises InputError where the motion has a different number of instances.
    """
    now, then = transforms.scene, motion.scene
    if len(motion.instance) != len(now):
        raise InputError(
            f"motion: expected {counted(len(now), 'instance')}, those of the scene, got {len(motion.instance)}"
        )
    moved = replace(now, camera_from_world=then.camera_from_world, world_from_model=motion.world_from_model)
    view_from_model = moved.view_from_model()
    moves = np.zeros(len(now), MOVE)
    change = _change(transforms.view_from_model[:, :3, :3], view_from_model[:, :3, :3])
    if now.sky.any():
        # flow.comp takes points of the sky as infinitely far away, and ignores their centre and shift. So C alone must
        # map them, with the translation of the 3 x 4 matrices.
        change[now.sky] = _change(transforms.view_from_model[now.sky, :3], view_from_model[now.sky, :3])
    centre = transforms.view_from_model[:, :3, 3]
    moves["change_and_shift"][:, :, :3] = np.clip(change, -_LARGEST_CHANGE, _LARGEST_CHANGE)
    moves["change_and_shift"][:, :, 3] = view_from_model[:, :3, 3] - centre
    moves["centre"] = centre
    moves["then"] = motion.instance.astype(np.uint32)  # -1 becomes GONE
    return moves


def _change(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return C of (I + C) before = after, (N, 3, 3), for N matrices; exactly 0 where both are equal."""
    # The pseudo-inverse exists even if a flat model's matrix is singular.
    change: NDArray[np.float64] = after @ np.linalg.pinv(before) - np.eye(3)
    change[(before == after).all(axis=(1, 2))] = 0
    return change


class FlowPass:
    """Draws depth and surfaces at the target moment; flow.comp computes flow from these and those of the pair."""

    def __init__(self, resources: RenderResources) -> None:
        self._resources, context = resources, resources.context
        self._draw_program = link_meshes(context, {"DEPTH": 0, "SURFACE": 1})
        # The first step handles single pixels, and there is one work list.
        self._steps = WorkListShader(context, "flow.comp", 2, tile_px=1, entries=1)
        self._moves = context.gl.buffer(reserve=_FEWEST_MOVES * MOVE.itemsize, dynamic=True)

    def compute(self, pair: DrawnPair, then: InstanceTransforms, moves: NDArray[np.void], eye: Eye) -> Targets:
        """Compute the flow of one eye's view towards the moment of ``then``; ``moves`` come from `compose_moves`.

        Returns the targets of `FLOW`, which the next call overwrites.
        """
        targets_then = pair.targets.with_depth("then", ("depth", "surface"))
        targets = pair.targets.without_depth("flow", FLOW)
        context, models, constants = self._resources.context, self._resources.models, self._resources.constants
        scene = pair.transforms.scene
        ranges = models.upload(then, eye)
        context.gl.enable_only(moderngl.DEPTH_TEST)
        context.gl.depth_func = ">"
        constants.write(then.scene, eye)
        targets_then.clear()
        for drawn in ranges:
            models.draw(self._draw_program, drawn)

        # From the left eye's frame to this eye's.
        moves = moves.copy()
        moves["centre"][:, 0] -= scene.offset_m(eye).astype(np.float32)
        eye_from_left = scene.camera.turn(eye)
        if eye_from_left is not None:
            change, shift = moves["change_and_shift"][:, :, :3], moves["change_and_shift"][:, :, 3]
            change[:] = eye_from_left @ change @ eye_from_left.T
            shift[:] = shift @ eye_from_left.T
            moves["centre"] = moves["centre"] @ eye_from_left.T
        refill(self._moves, moves)
        self._moves.bind_to_storage_buffer(_MOVES_BINDING)
        models.bind_triangles(then, eye)
        pair.eyes[eye].bind(depth=0, surface=1)
        targets_then.bind(depth=2, surface=3)
        targets.bind_to_images(flow=0, disparity_change=1, flow_visibility=2)
        constants.write(scene, eye)
        self._steps.run(pair.area)
        return targets
