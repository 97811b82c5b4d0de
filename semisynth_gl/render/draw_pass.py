"""The drawing pass: draws each eye's view of a scene, and antialiased colour in a separate pass where needed."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from math import ceil
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from semisynth_gl.frame.camera import EYES, OTHER_EYE, Crop, Eye
from semisynth_gl.frame.channels import ViewArrays
from semisynth_gl.render.edges import EdgeBlendPass
from semisynth_gl.render.instance_transforms import InstanceTransforms
from semisynth_gl.render.model_buffers import DrawRange
from semisynth_gl.render.occlusion import OcclusionCuller
from semisynth_gl.render.options import CHANNELS_OF_BOTH_EYES
from semisynth_gl.render.programs import link_meshes, link_program
from semisynth_gl.render.projector_light import ProjectorLight
from semisynth_gl.render.resources import RenderResources
from semisynth_gl.render.target_set import COLOUR, DrawnPair, TargetSet
from semisynth_gl.render.targets import EyeTargets, EyeView, Targets, viewport_of
from semisynth_gl.scene.scene import Scene


class DrawPass:
    """Draws both eyes' views; raises BackendError where the driver refuses a program."""

    def __init__(self, resources: RenderResources) -> None:
        self._resources, self._options = resources, resources.options
        self._gl = resources.context.gl
        self._culler = OcclusionCuller(resources) if resources.context.software else None
        self._light = None if resources.pattern is None else ProjectorLight(resources, resources.pattern)
        self._attachments = {eye: self._options.attachments(eye) for eye in EYES}
        # Programs by attachments, anisotropy, and whether a projector lights the scene.
        self._linked: dict[tuple[tuple[str, ...], int, bool], moderngl.Program] = {}
        for names in (*self._attachments.values(), *([COLOUR] if self._options.factor > 1 else [])):
            self._programs(names)
        self._edges = EdgeBlendPass(resources, self._culler) if self._options.outlines else None

    def draw(
        self, transforms: Sequence[InstanceTransforms], crop: Crop | None, target_set: TargetSet
    ) -> Iterator[DrawnPair]:
        """Draw the pairs of a scene with one or more cameras.

        Several pairs share one left view. It is drawn once, with 1 / Z, from which each pair's disparity is computed.

        Args:
            transforms: the scene's instances, with each of the cameras.
            crop: the part of both images that the caller wants, or None for all of it.
            target_set: the targets of the image size.

        Yields:
            Each pair; read it before asking for the next pair. Its ``views`` already have supersampled images, and the
            left view has the channels that were read for an earlier pair and do not depend on the right eye.
        """
        parts = {eye: self._part([each.scene for each in transforms], eye, crop) for eye in EYES}
        is_shared, names = len(transforms) > 1, self._attachments["left"]
        if is_shared:
            names = tuple("inverse_depth" if name == "disparity" else name for name in names)
        left = target_set.with_depth("shared left" if is_shared else "left", names)
        right = target_set.with_depth("right", self._attachments["right"])
        left_channels: dict[str, Any] = {}
        for each in transforms:
            self._draw_projector_depth(each)
            views: dict[Eye, dict[str, Any]] = {"left": left_channels, "right": {}}
            pair = DrawnPair(each, crop, target_set, {"left": left, "right": right}, views)
            if each is transforms[0]:
                self._draw(pair, "left", parts["left"])
            if is_shared:
                self._compute_disparity(each.scene, left, parts["left"])
            self._draw(pair, "right", parts["right"])
            yield pair
            left_channels = {name: read for name, read in left_channels.items() if name not in CHANNELS_OF_BOTH_EYES}

    def draw_image(self, transforms: InstanceTransforms, eye: Eye, target_set: TargetSet) -> NDArray[np.uint8]:
        """Draw only one eye's image; return it as the reader does, by default (H, W, 3) uint8 RGB or (H, W) grey."""
        self._draw_projector_depth(transforms)
        if self._options.factor > 1:
            return self._draw_supersampled(transforms, eye, None, target_set)
        view = EyeView(transforms, eye, None, target_set.with_depth("image", COLOUR))
        self._draw_view(view)
        self._antialias_outlines(view)
        image: NDArray[np.uint8] = view.targets.read("colour")
        return image

    def _draw_projector_depth(self, transforms: InstanceTransforms) -> None:
        """Draw the depth map of the scene's projector, if it has one."""
        if self._light is not None:
            self._light.draw_depth(transforms, self._draw_view)

    @cached_property
    def _disparity_vao(self) -> moderngl.VertexArray:
        program = link_program(self._resources.context, "whole_image.vert", "disparity.frag", {})
        return self._gl.vertex_array(program, [])

    @cached_property
    def _mean_vao(self) -> moderngl.VertexArray:
        defines = {"FACTOR": self._options.factor}
        program = link_program(self._resources.context, "whole_image.vert", "resolve.frag", defines)
        return self._gl.vertex_array(program, [])

    def _compute_disparity(self, scene: Scene, targets: EyeTargets, part: Crop | None) -> None:
        """Compute the disparity of a shared left view, or of a part of it, for the scene's camera.

        The drawing pass uses the same formula of 1 / Z, so the result is the same bit for bit.
        """
        assert targets.disparity is not None  # noqa: S101 - the targets are made with 1 / Z
        self._resources.constants.write(scene, "left")
        targets.bind(inverse_depth=0)
        self._draw_whole_image(self._disparity_vao, targets.disparity, part)

    def _draw_whole_image(self, vao: moderngl.VertexArray, targets: Targets, part: Crop | None) -> None:
        """Draw the triangle of whole_image.vert to targets, or to a part of them."""
        targets.limit(part)
        targets.framebuffer.use()
        self._gl.enable_only(moderngl.NOTHING)
        vao.render(moderngl.TRIANGLES, 3)

    def _programs(self, names: tuple[str, ...], *, lit: bool = False) -> list[moderngl.Program]:
        """Return the programs that draw to given attachments, one for each atlas; link programs that are missing."""
        for anisotropy in self._resources.anisotropies:
            if (names, anisotropy, lit) not in self._linked:
                self._linked[names, anisotropy, lit] = self._link(names, anisotropy, lit=lit)
        return [self._linked[names, anisotropy, lit] for anisotropy in self._resources.anisotropies]

    def _link(self, names: tuple[str, ...], anisotropy: int, *, lit: bool) -> moderngl.Program:
        defines = {name.upper(): number for number, name in enumerate(names)}
        if self._resources.patches.grey and "colour" in names:
            defines["GREY"] = 1
        if lit:
            defines["LIT"] = 1
        anisotropic = anisotropy > 1 and "colour" in names
        if anisotropic:
            defines["ANISOTROPIC"] = 1
        program = link_meshes(self._resources.context, defines)
        if anisotropic:
            program["most_samples"] = float(anisotropy)
        return program

    def _part(self, scenes: Sequence[Scene], eye: Eye, crop: Crop | None) -> Crop | None:
        """Return the part of one eye's image that a crop needs in any of the scenes; None for the whole image.

        The part is larger than the crop if the visibility pass looks up the other eye's points in it.
        """
        # If a camera deviates, look-ups may reach any row.
        if crop is None or not all(scene.camera.rectified for scene in scenes):
            return None
        # Antialiasing along outlines blends colours of adjacent pixels.
        left = right = border_px = 0 if self._edges is None else 1
        if self._options.visibility and OTHER_EYE[eye] in self._options.truth_eyes:
            # A disparity, x_left - x_right, lies between that of infinity, -doffs, and that of the near plane. Look-ups
            # reach one pixel farther to each side, and a second pixel is a margin for rounding.
            border_px = 2
            largest_px = max(ceil(float(scene.camera.disparity_px(scene.near_m))) for scene in scenes)
            below_zero_px = max(ceil(scene.camera.doffs_px) for scene in scenes) if self._options.signed else 0
            ahead, behind = max(0, largest_px) + border_px, max(0, below_zero_px) + border_px
            left, right = (behind, ahead) if eye == "left" else (ahead, behind)
        camera = scenes[0].camera
        x, y = max(0, crop.x_px - left), max(0, crop.y_px - border_px)
        x_end, y_end = min(camera.width_px, crop.right_px + right), min(camera.height_px, crop.bottom_px + border_px)
        return Crop(x, y, x_end - x, y_end - y)

    def _draw(self, pair: DrawnPair, eye: Eye, part: Crop | None) -> None:
        """Draw a part of one eye's view, or all of it; with supersampling, also draw and read the image."""
        targets = pair.eyes[eye]
        if targets.names:
            self._draw_view(EyeView(pair.transforms, eye, part, targets))
            self._antialias_outlines(EyeView(pair.transforms, eye, pair.crop, targets))
        if self._options.factor > 1:
            pair.views[eye]["image"] = self._draw_supersampled(pair.transforms, eye, pair.crop, pair.targets)

    def _draw_view(self, view: EyeView) -> None:
        """Draw a view with one sample a pixel."""
        models, transforms, targets = self._resources.models, view.transforms, view.targets
        ranges: Sequence[DrawRange] = models.upload(transforms, view.eye, view.part)
        self._resources.constants.write(transforms.scene, view.eye)
        targets.limit(view.part)
        if ViewArrays.normals.name in targets.names:
            models.bind_triangles(transforms, view.eye)
        if self._culler is not None and self._culler.pays_off(transforms):
            ranges = self._culler.cull(view, ranges)
            targets.clear(depth=False)  # the depth of the occluders stays
        else:
            targets.clear()
        self._draw_ranges(targets, ranges, transforms.scene, view.eye)

    def _antialias_outlines(self, view: EyeView) -> None:
        """Antialias the view that was drawn last along outlines, if the options ask for it."""
        if self._edges is not None:
            # The projector's light is still bound from the drawing.
            self._edges.draw(view, lit=view.transforms.scene.projector is not None)

    def _draw_supersampled(
        self, transforms: InstanceTransforms, eye: Eye, crop: Crop | None, target_set: TargetSet
    ) -> NDArray[np.uint8]:
        """Draw one eye's colour, or a crop of it, with several samples a pixel; return the image."""
        factor = self._options.factor
        fine = target_set.with_depth("fine", COLOUR, factor)
        mean = target_set.without_depth("mean", fine.attachments)
        # Do not cull: what is hidden at the centres of pixels may be visible between them.
        ranges = self._resources.models.upload(transforms, eye, crop)
        self._resources.constants.write(transforms.scene, eye)
        fine.limit(None if crop is None else Crop(*(factor * each for each in viewport_of(crop, target_set.size))))
        fine.clear()
        self._draw_ranges(fine, ranges, transforms.scene, eye)
        fine.bind(colour=0)
        self._draw_whole_image(self._mean_vao, mean, crop)
        image: NDArray[np.uint8] = mean.read("colour", crop)
        return image

    def _draw_ranges(self, targets: EyeTargets, ranges: Sequence[DrawRange], scene: Scene, eye: Eye) -> None:
        """Draw ranges of the uploaded instances to the targets in use."""
        projector = scene.projector if "colour" in targets.names else None
        if projector is not None and self._light is not None:
            self._light.bind(projector, scene.camera, eye, targets.framebuffer.width)
        programs = self._programs(targets.names, lit=projector is not None)
        self._gl.enable_only(moderngl.DEPTH_TEST)
        self._gl.depth_func = ">"
        for drawn in ranges:
            self._resources.patches.use(drawn.atlas)
            self._resources.models.draw(programs[drawn.atlas], drawn)
