"""Checks that a dataset has all files that its index and its shards' records list, unchanged, and no others."""

import hashlib
from io import BufferedReader
from pathlib import Path
from typing import Any, cast

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.config.model import digest_of
from semisynth_gl.dataset.documents import CARD, INDEX, LOCK, PLAN, Shard, ShardEntry, ShardRecord
from semisynth_gl.dataset.pair_files import StoredFrame, assemble_frame, decode_file, wrong_sizes
from semisynth_gl.dataset.reader import StoredIndex, read_members, read_record
from semisynth_gl.dataset.root import is_local, names_below, read_whole
from semisynth_gl.inputs.errors import ReadError, counted
from semisynth_gl.judge.findings import CheckResults
from semisynth_gl.layouts.roles import NEEDED_ROLES

_DOCUMENTS = frozenset({INDEX, PLAN, CARD})


def check_index(index: StoredIndex, results: CheckResults) -> None:
    """Check the index's digest of the config, that documents and the layout's lists exist, and that no file is foreign.

    A foreign file is one that the index does not list.
    """
    plan, root, present = index.plan, index.root, frozenset(names_below(index.root))
    # Compute the digest from the file: the parsed config lacks keys that this version does not know.
    digest = digest_of(JSON_OBJECT.decode(read_whole(root, INDEX), Path(INDEX))["config_values"])
    if digest != plan.config_sha256:
        results.add("index", f"config_values have the digest {digest[:12]}, config_sha256 is {plan.config_sha256:.12}")
    shards = {path for shard in plan.shards for path in (shard.record, shard.log)}
    if plan.layout.packed:
        shards |= {shard.tar for shard in plan.shards}
    else:
        pairs = ((split, number) for split, count in plan.pairs.items() for number in range(count))
        shards = shards.union(*(plan.files(*pair).values() for pair in pairs))
    links = {name for name in plan.links if is_local(root) and (root / name).is_symlink()}
    if foreign := sorted(present - (_DOCUMENTS | {LOCK} | plan.lists.keys() | shards | links)):
        files = counted(len(foreign), "file")
        results.add("foreign", f"{files} that the index does not list, but loaders may read, such as {foreign[0]}")
    for name in sorted(_DOCUMENTS - present):
        results.add("files", f"{name} is missing")
    for name, expected in plan.lists.items():
        try:
            if read_whole(root, name) != expected:
                results.add("files", f"{name} differs from the layout's list of the dataset's pairs")
        except ReadError as error:
            results.add("files", f"{name} {error.reason}")


def check_shard(index: StoredIndex, shard: Shard, entry: ShardEntry, results: CheckResults) -> ShardRecord | None:
    """Compare a shard's record with its entry in the index, and its tar with the record.

    Returns the record, or None if it cannot be read.
    """
    try:
        record = read_record(index.root, shard, packed=index.plan.layout.packed)
    except ReadError as error:
        results.add("shard", f"{shard.record} {error.reason}")
        return None
    for key in ("bytes", "sha256"):
        recorded, indexed = getattr(record, key), getattr(entry, key)
        if recorded != indexed:
            results.add("shard", f"{shard.name}: {key} is {recorded!r} in its record, {indexed!r} in the index")
    if record.tar is not None:
        try:
            with (index.root / shard.tar).open("rb") as file:
                digest = hashlib.file_digest(cast("BufferedReader", file), "sha256").hexdigest()
        except OSError as error:
            results.add("shard", f"{shard.tar} cannot be read: {error}")
        else:
            if digest != record.sha256:
                results.add("shard", f"{shard.tar} has the SHA-256 {digest[:12]}, in its record {record.sha256:.12}")
    return record


def read_pair(
    index: StoredIndex, shard: Shard, record: ShardRecord | None, number: int, results: CheckResults
) -> StoredFrame | None:
    """Read a pair's files; compare their names and digests with the record, and sizes and provenance with the index.

    Faults become findings. Returns None if they prevent further checks of the pair.
    """
    plan = index.plan
    if plan.layout.packed and record is None:
        return None  # `check_shard` has added a finding
    values = _read_files(index, shard, record, number, results)
    if not values.keys() >= NEEDED_ROLES:
        return None
    _check_origin(values["provenance"], index, shard, number, results)
    wrong = list(wrong_sizes(values, plan.size))
    for role, fault in wrong:
        results.add("size", f"{plan.files(shard.split, number)[role]} {fault}")
    if wrong:
        return None
    try:
        return assemble_frame(plan.key(shard.split, number), values, plan.encodings)
    except ReadError as error:
        results.add("files", f"{error.path} {error.reason}")
        return None


def _read_files(
    index: StoredIndex, shard: Shard, record: ShardRecord | None, number: int, results: CheckResults
) -> dict[str, Any]:
    """Return the content of a pair's readable files by role."""
    plan, values = index.plan, dict[str, Any]()
    expected = plan.files(shard.split, number)
    listed = {} if record is None else record.samples[number - shard.first].files
    if record is not None:
        for name in sorted(set(expected.values()) ^ listed.keys()):
            fault = "is in the record, but not in the layout" if name in listed else "is not in the shard's record"
            results.add("files", f"{name} {fault}")
    for role, name in expected.items():
        try:
            if plan.layout.packed and record is not None:
                data = read_members(index.root, shard, record, number, [name])[name]
            else:
                data = read_whole(index.root, name)
            # Records have no digests of files in a tar, only that of the tar.
            recorded, digest = listed[name].sha256 if name in listed else None, hashlib.sha256(data).hexdigest()
            if recorded not in (None, digest):
                results.add("sha256", f"{name} has the SHA-256 {digest[:12]}, in its shard's record {recorded:.12}")
            values[role] = decode_file(plan.layout, role, data, Path(name), plan.encodings)
        except ReadError as error:
            results.add("files", f"{name} {error.reason}")
    return values


def _check_origin(
    provenance: dict[str, Any], index: StoredIndex, shard: Shard, number: int, results: CheckResults
) -> None:
    """Compare a pair's provenance with the index, and with the pair's split and number."""
    plan = index.plan
    expected: dict[str, Any] = {name: getattr(plan, name) for name in ("program", "version", "config_sha256", "seed")}
    expected |= {"config": plan.name, "pair": number, "split": shard.split}
    expected["plugins"] = {group: names for group, names in plan.plugins.items() if group != "layouts"}
    if plan.views > 1:
        expected["view"] = number % plan.views
    for key, value in expected.items():
        found = provenance.get(key, {} if key == "plugins" else None)
        if found != value:
            results.add("origin", f"{key} is {found!r}, expected {value!r}")
