"""Every name that a dataset has on disk, except the layout's names."""

import re

from semisynth_gl.seeds.splits import SPLITS, SplitName

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

REPLACED = "replaced"
"""Key of a plan whose dataset is being removed to make room for another one."""

PARTIAL = ".partial"
"""Folder of unfinished files; the last run removes it."""
LOCK = f"{PARTIAL}/lock"
JOURNAL_SUFFIX = ".jsonl"

UNLOCKED = f"{PROGRAM}-"
"""Prefix of a run's own folder inside `PARTIAL`, for a shard that the run could not lock."""

_OF_A_SHARD = rf"semisynth-[^/]+-({'|'.join(SPLITS)})-\d{{6,}}({re.escape(JOURNAL_SUFFIX)}|\.tar|\.\d+)"
_UNFINISHED = re.compile(rf"{PARTIAL}/(lock|{PROGRAM}\.[^/]+\.\d+|({UNLOCKED}[^/]+/)?{_OF_A_SHARD})")


def shard_name(config: str, split: SplitName, number: int) -> str:
    """Return the name of a split's shard, with which the names of the shard's files begin."""
    return f"semisynth-{config}-{split}-{number:06d}"


def record_path(shard: str) -> str:
    """Return the path of the record that says that a shard is complete."""
    return f"{RECORDS}/{shard}.json"


def log_path(shard: str) -> str:
    """Return the path of a shard's log, which has the facts that differ between two runs of the same dataset."""
    return f"{RECORDS}/{shard}.log"


def tar_path(shard: str) -> str:
    """Return the path of a shard's tar, in layouts that pack their files."""
    return f"{RECORDS}/{shard}.tar"


def journal_name(shard: str) -> str:
    """Return the name, inside `PARTIAL`, of a shard's journal, which lists the pairs written so far."""
    return f"{shard}{JOURNAL_SUFFIX}"


def unfinished_path(name: str, number: int) -> str:
    """Return the path under which a file is written before it is renamed to ``name``; each run takes another number."""
    return f"{PARTIAL}/{PROGRAM}.{name.replace('/', '-')}.{number}"


def is_unfinished_file(path: str) -> bool:
    """Return whether a path is an unfinished file's of this program; other files in `PARTIAL` are somebody else's."""
    return _UNFINISHED.fullmatch(path) is not None
