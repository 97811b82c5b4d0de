"""From a config to a dataset on disk. The one way data goes:

config -> scene    `SceneSampler`: what stands where in pair i, from (config, seed, i) alone
       -> frame    `Renderer`: images, disparities and visibilities as arrays
       -> sample   `encode_scene`: files in memory
       -> dataset  `DatasetFolder`: whole scenes on disk, the index last
"""  # noqa: D415 - the drawing is the summary

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from math import ceil
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from semisynth_gl.checks import faults
from semisynth_gl.config import Config
from semisynth_gl.engine import LocalWorkers
from semisynth_gl.errors import InputError
from semisynth_gl.frame import Frame
from semisynth_gl.geometry.model_library import ModelLibrary, build_library
from semisynth_gl.imperfections import with_imperfections
from semisynth_gl.render.context import Backend
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.sampler import SampledScene, SceneSampler
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Atlas
from semisynth_gl.textures.prepare import prepare_atlas
from semisynth_gl.write.dataset import DatasetFolder
from semisynth_gl.write.middlebury import SCENE_LIST, SCENES, encode_scene, encode_scene_list, scene_name, share_beyond

PAIR_STAGES = ("sample", "draw", "visibility", "readback", "check", "encode", "write")
"""What a pair goes through, in order; the last two in `SequenceJob.write`."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """One rendered pair.

    Attributes:
        index: its number in the dataset.
        frame: images and truth.
        provenance: what made it, in JSON's types.
    """

    index: int
    frame: Frame
    provenance: dict[str, Any]


@dataclass(frozen=True, slots=True)
class _Settled:
    """The attempt that a sequence is drawn from, and what was wrong with those before it."""

    sequence: int
    attempt: int
    redrawn: list[str]


class PairRenderer:
    """Renders any pair of a config and seed. Use it in a ``with`` block, in the thread that made it.

    Args:
        config: the configuration.
        seed: 0 or more.
        backend: "auto", "egl" or "osmesa".

    Raises:
        InputError: where images or models cannot be used.
        BackendError: where OpenGL cannot be used.
    """

    def __init__(self, config: Config, seed: int, backend: Backend = "auto") -> None:
        if seed < 0:
            raise InputError(f"a seed must be 0 or more, got {seed}")
        self.config = config
        self.seed = seed
        self.atlas: Atlas = prepare_atlas(config.textures, seed)
        self.model_library: ModelLibrary = build_library(config.models, seed)
        self._sampler = SceneSampler(config, seed, self.model_library, self.atlas.patches)
        self._renderer = Renderer(
            self._sampler.models,
            self.atlas.layers,
            wrap=config.textures.wrap,
            anisotropy=config.textures.anisotropy,
            outputs=config.outputs,
            truth=config.truth,
            antialias=config.antialias,
            backend=backend,
        )
        self._settled: _Settled | None = None
        self._made_by = {
            "program": "semisynth-gl",
            "version": version("semisynth-gl"),
            "config": config.name,
            "config_sha256": config.digest(),
            "seed": seed,
            "renderer": self._renderer.renderer_name,
            "backend": self._renderer.backend,
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def release(self) -> None:
        """Free the renderer; a second call does nothing."""
        self._renderer.release()

    @property
    def renderer_name(self) -> str:
        """What the driver calls itself (GL_RENDERER)."""
        return self._renderer.renderer_name

    @property
    def facts(self) -> dict[str, str]:
        """Backend, renderer and version of OpenGL, as the driver calls them."""
        return self._renderer.facts

    def count_objects(self) -> dict[str, int]:
        """Count what the driver holds, by kind; for the search for leaks."""
        return self._renderer.count_objects()

    def render(self, index: int, done: Callable[[str], None] | None = None) -> Pair:
        """Render pair ``index``, 0 or more.

        A pair whose sequence fails its checks is drawn again from the next sub-seed.

        Args:
            index: the pair's number.
            done: for measurements: called after each stage, of `PAIR_STAGES`; see `Renderer.render`.

        Raises:
            InputError: where the index is negative, the config's ranges leave no scene for it, or no attempt passes.
        """
        if index < 0:
            raise InputError(f"a pair's index must be 0 or more, got {index}")
        number, frame_number = divmod(index, self.config.sequence.length)
        settled = self._settled
        if settled is None or settled.sequence != number or frame_number == 0:
            settled, frame, sampled = self._settle(number, done)
        if frame_number > 0:
            sampled = self._sampler.sample(index, settled.attempt)
            _tell(done, "sample")
            frame = self._renderer.render(sampled.scene, done)
        provenance = {"pair": index} | self._made_by | self._sampler.provenance(sampled)
        if settled.redrawn:
            provenance["redrawn"] = settled.redrawn
        if "instances" in self.config.outputs:
            provenance["instances"] = self._sampler.instance_table(sampled)
        if not self.config.imperfections.none():
            rng = generator(self.seed, Purpose.IMPERFECTIONS, index)
            frame, provenance["imperfections"] = with_imperfections(frame, self.config.imperfections, rng)
        _tell(done, "check")
        return Pair(index, frame, provenance)

    def _settle(self, number: int, done: Callable[[str], None] | None) -> tuple[_Settled, Frame, SampledScene]:
        """Find a sequence's first attempt whose first frame passes the checks; return that frame too."""
        redrawn: list[str] = []
        for attempt in range(self.config.checks.attempts):
            sampled = self._sampler.sample(number * self.config.sequence.length, attempt)
            _tell(done, "sample")
            frame = self._renderer.render(sampled.scene, done)
            found = faults(frame, self.config)
            _tell(done, "check")
            if not found:
                self._settled = _Settled(number, attempt, redrawn)
                return self._settled, frame, sampled
            redrawn.append("; ".join(found))
        raise InputError(
            f"sequence {number} fails its checks in all {len(redrawn)} attempts, the last one because it is "
            f"{redrawn[-1]}. Change images or scene, or lower the key of the section checks"
        )

    def card(self) -> dict[str, Any]:
        """What all pairs have in common, in JSON's types."""
        return self._made_by | {
            "config_values": self.config.model_dump(mode="json"),
            "patches": [asdict(patch) for patch in self.atlas.patches],
            "models": sorted({mesh.name for mesh in self.model_library.models}),
            "left_out": [str(skipped) for skipped in (*self.atlas.report.images_skipped, *self.model_library.skipped)],
        }


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
    with PairRenderer(config, seed, backend) as pairs:
        return pairs.render(index).frame


