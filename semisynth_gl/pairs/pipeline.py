"""From a config to pairs. Data flows as follows:

config -> scene    `MixSampler`: the objects of pair i, from (config, seed, i) alone
       -> frame    `Renderer`: images, disparities and visibilities as arrays
       -> sample   `encode_pair`: files in memory
       -> shard    `ShardWriter`: a fixed range of samples on disk, complete or absent
       -> dataset  `DatasetFiles`: shards, and at last an index

The first two steps are here; `semisynth_gl.dataset.generate` does the others.
"""  # noqa: D415 - the drawing is the summary

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Self

from semisynth_gl.config import Config
from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.channels import DRAWN_OUTPUTS, FUTURE_OUTPUTS, PAST_OUTPUTS
from semisynth_gl.frame.frame import Frame
from semisynth_gl.histogram import Histogram
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.cameras import Cameras
from semisynth_gl.pairs.checks import faults
from semisynth_gl.plugins import plugin_records
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.devices import check_libraries
from semisynth_gl.render.readers import Reader, read_array
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.mix import MixSampler
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.sources import Sources, prepare_sources
from semisynth_gl.seeds.seeds import LARGEST_NUMBER
from semisynth_gl.seeds.splits import Split

PAIR_STAGES = ("sample", "draw", "visibility", "readback", "check")
"""The stages of a pair that a `PairRenderer` reports to its listener, in order."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """One rendered pair.

    Attributes:
        index: the pair's number in the split.
        frame: images and truth.
        provenance: how the pair was made, in JSON's types: program, config, seed, renderer, scene and more.
    """

    index: int
    frame: Frame
    provenance: dict[str, Any]


def renderer_options(config: Config) -> dict[str, Any]:
    """Return the keyword arguments of a `Renderer` that a config decides."""
    return {
        "wrap": config.textures.wrap,
        "anisotropy": config.textures.anisotropy,
        "large_anisotropy": config.textures.large_anisotropy,
        "outputs": [output for output in config.outputs if output in DRAWN_OUTPUTS],
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
        read: fetches the pixels; with another reader than `read_array`, pairs must be rendered with
            ``checked=False``.
        sources: what `prepare_sources` makes of this config and split, if that is done already.

    Attributes:
        config: the configuration.
        split: the split of the pairs.
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
        split = seed if isinstance(seed, Split) else Split(to_whole("seed", seed, least=0))
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
            pattern=self.sources.pattern,
            **renderer_options(config),
        )
        self._cameras = Cameras(config, split.seed, self._renderer)
        # The latest sequence that passed its checks, and the faults of its failed attempts.
        self._settled, self._redrawn = -1, list[str]()
        self._latest: tuple[object, list[Pair]] | None = None  # the pairs of the latest scene, by number and crop
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
        """Free the renderer's OpenGL objects; a second call does nothing."""
        self._renderer.release()

    def forget_pixels(self) -> None:
        """Drop the patches' pixels from ``sources``, to save memory in each worker: the driver has its own copy."""
        self.sources = self.sources.without_pixels()

    @property
    def listener(self) -> Listener | None:
        """A listener that hears the end of each stage of `PAIR_STAGES`, for measurements; see `Renderer`."""
        return self._renderer.listener

    @listener.setter
    def listener(self, listener: Listener | None) -> None:
        self._renderer.listener = listener

    @property
    def renderer_name(self) -> str:
        """The driver's name of the renderer (GL_RENDERER)."""
        return self._renderer.renderer_name

    def expected_histogram(self) -> Histogram:
        """Return the expected distribution of the disparity over many pairs; see `MixSampler.expected`."""
        return self.sampler.expected()

    @property
    def facts(self) -> dict[str, str]:
        """Backend, renderer and OpenGL version, as the driver names them; see `Renderer.facts`."""
        return self._renderer.facts

    def count_objects(self) -> dict[str, int]:
        """Count the OpenGL objects by kind, to search for leaks."""
        return self._renderer.count_objects()

    def render(self, index: int, *, crop: Crop | None = None, checked: bool = True) -> Pair:
        """Render pair ``index``, 0 or more: scene ``index // views`` with right view ``index % views``.

        Where scenes have several pairs, those of the latest scene are kept, since checks need all of them.

        Args:
            index: the pair's number.
            crop: see `render_scene`.
            checked: see `render_scene`. Without checks, only this pair of its scene is rendered.

        Raises:
            InputError: as `render_scene` does.
        """
        index = to_whole("index", index, 0, LARGEST_NUMBER)
        number, view = divmod(index, self.config.views)
        if not checked:
            return self._pairs(number, crop, [view])[0]
        if self.config.views == 1:
            return self.render_scene(number, crop=crop)[0]
        if self._latest is None or self._latest[0] != (number, crop):
            self._latest = None
            self._latest = (number, crop), self.render_scene(number, crop=crop)
        return self._latest[1][view]

    def render_scene(self, number: int, *, crop: Crop | None = None, checked: bool = True) -> list[Pair]:
        """Render the pairs of scene ``number``, 0 or more: one for each right view. They share the left view's arrays.

        A sequence whose first frame fails its checks with any right view is sampled again from the next sub-seed.

        Args:
            number: the scene's number.
            crop: the part of both images to return; None for all. Checks need whole images, so the first frame of a
                sequence is rendered whole and cut afterwards. All other frames are rendered only as far as the crop
                needs, and so are all frames without checks, unless the config has a lens or imperfections.
            checked: whether to check pairs. Without checks, pairs with faults are returned; the dataset has a
                pair that was sampled again instead.

        Raises:
            InputError: where the number is negative, the config's ranges leave no scene for it, or all attempts fail
                the checks.
        """
        number = to_whole("number", number, 0, LARGEST_NUMBER // self.config.views)
        views, (sequence, frame) = range(self.config.views), divmod(number, self.config.sequence.length)
        if not checked:
            return self._pairs(number, crop, views)
        if self._settled != sequence:
            first = self._settle(sequence, crop)
            if frame == 0:
                return first
        return self._pairs(number, crop, views, self._redrawn)

    def _settle(self, sequence: int, crop: Crop | None) -> list[Pair]:
        """Return the first scene of a sequence in the first attempt that passes the checks; keep the attempt.

        Checks judge the rendered frames and, where lenses or imperfections change them, the frames that cameras give.
        """
        redrawn: list[str] = []
        number, views = sequence * self.config.sequence.length, range(self.config.views)
        for attempt in range(self.config.checks.attempts):
            sampled = self._sample(number, attempt)
            rendered = self._render(sampled, None, views)
            judged = ((frame, sampled.seen_by(view)) for view, frame in enumerate(rendered))
            clauses = next(filter(None, (faults(frame, self.config, seen) for frame, seen in judged)), [])
            if not clauses:
                taken = self._cameras.take(rendered, sampled, views)
                # The rendered frames are judged as well, since noise hides that a scene is flat.
                if not self.config.images_as_rendered:
                    spoilt = next(filter(None, (faults(frame, self.config) for frame, _ in taken)), [])
                    clauses = [f"{clause}, after lens and imperfections" for clause in spoilt]
            self._report("check")
            if not clauses:
                self._settled, self._redrawn = sequence, redrawn
                return self._described(taken, sampled, crop, views)
            redrawn.append("; ".join(clauses))
        raise InputError(
            f"sequence {sequence} failed its checks in {counted(len(redrawn), 'attempt')}. Fault of the last one: "
            f"{redrawn[-1]}. Change images, scene, lens or imperfections, or lower the limit in the section checks"
        )

    def _pairs(self, number: int, crop: Crop | None, views: Sequence[int], redrawn: Sequence[str] = ()) -> list[Pair]:
        """Return the pairs of some views of a scene, which are not checked; ``redrawn`` has its failed attempts."""
        sampled = self._sample(number, len(redrawn))
        # Lenses and imperfections need whole images.
        rendered = self._render(sampled, crop if self.config.images_as_rendered else None, views)
        taken = self._cameras.take(rendered, sampled, views)
        return self._described(taken, sampled, crop, views)

    def _sample(self, number: int, attempt: int) -> SampledScene:
        sampled = self.sampler.sample(number * self.config.views, attempt)
        self._report("sample")
        return sampled

    def _render(self, sampled: SampledScene, crop: Crop | None, views: Sequence[int]) -> list[Frame]:
        """Render the frames of some views of a scene, with the motions that outputs need."""
        outputs = self.config.outputs
        future = sampled.motion(+1) if FUTURE_OUTPUTS.intersection(outputs) else None
        past = sampled.motion(-1) if PAST_OUTPUTS.intersection(outputs) else None
        cameras = [sampled.views[view] for view in views]
        return self._renderer.render_rig(sampled.scene, cameras, crop, future=future, past=past)

    def _described(
        self,
        frames: Sequence[tuple[Frame, dict[str, Any]]],
        sampled: SampledScene,
        crop: Crop | None,
        views: Sequence[int],
    ) -> list[Pair]:
        """Return the pairs of some views of a scene, cut to the crop, with their provenance."""
        pairs = []
        number = sampled.sequence.number * self.config.sequence.length + sampled.frame
        for view, (frame, records) in zip(views, frames, strict=True):
            seen = sampled.seen_by(view)
            index = number * self.config.views + view
            provenance = {"pair": index} | self._made_by | seen.provenance()
            if sampled.sequence.attempt:
                provenance["redrawn"] = list(self._redrawn)
            if "instances" in self.config.outputs:
                provenance["instances"] = seen.instance_table()
            whole = frame.camera == seen.scene.camera
            pairs.append(Pair(index, frame.cropped(crop) if crop and whole else frame, provenance | records))
        self._report("check")
        return pairs

    def _report(self, stage: str) -> None:
        if self.listener is not None:
            self.listener.on_stage(stage)


def render_pair(config: Config, index: int, seed: int = 0, backend: Backend = "auto") -> Frame:
    """Render one pair of a config.

    Each call loads the photographs and models and opens a renderer; for many pairs, use a `PairRenderer`.

    Args:
        config: the configuration.
        index: the pair's number, 0 or more.
        seed: 0 or more.
        backend: "auto", "egl" or "osmesa".

    Raises:
        InputError: where images, models or ranges cannot be used, or all attempts fail the checks.
        BackendError: where OpenGL cannot be used.

    Returns:
        A `Frame`: ``left.image`` and ``right.image``, (H, W, 3) uint8, or (H, W) for grey cameras; ``left.disparity``
        and ``right.disparity``, (H, W) float32, px; and the other outputs of the config.
    """
    index = to_whole("index", index, 0, LARGEST_NUMBER)
    with PairRenderer(config, seed, backend) as pairs:
        return pairs.render(index).frame
