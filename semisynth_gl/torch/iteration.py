"""The common part of `StereoStream` and `StereoMix`: numbered samples that are dealt out, iterated over and resumed."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from importlib.metadata import version
from typing import Any, Protocol

from torch.utils.data import IterableDataset, get_worker_info

from semisynth_gl.dataset.names import PROGRAM
from semisynth_gl.dataset.plan import differences
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError, abbreviate, shown
from semisynth_gl.seeds.seeds import LARGEST_NUMBER
from semisynth_gl.torch.dealing import Dealing, TrainingProcess, Worker

_STATE = {"yielded", "worker", "workers", "stream"}


class Source(Protocol):
    """A source of numbered samples: any process can make a sample from its number.

    A source is pickled for worker processes, so it holds only settings; `open` opens its resources.
    """

    @property
    def together(self) -> int:
        """Number of successive samples that one worker should make, such as the frames of a sequence."""

    @property
    def identity(self) -> Mapping[str, Any]:
        """Everything that decides the content of the samples, in JSON's types; used to save and load states."""

    def open(self, worker: Worker) -> AbstractContextManager[Callable[[int], Any]]:
        """Open a worker's resources; the context yields a function that makes a sample from its number."""


class DealtDataset(IterableDataset[Any]):
    """The samples of a source, dealt out to the loader's workers and to the training processes.

    If ``process`` is None, torch.distributed gives the number of the process.
    """

    def __init__(self, source: Source, dealing: Dealing, process: TrainingProcess | None) -> None:
        self.source = source
        self.dealing = dealing
        self._process = process or TrainingProcess.current()
        self._resumed: tuple[int, Worker] | None = None
        self._yielded: int | None = None

    def __len__(self) -> int:
        """Return the number of samples of this training process.

        Raises:
            TypeError: where the stream has no end.
        """
        samples = self.dealing.count(self._process)
        if samples is None:
            raise TypeError("a stream without pairs=... has no end and no length")
        return samples

    def __iter__(self) -> Iterator[Any]:
        """Begin at the first sample; the first iteration after `load_state_dict` begins where the state ended.

        Raises:
            InputError: where the state is from another worker.
        """
        worker = _this_worker()
        resumed, self._resumed = self._resumed, None
        if resumed is not None and resumed[1] != worker:
            raise InputError(
                f"the loaded state is from worker {resumed[1].number} of {resumed[1].total}, and this is worker "
                f"{worker.number} of {worker.total}: resume with the same number of workers through torchdata's "
                "StatefulDataLoader, or select first=steps * batch_size * world_size"
            )
        self._yielded = 0 if resumed is None else resumed[0]
        return self._samples(worker, self._yielded)

    def state_dict(self) -> dict[str, Any]:
        """Return the position of this process or worker in the stream, in JSON's types.

        Each worker has its own state; torchdata's StatefulDataLoader gathers them. The keys are ``yielded`` (number of
        samples), ``worker``, ``workers`` and ``stream`` (everything that decides the content of the samples).

        Raises:
            InputError: where this process has not begun to iterate, as when the loader's workers iterate instead, or
                photographs or models cannot be used.
        """
        if self._yielded is None:
            raise InputError(
                "this process has not begun to iterate over the stream: a loader's workers have copies of their own. "
                "Ask torchdata's StatefulDataLoader for its state, or select first=steps * batch_size * world_size"
            )
        number, total = _this_worker()
        return {"yielded": self._yielded, "worker": number, "workers": total, "stream": self._identity}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Let the next iteration continue after the samples that were yielded before the state was saved.

        Args:
            state: the result of `state_dict`.

        Raises:
            InputError: where the state is not a stream's, or is from a stream that yields other samples, for example
                because its photographs have changed; or where photographs or models cannot be used.
        """
        yielded, worker, identity = _position(state)
        changed = differences(identity, self._identity)
        if changed:
            raise InputError(
                f"the state is from a stream that yields other samples: {abbreviate(changed)}. Make the stream "
                "as it was, with the same photographs and models"
            )
        self._yielded = yielded
        self._resumed = yielded, worker

    @property
    def _identity(self) -> dict[str, Any]:
        """Everything that decides which samples come; not the number of samples, which only decides where they end."""
        return {
            "version": version(PROGRAM),
            **self.source.identity,
            "first": self.dealing.first,
            "batch_size": self.dealing.batch,
            "rank": self._process.rank,
            "world_size": self._process.world_size,
        }

    def _samples(self, worker: Worker, skipped: int) -> Iterator[Any]:
        with self.source.open(worker) as read:
            for yielded, number in enumerate(self.dealing.numbers(self._process, worker, skipped), skipped + 1):
                sample = read(number)
                self._yielded = yielded
                yield sample


def _position(state: object) -> tuple[int, Worker, Mapping[str, Any]]:
    """Return a state's number of yielded samples, its worker, and its stream's identity; check all three."""
    if not isinstance(state, Mapping) or not set(state) >= _STATE or not isinstance(state["stream"], Mapping):
        raise InputError(
            f"expected the result of a stream's state_dict(), with the keys {', '.join(sorted(_STATE))}, got "
            f"{shown(state)}"
        )
    numbers = [
        to_whole(f"state: {name}", state[name], least, LARGEST_NUMBER)
        for name, least in (("yielded", 0), ("worker", 0), ("workers", 1))
    ]
    identity = state["stream"]
    try:
        json.dumps(identity)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"stream must have only JSON's types, got {shown(identity)}: {error}", argument="state"
        ) from None
    return numbers[0], Worker(*numbers[1:]), identity


def _this_worker() -> Worker:
    info = get_worker_info()
    return Worker() if info is None else Worker(info.id, info.num_workers)
