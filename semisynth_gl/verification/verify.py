"""Read a dataset back, with nothing but its files, and report its faults."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any

from semisynth_gl.dataset.reader import DamagedIndexError, read_index
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.listener import FinishedPair, Listener
from semisynth_gl.verification.dataset import verify_dataset
from semisynth_gl.verification.verdict import DATASET, Finding, Verdict


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of all checks of a dataset.

    Attributes:
        pairs: number of pairs of the dataset; 0 where neither index nor plan can be read.
        verdicts: the verdict on the dataset as a whole, and then one for each pair.
    """

    pairs: int
    verdicts: Sequence[Verdict]

    @property
    def findings(self) -> list[Finding]:
        """All faults, in the order in which they were found."""
        return [finding for verdict in self.verdicts for finding in verdict.findings]

    @property
    def faulty_pairs(self) -> int:
        """Number of pairs with a fault; a shard's faults count as its first pair's."""
        return sum(1 for verdict in self.verdicts[1:] if verdict.findings)

    def values(self) -> dict[str, Any]:
        """Return the content of ``semisynth-gl verify --json``, in JSON's types.

        The keys are the number of ``pairs``; ``findings``, each with ``scene``, ``check`` and ``message``; and
        ``measures`` by scene and name.
        """
        return {
            "pairs": self.pairs,
            "findings": [asdict(finding) for finding in self.findings],
            "measures": {verdict.scene: verdict.measures for verdict in self.verdicts if verdict.measures},
        }


def verify(
    dataset: str | PathLike[str],
    *,
    oracle: bool = False,
    pixels: int = 500,
    listener: Listener | None = None,
    on_finding: Callable[[Finding], None] | None = None,
) -> Verification:
    """Read a dataset back, and compare its files with each other, with the index and with the shards' records.

    Args:
        dataset: a folder, or an address that fsspec knows.
        oracle: whether to sample each scene again and compare the pair with float64 rays through it.
        pixels: number of rays for each pair, with ``oracle``.
        listener: is told the number of pairs, and each checked pair.
        on_finding: is called with each fault as soon as it is found.

    Raises:
        InputError: where there is no dataset, or ``oracle`` is set and its scenes cannot be sampled again.
    """
    pixels, listener = to_whole("pixels", pixels, least=1), listener or Listener()
    keys: list[FinishedPair] = []
    try:
        index = read_index(dataset)
    except DamagedIndexError as error:
        damaged = Verdict(DATASET)
        for fault in error.faults:
            damaged.add("index", fault)
        found: Iterable[Verdict] = [damaged]
    else:
        found = verify_dataset(index, pixels if oracle else 0)
        keys = [FinishedPair(each.split, n) for each in index.plan.shards for n in range(each.first, each.end)]
    listener.on_total(len(keys))
    verdicts: list[Verdict] = []
    for verdict in found:
        if on_finding is not None:
            for finding in verdict.findings:
                on_finding(finding)
        if verdicts:  # the first verdict is about the dataset, not about a pair
            listener.on_pair(keys[len(verdicts) - 1])
        verdicts.append(verdict)
    return Verification(len(keys), verdicts)
