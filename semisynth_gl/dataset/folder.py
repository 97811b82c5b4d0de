"""A dataset's folder: `begin` writes the plan, `missing` lists the missing shards, `finish` writes the index last.

A run may be killed at any time: the next run makes the shards that have no record.
"""

import fcntl
import os
import shutil
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from upath import UPath

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.dataset.documents import CARD, INDEX, LOCK, PLAN, PROGRAM, SHARDS_FOLDER, DatasetPlan, Shard, parse
from semisynth_gl.dataset.index import encode_card, index_values
from semisynth_gl.dataset.plan import differences
from semisynth_gl.dataset.reader import read_record
from semisynth_gl.dataset.root import explained_errors, is_local, names_below, read_if_there, replace, shown_path, write
from semisynth_gl.inputs.errors import InputError, ReadError, abbreviate, counted
from semisynth_gl.scene.sources import SceneSources
from semisynth_gl.seeds.splits import SplitName

_MOST_REQUESTS = 16  # at a time, to an object store


def read_plan(root: UPath) -> DatasetPlan | None:
    """Read the plan of a dataset; return None if the root is empty or does not exist.

    Raises:
        InputError: where a newer program wrote the plan, its layout is a plug-in that is not installed, or the root
            holds something other than a dataset.
        ReadError: where the plan is damaged. Only the plan says which folders belong to the dataset.
    """
    if is_local(root) and root.is_file():
        raise InputError(f"{root}: expected a folder, got a file", argument="out")
    data = read_if_there(root, PLAN)
    if data is None:
        with explained_errors(root):
            # A run may hold the lock, or may have been killed while it wrote the plan.
            names = [name for name in names_below(root) if not name.startswith((PLAN, LOCK))]
        if names:
            raise InputError(
                f"{root}: the folder is not empty (it holds {abbreviate(names, 3)}), and is no dataset of {PROGRAM}: "
                "choose a different folder",
                argument="out",
            )
        return None
    try:
        return parse(DatasetPlan, data, shown_path(root, PLAN))
    except ReadError as error:
        remedy = "without a plan, a dataset can be neither resumed nor replaced: remove its folder"
        raise ReadError(error.path, f"{error.reason}; {remedy}") from None


def holds_only_plan(root: UPath) -> bool:
    """Return whether a folder holds no files except a plan, a plan that was being written, and a lock."""
    if not is_local(root):
        return False
    others = {*root.glob("*"), *root.glob(f"{SHARDS_FOLDER}/*")} - {root / SHARDS_FOLDER, root / LOCK}
    return all(str(path).startswith(str(root / PLAN)) for path in others)


def check_resumable(root: UPath, stored: DatasetPlan, plan: DatasetPlan) -> None:
    """Raise InputError with the keys that differ if a dataset with the plan ``stored`` cannot go on as ``plan``.

    The digests of patches and models are compared only if ``plan`` has them.
    """
    old, new = stored.values(), plan.values()
    if stored.layout_name != plan.layout_name:
        old["config_values"] |= {"outputs": new["config_values"]["outputs"]}  # layouts add outputs
    keys = ("version", "seed", "layout", "shard_pairs", "plugins")
    changed = differences({key: old.get(key, {}) for key in keys}, {key: new.get(key, {}) for key in keys})
    changed += differences(old["config_values"], new["config_values"])
    changed += [f"{split} (no pairs there)" for split in plan.pairs if split not in stored.pairs]
    if plan.sources:
        changed += differences(stored.sources, plan.sources, "photographs or models: ")
    if changed:
        raise InputError(
            f"{root}: holds a dataset that was begun with other values: {abbreviate(changed)}. Give the same, or more "
            "pairs, to go on with it; or choose another folder, or replace the dataset with --overwrite",
            argument="out",
        )
    for split, count in stored.pairs.items():
        if (given := plan.pairs.get(split, 0)) < count:
            raise InputError(
                f"expected at least the {counted(count, 'pair')} in {root}, got {given}: a dataset cannot shrink; or "
                "choose another folder, or replace the dataset with --overwrite",
                argument="pairs" if split == "train" else split,
            )


