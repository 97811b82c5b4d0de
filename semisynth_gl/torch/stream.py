"""Pairs rendered while a network trains: `StereoStream`, an IterableDataset without files.

Sample n of the stream is a pair of the dataset that the same config and seed give, whoever renders it. `Dealing` says
which process gets which samples, so workers and ranks share nothing but the numbers that the stream was made with.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from importlib.metadata import version
from typing import Any, Literal, get_args

import torch
import torch.distributed
from torch.utils.data import IterableDataset, get_worker_info

from semisynth_gl.camera import Crop
from semisynth_gl.config import Config
from semisynth_gl.dataset.plan import PROGRAM, differences, abbreviate
from semisynth_gl.engines.task import threads_each
from semisynth_gl.errors import BackendError, InputError
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.render.context import BACKENDS, Backend
from semisynth_gl.render.devices import egl_index_of_worker
from semisynth_gl.render.readers import read_array
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.splits import SPLITS, SplitName, split_of
from semisynth_gl.torch.dealing import Consumer, Dealing
from semisynth_gl.torch.interop import CudaReader
from semisynth_gl.torch.samples import Sample, to_sample

TensorDevice = Literal["cpu", "cuda"]

_THREADS = "LP_NUM_THREADS"
_WORKER = ("worker", "workers")


class StereoStream(IterableDataset[Any]):
    """Renders pairs one after the other, in the DataLoader's workers if it has any; writes no files.

    Samples are numbered from 0 on and never repeat within an iteration; each iteration begins at ``first``. Without
    ``frames``, sample n is pair n. A sample is a dictionary, see `to_sample`. Each process that iterates opens a
    renderer of its own when it begins and releases it when it ends.

    Args:
        config: the configuration.
        seed: 0 or more.
        split: which split of the dataset.
        splits: all splits that the dataset has: photographs are held out for each of them.
        first: number of the first sample; to resume a stream, its own plus ``steps * batch_size * world_size``.
        pairs: how many samples, of all ranks together; None for no end.
        frames: of each sequence, the frames to yield, growing; all by default.
        crop: height and width, px: yield a crop of each pair, at a place that follows from the seed and the pair's
            sequence; None for whole images.
        checked: whether pairs that fail the config's checks are drawn again, as in a dataset. Without, crops are much
            faster, and the few pairs that would have failed differ from the dataset's.
        transform: gets the sample, returns what is yielded instead.
        batch_size: the DataLoader's: batches are then made of samples that follow each other, and come in order.
        backend: "auto", "egl" or "osmesa".
        gpus: CUDA's numbers of the GPUs that workers take turns on; none for the first device of EGL.
        rank: number of this training process; by default what torch.distributed says, 0 without it.
        world_size: how many training processes there are; by default likewise, 1 without it.
        device: "cpu", or "cuda" for tensors that never leave the GPU, without workers.

    Raises:
        InputError: where an argument cannot be used.
    """

    def __init__(
        self,
        config: Config,
        seed: int = 0,
        *,
        split: SplitName = "train",
        splits: Sequence[SplitName] = ("train",),
        first: int = 0,
        pairs: int | None = None,
        frames: Iterable[int] | None = None,
        crop: tuple[int, int] | None = None,
        checked: bool = True,
        transform: Callable[[Sample], Any] | None = None,
        batch_size: int = 1,
        backend: Backend = "auto",
        gpus: Sequence[int] = (),
        rank: int | None = None,
        world_size: int | None = None,
        device: TensorDevice = "cpu",
    ) -> None:
        self.config = config
        self.seed = seed
        self._split, self._splits = split, tuple(splits)
        self._frames = tuple(range(config.sequence.length) if frames is None else frames)
        self._crop = crop
        self._checked = checked
        self._transform = transform
        self._backend = backend
        self._gpus = tuple(gpus)
        alone = rank is None and world_size is None
        # Of one number alone nothing follows: half an answer is refused like a wrong one.
        self._rank, self._ranks = _distributed() if alone else (-1 if rank is None else rank, world_size or 0)
        self._device = device
        self._dealing = Dealing(first, pairs, batch_size, len(self._frames))
        self._check()
        self._part = split_of(config.splits, self._splits, split)
        self._identity = self._described()
        self._resumed: dict[str, Any] = {}
        self._yielded: int | None = None

    def __len__(self) -> int:
        """How many samples this rank gets.

        Raises:
            TypeError: where the stream has no end.
        """
        samples = self._dealing.count(self._rank, self._ranks)
        if samples is None:
            raise TypeError("a stream without pairs=... has no end and no length")
        return samples

    def __iter__(self) -> Iterator[Any]:
        """Begin at ``first``, or, once, after what a loaded state had yielded.

        Raises:
            InputError: where the state is another worker's, or workers shall yield CUDA tensors.
        """
        consumer = self._consumer()
        skipped, self._resumed = self._resumed, {}
        for name in _WORKER:
            if skipped and skipped[name] != getattr(consumer, name):
                raise InputError(
                    f"the state that was loaded is of worker {skipped['worker']} of {skipped['workers']}, and this is "
                    f"worker {consumer.worker} of {consumer.workers}: resume with the same number of workers through "
                    "torchdata's StatefulDataLoader, or make the stream with first=steps * batch_size * world_size"
                )
        if self._device == "cuda" and get_worker_info() is not None:
            raise InputError("device='cuda' goes with num_workers=0 alone: tensors on a GPU do not leave their process")
        self._yielded = skipped.get("yielded", 0)
        return self._samples(consumer, self._yielded)

    def state_dict(self) -> dict[str, Any]:
        """Return what this process has yielded, and what must agree to go on from there, in JSON's types.

        A worker's stream has a state of its own: torchdata's StatefulDataLoader gathers them.

        Raises:
            InputError: where this process has yielded nothing, since the loader's workers do.
        """
        if self._yielded is None:
            raise InputError(
                "this process has not begun to iterate over the stream: a loader's workers have copies of their own. "
                "Ask torchdata's StatefulDataLoader for its state, or resume with first=steps * batch_size * world_size"
            )
        consumer = self._consumer()
        place = {name: getattr(consumer, name) for name in _WORKER}
        return {"yielded": self._yielded, **place, "stream": self._identity}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Let the next iteration go on after what had been yielded.

        Raises:
            InputError: where the state is no stream's, or of one that yields other samples.
        """
        if not {"yielded", *_WORKER, "stream"} <= set(state):
            raise InputError(f"expected what state_dict() of a stream has returned, got the keys {sorted(state)}")
        changed = differences(state["stream"], self._identity)
        if changed:
            raise InputError(
                f"the state is of a stream that yields other samples: {abbreviate(changed)}. Make the stream as it was"
            )
        self._resumed = {name: state[name] for name in ("yielded", *_WORKER)}
        self._yielded = state["yielded"]

    def _samples(self, consumer: Consumer, skipped: int) -> Iterator[Any]:
        length = self.config.sequence.length
        with self._opened(consumer) as render:
            for number in self._dealing.numbers(consumer, skipped):
                sequence, frame = divmod(number, len(self._frames))
                pair = render(sequence * length + self._frames[frame], self._crop_of(sequence))
                sample = to_sample(pair)
                yielded = sample if self._transform is None else self._transform(sample)
                skipped += 1
                self._yielded = skipped
                yield yielded

    @contextmanager
    def _opened(self, consumer: Consumer) -> Iterator[Callable[[int, Crop | None], Pair]]:
        """Open this process's renderer; give what makes a pair of an index and a crop."""
        who = "the stream"
        if get_worker_info() is not None:
            who = f"worker {consumer.worker} of {consumer.workers}"
            os.environ.setdefault(_THREADS, str(threads_each(consumer.workers)))
        gpus = self._gpus
        reader: CudaReader | None = None
        if self._device == "cuda":
            gpus = gpus or (torch.cuda.current_device(),)
            reader = CudaReader(torch.device("cuda", gpus[0]))
        device_index = egl_index_of_worker(gpus, consumer.worker)
        try:
            renderer = PairRenderer(
                self.config, self.seed, self._backend, self._part, device_index, reader or read_array
            )
        except BackendError as error:
            raise BackendError(f"{who} cannot render: {error}") from error

        with renderer, nullcontext() if reader is None else closing(reader):
            yield lambda index, crop: renderer.render(index, crop=crop, checked=self._checked)

    def _crop_of(self, sequence: int) -> Crop | None:
        """Where a sequence is cropped: all of its frames at one place, so that flow leads from one to the next."""
        if self._crop is None:
            return None
        height, width = self._crop
        camera = self.config.camera
        rng = generator(self._part.seed(self.seed), Purpose.CROP, sequence)
        x, y = rng.integers(camera.width_px - width + 1), rng.integers(camera.height_px - height + 1)
        return Crop(int(x), int(y), width, height)

    def _consumer(self) -> Consumer:
        info = get_worker_info()
        worker, workers = (0, 1) if info is None else (info.id, info.num_workers)
        return Consumer(self._rank, self._ranks, worker, workers)

    def _described(self) -> dict[str, Any]:
        """What decides which samples come, in JSON's types; ``pairs`` decides only where they end."""
        return {
            "version": version(PROGRAM),
            "config": self.config.name,
            "config_sha256": self.config.digest(),
            "seed": self.seed,
            "split": self._split,
            "splits": list(self._splits),
            "first": self._dealing.first,
            "frames": list(self._frames),
            "crop": self._crop and list(self._crop),
            "checked": self._checked,
            "batch_size": self._dealing.batch,
            "rank": self._rank,
            "world_size": self._ranks,
        }

    def _check(self) -> None:
        dealing, camera, length = self._dealing, self.config.camera, self.config.sequence.length
        if self.seed < 0:
            raise InputError(f"a seed must be 0 or more, got {self.seed}")
        if not self._splits or set(self._splits) - set(SPLITS) or self._split not in self._splits:
            raise InputError(
                f"split: expected one of splits, which name all that the dataset has of {', '.join(SPLITS)}, got "
                f"split={self._split!r} and splits={self._splits!r}"
            )
        if dealing.first < 0:
            raise InputError(f"first: expected the number of a sample, 0 or more, got {dealing.first}")
        if dealing.samples is not None and dealing.samples < 1:
            raise InputError(f"pairs: expected 1 or more, or None for a stream without end, got {dealing.samples}")
        if dealing.batch < 1:
            raise InputError(f"batch_size: expected the loader's, 1 or more, got {dealing.batch}")
        if (
            not self._frames
            or not set(self._frames) <= set(range(length))
            or list(self._frames) != sorted(set(self._frames))
        ):
            raise InputError(
                f"frames: expected growing numbers from 0 to {length - 1}, since the config's sequence.length is "
                f"{length}, got {self._frames}"
            )
        largest = camera.height_px, camera.width_px
        if self._crop is not None and not all(
            1 <= side <= most for side, most in zip(self._crop, largest, strict=True)
        ):
            raise InputError(
                f"crop: expected (height, width) of up to {largest} px, which is what the config's camera has, got "
                f"{self._crop}"
            )
        if not 0 <= self._rank < self._ranks:
            raise InputError(
                f"rank: expected 0 to world_size - 1, got rank={self._rank} and world_size={self._ranks}: give both "
                "or neither, for those of torch.distributed"
            )
        if self._backend not in BACKENDS:
            raise InputError(f"backend: expected one of {', '.join(BACKENDS)}, got {self._backend!r}")
        self._check_device()

    def _check_device(self) -> None:
        if self._device not in get_args(TensorDevice):
            raise InputError(f"device: expected one of {', '.join(get_args(TensorDevice))}, got {self._device!r}")
        if self._device == "cpu":
            return
        if self._checked or not self.config.imperfections.none():
            raise InputError(
                "device='cuda' needs checked=False and a config without imperfections, since checks and imperfections "
                "work on arrays in the computer's memory: change that, or leave device out and let the loader pin "
                "memory (pin_memory=True)"
            )
        if self._backend == "osmesa" or not torch.cuda.is_available():
            raise InputError(
                f"device='cuda' needs EGL and a GPU that torch finds, got backend={self._backend!r} and "
                f"torch.cuda.is_available() {torch.cuda.is_available()}: leave device out"
            )


def _distributed() -> tuple[int, int]:
    """Rank and number of training processes, as torch.distributed has them."""
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        return torch.distributed.get_rank(), torch.distributed.get_world_size()
    return 0, 1
