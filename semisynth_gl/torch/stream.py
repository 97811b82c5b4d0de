"""Pairs rendered while a network trains: `StereoStream`, an IterableDataset without files.

Sample n of the stream is a pair of the dataset that the same config and seed give, whichever process renders it.
`Dealing` says which process gets which samples, so workers and training processes share only the stream's arguments.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Literal, get_args

import torch
from torch.utils.data import get_worker_info

from semisynth_gl.config import Config
from semisynth_gl.engines.task import THREADS, threads_each
from semisynth_gl.inputs.arguments import check_one_of, check_type, to_whole
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.plugins import plugin_records
from semisynth_gl.render.backends import BACKENDS, Backend
from semisynth_gl.render.devices import egl_index_of_worker
from semisynth_gl.render.readers import read_array
from semisynth_gl.scene.sources import Sources, prepare_sources
from semisynth_gl.torch.dealing import Dealing, Selection, TrainingProcess, Worker
from semisynth_gl.torch.interop import CudaReader
from semisynth_gl.torch.iteration import DealtDataset
from semisynth_gl.torch.samples import Sample, check_crop, check_transform, draw_crop, to_sample

TensorDevice = Literal["cpu", "cuda"]


@dataclass(frozen=True, slots=True)
class Hardware:
    """The hardware that draws, and the device of the tensors.

    Attributes:
        backend: "auto", "egl" or "osmesa".
        gpus: CUDA's numbers of the GPUs that workers take turns on; empty for the first device of EGL.
        device: "cpu", or "cuda" for tensors that never leave the GPU, without workers.

    Raises:
        InputError: where a value is not one of these.
    """

    backend: Backend = "auto"
    gpus: Sequence[int] = ()
    device: TensorDevice = "cpu"

    def __post_init__(self) -> None:
        check_type("gpus", self.gpus, Sequence)
        for number in self.gpus:
            to_whole("a number of gpus", number, least=0)
        check_one_of("backend", self.backend, BACKENDS)
        check_one_of("device", self.device, get_args(TensorDevice))


class StereoStream(DealtDataset):
    """Renders pairs one after the other, in the DataLoader's workers if it has any; writes no files.

    Samples are numbered from 0 on and never repeat within an iteration; each iteration begins at ``selection.first``.
    Without ``selection.frames``, sample n is pair n. A sample is a dictionary, see `to_sample`. Each process that
    iterates opens a renderer when it begins and releases it when it ends.

    Args:
        config: the configuration.
        seed: 0 or more.
        selection: the samples; by default all pairs of ``train``, without end.
        crop: height and width, px: yield a crop of each pair, at a place that follows from the seed and the pair's
            sequence; None for whole images.
        checked: whether pairs that fail the config's checks are drawn again, as in a dataset. Without checks, crops are
            much faster, and the few pairs that would have failed differ from the dataset's.
        transform: gets the sample, returns the object that the stream yields instead.
        batch_size: the DataLoader's: batches then consist of successive samples, and come in order.
        process: the training process; by default the process that torch.distributed says.
        hardware: the hardware that draws, and the device of the tensors; by default any, and "cpu".

    Raises:
        InputError: where an argument cannot be used.
    """

    def __init__(
        self,
        config: Config,
        seed: int = 0,
        selection: Selection | None = None,
        *,
        crop: tuple[int, int] | None = None,
        checked: bool = True,
        transform: Callable[[Sample], Any] | None = None,
        batch_size: int = 1,
        process: TrainingProcess | None = None,
        hardware: Hardware | None = None,
    ) -> None:
        check_type("config", config, Config, "load_config(NAME_OR_PATH) reads one")
        seed = to_whole("a seed", seed, least=0)
        batch_size = to_whole("batch_size, the loader's,", batch_size, least=1)
        for name, value, expected in (
            ("selection", selection, Selection),
            ("process", process, TrainingProcess),
            ("hardware", hardware, Hardware),
        ):
            check_type(name, value, expected | None)
        selection = selection or Selection()
        source = RenderedPairs(
            config, seed, selection, hardware or Hardware(), crop=crop, checked=checked, transform=transform
        )
        super().__init__(source, Dealing(selection.first, selection.pairs, batch_size, source.together), process)


class RenderedPairs:
    """The pairs of a config and a seed as a `Source`, rendered when they are asked for; see `StereoStream`.

    Raises:
        InputError: where an argument cannot be used.
    """

    def __init__(
        self,
        config: Config,
        seed: int,
        selection: Selection,
        hardware: Hardware,
        *,
        crop: tuple[int, int] | None,
        checked: bool,
        transform: Callable[[Sample], Any] | None,
    ) -> None:
        self._config = config
        self._split = config.splits.split(selection.split, selection.splits, seed)
        self._frames = selection.frames_in(config.sequence.length)
        self._crop, self._checked, self._transform, self._hardware = crop, checked, transform, hardware
        self._check()
        self.together = len(self._frames) * config.views
        self._settings = {
            "config": config.name,
            "config_sha256": config.digest(),
            "seed": seed,
            "split": selection.split,
            "splits": list(selection.splits),
            "frames": list(self._frames),
            "crop": crop and [int(side) for side in crop],
            "checked": checked,
        }
        self._sources: Sources | None = None
        self._digests: Mapping[str, str] | None = None

    def __getstate__(self) -> dict[str, Any]:
        # Each worker takes patches and models from the cache: an atlas has up to 134 MB.
        return self.__dict__ | {"_sources": None, "_digests": None}

    @property
    def identity(self) -> Mapping[str, Any]:
        """All that decides what the samples are: arguments, digests of patches and models, versions of plug-ins.

        Raises:
            InputError: where photographs, models or plug-ins cannot be used.
        """
        if self._digests is None:
            self._digests = self._prepared().digests()
        plugins = plugin_records(self._config.used_plugins().values())
        return {**self._settings, "sources": self._digests, "plugins": plugins}

    @contextmanager
    def open(self, worker: Worker) -> Iterator[Callable[[int], Any]]:
        """Open a worker's renderer; give a function from a sample's number to the sample.

        Raises:
            InputError: where workers shall yield CUDA tensors, or photographs or models cannot be used.
            BackendError: where OpenGL cannot be used.
        """
        name = "the stream"
        if get_worker_info() is not None:
            if self._hardware.device == "cuda":
                raise InputError(
                    "device='cuda' goes with num_workers=0 alone: tensors on a GPU do not leave their process"
                )
            name = f"worker {worker.number} of {worker.total}"
            os.environ.setdefault(THREADS, str(threads_each(worker.total)))
        gpus, backend = self._hardware.gpus, self._hardware.backend
        reader: CudaReader | None = None
        if self._hardware.device == "cuda":
            gpus = gpus or (torch.cuda.current_device(),)
            reader = CudaReader(torch.device("cuda", gpus[0]))
        device_index = egl_index_of_worker(tuple(gpus), worker.number)
        try:
            renderer = PairRenderer(
                self._config, self._split, backend, device_index, reader or read_array, self._prepared()
            )
        except BackendError as error:
            raise BackendError(f"{name} cannot render: {error}") from error
        renderer.forget_pixels()
        if get_worker_info() is not None:
            self._sources = None  # of many workers, each would hold its own copy of the pixels
        try:
            with renderer, nullcontext() if reader is None else closing(reader):
                yield lambda number: self._render(renderer, number)
        finally:
            self._sources = None

    def _prepared(self) -> Sources:
        """Return patches and models, which stay from the first question for them to the end of an iteration."""
        if self._sources is None:
            self._sources = prepare_sources(self._config, self._split)
            self._digests = None  # files may have changed since
        return self._sources

    def _render(self, renderer: PairRenderer, number: int) -> Any:  # noqa: ANN401 - what the transform returns
        sequence, rest = divmod(number, self.together)
        frame, view = divmod(rest, self._config.views)
        crop = None
        if self._crop is not None:
            camera = self._config.camera
            sides = camera.height_px, camera.width_px
            crop = draw_crop(self._crop, sides, self._split.seed, sequence)
        index = (sequence * self._config.sequence.length + self._frames[frame]) * self._config.views + view
        pair = renderer.render(index, crop=crop, checked=self._checked)
        sample = to_sample(pair.index, pair.frame)
        return sample if self._transform is None else self._transform(sample)

    def _check(self) -> None:
        camera, hardware = self._config.camera, self._hardware
        check_transform(self._transform)
        if self._crop is not None:
            check_crop(self._crop, (camera.height_px, camera.width_px), "the config's camera")
        if hardware.device == "cpu":
            return
        if self._checked or not self._config.imperfections.none():
            raise InputError(
                "device='cuda' needs checked=False and a config without imperfections, since checks and imperfections "
                "work on arrays in the computer's memory: change that, or leave device out and let the loader pin "
                "memory (pin_memory=True)"
            )
        if hardware.backend == "osmesa" or not torch.cuda.is_available():
            raise InputError(
                f"device='cuda' needs EGL and a GPU that torch finds, got backend={hardware.backend!r} and "
                f"torch.cuda.is_available() {torch.cuda.is_available()}: leave device out"
            )
