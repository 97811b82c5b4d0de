"""From a config to pairs. Data goes this way:

config -> scene    `MixSampler`: the objects of pair i, from (config, seed, i) alone
       -> frame    `Renderer`: images, disparities and visibilities as arrays
       -> sample   `encode_pair`: files in memory
       -> shard    `ShardWriter`: a fixed range of samples on disk, complete or absent
       -> dataset  `DatasetFiles`: shards, and an index last

The first two arrows are here; `semisynth_gl.generation.generate` has the others.
"""  # noqa: D415 - the drawing is the summary

from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any, Self

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES, Crop, Eye
from semisynth_gl.frame.frame import FUTURE_OUTPUTS, PAST_OUTPUTS, Frame
from semisynth_gl.histogram import Histogram
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.checks import Closed, faults
from semisynth_gl.pairs.exposure import exposed, moments
from semisynth_gl.pairs.imperfections import with_imperfections
from semisynth_gl.plugins import plugin_records
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.devices import check_libraries
from semisynth_gl.render.pass_clock import PassClock
from semisynth_gl.render.readers import Reader, read_array
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.render.shared_left import SharedLeft
from semisynth_gl.scene.mix import MixSampler
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.scene import Motion
from semisynth_gl.scene.sources import Sources, prepare_sources
from semisynth_gl.seeds.seeds import LARGEST_NUMBER, Purpose, generator
from semisynth_gl.seeds.splits import Split

