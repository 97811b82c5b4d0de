"""From a config to pairs: scenes are sampled, rendered, checked, and captured by the cameras of a rig."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Self

from semisynth_gl.config import Config
from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.channels import FUTURE_OUTPUTS, PAST_OUTPUTS, RENDERED_OUTPUTS
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.pairs.cameras import RigCapture
from semisynth_gl.pairs.checks import faults
from semisynth_gl.plugins import plugin_packages
from semisynth_gl.render import Backend
from semisynth_gl.render.context import check_libraries
from semisynth_gl.render.readers import PixelReader, read_array
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.mix import RecipeMixSampler
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.sources import prepare_sources
from semisynth_gl.seeds.seeds import LARGEST_NUMBER
from semisynth_gl.seeds.splits import Split

PAIR_STAGES = ("sample", "draw", "visibility", "readback", "check")
"""The stages of a pair, in order; a `PairRenderer` reports them to its listener."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """A pair, rendered and captured by the rig's cameras.

    Attributes:
        index: the pair's number in the split.
        frame: images and truth.
        provenance: how the pair was made, in JSON's types: program, config, seed, renderer, scene and more.
    """

    index: int
    frame: Frame
    provenance: dict[str, Any]


def renderer_options(config: Config) -> dict[str, Any]:
    """Return the keyword arguments of a `Renderer` that follow from a config."""
    return {
        "wrap": config.textures.wrap,
        "anisotropy": config.textures.anisotropy,
        "large_anisotropy": config.textures.large_anisotropy,
        "outputs": [output for output in config.outputs if output in RENDERED_OUTPUTS],
        "truth": config.truth,
        "rectified": config.rig.is_rectified(),
        "signed": config.disparity.signed,
        "antialias": config.antialias,
    }


class PairRenderer:
    """Renders any pair of a config and seed. Use it in a ``with`` block, in the thread that made it.

    Args:
        config: the configuration.
        seed: the dataset's seed, 0 or more, or the split of the pairs for a dataset of several splits.
        backend: "auto", "egl" or "osmesa".
        device_index: EGL's number of the device.
        read: fetches the pixels. Only `read_array` allows checks; others need ``checked=False``.

    Attributes:
        config: the configuration.
        split: the split of the pairs.
        sources: patches and models; see `forget_pixels`.
        sampler: makes the scenes of the pairs.
        renderer: renders them; its listener receives the end of each stage of `PAIR_STAGES`.
        renderer_name: the driver's name for the renderer (GL_RENDERER).

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
        read: PixelReader = read_array,
    ) -> None:
        check_type("config", config, Config, "load_config(NAME_OR_PATH) reads one")
        self.config = config
        self.split = split = seed if isinstance(seed, Split) else Split(to_whole("seed", seed, least=0))
        check_libraries(backend)
        self.sources = prepare_sources(config, split)
        atlas = self.sources.atlas
        self.sampler = RecipeMixSampler(config, split.seed, self.sources.libraries, atlas.patches)
        self.renderer = Renderer(
            self.sampler.models,
            atlas.layers,
            large_layers=atlas.large_layers if len(atlas.large_layers) else None,
            backend=backend,
            device_index=device_index,
            read=read,
            pattern=self.sources.pattern,
            **renderer_options(config),
        )
        self.renderer_name = self.renderer.renderer_name
        self._cameras = RigCapture(config, split.seed, self.renderer)
        # The latest sequence that passed its checks, and the faults of its failed attempts.
        self._accepted, self._failures = -1, list[str]()
        self._latest: tuple[object, list[Pair]] | None = None  # number and crop of the latest scene, and its pairs
        plugins = plugin_packages(config.used_plugins().values())
        self._made_by = {
            "program": "semisynth-gl",
            "version": version("semisynth-gl"),
            "config": config.name,
            "config_sha256": config.digest(),
            "seed": split.dataset_seed,
            "split": split.name,
            **({"plugins": plugins} if plugins else {}),
            "renderer": self.renderer_name,
            "backend": self.renderer.backend,
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.release()

    def release(self) -> None:
        """Free the renderer's OpenGL objects; a second call does nothing."""
        self.renderer.release()

    def forget_pixels(self) -> None:
        """Drop the patches' pixels from ``sources``, to save memory in each worker: the driver has its own copy."""
        self.sources = self.sources.without_pixels()

    def render(self, index: int, *, crop: Crop | None = None, checked: bool = True) -> Pair:
        """Render pair ``index``, 0 or more: scene ``index // views`` with right view ``index % views``.

        If any right view of a sequence's first frame fails its checks, the sequence is sampled again from the next
        sub-seed. Pairs of one scene share the left view's arrays. All pairs of the latest scene are kept.

        Args:
            index: the pair's number.
            crop: the part of both images to return; None for all. Only the crop is rendered, except where whole
                images are needed: for checks of a sequence's first frame, and for a lens or imperfections.
            checked: whether to check pairs, as a dataset does. Where an unchecked pair has faults, the dataset has
                another scene.

        Raises:
            InputError: where the number is negative, the config's ranges leave no scene for it, or all attempts fail
                the checks.
        """
        index = to_whole("index", index, 0, LARGEST_NUMBER)
        number, view = divmod(index, self.config.views)
        if not checked:
            return self._pairs(number, crop, [view])[0]
        if self.config.views == 1:
            return self._checked_pairs(number, crop)[0]
        if self._latest is None or self._latest[0] != (number, crop):
            self._latest = None
            self._latest = (number, crop), self._checked_pairs(number, crop)
        return self._latest[1][view]

    def _checked_pairs(self, number: int, crop: Crop | None) -> list[Pair]:
        """Return the pairs of a scene in the first attempt that passes the checks of its sequence's first frame."""
        sequence, frame = divmod(number, self.config.sequence.length)
        if self._accepted != sequence:
            first = self._first_scene(sequence, crop)
            if frame == 0:
                return first
        return self._pairs(number, crop, range(self.config.views), self._failures)

    def _first_scene(self, sequence: int, crop: Crop | None) -> list[Pair]:
        """Return the pairs of a sequence's first scene in the first attempt that passes the checks; keep the attempt.

        The rendered frames are checked, and the captured frames too if lenses or imperfections change them. A check of
        captured frames only would miss flat scenes, since noise hides them.
        """
        failures: list[str] = []
        views = range(self.config.views)
        for attempt in range(self.config.checks.attempts):
            sampled = self._sample(sequence * self.config.sequence.length, attempt)
            frames = self._render(sampled, None, views)
            judged = (faults(frame, self.config, sampled.seen_by(view)) for view, frame in enumerate(frames))
            clauses = next(filter(None, judged), [])
            if not clauses:
                captured = self._cameras.capture(frames, sampled, views)
                if not self.config.images_as_rendered:
                    judged = (faults(frame, self.config) for frame, _ in captured)
                    clauses = [f"{clause}, after lens and imperfections" for clause in next(filter(None, judged), [])]
                if not clauses:
                    self._accepted, self._failures = sequence, failures
                    return self._with_provenance(captured, sampled, crop, views)
            failures.append("; ".join(clauses))
        raise InputError(
            f"sequence {sequence} failed its checks in {counted(len(failures), 'attempt')}. Fault of the last one: "
            f"{failures[-1]}. Change images, scene, lens or imperfections, or lower the limit in the section checks"
        )

    def _pairs(self, number: int, crop: Crop | None, views: Sequence[int], failures: Sequence[str] = ()) -> list[Pair]:
        """Return pairs of some views of a scene without checks; ``failures`` are the faults of its failed attempts."""
        sampled = self._sample(number, len(failures))
        # Lenses and imperfections need whole images.
        before, after = (crop, None) if self.config.images_as_rendered else (None, crop)
        captured = self._cameras.capture(self._render(sampled, before, views), sampled, views)
        return self._with_provenance(captured, sampled, after, views)

    def _sample(self, number: int, attempt: int) -> SampledScene:
        sampled = self.sampler.sample(number * self.config.views, attempt)
        self._report("sample")
        return sampled

    def _render(self, sampled: SampledScene, crop: Crop | None, views: Sequence[int]) -> list[Frame]:
        """Render the frames of some views of a scene."""
        outputs = self.config.outputs
        future = sampled.motion(+1) if FUTURE_OUTPUTS.intersection(outputs) else None
        past = sampled.motion(-1) if PAST_OUTPUTS.intersection(outputs) else None
        cameras = [sampled.views[view] for view in views]
        return self.renderer.render_rig(sampled.scene, cameras, crop, future=future, past=past)

    def _with_provenance(
        self,
        frames: Sequence[tuple[Frame, dict[str, Any]]],
        sampled: SampledScene,
        crop: Crop | None,
        views: Sequence[int],
    ) -> list[Pair]:
        """Return the pairs of some views of a scene, cropped and with their provenance."""
        pairs = []
        number = sampled.sequence.number * self.config.sequence.length + sampled.frame
        for view, (frame, records) in zip(views, frames, strict=True):
            seen = sampled.seen_by(view)
            index = number * self.config.views + view
            provenance = {"pair": index} | self._made_by | seen.provenance()
            if sampled.sequence.attempt:
                provenance["redrawn"] = list(self._failures)
            if "instances" in self.config.outputs:
                provenance["instances"] = seen.instance_table()
            pairs.append(Pair(index, frame.cropped(crop) if crop else frame, provenance | records))
        self._report("check")
        return pairs

    def _report(self, stage: str) -> None:
        if self.renderer.listener is not None:
            self.renderer.listener.on_stage(stage)


def render_pair(config: Config, index: int, seed: int = 0, backend: Backend = "auto") -> Frame:
    """Render one pair of a config. Each call loads all sources and opens a renderer: for many, use a `PairRenderer`.

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
