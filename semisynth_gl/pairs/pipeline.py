"""From a config to pairs. Data flows as follows:

config -> scene    `MixSampler`: the objects of pair i, from (config, seed, i) alone
       -> frame    `Renderer`: images, disparities and visibilities as arrays
       -> sample   `encode_pair`: files in memory
       -> shard    `ShardWriter`: a fixed range of samples on disk, complete or absent
       -> dataset  `DatasetFiles`: shards, and at last an index

The first two steps are here; `semisynth_gl.dataset.generate` does the others.
"""  # noqa: D415 - the drawing is the summary

from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any, Self

from numpy.typing import NDArray

from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES, Crop, Eye
from semisynth_gl.frame.channels import DRAWN_OUTPUTS, FUTURE_OUTPUTS, PAST_OUTPUTS
from semisynth_gl.frame.frame import Frame
from semisynth_gl.histogram import Histogram
from semisynth_gl.inputs.arguments import check_type, to_whole
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.cameras import Cameras
from semisynth_gl.pairs.checks import OPEN, Closed, faults
from semisynth_gl.plugins import plugin_records
from semisynth_gl.render.backends import Backend
from semisynth_gl.render.devices import check_libraries
from semisynth_gl.render.readers import Reader, read_array
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.render.shared_left import SharedLeft
from semisynth_gl.scene.mix import MixSampler
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.scene import Motion
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


@dataclass(frozen=True, slots=True)
class _Settled:
    """The attempt whose scenes a sequence takes, and the faults of each attempt before it."""

    sequence: int
    attempt: int
    redrawn: list[str]


