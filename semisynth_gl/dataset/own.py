"""Which files in a folder are a dataset's: no others are replaced or removed, and no link leads a run out of there.

A folder is the program's where its index or plan says so. In such a folder, `own_names` and the names of unfinished
files (`semisynth_gl.dataset.schema`) are the dataset's, and all other files are somebody else's.
"""

import os
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from pathlib import PurePosixPath

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.dataset.begun import plan_document, plan_of
from semisynth_gl.dataset.documents import PlanDocument
from semisynth_gl.dataset.places import Folder, Place, entries_below
from semisynth_gl.dataset.plan import Plan
from semisynth_gl.dataset.schema import (
    CARD,
    CROISSANT,
    INDEX,
    LOCK,
    PARTIAL,
    PLAN,
    REPLACED,
    UNLOCKED,
    is_unfinished_file,
    log_path,
    record_path,
    tar_path,
    unfinished_path,
)
from semisynth_gl.inputs.errors import InputError, abbreviate


def own_names(plan: Plan) -> Iterator[str]:
    """Yield the names of all files that a dataset may have, the pairs' files last."""
    yield from (INDEX, CARD, CROISSANT, PLAN)
    for split in plan.splits:
        first = [plan.key(split, 0)]
        yield from (*plan.lists(first), *plan.links(first))
    for shard in plan.shards:
        yield from (record_path(shard.name), log_path(shard.name), tar_path(shard.name))
    if not plan.layout.packed:
        for split in plan.splits:
            for index in range(plan.pairs[split]):
                yield from plan.files(split, index).values()
                # Some layouts have a link for each pair.
                yield from plan.links([plan.key(split, index)])


def check_ways(place: Place, plan: Plan) -> None:
    """Refuse a folder in which a link would lead writes, renames or removals out of it.

    The folders of single pairs are looked at when their pairs are written. Anything else in the place of the dataset's
    folders and links is refused too.
    """
    if not isinstance(place, Folder):
        return
    place.own_path(LOCK, in_place=True)
    names = [PLAN, *(f"{name}/*" for name in plan.folders)]
    links: dict[str, str] = {}
    for split in plan.splits:
        first = [plan.key(split, 0)]
        names += plan.lists(first)
        names += [] if plan.layout.packed else plan.files(split, 0).values()
        links |= plan.links(first)
    for name in names:
        place.own_path(name)
    for name, target in links.items():
        path = place.own_path(name)
        if os.path.lexists(path) and not path.is_symlink():
            raise InputError(f"{place.address}: {name}: expected a link to {target}, got something else: remove it")


def foreign_names(place: Place) -> list[str]:
    """Return what others have put into a place without a plan.

    A run that is killed before it has written its plan leaves a lock, unfinished plans and empty folders there.
    """
    if not isinstance(place, Folder):
        return sorted({name.partition("/")[0] for name in place.names()})
    if not place.local.is_dir():
        return []
    plan = unfinished_path(PLAN, 0).removesuffix("0")
    foreign = []
    for top in sorted(place.local.iterdir()):
        if top.is_symlink() or not top.is_dir():
            foreign.append(top.name)
        elif top.name == PARTIAL:
            names = place.names(PARTIAL)
            ours = (name for name in names if (name == LOCK and not place.size(name)) or name.startswith(plan))
            foreign += sorted(set(names) - {name for name in ours if is_unfinished_file(name)})
        elif next(entries_below(top), None) is not None:
            foreign.append(top.name)
    return foreign


def own_files(place: Place, plan: Plan) -> list[str]:
    """Return the names of a dataset's files in its place; raises InputError where a file there is somebody else's."""
    files = place.names()
    foreign = {name for name in files if not is_unfinished_file(name)}
    for name in own_names(plan):
        # A dataset that was hardly begun need not be gone through to its end.
        if not foreign:
            break
        foreign.discard(name)
    if foreign:
        raise InputError(
            f"{place.address}: `overwrite` replaces only what this program wrote, but the folder holds "
            f"{abbreviate(sorted(foreign), 3)}. Choose another folder for `out`, or remove these yourself"
        )
    return files


def remove_dataset(place: Place, beginning: PlanDocument) -> None:
    """Remove an earlier dataset but for its plan, so that a run that is ended in between can be overwritten too.

    First of all the plan says that the dataset is being replaced: else a run with an equal plan would take the rest for
    its own work. Raises InputError as `own_files` does, before anything is removed.
    """
    plan = plan_of(beginning)
    names = own_files(place, plan)
    place.write(PLAN, JSON_OBJECT.encode(plan_document(plan, beginning.values) | {REPLACED: True}))
    for name in (INDEX, *names):
        if name not in (PLAN, LOCK):
            place.remove(name)
    if isinstance(place, Folder):
        # Of all files that there may have been: an earlier run may have removed them, and not their folders.
        remove_folders(place, plan)
        _remove_partial_folders(place)


def remove_folders(place: Folder, plan: Plan) -> None:
    """Remove the folders of a dataset's files in which nothing is left."""
    there = {folder for folder in place.folders() if folder.partition("/")[0] != PARTIAL}
    own: set[str] = set()
    for folder in chain(plan.folders, (str(PurePosixPath(name).parent) for name in own_names(plan))):
        if own == there:
            break
        own.update({folder, *map(str, PurePosixPath(folder).parents)} & there)
    place.remove_empty(own)


def remove_unfinished(place: Folder) -> None:
    """Remove the unfinished files that this program left, the lock last; files of others stay."""
    with suppress(OSError):
        for name in filter(is_unfinished_file, place.names(PARTIAL)):
            if name != LOCK:
                place.remove(name)
        place.remove(LOCK)
        _remove_partial_folders(place)


def _remove_partial_folders(place: Folder) -> None:
    unlocked = (path.name for path in place.path(PARTIAL).glob(f"{UNLOCKED}*"))
    place.remove_empty([PARTIAL, *(f"{PARTIAL}/{name}" for name in unlocked)])
