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
from semisynth_gl.dataset.schema import CARD, INDEX, PLAN, PROGRAM, record_path
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.plugins import MissingPluginError, require_plugins


def read_beginning(place: Place) -> PlanDocument | None:
    """Return a dataset's index, or else its plan; None where the place has neither.

    A file that is cut off, or of another program, counts as missing.

    Raises:
        ReadError: where a file has values that no dataset has; the message has advice.
        NewerFormatError: where a newer program wrote the dataset.
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
    """Return the document that `read_beginning` returns; raises MissingPluginError where a plug-in is not installed."""
    beginning = read_beginning(place)
    if beginning is not None:
        try:
            require_plugins(beginning.plugin_records)
        except MissingPluginError as error:
            raise MissingPluginError(f"{place.address}: {error}") from None
    return beginning


def complete_record(place: Place, shard: Shard) -> RecordDocument | None:
    """Return a shard's record, or None where the shard must be made again.

    A record counts only if it is not cut off, is this shard's, and all its files are there with the sizes that it says.
    Raises ReadError where a link or a folder stands in the place of a file.
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
    """Return the plan in an index or a plan.json; raises InputError where this version does not know its config."""
    try:
        config = Config.model_validate(document.config_values.values)
    except ValidationError as error:
        raise InputError(f"the dataset's plan is not this version's: {str(error).splitlines()[0]}") from None
    contents = document.contents
    described = config, contents.layout_name, contents.pairs, contents.shard_pairs, config.views
    return Plan(*described, document.seed, document.plugin_records)


def plan_document(plan: Plan, beginning: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of plan.json for a dataset whose index or plan.json has the values ``beginning``."""
    return {key: beginning[key] for key in (*plan.values(), "sources") if key in beginning}


def lost_files(place: Place, plan: Plan) -> list[str]:
    """Return the names of files, links and folders about the whole dataset that are missing or differ from the plan's.

    A card with other contents is not lost, since users add to it. A real folder instead of a link is fine: ``cp -rL``
    makes one. Raises ReadError where a link or a folder stands in the place of a file.
    """
    index = read_object(place, INDEX)
    if index is None:
        return [INDEX]
    lost = [PLAN] if read_object(place, PLAN) != plan_document(plan, index) else []
    lost += [CARD] if place.size(CARD) is None else []
    lost += [name for name, data in plan.all_lists.items() if place.size(name) is None or place.read(name) != data]
    if place.local is not None:
        for name, target in plan.all_links.items():
            path = place.path(name)
            if not os.path.lexists(path) or (path.is_symlink() and os.readlink(path) != target):  # noqa: PTH115
                lost.append(name)
        lost += [name for name in plan.folders if not place.path(name).is_dir()]
    return lost


def read_object(place: Place, name: str) -> dict[str, Any] | None:
    """Return the object in a JSON file; None where the file is missing, cut off or no JSON object."""
    try:
        data = place.read(name)
    except (FileNotFoundError, NotADirectoryError):
        return None
    with suppress(ReadError):
        return JSON_OBJECT.decode(data, Path(name))
    return None
