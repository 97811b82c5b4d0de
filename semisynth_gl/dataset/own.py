"""Which files in a folder are a dataset's: a run replaces and removes only these, and follows no link.

A folder is the program's if its index or plan says so. In such a folder, files with the names of `own_names` or of
unfinished files (`semisynth_gl.dataset.schema`) are the dataset's. All other files are somebody else's.
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
    yield from (INDEX, CARD, PLAN)
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
    yield from plan.copies


def check_ways(place: Place, plan: Plan) -> None:
    """Check that no link would lead a run out of the dataset's folder when it writes, renames or removes files.

    Folders of single pairs are checked later, when their pairs are written.

    Raises:
        InputError: where a link stands in the place of a folder, or anything else in the place of a folder or link.
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
    """Return the names of files and folders that others have put into a place without a plan.

    A lock, unfinished plans and empty folders are not among them: a run that was killed before it wrote its plan may
    have left these.
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
    """Return the names of all files in a dataset's place; raises InputError where a file there is somebody else's."""
    files = place.names()
    foreign = {name for name in files if not is_unfinished_file(name)}
    for name in own_names(plan):
        # If few files of a large dataset exist, this saves listing the other names.
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
    """Remove an earlier dataset except for its plan, so that `overwrite` still works if this run is ended midway.

    The plan is first marked with `REPLACED`: otherwise a run with an equal plan would take the remaining files for its
    own. Raises InputError as `own_files` does, before anything is removed.
    """
    plan = plan_of(beginning)
    names = own_files(place, plan)
    place.write(PLAN, JSON_OBJECT.encode(plan_document(plan, beginning.values) | {REPLACED: True}))
    for name in (INDEX, *names):
        if name not in (PLAN, LOCK):
            place.remove(name)
    if isinstance(place, Folder):
        # The folders of all files of the plan: an earlier run may have removed files, but not their folders.
        remove_folders(place, plan)
        _remove_partial_folders(place)


def remove_folders(place: Folder, plan: Plan) -> None:
    """Remove the folders of a dataset's files that are empty."""
    there = {folder for folder in place.folders() if folder.partition("/")[0] != PARTIAL}
    own: set[str] = set()
    for folder in chain(plan.folders, (str(PurePosixPath(name).parent) for name in own_names(plan))):
        if own == there:
            break
        own.update({folder, *map(str, PurePosixPath(folder).parents)} & there)
    place.remove_empty(own)


def remove_unfinished(place: Folder) -> None:
    """Remove the unfinished files of this program, the lock last; other people's files stay."""
    with suppress(OSError):
        for name in filter(is_unfinished_file, place.names(PARTIAL)):
            if name != LOCK:
                place.remove(name)
        place.remove(LOCK)
        _remove_partial_folders(place)


def _remove_partial_folders(place: Folder) -> None:
    unlocked = (path.name for path in place.path(PARTIAL).glob(f"{UNLOCKED}*"))
    place.remove_empty([PARTIAL, *(f"{PARTIAL}/{name}" for name in unlocked)])