PAIR_STAGES = ("sample", "draw", "visibility", "readback", "check")
"""The stages of a pair that a renderer reports to its listener, in order."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """One rendered pair.

    Attributes:
        index: the pair's number in the split.
        frame: images and truth.
        provenance: the origin of the pair, in JSON's types.
    """

    index: int
    frame: Frame
    provenance: dict[str, Any]


@dataclass(frozen=True, slots=True)
class _Settled:
    """The attempt that a sequence is drawn from, and the faults of the attempts before it."""

    sequence: int
    attempt: int
    redrawn: list[str]


@dataclass(slots=True, eq=False)
class _Shown:
    """A scene whose pairs are asked for, and the part of the images that is drawn; None for all of them."""

    number: int
    sampled: SampledScene
    crop: Crop | None
    # Draws the scene's pairs, where there are several.
    shared: SharedLeft | None
    # Pairs that were drawn for the checks and not asked for yet, by right view.
    frames: dict[int, Frame] = field(default_factory=dict)
    # With imperfections, once one of the pairs has it.
    left_image: NDArray[np.uint8] | None = None

    def shows(self, number: int, attempt: int, crop: Crop | None) -> bool:
        """Return whether pairs of a scene wait here, whole ones which can be cut, or share a left view of a crop."""
        waits = self.crop is None and bool(self.frames)
        shares = self.shared is not None and self.crop == crop
        return (self.number, self.sampled.attempt) == (number, attempt) and (waits or shares)


def renderer_options(config: Config) -> dict[str, Any]:
    """Return the options of a `Renderer` that a config states."""
    return {
        "wrap": config.textures.wrap,
        "anisotropy": config.textures.anisotropy,
        "large_anisotropy": config.textures.large_anisotropy,
        "outputs": config.outputs,
        "truth": config.truth,
        "rectified": config.rig.none(),
        "signed": config.disparity.signed,
        "antialias": config.antialias,
    }


class PairRenderer:
    """Renders any pair of a config and seed. Use it in a ``with`` block, in the thread that made it.

    Args:
        config: the configuration.
        seed: the dataset's seed, 0 or more, for a dataset of one split; else the split of the pairs.
        backend: "auto", "egl" or "osmesa".
        device_index: EGL's number of the device.
        read: takes the drawn pixels; other readers than `read_array` need ``checked=False``.
        sources: patches and models of this config and split, where they are there already.

    Attributes:
        sources: patches and models; see `forget_pixels`.
        sampler: makes the scenes of the pairs.

    Raises:
        InputError: where images or models cannot be used.
        BackendError: where OpenGL cannot be used.
    """

    def __init__(
        self,
        config: Config,
        seed: int | Split,
        backend: Backend = "auto",
        device_index: int = 0,
        read: Reader = read_array,
        sources: Sources | None = None,
    ) -> None:
        check_type("config", config, Config, "load_config(NAME_OR_PATH) reads one")
        split = seed if isinstance(seed, Split) else Split(to_whole("a seed", seed, least=0))
        self.config = config
        self.split = split
        check_libraries(backend)
        self.sources = sources or prepare_sources(config, split)
        atlas = self.sources.atlas
        self.sampler = MixSampler(config, split.seed, self.sources.libraries, atlas.patches)
        self._renderer = Renderer(
            self.sampler.models,
            atlas.layers,
            large_layers=atlas.large_layers if len(atlas.large_layers) else None,
            backend=backend,
            device_index=device_index,
            read=read,
            **renderer_options(config),
        )
        self._settled: _Settled | None = None
        self._shown: _Shown | None = None
        plugins = plugin_records(config.used_plugins().values())
        self._made_by = {
            "program": "semisynth-gl",
            "version": version("semisynth-gl"),
            "config": config.name,
            "config_sha256": config.digest(),
            "seed": split.dataset_seed,
            "split": split.name,
            **({"plugins": plugins} if plugins else {}),
            "renderer": self._renderer.renderer_name,
            "backend": self._renderer.backend,
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.release()

    def release(self) -> None:
        """Free the renderer; a second call does nothing."""
        self._renderer.release()

    def forget_pixels(self) -> None:
        """Let go of the patches' pixels in ``sources``, which the driver has: each worker would hold its own copy."""
        self.sources = self.sources.without_pixels()

    @property
    def listener(self) -> Listener | None:
        """For measurements: hears each stage of `PAIR_STAGES`; see `Renderer`."""
        return self._renderer.listener

    @listener.setter
    def listener(self, listener: Listener | None) -> None:
        self._renderer.listener = listener

    @property
    def clock(self) -> PassClock:
        """For measurements: times the passes of pairs; see `Renderer`."""
        return self._renderer.clock

    @property
    def renderer_name(self) -> str:
        """The driver's name of the renderer (GL_RENDERER)."""
        return self._renderer.renderer_name

    def expected_histogram(self) -> Histogram:
        """Return the expected distribution of disparity over many pairs; see `MixSampler.expected`."""
        return self.sampler.expected()

    @property
    def facts(self) -> dict[str, str]:
        """Backend, renderer and version of OpenGL in the driver's words."""
        return self._renderer.facts

    def count_objects(self) -> dict[str, int]:
        """Count the driver's objects by kind, to search for leaks."""
        return self._renderer.count_objects()

    def render(self, index: int, *, crop: Crop | None = None, checked: bool = True) -> Pair:
        """Render pair ``index``, 0 or more.

        A pair whose sequence fails its checks is drawn again from the next sub-seed.

        Args:
            index: the pair's number.
            crop: return this part of both images alone. Checks judge whole images, so the first frame of a sequence is
                drawn whole for them, and cut afterwards; all others, or all where nothing is checked, are drawn and
                read back as far as the crop needs.
            checked: whether to check. Without checks, a pair with faults is returned, which differs from the dataset's.

        Raises:
            InputError: where the index is negative, the config's ranges leave no scene for it, or no attempt passes.
        """
        index = to_whole("a pair's index", index, 0, LARGEST_NUMBER)
        check_type("crop", crop, Crop | None)
        check_type("checked", checked, bool)
        if crop == Crop(0, 0, self.config.camera.width_px, self.config.camera.height_px):
            crop = None
        number, view = divmod(index, self.config.views)
        sequence = number // self.config.sequence.length
        settled = self._settled if checked else _Settled(sequence, 0, [])
        # Several pairs of a first frame are not all drawn again for one of them.
        judged = checked and self.config.views == 1 and number % self.config.sequence.length == 0
        if settled is None or settled.sequence != sequence or judged:
            settled = self._settle(sequence)
        # Imperfections are drawn for whole images.
        shown = self._show(number, settled.attempt, crop if self.config.imperfections.none() else None)
        sampled = shown.sampled.seen_by(view)
        frame = shown.frames.pop(view) if view in shown.frames else self._draw(shown, view)
        provenance = {"pair": index} | self._made_by | self.sampler.provenance(sampled)
        if settled.redrawn:
            provenance["redrawn"] = settled.redrawn
        if "instances" in self.config.outputs:
            provenance["instances"] = self.sampler.instance_table(sampled)
        if not self.config.imperfections.none():
            frame, provenance["imperfections"] = self._imperfect(frame, shown, view)
        if crop is not None and frame.camera == sampled.scene.camera:  # it was drawn whole
            frame = frame.cropped(crop)
        self._report("check")
        return Pair(index, frame, provenance)

    def _show(self, number: int, attempt: int, crop: Crop | None) -> _Shown:
        """Return a scene: the latest one, or another that is sampled now."""
        latest = self._shown
        if latest is not None and latest.shows(number, attempt, crop):
            return latest
        sampled = self.sampler.sample(number * self.config.views, attempt)
        self._report("sample")
        shared = None
        if self.config.views > 1:
            shared = self._renderer.share_left(sampled.scene, sampled.views, crop, **self._motions(sampled))
        self._shown = _Shown(number, sampled, crop, shared)
        return self._shown

    def _motions(self, sampled: SampledScene) -> dict[str, Motion | None]:
        """Return the motions of a scene that an output needs, as `Renderer.render` takes them."""
        outputs = self.config.outputs
        return {
            "future": self.sampler.motion(sampled, +1) if FUTURE_OUTPUTS.intersection(outputs) else None,
            "past": self.sampler.motion(sampled, -1) if PAST_OUTPUTS.intersection(outputs) else None,
        }

    def _draw(self, shown: _Shown, view: int) -> Frame:
        """Draw a scene as one of its right views sees it, with its motion where an output needs it."""
        if shown.shared is not None:
            return shown.shared.render(view)
        return self._renderer.render(shown.sampled.scene, shown.crop, **self._motions(shown.sampled))

    def _settle(self, sequence: int) -> _Settled:
        """Find a sequence's first attempt whose first frame passes the checks in all its right views.

        The pairs of that frame await being asked for.
        """
        redrawn: list[str] = []
        for attempt in range(self.config.checks.attempts):
            self._shown = None
            shown = self._show(sequence * self.config.sequence.length, attempt, None)
            clauses: list[str] = []
            for view in range(self.config.views):
                shown.frames[view] = self._draw(shown, view)
                closed = Closed.of(shown.sampled.seen_by(view), self.config)
                clauses = faults(shown.frames[view], self.config, closed)
                self._report("check")
                if clauses:
                    break
            if not clauses:
                self._settled = _Settled(sequence, attempt, redrawn)
                return self._settled
            redrawn.append("; ".join(clauses))
        raise InputError(
            f"sequence {sequence} fails its checks in {counted(len(redrawn), 'attempt')}, the last one because it is "
            f"{redrawn[-1]}. Change images or scene, or lower the key of the section checks"
        )

    def _imperfect(self, frame: Frame, shown: _Shown, view: int) -> tuple[Frame, dict[str, dict[str, Any]]]:
        """Put a rig's imperfections on a pair: the left eye's are the scene's, the right eye's are the pair's."""
        seed, section = self.split.seed, self.config.imperfections

        def of_scene(*keys: int | str) -> Generator:
            return generator(seed, Purpose.IMPERFECTIONS, shown.number, *keys)

        def further(key: str, eye: Eye) -> Generator:
            return of_scene(*((view,) if eye == "right" and view else ()), key, eye)

        # All eyes expose at the same time.
        motion_blur = section.motion_blur.draw(of_scene("motion_blur"))
        if motion_blur > 0:
            sampled = shown.sampled.seen_by(view)
            scenes = [self.sampler.moment(sampled, frames) for frames in moments(motion_blur, section.sub_frames)]
            # The first right eye's noise follows the left one's, so that pair makes the left image in any case.
            eyes: tuple[Eye, ...] = ("right",) if view and shown.left_image is not None else EYES
            frame = exposed(self._renderer, frame, sampled.scene, scenes, eyes)
        right_rng = of_scene(view) if view else None
        frame, drawn = with_imperfections(frame, section, of_scene(), further, right_rng, shown.left_image)
        if shown.shared is not None:
            shown.left_image = frame.left.image
            shown.left_image.flags.writeable = False
        if motion_blur > 0:
            drawn = {eye: values | {"motion_blur": motion_blur} for eye, values in drawn.items()}
        return frame, drawn

    def _report(self, stage: str) -> None:
        if self.listener is not None:
            self.listener.on_stage(stage)


def render_pair(config: Config, index: int, seed: int = 0, backend: Backend = "auto") -> Frame:
    """Render one pair of a config.

    This opens and closes everything; for many pairs keep a `PairRenderer`.

    Args:
        config: the configuration.
        index: the pair's number, 0 or more.
        seed: 0 or more.
        backend: "auto", "egl" or "osmesa".

    Raises:
        InputError: where images, models or ranges cannot be used, or no attempt passes the checks.
        BackendError: where OpenGL cannot be used.

    Returns:
        ``left`` and ``right`` (H, W, 3) uint8, (H, W) of monochrome cameras, ``disparity_left`` and ``disparity_right``
        (H, W) float32 px, and the visibilities; see `Frame`.
    """
    index = to_whole("a pair's index", index, 0, LARGEST_NUMBER)
    with PairRenderer(config, seed, backend) as pairs:
        return pairs.render(index).frame
