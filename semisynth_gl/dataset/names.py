"""The names of the files that every dataset has; its layout names the others."""

from semisynth_gl.seeds.splits import SplitName

PROGRAM = "semisynth-gl"
"""Value of the key ``program`` in index and plan."""

FORMAT = 1
"""Value of the key ``format`` in index, plan and records: the newest format of a dataset that this program reads.

A change that an older program would misread takes the next number. A new key takes none: older programs ignore it.
"""

INDEX = "index.json"
"""The dataset's index, written last: it says that the dataset is complete."""
CARD = "README.md"

RECORDS = "shards"
"""Folder of the shards' records and tars."""
PLAN = f"{RECORDS}/plan.json"
"""The dataset's plan, written first: without an index beside it, the dataset is unfinished."""
LOCK = f"{RECORDS}/lock"
"""Locked by runs on the dataset; a finished dataset has no such file."""


def shard_name(config: str, split: SplitName, number: int) -> str:
    """Return the name of a split's shard, with which the names of the shard's files begin."""
    return f"semisynth-{config}-{split}-{number:06d}"


def record_path(shard: str) -> str:
    """Return the path of the record that says that a shard is complete."""
    return f"{RECORDS}/{shard}.json"


def log_path(shard: str) -> str:
    """Return the path of a shard's log, which says how long it took."""
    return f"{RECORDS}/{shard}.log"


def tar_path(shard: str) -> str:
    """Return the path of a shard's tar, in layouts that pack their files."""
    return f"{RECORDS}/{shard}.tar"
