"""The cameras of a rig: motion blur, lenses, imperfections and rectification of rendered images.

Motion blur is the mean of images at several moments before and after the frame's time, which is in the middle. So the
truth of a point that moves steadily is at the middle of its blur.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES, Eye, StereoCamera
from semisynth_gl.frame.frame import Frame
from semisynth_gl.lens.borders import with_borders
from semisynth_gl.lens.rectification import EyeRectification
from semisynth_gl.pairs.imperfections import ImageImperfections, apply_imperfections, sample_imperfections
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.scene import Scene
from semisynth_gl.seeds.seeds import Purpose, generator

Images = dict[Eye, NDArray[np.uint8]]
Channels = dict[str, NDArray[Any]]


class RigCapture:
    """The cameras of a rig. ``seed`` is the split's; ``renderer`` renders further moments and denser images."""

    def __init__(self, config: Config, seed: int, renderer: Renderer) -> None:
        self._config, self._seed, self._renderer = config, seed, renderer
        # For each eye: the arguments and the result of the latest `EyeRectification`.
        self._lenses: dict[Eye, tuple[object, EyeRectification]] = {}

    def capture(
        self, frames: Sequence[Frame], sampled: SampledScene, views: Sequence[int]
    ) -> list[tuple[Frame, dict[str, Any]]]:
        """Return the captured frames, each with the entries "lens" and "imperfections" of its pair's provenance.

        Random imperfections of the left eye depend on the scene, those of a right eye on the scene and the view.
        Several frames share their left images, which are then read-only.

        Args:
            frames: rendered frames of one scene.
            sampled: the scene.
            views: the number of each frame's right view.
        """
        if self._config.images_as_rendered:
            return [(frame, {}) for frame in frames]
        results, channels = [], dict[Eye, Channels]()
        for view, frame in zip(views, frames, strict=True):
            seen = sampled.seen_by(view)
            lenses = self._eye_lenses(seen.sequence.number, seen.scene.camera)
            captured, records = self._capture_eyes(frame, seen, lenses, ("right",) if channels else EYES)
            channels |= captured
            left, right = (frame.view(eye).with_channels(channels[eye]) for eye in EYES)
            result = Frame(frame.camera, left, right)
            if self._config.lens is not None:
                keep = self._config.lens.border_disparity
                result = with_borders(result, lenses, self._config.outputs, border_disparity=keep)
            results.append((result, records))
        if len(frames) > 1:
            for array in channels["left"].values():
                array.flags.writeable = False
        return results

    def _capture_eyes(
        self, frame: Frame, sampled: SampledScene, lenses: Mapping[Eye, EyeRectification], eyes: Sequence[Eye]
    ) -> tuple[dict[Eye, Channels], dict[str, Any]]:
        """Return each eye's image and its outputs "raw" and "raw_map", and the pair's entries of the provenance."""
        section, camera, records = self._config.imperfections, sampled.scene.camera, dict[str, Any]()
        number = sampled.sequence.number * self._config.sequence.length + sampled.frame
        if self._config.lens is not None:
            records["lens"] = {eye: lens.raw.record() for eye, lens in lenses.items()}
            if not self._config.lens.border_disparity:
                records["lens"]["border_disparity"] = False
        # Both eyes expose at the same time, so a scene has one motion blur.
        motion_blur = section.motion_blur.sample(generator(self._seed, Purpose.IMPERFECTIONS, number, "motion_blur"))
        # Each eye has its own density: with a common one, a shared left image would depend on the right lens.
        densities = {eye: lenses[eye].density if lenses else 1.0 for eye in eyes}
        images = self._expose_eyes(frame, sampled, motion_blur, densities)
        principal_points = {eye: camera.intrinsics_px(eye)[:2] for eye in EYES}
        if lenses:
            images = {eye: lenses[eye].raw_image(image, densities[eye]) for eye, image in images.items()}
            principal_points = {eye: (lens.raw.cx_px, lens.raw.cy_px) for eye, lens in lenses.items()}
        if not section.changes_nothing():
            records["imperfections"] = {}
            for eye in EYES:
                # The left eye's imperfections are the same for all right views.
                view = 0 if eye == "left" else sampled.view
                generator_of = partial(generator, self._seed, Purpose.IMPERFECTIONS, number, eye, view)
                rng = generator_of()
                values = sample_imperfections(section, rng, generator_of)
                records["imperfections"][eye] = values | ({"motion_blur": motion_blur} if motion_blur > 0 else {})
                if eye in images:
                    imperfections = ImageImperfections(**values)
                    images[eye] = apply_imperfections(images[eye], imperfections, rng, principal_points[eye])
        return {
            eye: self._rectified(lenses[eye], image) if lenses else {"image": image} for eye, image in images.items()
        }, records

    def _expose_eyes(
        self, frame: Frame, sampled: SampledScene, motion_blur: float, densities: Mapping[Eye, float]
    ) -> Images:
        """Return the image of each eye in ``densities`` at this density, with motion blur."""
        images, scenes = Images(), [sampled.scene]
        if motion_blur > 0:
            count = self._config.imperfections.sub_frames
            scenes = [sampled.moment(frames) for frames in moments(motion_blur, count)]
        for density in dict.fromkeys(densities.values()):
            eyes = [eye for eye in densities if densities[eye] == density]
            if density == 1 and motion_blur == 0:
                images |= {eye: frame.view(eye).image for eye in eyes}
            else:
                camera = sampled.scene.camera
                size = ceil(camera.height_px * density), ceil(camera.width_px * density)
                denser = camera.scaled(density, density, size)
                images |= expose(self._renderer, [replace(scene, camera=denser) for scene in scenes], eyes)
        return images

    def _rectified(self, lens: EyeRectification, raw_image: NDArray[np.uint8]) -> Channels:
        """Return the image and the outputs "raw" and "raw_map" of an eye's view, from its raw image."""
        channels: Channels = {"image": lens.rectify(raw_image)}
        if "raw" in self._config.outputs:
            channels["raw"] = lens.within_view(raw_image)
        if "raw_map" in self._config.outputs:
            channels["raw_map"] = lens.raw_map.copy()
        return channels

    def _eye_lenses(self, sequence: int, camera: StereoCamera) -> dict[Eye, EyeRectification]:
        """Return each eye's lens in a sequence; ``camera`` is the rectified pair. Empty without the section lens."""
        section = self._config.lens
        if section is None:
            return {}
        for eye in EYES:
            raw = section.sample(eye, generator(self._seed, Purpose.LENS, sequence, eye))
            key = raw, camera.width_px, camera.height_px, camera.intrinsics_px(eye)
            if eye not in self._lenses or self._lenses[eye][0] != key:
                self._lenses[eye] = key, EyeRectification(raw, camera, eye, section.border)
        return {eye: lens for eye, (_, lens) in self._lenses.items()}


def moments(exposure: float, count: int) -> NDArray[np.float64]:
    """Return the middles of ``count`` equal parts of an exposure, (count,), relative to the exposure's middle.

    These times and the length ``exposure`` are fractions of the time between frames.
    """
    return exposure * ((np.arange(count) + 0.5) / count - 0.5)


def expose(renderer: Renderer, scenes: Sequence[Scene], eyes: Sequence[Eye]) -> Images:
    """Return the mean of the images of a scene at up to 257 moments, by eye; halves are rounded to the even level."""
    first, *others = scenes
    images = renderer.render_images(first, eyes)
    if not others:
        return images
    sums = {eye: image.astype(np.uint16) for eye, image in images.items()}
    for scene in others:
        for eye, image in renderer.render_images(scene, eyes).items():
            sums[eye] += image
    table = np.rint(np.arange(255 * len(scenes) + 1) / len(scenes)).astype(np.uint8)
    return {eye: np.take(table, total) for eye, total in sums.items()}
