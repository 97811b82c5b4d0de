"""Streams and datasets mixed in shares: `StereoMix`.

Sample n of a mix is a sample of one of its sources. The source, and the number of the sample in it, depend only on the
seed and n. So any worker can make any sample, and a mix can be resumed anywhere at once.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from itertools import accumulate
from math import lcm
from typing import Any

import numpy as np
from torch.utils.data import Dataset, IterableDataset

from semisynth_gl.inputs.arguments import to_real, to_whole
from semisynth_gl.inputs.errors import InputError, shown
from semisynth_gl.seeds.seeds import LARGEST_NUMBER, Purpose, generator
from semisynth_gl.torch.dataset import StereoDataset
from semisynth_gl.torch.dealing import Dealing, TrainingProcess, Worker
from semisynth_gl.torch.iteration import DealtDataset, Source

_WINDOW = 256
"""Number of turns whose order is drawn at once."""
_UNIT = 2**32
_GOLDEN = 2654435769
"""The golden section of `_UNIT`: its multiples are spread more evenly than those of any other number."""


class StereoMix(DealtDataset):
    """Mixes streams and datasets in shares; an IterableDataset that is dealt out and resumed like a `StereoStream`.

    The seed and n decide from which source sample n comes. The sources take turns: a turn is one sample, or several
    where a source keeps samples together, such as the frames of a sequence. Shares are exact in the long run: of each
    256 turns, a source of share s gets 256 s, rounded up or down, and the rounding evens out in later turns. Datasets
    are read again and again, each time in another order; a `StereoDataset` then also has the crops of another epoch.
    Streams continue where their last turn ended, and begin again at their end. The batch size and the process of a
    mixed stream are ignored.

    Args:
        sources: pairs of a source and its share. A source is a `StereoStream`, a `StereoDataset`, another map-style
            dataset or a `StereoMix`. A share is a number above 0; only the ratios of the shares count.
        seed: decides the order of turns and the orders of datasets; 0 or more.
        first: number of the first sample. To resume a mix that began at 0, take
            ``steps * batch_size * world_size``.
        pairs: number of samples, of all training processes together; None for no end.
        batch_size: the DataLoader's: batches then consist of successive samples, and come in order.
        process: the training process; by default the process that torch.distributed says.

    Raises:
        InputError: where an argument cannot be used.
    """

    def __init__(
        self,
        sources: Sequence[tuple[Dataset[Any], float]],
        seed: int = 0,
        *,
        first: int = 0,
        pairs: int | None = None,
        batch_size: int = 1,
        process: TrainingProcess | None = None,
    ) -> None:
        seed = to_whole("seed", seed, least=0)
        first = to_whole("first", first, 0, LARGEST_NUMBER)
        if pairs is not None:
            pairs = to_whole("pairs", pairs, 1, LARGEST_NUMBER)
        batch_size = to_whole("batch_size", batch_size, least=1)
        source = MixedSamples(sources, seed)
        super().__init__(source, Dealing(first, pairs, batch_size, source.together), process)


class MixedSamples:
    """The samples of several sources as one `Source`; see `StereoMix` for the arguments.

    Each turn takes ``together`` successive samples of a source: the least common multiple of the sources' own
    ``together``, so that no source's samples are separated.
    """

    def __init__(self, sources: Sequence[tuple[Dataset[Any], float]], seed: int) -> None:
        if not sources:
            raise InputError("expected at least one (source, share), got none", argument="sources")
        for pair in sources:
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise InputError(f"expected pairs of (source, share), got {shown(pair, 80)}", argument="sources")
        shares = [_exact(share) for _, share in sources]
        self._shares = [share / sum(shares) for share in shares]
        self._parts = [_dealt(source, seed, place) for place, (source, _) in enumerate(sources)]
        self._seed = seed
        self.together = lcm(*(part.source.together for part in self._parts))

    @property
    def identity(self) -> Mapping[str, Any]:
        """Everything that decides the content of the samples, in JSON's types."""
        return {
            "seed": self._seed,
            "sources": {
                str(place): {
                    **part.source.identity,
                    "first": part.dealing.first,
                    "pairs": part.dealing.samples,
                    "share": float(share),
                }
                for place, (part, share) in enumerate(zip(self._parts, self._shares, strict=True))
            },
        }

    @contextmanager
    def open(self, worker: Worker) -> Iterator[Callable[[int], Any]]:
        """Open all sources in a worker; yield a function that makes a sample from its number."""
        turns = Turns(self._shares, self._seed)
        with ExitStack() as stack:
            reads = [stack.enter_context(part.source.open(worker)) for part in self._parts]

            def read(number: int) -> Any:  # noqa: ANN401 - a sample of any source
                turn, within = divmod(number, self.together)
                place, earlier = turns[turn]
                drawn, dealing = earlier * self.together + within, self._parts[place].dealing
                if dealing.samples is not None:
                    drawn %= dealing.samples
                return reads[place](dealing.first + drawn)

            yield read


