"""Pairs rendered while a network trains: `StereoStream`, an IterableDataset without files.

The samples of a stream are the pairs of the dataset that the same config and seed give, whichever process renders them.
`Dealing` decides which process gets which samples, so workers and training processes share only the stream's arguments.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Literal, get_args

import torch
from torch.utils.data import get_worker_info

from semisynth_gl.augmentation import Augmentation
from semisynth_gl.config import Config
from semisynth_gl.dataset.engines import THREADS, threads_each
from semisynth_gl.inputs.arguments import check_one_of, check_type, to_whole
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.plugins import plugin_records
from semisynth_gl.render.backends import BACKENDS, Backend
from semisynth_gl.render.devices import egl_index_of_worker
from semisynth_gl.render.readers import read_array
from semisynth_gl.scene.sources import Sources, prepare_sources
from semisynth_gl.torch.cutting import Cutting
from semisynth_gl.torch.dealing import Dealing, Selection, TrainingProcess, Worker
from semisynth_gl.torch.interop import CudaReader
from semisynth_gl.torch.iteration import DealtDataset
from semisynth_gl.torch.samples import Sample, check_transform

TensorDevice = Literal["cpu", "cuda"]


@dataclass(frozen=True, slots=True)
class Hardware:
    """The hardware that draws, and the device of the tensors.

    Attributes:
        backend: "auto", "egl" or "osmesa".
        gpus: numbers, as CUDA counts, of the GPUs that workers use in turn; empty for EGL's first device, or, with
            device "cuda", for torch's current one.
        device: "cpu", or "cuda" for tensors that never leave the GPU; "cuda" needs a DataLoader without workers.

    Raises:
        InputError: where a value cannot be used.
    """

    backend: Backend = "auto"
    gpus: Sequence[int] = ()
    device: TensorDevice = "cpu"

    def __post_init__(self) -> None:
        for number in self.gpus:
            to_whole("gpus", number, least=0)
        check_one_of("backend", self.backend, BACKENDS)
        check_one_of("device", self.device, get_args(TensorDevice))


class StereoStream(DealtDataset):
    """Renders pairs one after the other, in the DataLoader's workers if it has any, and writes no files.

    Samples are numbered from 0 and never repeat within an iteration; each iteration begins at ``selection.first``.
    Without ``selection.frames``, sample n is pair n. A sample is a dictionary, see `to_sample`. Each process that
    iterates opens a renderer when it begins and releases it when it ends.

    Args:
        config: the config of the pairs.
        seed: decides, with the config, the content of all pairs; 0 or more.
        selection: the samples to yield; by default all pairs of ``train``, without end.
        crop: height and width, px: yield a crop of each pair, at a place that follows from the seed and the pair's
            sequence; None for whole images.
        augmentation: changes of each pair, before the transform; the seed and the pair's sequence decide them.
        checked: whether pairs that fail the config's checks are drawn again, as in a dataset. Without checks, crops are
            much faster, and the few pairs that would have failed differ from the dataset's pairs.
        transform: a function that gets the sample and returns the object to yield instead.
        batch_size: the DataLoader's batch size, with which batches consist of successive samples and come in order.
        process: this training process; by default as torch.distributed numbers it.
        hardware: the hardware that draws, and the device of the tensors; see `Hardware` for the defaults.

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
        augmentation: Augmentation | None = None,
        checked: bool = True,
        transform: Callable[[Sample], Any] | None = None,
        batch_size: int = 1,
        process: TrainingProcess | None = None,
        hardware: Hardware | None = None,
    ) -> None:
        check_type("config", config, Config, "load_config(NAME_OR_PATH) reads one")
        seed = to_whole("seed", seed, least=0)
        batch_size = to_whole("batch_size", batch_size, least=1)
        selection = selection or Selection()
        source = RenderedPairs(config, seed, selection, hardware or Hardware(), crop, augmentation, checked, transform)
        super().__init__(source, Dealing(selection.first, selection.pairs, batch_size, source.together), process)


