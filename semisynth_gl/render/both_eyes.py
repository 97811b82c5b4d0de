"""The passes that compare both eyes' views: whether and where the other eye sees the points of one eye's view."""

import numpy as np

from semisynth_gl.frame.camera import OTHER_EYE, Eye, StereoCamera
from semisynth_gl.frame.channels import VISIBLE
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.target_set import DrawnPair
from semisynth_gl.render.targets import CORRESPONDENCE, VISIBILITY, Targets
from semisynth_gl.render.work_list_shader import WorkListShader

_TILE_PX = 4
# Room in the visibility pass's work lists for each tile: the tile in one list, its pixels in the other one.
_ENTRIES = 1 + _TILE_PX**2


class VisibilityMaskPass:
    """Computes whether the other eye sees the points that one eye sees, in rectified pairs; see visibility.comp."""

    def __init__(self, resources: RenderResources) -> None:
        self._resources = resources
        self._steps = WorkListShader(resources.context, "visibility.comp", 3, _TILE_PX, _ENTRIES)

    def compute(self, pair: DrawnPair, eye: Eye) -> None:
        """Compute the visibility of one eye's view, or of a crop of it, from both eyes' disparities and surfaces."""
        targets, other = pair.targets.without_depth(f"visibility {eye}", VISIBILITY), OTHER_EYE[eye]
        targets.limit(pair.crop)
        targets.bind_to_images(visibility=0)
        pair.eyes[eye].bind(disparity=0, surface=2)
        pair.eyes[other].bind(disparity=1, surface=3)
        self._resources.models.bind_triangles(pair.transforms, other)
        self._resources.constants.write(pair.transforms.scene, other)
        targets.framebuffer.use()
        self._resources.context.functions.clear_unsigned(0, VISIBLE)
        self._steps.run(pair.area)


class CorrespondencePass:
    """Computes where the other eye sees the points that one eye sees, even if right cameras deviate; see flow.comp."""

    def __init__(self, resources: RenderResources) -> None:
        self._resources = resources
        # The first step handles single pixels, and there is one work list.
        self._steps = WorkListShader(resources.context, "flow.comp", 2, tile_px=1, entries=1, defines={"OTHER_EYE": 1})

    def compute(self, pair: DrawnPair, eye: Eye) -> Targets:
        """Compute the correspondences of one eye's view; return the targets of `CORRESPONDENCE`.

        The next call overwrites the targets. In a rectified pair, ignore the targets' disparity and visibility: the
        drawing pass and the visibility pass make these.
        """
        targets = pair.targets.without_depth("correspondence", CORRESPONDENCE)
        scene, camera, other = pair.transforms.scene, pair.transforms.scene.camera, OTHER_EYE[eye]
        self._steps.set("rectified", camera.rectified)
        self._steps.set("change_and_shift", _change_and_shift(camera, eye))
        own_lens, lens = np.array(camera.intrinsics_px(eye)), np.array(camera.intrinsics_px(other))
        self._steps.set("own_lens", tuple(own_lens))
        self._steps.set("lens_change", tuple(lens - own_lens))
        self._resources.models.bind_triangles(pair.transforms, other)
        pair.eyes[eye].bind(depth=0, surface=1, disparity=6)
        pair.eyes[other].bind(depth=2, surface=3)
        targets.bind_to_images(correspondence=0, disparity=1, visibility=2)
        self._resources.constants.write(scene, other)
        self._steps.run(pair.area)
        return targets


def _change_and_shift(camera: StereoCamera, eye: Eye) -> list[tuple[float, ...]]:
    """Return the three rows of [R - I | s], for the transform R x + s from one eye's frame to the other eye's."""
    other = OTHER_EYE[eye]
    own_turn, other_turn = (np.eye(3) if turn is None else turn for turn in (camera.turn(eye), camera.turn(other)))
    shift = other_turn @ (camera.offset_m(eye) - camera.offset_m(other), 0.0, 0.0)
    return [(*row, at) for row, at in zip(other_turn @ own_turn.T - np.eye(3), shift, strict=True)]
