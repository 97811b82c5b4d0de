"""A dataset that a run has begun: its plan, the records of its complete shards, and the files that it lacks."""

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.config import Config
from semisynth_gl.dataset.contents import Shard
from semisynth_gl.dataset.documents import CHANGED_INDEX, PlanDocument, RecordDocument, parse_beginning, parse_record
from semisynth_gl.dataset.places import Place
from semisynth_gl.dataset.plan import Plan
from semisynth_gl.dataset.schema import CARD, CROISSANT, INDEX, PLAN, PROGRAM, record_path
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.plugins import MissingPluginError, require_plugins


def read_beginning(place: Place) -> PlanDocument | None:
    """Return what a dataset was begun as, from its index, else from its plan; None without either.

    A file that is cut off counts as missing: a run writes it again. Values that no dataset has raise ReadError.
    """
    for name in (INDEX, PLAN):
        values = read_object(place, name)
        if values is not None and values.get("program") == PROGRAM:
            try:
                return parse_beginning(values, name, place.path(name))
            except ReadError as error:
                advice = CHANGED_INDEX if name == INDEX else "choose another folder for `out`, or bring the file back"
                raise ReadError(error.path, f"{error.reason}: {advice}") from None
    return None


def read_resumed(place: Place) -> PlanDocument | None:
    """Return the plan that a run resumes, as `read_beginning` does; raises MissingPluginError for a missing plug-in."""
    beginning = read_beginning(place)
    if beginning is not None:
        try:
            require_plugins(beginning.plugin_records)
        except MissingPluginError as error:
            raise MissingPluginError(f"{place.address}: {error}") from None
    return beginning


def complete_record(place: Place, shard: Shard) -> RecordDocument | None:
    """Return a shard's record, or None where the shard must be made again.

    A record counts only if it is whole and this shard's, and all files are there in the sizes that it says. A link or a
    folder in the place of a file raises ReadError.
    """
    name = record_path(shard.name)
    values = read_object(place, name)
    if values is None:
        return None
    try:
        record = parse_record(values, shard, place.path(name), packed="tar" in values)
    except ReadError:
        return None
    return record if all(place.size(name) == size for name, size in record.sizes.items()) else None


def plan_of(document: PlanDocument) -> Plan:
    """Return the plan of a dataset that was begun; raises InputError where this version does not know the config."""
    try:
        config = Config.model_validate(document.config_values.values)
    except ValidationError as error:
        raise InputError(f"the dataset's plan is not this version's: {str(error).splitlines()[0]}") from None
    contents = document.contents
    described = config, contents.layout_name, contents.pairs, contents.shard_pairs, config.views
    return Plan(*described, document.seed, document.plugin_records)


def plan_document(plan: Plan, beginning: Mapping[str, Any]) -> dict[str, Any]:
    """Return what plan.json says of a dataset that began with an index or a plan.json of these values."""
    return {key: beginning[key] for key in (*plan.values(), "sources") if key in beginning}


def lost_files(place: Place, plan: Plan) -> list[str]:
    """Return which files, links and folders about the whole dataset are missing, cut off, or not its plan's.

    A card or a Croissant file with other contents is not lost: users add to them. Nor is a folder in the place of
    a link, as a copy without links has it. A link or a folder in the place of a file raises ReadError.
    """
    index = read_object(place, INDEX)
    if index is None:
        return [INDEX]
    lost = [PLAN] if read_object(place, PLAN) != plan_document(plan, index) else []
    lost += [name for name in (CARD, CROISSANT) if place.size(name) is None]
    lost += [name for name, data in plan.all_lists.items() if place.size(name) is None or place.read(name) != data]
    if place.local is not None:
        for name, target in plan.all_links.items():
            path = place.path(name)
            if not os.path.lexists(path) or (path.is_symlink() and os.readlink(path) != target):  # noqa: PTH115
                lost.append(name)
        lost += [name for name in plan.folders if not place.path(name).is_dir()]
    return lost


def read_object(place: Place, name: str) -> dict[str, Any] | None:
    """Return the object in a JSON file; None where the file is missing, cut off or something else."""
    try:
        data = place.read(name)
    except (FileNotFoundError, NotADirectoryError):
        return None
    with suppress(ReadError):
        return JSON_OBJECT.decode(data, Path(name))
    return None