def begin(root: UPath, plan: DatasetPlan, *, overwrite: bool = False) -> None:
    """Write a dataset's plan. A dataset with this plan, or with this plan and fewer pairs, keeps its complete shards.

    With ``overwrite``, `begin` removes a finished dataset, or one with a different plan, and all files in its layout's
    folders. Raises InputError if the folder holds something else or, without ``overwrite``, any other dataset.
    """
    stored = read_plan(root)
    if stored is not None:
        if overwrite and (stored != plan or (root / INDEX).exists()):
            _remove_all_but_plan(root, stored)
        else:
            check_resumable(root, stored, plan)
        (root / INDEX).unlink(missing_ok=True)
        ends = {shard.record: shard.end for shard in plan.shards}
        for shard in stored.shards:
            if ends.get(shard.record, shard.end) != shard.end:  # the split's last shard gets more pairs
                (root / shard.record).unlink(missing_ok=True)
    if stored != plan:
        with explained_errors(root):
            replace(root, PLAN, JSON_OBJECT.encode(plan.values()))


def missing(root: UPath, plan: DatasetPlan) -> list[Shard]:
    """Return the shards that have no record."""
    present = {f"{SHARDS_FOLDER}/{name}" for name in names_below(root / SHARDS_FOLDER)}
    return [shard for shard in plan.shards if shard.record not in present]


def finish(root: UPath, plan: DatasetPlan, sources: Mapping[SplitName, SceneSources]) -> dict[str, Any]:
    """Write lists, links, card and at last the index of a dataset that lacks no shard; return the index's content.

    ``sources`` are the photographs, patches and models of each split.
    """
    with ThreadPoolExecutor(_MOST_REQUESTS) as pool:
        records = pool.map(lambda shard: read_record(root, shard, packed=plan.layout.packed), plan.shards)
        index = index_values(plan, sources, records)
    for name, data in plan.lists.items():
        write(root, name, data)
    write(root, CARD, encode_card(plan, index))
    if is_local(root):
        for name in plan.folders:
            (root / name).mkdir(parents=True, exist_ok=True)
        for name, target in plan.links.items():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            if not (root / name).is_symlink():
                (root / name).symlink_to(target)
    replace(root, INDEX, JSON_OBJECT.encode(index))
    return index


@contextmanager
def locked(root: UPath, *, shared: bool = False) -> Iterator[bool]:
    """Lock a dataset against other runs, also on other machines that share the disk; the lock ends with the process.

    Runs with a ``shared`` lock make different shards at the same time. Yields whether this run is certainly the only
    one: it is not if the lock is shared, or if the object store or network file system has no locks. An OSError without
    a file name gets the dataset's folder as file name. Raises InputError if a different run has locked the dataset.
    """
    if not is_local(root):
        yield False
        return
    path = root / LOCK
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("ab")
    except OSError as error:
        raise InputError(f"{root}: cannot be written to: {error.strerror}", argument="out") from None
    alone = not shared
    with file:
        try:
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
            # A run that finished may have removed the file after it was opened here, and another may have made it anew.
            busy = not path.exists() or not os.path.samestat(os.fstat(file.fileno()), path.stat())
        except BlockingIOError:
            busy = True
        except OSError:  # a file system without locks
            alone = busy = False
        if busy:
            raise InputError(
                f"{root}: another run is making this dataset: wait for its end, stop it, or let each run make "
                "different shards",
                argument="out",
            )
        try:
            yield alone
        except OSError as error:
            error.filename = error.filename or str(root)
            raise
        finally:
            if (root / INDEX).exists():
                path.unlink(missing_ok=True)


def _remove_all_but_plan(root: UPath, plan: DatasetPlan) -> None:
    """Remove all files in a dataset's folders; records first, so that no shard seems complete."""
    top_names = plan.top_names
    names = [name for name in names_below(root) if name.split("/")[0] in top_names and name not in {PLAN, LOCK}]
    records = [name for name in names if name == INDEX or (name.startswith(SHARDS_FOLDER) and name.endswith(".json"))]
    others = sorted({*names}.difference(records))
    if is_local(root):
        for name in (*records, *others):
            (root / name).unlink()
        for top in top_names - {SHARDS_FOLDER}:
            shutil.rmtree(root / top, ignore_errors=True)  # only folders are left
    else:
        for part in filter(None, (records, others)):
            root.fs.rm([(root / name).path for name in part])