@dataclass(slots=True, eq=False)
class _Shown:
    """A scene whose pairs are asked for, and ``crop``, the part of the images that is drawn; None for all."""

    number: int
    sampled: SampledScene
    crop: Crop | None
    # Draws the scene's pairs if there are several.
    shared: SharedLeft | None
    # Frames that were made for the checks and not asked for yet, each with what the provenance says of its cameras, by
    # the number of the right view.
    frames: dict[int, tuple[Frame, dict[str, Any]]] = field(default_factory=dict)
    # What the left camera gives, by channel, once a pair of the scene has been made.
    left_channels: dict[str, NDArray[Any]] | None = None

    def shows(self, number: int, attempt: int, crop: Crop | None) -> bool:
        """Return whether this is the scene of an attempt, and can still give pairs with a crop.

        It can if whole frames wait, which can be cut, or if its pairs share a left view of the same crop.
        """
        waits = self.crop is None and bool(self.frames)
        shares = self.shared is not None and self.crop == crop
        return (self.number, self.sampled.attempt) == (number, attempt) and (waits or shares)


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
        read: fetches the drawn pixels; with another reader than `read_array`, pairs must be rendered with
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
        self._cameras = Cameras(config, split.seed, self._renderer, self.sampler)
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
        """Render pair ``index``, 0 or more.

        A sequence whose first frame fails its checks is drawn again from the next sub-seed.

        Args:
            index: the pair's number.
            crop: the part of both images to return; None for all. Checks need whole images, so the first frame of a
                sequence is drawn whole and cut afterwards. All other frames, and without checks all frames, are drawn
                and read back only as far as the crop needs, unless the config has a lens or imperfections.
            checked: whether to check pairs. Without checks, a pair with faults is returned, where the dataset has
                another attempt.

        Raises:
            InputError: where the index is negative, the config's ranges leave no scene for it, or all attempts fail the
                checks.
        """
        index = to_whole("index", index, 0, LARGEST_NUMBER)
        if crop == Crop(0, 0, self.config.camera.width_px, self.config.camera.height_px):
            crop = None
        number, view = divmod(index, self.config.views)
        sequence = number // self.config.sequence.length
        settled = self._settled if checked else _Settled(sequence, 0, [])
        # Where scenes have several pairs, asking for one of them does not draw them all for the checks again.
        judged = checked and self.config.views == 1 and number % self.config.sequence.length == 0
        if settled is None or settled.sequence != sequence or judged:
            settled = self._settle(sequence)
        # Lenses and imperfections need whole images.
        shown = self._show(number, settled.attempt, crop if self.config.images_as_drawn else None)
        sampled = shown.sampled.seen_by(view)
        if view in shown.frames:
            frame, records = shown.frames.pop(view)
        else:
            frame, records = self._through_cameras(self._draw(shown, view), shown, view)
        provenance = {"pair": index} | self._made_by | self.sampler.provenance(sampled)
        if settled.redrawn:
            provenance["redrawn"] = settled.redrawn
        if "instances" in self.config.outputs:
            provenance["instances"] = self.sampler.instance_table(sampled)
        provenance |= records
        if crop is not None and frame.camera == sampled.scene.camera:  # it was drawn whole
            frame = frame.cropped(crop)
        self._report("check")
        return Pair(index, frame, provenance)

    def _show(self, number: int, attempt: int, crop: Crop | None) -> _Shown:
        """Return the scene of a number and attempt: the latest one if it still serves, or else sample it."""
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
        """Return the motions of a scene that the outputs need, as keyword arguments of `Renderer.render`."""
        outputs = self.config.outputs
        return {
            "future": self.sampler.motion(sampled, +1) if FUTURE_OUTPUTS.intersection(outputs) else None,
            "past": self.sampler.motion(sampled, -1) if PAST_OUTPUTS.intersection(outputs) else None,
        }

    def _draw(self, shown: _Shown, view: int) -> Frame:
        """Draw the frame of a scene with one of its right views, and with the motion that outputs need."""
        if shown.shared is not None:
            return shown.shared.render(view)
        return self._renderer.render(shown.sampled.scene, shown.crop, **self._motions(shown.sampled))

    def _settle(self, sequence: int) -> _Settled:
        """Return a sequence's first attempt whose first frame passes the checks with all its right views.

        Checks judge the drawn frames and, where lenses or imperfections change them, the frames that cameras give.
        These are kept until they are asked for.
        """
        redrawn: list[str] = []
        for attempt in range(self.config.checks.attempts):
            self._shown = None
            shown = self._show(sequence * self.config.sequence.length, attempt, None)
            clauses: list[str] = []
            for view in range(self.config.views):
                frame = self._draw(shown, view)
                clauses = faults(frame, self.config, Closed.of(shown.sampled.seen_by(view), self.config))
                if not clauses:
                    shown.frames[view] = self._through_cameras(frame, shown, view)
                    # The drawn frame is judged too, since noise hides that a scene is flat.
                    if not self.config.images_as_drawn:
                        seen = faults(shown.frames[view][0], self.config, OPEN)
                        clauses = [f"{clause}, after lens and imperfections" for clause in seen]
                self._report("check")
                if clauses:
                    break
            if not clauses:
                self._settled = _Settled(sequence, attempt, redrawn)
                return self._settled
            redrawn.append("; ".join(clauses))
        raise InputError(
            f"sequence {sequence} failed its checks in {counted(len(redrawn), 'attempt')}. Fault of the last one: "
            f"{redrawn[-1]}. Change images, scene, lens or imperfections, or lower the limit in the section checks"
        )

    def _through_cameras(self, frame: Frame, shown: _Shown, view: int) -> tuple[Frame, dict[str, Any]]:
        """Return a frame with the images that the rig's cameras give, and what the provenance says of them."""
        if self.config.images_as_drawn:
            return frame, {}
        left = shown.left_channels if view else None
        eyes: tuple[Eye, ...] = EYES if left is None else ("right",)
        taken = self._cameras.take(frame, shown.sampled.seen_by(view), shown.number, view, eyes)
        if left is not None:
            taken = taken._replace(views={**taken.views, "left": left})
        elif shown.shared is not None:
            shown.left_channels = taken.views["left"]
            for array in shown.left_channels.values():
                array.flags.writeable = False
        return taken.frame(frame, self.config), taken.records

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