class Turns:
    """An endless sequence of turns, in which each source has its share; the shares' sum is 1.

    Turns are drawn in windows of 256. Each window has 256 points at equal distances. A source gets the points that fall
    into its share, and the seed decides the order of the turns. From window to window the points are shifted by the
    golden section, so that rounding in one window evens out in other windows.
    """

    def __init__(self, shares: Sequence[Fraction], seed: int) -> None:
        self._ends = np.array([round(end * _WINDOW * _UNIT) for end in accumulate(shares)], np.int64)
        self._seed = seed
        self._offset = int(generator(seed, Purpose.MIX).integers(_UNIT))
        self._draw(0)

    def __getitem__(self, turn: int) -> tuple[int, int]:
        """Return the index of the source whose turn it is, and the number of its earlier turns."""
        window, within = divmod(turn, _WINDOW)
        if window != self._window:
            self._draw(window)
        return int(self._sources[within]), int(self._earlier[within])

    def _draw(self, window: int) -> None:
        """Work out the turns of a window from all windows before it."""
        phases = (self._offset + np.arange(window + 1, dtype=np.int64) * _GOLDEN) % _UNIT
        # The points of a window are phase + k * _UNIT; count those below the end of each source's share.
        below = (self._ends[:, None] - phases + _UNIT - 1) // _UNIT
        counts = np.diff(below, axis=0, prepend=0)
        rng = generator(self._seed, Purpose.MIX, window)
        self._sources = rng.permutation(np.repeat(np.arange(len(counts)), counts[:, -1]))
        self._earlier = np.empty(_WINDOW, np.int64)
        for source, before in enumerate(counts[:, :-1].sum(axis=1)):
            own = self._sources == source
            self._earlier[own] = before + np.arange(np.count_nonzero(own))
        self._window = window


class _Passes:
    """A map-style dataset as an endless `Source`: it is read again and again, each pass in another order."""

    together = 1

    def __init__(self, dataset: Dataset[Any], length: int, seed: int, place: int) -> None:
        self._dataset, self._length, self._seed, self._place = dataset, length, seed, place
        ours = dataset.identity if isinstance(dataset, StereoDataset) else {"dataset": type(dataset).__qualname__}
        self.identity: Mapping[str, Any] = {**ours, "length": length}

    @contextmanager
    def open(self, _: Worker) -> Iterator[Callable[[int], Any]]:
        """Yield a function that reads a sample by its number; nothing has to be opened."""
        current, order, dataset = -1, np.arange(0), self._dataset

        def read(number: int) -> Any:  # noqa: ANN401 - whatever the dataset has
            nonlocal current, order, dataset
            turn, within = divmod(number, self._length)
            if turn != current:
                order = generator(self._seed, Purpose.MIX, self._place, turn).permutation(self._length)
                if isinstance(self._dataset, StereoDataset):
                    dataset = self._dataset.at_epoch(turn)
                current = turn
            return dataset[int(order[within])]

        yield read


def _exact(share: object) -> Fraction:
    number = to_real("share", share)
    if number <= 0:
        raise InputError(f"must be above 0, got {shown(share)}: leave the source out", argument="share")
    return share if isinstance(share, Fraction) else Fraction(number)


def _dealt(source: object, seed: int, place: int) -> DealtDataset:
    """Return a stream or a mix as it is, and a map-style dataset as an endless stream of its samples."""
    if isinstance(source, DealtDataset):
        return source
    if not isinstance(source, Dataset) or isinstance(source, IterableDataset) or not hasattr(source, "__len__"):
        raise InputError(
            "sources: expected a StereoStream, a StereoDataset, a StereoMix or another map-style dataset of "
            f"PyTorch's with a length, got {shown(source, 80)}"
        )
    length = len(source)
    if length < 1:
        raise InputError(
            f"expected a dataset with samples, got {shown(source, 80)}, which has none", argument="sources"
        )
    passes: Source = _Passes(source, length, seed, place)
    return DealtDataset(passes, Dealing(0, None, 1, 1), TrainingProcess())
