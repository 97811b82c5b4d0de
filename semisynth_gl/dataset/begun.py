"""What is there of a dataset that a run has begun: its plan, and the records of its complete shards."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.config import Config
from semisynth_gl.dataset.documents import CHANGED_INDEX, check_index, check_plan, check_record
from semisynth_gl.dataset.places import Place
from semisynth_gl.dataset.plan import Plan, Shard
from semisynth_gl.dataset.schema import INDEX, PLAN, PROGRAM, record_path
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.plugins import MissingPluginError, require_plugins


def read_beginning(place: Place) -> dict[str, Any] | None:
    """Return the values that a dataset was begun with, from its index, else from its plan; None without either.

    A file that is cut off counts as missing: a run writes it again.

    Raises:
        ReadError: where the index or plan has values that no dataset has.
    """
    for name, check in ((INDEX, check_index), (PLAN, check_plan)):
        values = read_object(place, name)
        if values is not None and values.get("program") == PROGRAM:
            try:
                check(values, place.path(name))
            except ReadError as error:
                advice = CHANGED_INDEX if name == INDEX else "choose another folder with --out, or bring the file back"
                raise ReadError(error.path, f"{error.reason}: {advice}") from None
            return values
    return None


def read_resumed(place: Place) -> dict[str, Any]:
    """Return the values that the dataset was begun with that a run is to go on with; none where there is no dataset.

    Raises:
        ReadError: see `read_beginning`.
        MissingPluginError: where a plug-in that the dataset is made with is not installed.
    """
    values = read_beginning(place) or {}
    try:
        require_plugins(values.get("plugins", {}))
    except MissingPluginError as error:
        raise MissingPluginError(f"{place.address}: {error}") from None
    return values


def complete_record(place: Place, shard: Shard) -> dict[str, Any] | None:
    """Return a shard's record, or None where the shard is to be made again.

    That is where the record is missing, cut off, or not this shard's, and where a file is missing or has another size.

    Raises:
        ReadError: where a link, a folder or the like stands in the place of a file.
    """
    record = read_object(place, record_path(shard.name))
    if record is None:
        return None
    try:
        check_record(record, shard, place.path(record_path(shard.name)), packed="tar" in record)
    except ReadError:
        return None
    sizes = (
        {record["tar"]: record["bytes"]}
        if "tar" in record
        else {name: file["bytes"] for sample in record["samples"] for name, file in sample["files"].items()}
    )
    return record if all(place.size(name) == size for name, size in sizes.items()) else None


def plan_from_values(values: Mapping[str, Any]) -> Plan:
    """Return the plan of a dataset from the values of its index or plan file.

    Raises:
        InputError: where this version does not understand the config.
    """
    try:
        config = Config.model_validate(values["config_values"])
        numbers = int(values["seed"]), int(values["shard_pairs"])
        return Plan(config, numbers[0], values["layout"], dict(values["pairs"]), numbers[1], values.get("plugins", {}))
    except (ValidationError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"the dataset's plan is not this version's: {str(error).splitlines()[0]}") from None


def read_object(place: Place, name: str) -> dict[str, Any] | None:
    """Return the object in a JSON file; None where the file is missing, cut off or none."""
    try:
        data = place.read(name)
    except (FileNotFoundError, NotADirectoryError):
        return None
    with suppress(ReadError):
        return JSON_OBJECT.decode(data, Path(name))
    return None
