"""What the cameras of a rig make of rendered images: exposed, bent by lenses, made imperfect, and rectified."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.frame import Frame
from semisynth_gl.lens.borders import with_borders
from semisynth_gl.lens.chain import LensChain, scaled_camera
from semisynth_gl.lens.lenses import Lenses
from semisynth_gl.pairs.exposure import exposed, moments
from semisynth_gl.pairs.imperfections import apply_imperfections, recorded, sample_imperfections
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.mix import MixSampler
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.scene import Scene
from semisynth_gl.seeds.seeds import Purpose, generator

Images = dict[Eye, NDArray[np.uint8]]


class CameraImages(NamedTuple):
    """The images of a pair as its cameras give them.

    Attributes:
        views: "image" of each eye that was asked for and, as the outputs ask, "raw" and "raw_map".
        chains: the way of each eye's image through its lens; None without lenses.
        records: "lens" and "imperfections" of the pair's provenance, in JSON's types.
    """

    views: dict[Eye, dict[str, NDArray[Any]]]
    chains: Mapping[Eye, LensChain] | None
    records: dict[str, Any]

    def frame(self, rendered: Frame, config: Config) -> Frame:
        """Return a frame with these images of both eyes, and with the borders that lenses leave in its masks."""
        views = {eye: rendered.view(eye).with_channels(self.views[eye]) for eye in EYES}
        frame = Frame(rendered.camera, views["left"], views["right"])
        if self.chains is None or config.lens is None:
            return frame
        return with_borders(frame, self.chains, config.outputs, border_disparity=config.lens.border_disparity)


class Cameras:
    """The cameras of a dataset's rig.

    Args:
        config: the configuration.
        seed: of the split.
        renderer: renders what frames lack: other moments, and denser images.
        sampler: made the scenes.
    """

    def __init__(self, config: Config, seed: int, renderer: Renderer, sampler: MixSampler) -> None:
        self._config, self._seed, self._renderer, self._sampler = config, seed, renderer, sampler
        self._lenses = None if config.lens is None else Lenses(config.lens, self._lens_rng)

    def take(
        self, frame: Frame, sampled: SampledScene, number: int, left: dict[str, NDArray[Any]] | None = None
    ) -> CameraImages:
        """Take the images of a rendered frame.

        The left eye's random values depend on the scene, the right eye's on the scene and the view.

        Args:
            frame: the rendered pair.
            sampled: its scene, as its right view sees it.
            number: of the scene.
            left: what this method gave of the left view with another right view of the scene, if it did.
        """
        eyes: Sequence[Eye] = EYES if left is None else ("right",)
        section, camera, chains = self._config.imperfections, sampled.scene.camera, None
        records: dict[str, Any] = {}
        if self._lenses is not None:
            chains = self._lenses.chains(number // self._config.sequence.length, camera)
            records["lens"] = {eye: chain.raw.record() for eye, chain in chains.items()}
            if self._config.lens is not None and not self._config.lens.border_disparity:
                records["lens"]["border_disparity"] = False
        # All eyes expose at the same time, so motion blur is sampled once for a scene.
        motion_blur = section.motion_blur.sample(generator(self._seed, Purpose.IMPERFECTIONS, number, "motion_blur"))
        moved: list[Scene] = []
        if motion_blur > 0:
            moved = [self._sampler.moment(sampled, frames) for frames in moments(motion_blur, section.sub_frames)]
        # An eye's density is that of its lens alone, since pairs that share a left view differ in the right.
        densities = {eye: chains[eye].density if chains else 1.0 for eye in eyes}
        images: Images = {}
        for density in dict.fromkeys(densities.values()):
            alike = [eye for eye in eyes if densities[eye] == density]
            images |= self._exposed(frame, sampled.scene, moved, density, alike)
        points = {eye: camera.lens_px(eye)[:2] for eye in EYES}
        if chains:
            images = {eye: chains[eye].raw_image(image, densities[eye]) for eye, image in images.items()}
            points = {eye: (chain.raw.cx_px, chain.raw.cy_px) for eye, chain in chains.items()}
        if not section.none():
            images, values_by_eye = self._imperfect(images, points, number, sampled.view)
            blurred = {"motion_blur": motion_blur} if motion_blur > 0 else {}
            records["imperfections"] = {eye: values | blurred for eye, values in values_by_eye.items()}
        views = {
            eye: self._rectified(chains[eye], image) if chains else {"image": image} for eye, image in images.items()
        }
        return CameraImages(views if left is None else views | {"left": left}, chains, records)

    def _exposed(
        self, frame: Frame, scene: Scene, moved: Sequence[Scene], density: float, eyes: Sequence[Eye]
    ) -> Images:
        """Return images of eyes whose lenses want one density, exposed at the moments of moved scenes, if any."""
        camera = scaled_camera(scene.camera, density)
        if density > 1:
            scene = replace(scene, camera=camera)
            images = self._renderer.render_images(scene, eyes)
        else:
            images = {eye: frame.view(eye).image for eye in eyes}
        if not moved:
            return images
        return exposed(self._renderer, images, scene, [replace(each, camera=camera) for each in moved])

    def _rectified(self, chain: LensChain, raw_image: NDArray[np.uint8]) -> dict[str, NDArray[Any]]:
        """Return the channels of an eye's view that follow from its raw image, as the outputs ask."""
        channels: dict[str, NDArray[Any]] = {"image": chain.rectify(raw_image)}
        if "raw" in self._config.outputs:
            channels["raw"] = chain.within_view(raw_image)
        if "raw_map" in self._config.outputs:
            channels["raw_map"] = chain.raw_map.copy()
        return channels

    def _imperfect(
        self, images: Images, points: Mapping[Eye, tuple[float, float]], number: int, view: int
    ) -> tuple[Images, dict[Eye, dict[str, Any]]]:
        """Return images with imperfections, and both eyes' values as the provenance has them."""
        section = self._config.imperfections
        finished: Images = {}
        records: dict[Eye, dict[str, Any]] = {}
        for eye in EYES:
            # All right views share the left eye's.
            of_eye = partial(generator, self._seed, Purpose.IMPERFECTIONS, number, eye, 0 if eye == "left" else view)
            rng = of_eye()
            sampled = sample_imperfections(section, rng, of_eye)
            records[eye] = recorded(sampled, section)
            if eye in images:
                finished[eye] = apply_imperfections(images[eye], sampled, rng, points[eye])
        return finished, records

    def _lens_rng(self, sequence: int, eye: Eye) -> np.random.Generator:
        return generator(self._seed, Purpose.LENS, sequence, eye)
