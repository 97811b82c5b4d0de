"""Every name that a dataset has on disk, beside those of its layout."""

from semisynth_gl.splits import SplitName

PROGRAM = "semisynth-gl"
"""Value of the key ``program`` in index and plan."""

INDEX = "index.json"
"""Written last: it says that the dataset is complete."""
CARD = "README.md"
CROISSANT = "croissant.json"

RECORDS = "shards"
"""Folder of the shards' records and tars."""
PLAN = f"{RECORDS}/plan.json"
"""What the dataset was begun as: the first file that is written, and the mark of an unfinished dataset."""

PARTIAL = ".partial"
"""Folder of unfinished files; it goes with the last run."""
LOCK = f"{PARTIAL}/lock"


def shard_name(config: str, split: SplitName, number: int) -> str:
    """Return the name of a split's shard, which its files are named after."""
    return f"semisynth-{config}-{split}-{number:06d}"


def record_path(shard: str) -> str:
    """Return the path of the record that says that a shard is complete."""
    return f"{RECORDS}/{shard}.json"


def tar_path(shard: str) -> str:
    """Return the path of a shard's tar, in layouts that pack their files."""
    return f"{RECORDS}/{shard}.tar"


def journal_name(shard: str) -> str:
    """Return the name, in the folder of unfinished files, of the list of a shard's pairs so far."""
    return f"{shard}.jsonl"
