"""From a config to pairs. Data goes this way:

config -> scene    `MixSampler`: the objects of pair i, from (config, seed, i) alone
       -> frame    `Renderer`: images, disparities and visibilities as arrays
       -> sample   `encode_pair`: files in memory
       -> shard    `ShardWriter`: a fixed range of samples on disk, complete or absent
       -> dataset  `DatasetFiles`: shards, and an index last

The first two arrows are here; `semisynth_gl.generation.generate` has the others.
"""  # noqa: D415 - the drawing is the summary

from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Self

from numpy.random import Generator

from semisynth_gl.arguments import check_type, to_whole
from semisynth_gl.camera import Crop
from semisynth_gl.config import Config
from semisynth_gl.errors import InputError
from semisynth_gl.frame import FUTURE_OUTPUTS, PAST_OUTPUTS, Frame
from semisynth_gl.histogram import Histogram
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.checks import faults
from semisynth_gl.pairs.exposure import exposed, moments
from semisynth_gl.pairs.imperfections import with_imperfections
from semisynth_gl.plugins import plugin_records
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.pass_clock import PassClock
from semisynth_gl.render.readers import Reader, read_array
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.mix import MixSampler
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.sources import prepare_sources
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.splits import WHOLE, Split

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


class PairRenderer:
    """Renders any pair of a config and seed. Use it in a ``with`` block, in the thread that made it.

    Args:
        config: the configuration.
        seed: 0 or more.
        backend: "auto", "egl" or "osmesa".
        split: the split of the pairs.
        device_index: EGL's number of the device.
        read: takes the drawn pixels; other readers than `read_array` need ``checked=False``.

    Attributes:
        sources: patches and models.
        sampler: makes the scenes of the pairs.

    Raises:
        InputError: where images or models cannot be used.
        BackendError: where OpenGL cannot be used.
    """

    def __init__(
        self,
        config: Config,
        seed: int,
        backend: Backend = "auto",
        split: Split = WHOLE,
        device_index: int = 0,
        read: Reader = read_array,
    ) -> None:
        check_type("config", config, Config, "load_config(NAME_OR_PATH) reads one")
        seed = to_whole("a seed", seed, least=0)
        check_type("split", split, Split, "config.splits.split(NAME, NAMES) makes one")
        self.config = config
        self.seed = seed
        self.split = split
        self.sources = prepare_sources(config, seed, split)
        atlas = self.sources.atlas
        self.sampler = MixSampler(config, split.seed(seed), self.sources.libraries, atlas.patches)
        self._renderer = Renderer(
            self.sampler.models,
            atlas.layers,
            large_layers=atlas.large_layers if len(atlas.large_layers) else None,
            wrap=config.textures.wrap,
            anisotropy=config.textures.anisotropy,
            large_anisotropy=config.textures.large_anisotropy,
            outputs=config.outputs,
            truth=config.truth,
            rectified=config.rig.none(),
            signed=config.disparity.signed,
            antialias=config.antialias,
            backend=backend,
            device_index=device_index,
            read=read,
        )
        self._settled: _Settled | None = None
        plugins = plugin_records(config.used_plugins().values())
        self._made_by = {
            "program": "semisynth-gl",
            "version": version("semisynth-gl"),
            "config": config.name,
            "config_sha256": config.digest(),
            "seed": seed,
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
        index = to_whole("a pair's index", index, least=0)
        check_type("crop", crop, Crop | None)
        if crop == Crop(0, 0, self.config.camera.width_px, self.config.camera.height_px):
            crop = None
        number, frame_number = divmod(index, self.config.sequence.length)
        settled = self._settled if checked else _Settled(number, 0, [])
        if settled is None or settled.sequence != number or (checked and frame_number == 0):
            settled, frame, sampled = self._settle(number)
        if frame_number > 0 or not checked:
            sampled = self.sampler.sample(index, settled.attempt)
            self._report("sample")
            # Imperfections are drawn for whole images.
            frame = self._draw(sampled, crop if self.config.imperfections.none() else None)
        provenance = {"pair": index} | self._made_by | self.sampler.provenance(sampled)
        if settled.redrawn:
            provenance["redrawn"] = settled.redrawn
        if "instances" in self.config.outputs:
            provenance["instances"] = self.sampler.instance_table(sampled)
        if not self.config.imperfections.none():
            frame, provenance["imperfections"] = self._imperfect(index, sampled, frame)
        if crop is not None and frame.camera == sampled.scene.camera:  # it was drawn whole
            frame = frame.cropped(crop)
        self._report("check")
        return Pair(index, frame, provenance)

    def _draw(self, sampled: SampledScene, crop: Crop | None = None) -> Frame:
        """Draw a scene, with its motion where an output needs it."""
        outputs = self.config.outputs
        future = self.sampler.motion(sampled, +1) if FUTURE_OUTPUTS.intersection(outputs) else None
        past = self.sampler.motion(sampled, -1) if PAST_OUTPUTS.intersection(outputs) else None
        return self._renderer.render(sampled.scene, crop, future=future, past=past)

    def _imperfect(self, index: int, sampled: SampledScene, frame: Frame) -> tuple[Frame, dict[str, dict[str, Any]]]:
        """Put a pair's imperfections on its images; return them too, by eye."""
        section, seed = self.config.imperfections, self.split.seed(self.seed)

        def further(*keys: str) -> Generator:
            return generator(seed, Purpose.IMPERFECTIONS, index, *keys)

        # Both eyes expose at the same time.
        motion_blur = section.motion_blur.draw(further("motion_blur"))
        if motion_blur > 0:
            scenes = [self.sampler.moment(sampled, frames) for frames in moments(motion_blur, section.sub_frames)]
            frame = exposed(self._renderer, frame, sampled.scene, scenes)
        frame, drawn = with_imperfections(frame, section, further(), further)
        if motion_blur > 0:
            drawn = {eye: values | {"motion_blur": motion_blur} for eye, values in drawn.items()}
        return frame, drawn

    def _settle(self, number: int) -> tuple[_Settled, Frame, SampledScene]:
        """Find a sequence's first attempt whose first frame passes the checks; return that frame too."""
        redrawn: list[str] = []
        for attempt in range(self.config.checks.attempts):
            sampled = self.sampler.sample(number * self.config.sequence.length, attempt)
            self._report("sample")
            frame = self._draw(sampled)
            clauses = faults(frame, self.config)
            self._report("check")
            if not clauses:
                self._settled = _Settled(number, attempt, redrawn)
                return self._settled, frame, sampled
            redrawn.append("; ".join(clauses))
        raise InputError(
            f"sequence {number} fails its checks in all {len(redrawn)} attempts, the last one because it is "
            f"{redrawn[-1]}. Change images or scene, or lower the key of the section checks"
        )

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
        ``left`` and ``right`` (H, W, 3) uint8, ``disparity_left`` and ``disparity_right`` (H, W) float32 px, and the
        visibilities; see `Frame`.
    """
    index = to_whole("a pair's index", index, least=0)
    with PairRenderer(config, seed, backend) as pairs:
        return pairs.render(index).frame
