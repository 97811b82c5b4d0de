"""Pairs rendered while a network trains: `StereoStream`, an IterableDataset without files.

Sample n of the stream is a pair of the dataset that the same config and seed give, whichever process renders it.
`Dealing` says which process gets which samples, so workers and training processes share only the stream's arguments.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from importlib.metadata import version
from numbers import Integral
from typing import Any, Literal, get_args

import torch
from torch.utils.data import IterableDataset, get_worker_info

from semisynth_gl.arguments import check_type, to_whole
from semisynth_gl.camera import Crop
from semisynth_gl.config import Config
from semisynth_gl.dataset.plan import abbreviate, differences
from semisynth_gl.dataset.schema import PROGRAM
from semisynth_gl.engines.task import THREADS, threads_each
from semisynth_gl.errors import BackendError, InputError
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.render.context import BACKENDS, Backend
from semisynth_gl.render.devices import egl_index_of_worker
from semisynth_gl.render.readers import read_array
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.torch.dealing import Dealing, Selection, TrainingProcess, Worker
from semisynth_gl.torch.interop import CudaReader
from semisynth_gl.torch.samples import Sample, to_sample

TensorDevice = Literal["cpu", "cuda"]

_STATE = {"yielded", "worker", "workers", "stream"}


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
        if self.backend not in BACKENDS:
            raise InputError(f"backend: expected one of {', '.join(BACKENDS)}, got {self.backend!r}")
        if self.device not in get_args(TensorDevice):
            raise InputError(f"device: expected one of {', '.join(get_args(TensorDevice))}, got {self.device!r}")


class StereoStream(IterableDataset[Any]):
    """Renders pairs one after the other, in the DataLoader's workers if it has any; writes no files.

    Samples are numbered from 0 on and never repeat within an iteration; each iteration begins at ``selection.first``.
    Without ``selection.frames``, sample n is pair n. A sample is a dictionary, see `to_sample`. Each process that
    iterates opens a renderer of its own when it begins and releases it when it ends.

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
        if transform is not None and not callable(transform):
            raise InputError(f"transform must be a function of a sample, got {transform!r}")
        self.config = config
        self.seed = seed
        selection = selection or Selection()
        self._frames = selection.frames_in(config.sequence.length)
        self._crop = crop
        self._checked = checked
        self._transform = transform
        self._process = process or TrainingProcess.current()
        self._hardware = hardware or Hardware()
        self._dealing = Dealing(selection.first, selection.pairs, batch_size, len(self._frames))
        self._check()
        self._split = config.splits.split(selection.split, selection.splits)
        # All that decides which samples come, in JSON's types; ``pairs`` decides only where they end.
        self._identity = {
            "version": version(PROGRAM),
            "config": config.name,
            "config_sha256": config.digest(),
            "seed": seed,
            "split": selection.split,
            "splits": list(selection.splits),
            "first": selection.first,
            "frames": list(self._frames),
            "crop": crop and list(crop),
            "checked": checked,
            "batch_size": batch_size,
            "rank": self._process.rank,
            "world_size": self._process.world_size,
        }
        self._resumed: tuple[int, Worker] | None = None
        self._yielded: int | None = None

    def __len__(self) -> int:
        """Return the number of samples of this training process.

        Raises:
            TypeError: where the stream has no end.
        """
        samples = self._dealing.count(self._process)
        if samples is None:
            raise TypeError("a stream without pairs=... has no end and no length")
        return samples

    def __iter__(self) -> Iterator[Any]:
        """Begin at the first sample, or, once, at the sample that follows a loaded state.

        Raises:
            InputError: where the state is another worker's, or workers shall yield CUDA tensors.
        """
        worker = _this_worker()
        resumed, self._resumed = self._resumed, None
        if resumed is not None and resumed[1] != worker:
            raise InputError(
                f"the state that was loaded is of worker {resumed[1].number} of {resumed[1].total}, and this is worker "
                f"{worker.number} of {worker.total}: resume with the same number of workers through torchdata's "
                "StatefulDataLoader, or select first=steps * batch_size * world_size"
            )
        if self._hardware.device == "cuda" and get_worker_info() is not None:
            raise InputError("device='cuda' goes with num_workers=0 alone: tensors on a GPU do not leave their process")
        self._yielded = 0 if resumed is None else resumed[0]
        return self._samples(worker, self._yielded)

    def state_dict(self) -> dict[str, Any]:
        """Return the position of this process in the stream, and the stream's arguments, in JSON's types.

        A worker's stream has a state of its own: torchdata's StatefulDataLoader gathers them.

        Raises:
            InputError: where this process has yielded nothing, since the loader's workers do.
        """
        if self._yielded is None:
            raise InputError(
                "this process has not begun to iterate over the stream: a loader's workers have copies of their own. "
                "Ask torchdata's StatefulDataLoader for its state, or select first=steps * batch_size * world_size"
            )
        number, total = _this_worker()
        return {"yielded": self._yielded, "worker": number, "workers": total, "stream": self._identity}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Let the next iteration go on after the samples that the state has yielded.

        Args:
            state: the result of `state_dict`.

        Raises:
            InputError: where the state is no stream's, or of a stream that yields other samples.
        """
        if not set(state) >= _STATE:
            raise InputError(f"expected what state_dict() of a stream has returned, got the keys {sorted(state)}")
        changed = differences(state["stream"], self._identity)
        if changed:
            raise InputError(
                f"the state is of a stream that yields other samples: {abbreviate(changed)}. Make the stream as it was"
            )
        self._yielded = state["yielded"]
        self._resumed = state["yielded"], Worker(state["worker"], state["workers"])

    def _samples(self, worker: Worker, skipped: int) -> Iterator[Any]:
        length = self.config.sequence.length
        with self._open_renderer(worker) as render:
            for yielded, number in enumerate(self._dealing.numbers(self._process, worker, skipped), skipped + 1):
                sequence, frame = divmod(number, len(self._frames))
                sample = to_sample(render(sequence * length + self._frames[frame], self._crop_for(sequence)))
                result = sample if self._transform is None else self._transform(sample)
                self._yielded = yielded
                yield result

    @contextmanager
    def _open_renderer(self, worker: Worker) -> Iterator[Callable[[int, Crop | None], Pair]]:
        """Open this process's renderer; give a function that renders the pair of an index and a crop."""
        name = "the stream"
        if get_worker_info() is not None:
            name = f"worker {worker.number} of {worker.total}"
            os.environ.setdefault(THREADS, str(threads_each(worker.total)))
        gpus, backend = self._hardware.gpus, self._hardware.backend
        reader: CudaReader | None = None
        if self._hardware.device == "cuda":
            gpus = gpus or (torch.cuda.current_device(),)
            reader = CudaReader(torch.device("cuda", gpus[0]))
        device_index = egl_index_of_worker(tuple(gpus), worker.number)
        try:
            renderer = PairRenderer(self.config, self.seed, backend, self._split, device_index, reader or read_array)
        except BackendError as error:
            raise BackendError(f"{name} cannot render: {error}") from error
        with renderer, nullcontext() if reader is None else closing(reader):
            yield lambda index, crop: renderer.render(index, crop=crop, checked=self._checked)

    def _crop_for(self, sequence: int) -> Crop | None:
        """Draw the crop of a sequence: all of its frames at one place, so that flow leads from one to the next."""
        if self._crop is None:
            return None
        height, width = self._crop
        camera = self.config.camera
        rng = generator(self._split.seed(self.seed), Purpose.CROP, sequence)
        x, y = rng.integers(camera.width_px - width + 1), rng.integers(camera.height_px - height + 1)
        return Crop(int(x), int(y), width, height)

    def _check(self) -> None:
        camera, hardware = self.config.camera, self._hardware
        if self._crop is not None:
            sides = camera.height_px, camera.width_px
            if not _fits(self._crop, sides):
                raise InputError(
                    f"crop: expected (height, width), whole numbers of up to {sides} px, which is what the config's "
                    f"camera has, got {self._crop!r}"
                )
        if hardware.device == "cpu":
            return
        if self._checked or not self.config.imperfections.none():
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


def _fits(crop: object, sides: tuple[int, int]) -> bool:
    """Whether a crop is (height, width) within an image of that height and width."""
    if not isinstance(crop, Sequence) or len(crop) != 2 or not all(isinstance(side, Integral) for side in crop):
        return False
    return all(1 <= side <= most for side, most in zip(crop, sides, strict=True))


def _this_worker() -> Worker:
    info = get_worker_info()
    return Worker() if info is None else Worker(info.id, info.num_workers)
