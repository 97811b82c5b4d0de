"""The files about a whole dataset, beside its shards: which there are, and which of them a finished dataset lacks."""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from semisynth_gl.dataset.begun import read_object
from semisynth_gl.dataset.places import Place
from semisynth_gl.dataset.plan import Plan
from semisynth_gl.dataset.schema import CARD, CROISSANT, INDEX, LOCK, PLAN, log_path, record_path, tar_path
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.layouts import Key
from semisynth_gl.seeds.splits import SplitName

_SOURCES = "sources"


def lists_of(plan: Plan) -> dict[str, bytes]:
    """Return the contents of the layout's lists of pairs, by name."""
    return {name: data for split in plan.splits for name, data in _lists(plan, split, plan.keys(split)).items()}


def links_of(plan: Plan) -> dict[str, str]:
    """Return the targets of the layout's links, relative to each link's folder, by name."""
    return {name: target for split in plan.splits for name, target in _links(plan, split, plan.keys(split)).items()}


def folders_of(plan: Plan) -> list[str]:
    """Return the folders that loaders list though they may be empty."""
    return [f"{plan.folder(split)}{path}" for split in plan.splits for path in plan.layout.folders()]


def plan_document(plan: Plan, beginning: Mapping[str, Any]) -> dict[str, Any]:
    """Return what plan.json says of a dataset that was begun, in JSON's types.

    Args:
        plan: the plan of the dataset.
        beginning: its index, or its plan.json.
    """
    return {key: beginning[key] for key in (*plan.values(), _SOURCES) if key in beginning}


def lost_files(place: Place, plan: Plan) -> list[str]:
    """Return which files, links and folders about the whole dataset are missing, cut off, or not its plan's.

    A card or a Croissant file with other contents is not lost: users add to them. Nor is a folder in the place of
    a link, as a copy without links has it.

    Raises:
        ReadError: where a link, a folder or the like stands in the place of a file.
    """
    index = read_object(place, INDEX)
    if index is None:
        return [INDEX]
    lost = [PLAN] if read_object(place, PLAN) != plan_document(plan, index) else []
    lost += [name for name in (CARD, CROISSANT) if place.size(name) is None]
    lost += [name for name, data in lists_of(plan).items() if place.size(name) is None or place.read(name) != data]
    if place.local is not None:
        links = ((name, place.path(name), target) for name, target in links_of(plan).items())
        lost += [
            name
            for name, path, target in links
            if not os.path.lexists(path) or (path.is_symlink() and os.readlink(path) != target)  # noqa: PTH115
        ]
        lost += [name for name in folders_of(plan) if not place.path(name).is_dir()]
    return lost


def check_ways(place: Place, plan: Plan) -> None:
    """Refuse a folder in which a link would lead writes, renames or removals out of it.

    The folders of single pairs are looked at when their pairs are written.

    Raises:
        InputError: with the link, or what else stands where the dataset has a folder.
    """
    if place.local is None:
        return
    place.own_path(LOCK, in_place=True)
    names = [PLAN, *(f"{name}/*" for name in folders_of(plan))]
    for split in plan.splits:
        names += _lists(plan, split, [plan.key(split, 0)])
        names += [] if plan.layout.packed else plan.files(split, 0).values()
    for name in names:
        place.own_path(name)
    for split in plan.splits:
        for name, target in _links(plan, split, [plan.key(split, 0)]).items():
            path = place.own_path(name)
            if os.path.lexists(path) and not path.is_symlink():
                raise InputError(f"{place.address}: {name}: expected a link to {target}, got something else: remove it")


def own_names(plan: Plan) -> Iterator[str]:
    """Yield the names of all files that a dataset may have, the pairs' files last."""
    yield from (INDEX, CARD, CROISSANT, PLAN)
    for split in plan.splits:
        first = [plan.key(split, 0)]
        yield from (*_lists(plan, split, first), *_links(plan, split, first))
    for shard in plan.shards:
        yield from (record_path(shard.name), log_path(shard.name), tar_path(shard.name))
    if not plan.layout.packed:
        for split in plan.splits:
            for index in range(plan.pairs[split]):
                yield from plan.files(split, index).values()
                # Some layouts have a link for each pair.
                yield from _links(plan, split, [plan.key(split, index)])


def own_folders(plan: Plan) -> Iterator[str]:
    """Yield the folders that a dataset may have, some more than once."""
    yield from folders_of(plan)
    yield from (str(PurePosixPath(name).parent) for name in own_names(plan))


def _lists(plan: Plan, split: SplitName, keys: Sequence[Key]) -> dict[str, bytes]:
    lists = plan.layout.lists(keys, plan.encodings)
    return {f"{plan.folder(split)}{path}": data for path, data in lists.items()}


def _links(plan: Plan, split: SplitName, keys: Sequence[Key]) -> dict[str, str]:
    return {f"{plan.folder(split)}{path}": target for path, target in plan.layout.links(keys).items()}