@dataclass(frozen=True, slots=True)
class Written:
    """A pair that is on disk.

    Attributes:
        index: its number.
        redrawn: what was wrong with the attempts before it; of a sequence, told of its first frame alone.
        share_beyond: share of the pixels whose disparity the encoding cannot say, of the view that has more.
    """

    index: int
    redrawn: tuple[str, ...]
    share_beyond: float = 0.0


@dataclass(frozen=True, slots=True)
class SequenceJob:
    """Renders sequences and writes them; what the engine hands to its workers.

    Attributes:
        config: the configuration.
        seed: 0 or more.
        backend: "auto", "egl" or "osmesa".
        pairs: how many the dataset has: the last sequence may be cut short.
        folder: where to; open already when the first task comes.
    """

    config: Config
    seed: int
    backend: Backend
    pairs: int
    folder: DatasetFolder

    @contextmanager
    def open(self) -> Iterator[Callable[[int], list[Written]]]:
        """Open a renderer."""
        with PairRenderer(self.config, self.seed, self.backend) as renderer:
            yield lambda number: self.write_sequence(renderer, number)

    def write_sequence(self, renderer: PairRenderer, number: int) -> list[Written]:
        """Render and write all pairs of a sequence."""
        length = self.config.sequence.length
        return [
            self.write(renderer.render(index))
            for index in range(number * length, min((number + 1) * length, self.pairs))
        ]

    def write(self, pair: Pair, done: Callable[[str], None] | None = None) -> Written:
        """Encode and write a pair; ``done`` is called after both."""
        encodings = self.config.files.encodings
        files = encode_scene(pair.frame, pair.provenance, ndisp=ceil(self.config.disparity.max_px), encodings=encodings)
        _tell(done, "encode")
        self.folder.add_folder(SCENES / scene_name(self.config.name, pair.index), files)
        _tell(done, "write")
        # All frames of a sequence tell of the same redraws.
        redrawn = pair.provenance.get("redrawn", []) if pair.provenance["frame"] == 0 else []
        return Written(pair.index, tuple(redrawn), share_beyond(pair.frame, encodings))


def _tell(done: Callable[[str], None] | None, stage: str) -> None:
    if done is not None:
        done(stage)


def generate(
    config: Config,
    folder: DatasetFolder,
    pairs: int,
    seed: int,
    backend: Backend = "auto",
    *,
    workers: int = 1,
    started: Callable[[PairRenderer], None] = lambda _: None,
    written: Callable[[Written], None] = lambda _: None,
) -> Path:
    """Write a dataset in Middlebury's layout.

    The files are the same whatever the number of workers.

    Args:
        config: the configuration.
        folder: where to; not opened yet.
        pairs: how many.
        seed: 0 or more.
        backend: "auto", "egl" or "osmesa".
        workers: processes that render; 1 renders in this one.
        started: called once everything is read and opened.
        written: called after each pair.

    Returns:
        The folder of the scenes.

    Raises:
        SemisynthError: where the input cannot be used, or a worker dies.
        OSError: where the disk is full or refuses. Whole scenes stay, nothing half-written does.
    """
    config.files.encodings.check()
    job = SequenceJob(config, seed, backend, pairs, folder)
    sequences = ceil(pairs / config.sequence.length)
    redraws = 0

    def note(made: Iterable[Written]) -> None:
        nonlocal redraws
        for one in made:
            redraws += len(one.redrawn)
            written(one)

    with ExitStack() as stack:
        renderer = stack.enter_context(PairRenderer(config, seed, backend))
        card = renderer.card()
        # Workers open while the first sequence is drawn here; what they need is in the cache by now.
        helpers = stack.enter_context(LocalWorkers(job, workers)) if workers > 1 and sequences > 1 else None
        started(renderer)
        # A pair first, then the folder: what the driver or the checks refuse costs nobody an earlier dataset.
        first = renderer.render(0)
        folder.open()
        try:
            note([job.write(first)])
            note(job.write(renderer.render(index)) for index in range(1, min(config.sequence.length, pairs)))
            rest = range(1, sequences)
            if helpers is None:
                for number in rest:
                    note(job.write_sequence(renderer, number))
            else:
                renderer.release()
                for made in helpers.run(rest):
                    note(made)
            names = [scene_name(config.name, index) for index in range(pairs)]
            folder.add_file(SCENE_LIST, encode_scene_list(names))
            folder.finish(card | {"layout": "middlebury", "pairs": pairs, "redraws": redraws, "scenes": names})
        except BaseException:
            # Workers may still be writing: nothing is tidied up before they have ended.
            stack.close()
            folder.abandon()
            raise
    return folder.path / SCENES
