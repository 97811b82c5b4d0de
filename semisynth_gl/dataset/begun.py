"""What is there of a dataset that a run has begun: its plan, and the records of its complete shards."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.config import Config
from semisynth_gl.dataset.contents import Shard
from semisynth_gl.dataset.documents import (
    CHANGED_INDEX,
    PlanDocument,
    RecordDocument,
    parse_document,
    parse_index,
    parse_record,
)
from semisynth_gl.dataset.places import Place
from semisynth_gl.dataset.plan import Plan
from semisynth_gl.dataset.schema import INDEX, PLAN, PROGRAM, record_path
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.plugins import MissingPluginError, require_plugins


def read_beginning(place: Place) -> PlanDocument | None:
    """Return what a dataset was begun as, from its index, else from its plan; None without either.

    A file that is cut off counts as missing: a run writes it again.

    Raises:
        ReadError: where the index or plan has values that no dataset has.
    """
    for name in (INDEX, PLAN):
        values = read_object(place, name)
        if values is not None and values.get("program") == PROGRAM:
            path = place.path(name)
            try:
                return parse_index(values, path) if name == INDEX else parse_document(values, PlanDocument, path)
            except ReadError as error:
                advice = CHANGED_INDEX if name == INDEX else "choose another folder for `out`, or bring the file back"
                raise ReadError(error.path, f"{error.reason}: {advice}") from None
    return None


def read_resumed(place: Place) -> PlanDocument | None:
    """Return the plan that a run resumes; None where there is no dataset.

    Raises:
        ReadError: see `read_beginning`.
        MissingPluginError: where a plug-in that the dataset is made with is not installed.
    """
    beginning = read_beginning(place)
    if beginning is not None:
        try:
            require_plugins(beginning.plugin_records)
        except MissingPluginError as error:
            raise MissingPluginError(f"{place.address}: {error}") from None
    return beginning


def complete_record(place: Place, shard: Shard) -> RecordDocument | None:
    """Return a shard's record, or None where the shard must be made again.

    It must be where the record is missing, cut off or another shard's, or a file is missing or has another size.

    Raises:
        ReadError: where a link, a folder or the like stands in the place of a file.
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
    """Return the plan of a dataset that was begun.

    Raises:
        InputError: where this version does not understand the config.
    """
    try:
        config = Config.model_validate(document.config_values.values)
    except ValidationError as error:
        raise InputError(f"the dataset's plan is not this version's: {str(error).splitlines()[0]}") from None
    contents = document.contents
    described = config, contents.layout_name, contents.pairs, contents.shard_pairs, config.views
    return Plan(*described, document.seed, document.plugin_records)


def read_object(place: Place, name: str) -> dict[str, Any] | None:
    """Return the object in a JSON file; None where the file is missing, cut off or something else."""
    try:
        data = place.read(name)
    except (FileNotFoundError, NotADirectoryError):
        return None
    with suppress(ReadError):
        return JSON_OBJECT.decode(data, Path(name))
    return None