@dataclass(eq=False)
class RenderedPairs:
    """The pairs of a config and a seed as a `Source`, rendered when they are asked for; see `StereoStream`."""

    config: Config
    seed: int
    selection: Selection
    hardware: Hardware
    crop: tuple[int, int] | None
    augmentation: Augmentation | None
    checked: bool
    transform: Callable[[Sample], Any] | None

    def __post_init__(self) -> None:
        self._split = self.config.splits.split(self.selection.split, self.selection.splits, self.seed)
        self._frames = self.selection.frames_in(self.config.sequence.length)
        self._check()
        sides = self.config.camera.height_px, self.config.camera.width_px
        self._cutting = Cutting(self.crop, self.augmentation, sides, "the config's camera")
        self.together = len(self._frames) * self.config.views
        self._sources: Sources | None = None
        self._digests: Mapping[str, str] | None = None

    def __getstate__(self) -> dict[str, Any]:
        # Workers load patches and models from the cache: an atlas of up to 134 MB would be slow to pickle.
        return self.__dict__ | {"_sources": None, "_digests": None}

    @property
    def identity(self) -> Mapping[str, Any]:
        """Everything that decides the content of the samples, in JSON's types.

        This includes arguments, digests of patches and models, and versions of plug-ins.
        """
        if self._digests is None:
            self._digests = self._prepared().digests()
        return {
            "config": self.config.name,
            "config_sha256": self.config.digest(),
            "seed": self.seed,
            "split": self.selection.split,
            "splits": list(self.selection.splits),
            "frames": list(self._frames),
            **self._cutting.identity,
            "checked": self.checked,
            "sources": self._digests,
            "plugins": plugin_records(self.config.used_plugins().values()),
        }

    @contextmanager
    def open(self, worker: Worker) -> Iterator[Callable[[int], Any]]:
        """Open a worker's renderer; yield a function that renders a sample by its number."""
        name = "the stream"
        if get_worker_info() is not None:
            if self.hardware.device == "cuda":
                raise InputError("device='cuda' needs num_workers=0, since tensors on a GPU do not leave their process")
            name = f"worker {worker.number} of {worker.total}"
            os.environ.setdefault(THREADS, str(threads_each(worker.total)))
        gpus, backend = self.hardware.gpus, self.hardware.backend
        reader: CudaReader | None = None
        if self.hardware.device == "cuda":
            gpus = gpus or (torch.cuda.current_device(),)
            reader = CudaReader(torch.device("cuda", gpus[0]))
        device_index = egl_index_of_worker(tuple(gpus), worker.number)
        try:
            renderer = PairRenderer(
                self.config, self._split, backend, device_index, reader or read_array, self._prepared()
            )
        except BackendError as error:
            raise BackendError(f"{name} cannot render: {error}") from error
        renderer.forget_pixels()
        if get_worker_info() is not None:
            self._sources = None  # each of many workers would hold its own copy of the pixels
        try:
            with renderer, nullcontext() if reader is None else closing(reader):
                yield lambda number: self._render(renderer, number)
        finally:
            self._sources = None

    def _prepared(self) -> Sources:
        """Return patches and models; they are kept from the first call to the end of an iteration."""
        if self._sources is None:
            self._sources = prepare_sources(self.config, self._split)
            self._digests = None  # files may have changed since
        return self._sources

    def _render(self, renderer: PairRenderer, number: int) -> Any:  # noqa: ANN401 - what the transform returns
        sequence, rest = divmod(number, self.together)
        frame, view = divmod(rest, self.config.views)
        index = (sequence * self.config.sequence.length + self._frames[frame]) * self.config.views + view
        seed = self._split.seed
        place, drawn = self._cutting.draw(seed, sequence)
        pair = renderer.render(index, crop=place, checked=self.checked)
        sample = self._cutting.sample(pair.frame, drawn, seed, pair.index)
        return sample if self.transform is None else self.transform(sample)

    def _check(self) -> None:
        hardware = self.hardware
        check_transform(self.transform)
        if hardware.device == "cpu":
            return
        if self.checked or self.augmentation is not None or not self.config.images_as_drawn:
            raise InputError(
                "device='cuda' needs checked=False and a config without a lens, imperfections or augmentation, since "
                "these work on arrays in the computer's memory: change that, or leave device out and let the loader "
                "pin memory (pin_memory=True)"
            )
        if hardware.backend == "osmesa" or not torch.cuda.is_available():
            raise InputError(
                f"device='cuda' needs EGL and a GPU that torch finds, got backend={hardware.backend!r} and "
                f"torch.cuda.is_available() {torch.cuda.is_available()}: leave device out"
            )
