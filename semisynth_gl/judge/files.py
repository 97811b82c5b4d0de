"""Checks that all needed files are present and as recorded, and that no other file misleads a loader."""

import hashlib
import tarfile
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from io import BufferedReader
from pathlib import Path
from typing import Any, cast

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.config.model import digest_of
from semisynth_gl.dataset.documents import Record, Shard, StoredFile
from semisynth_gl.dataset.names import CARD, INDEX, LOCK, PLAN, log_path, record_path, tar_path
from semisynth_gl.dataset.reader import StoredIndex, read_members, read_record
from semisynth_gl.dataset.root import is_local, read_whole
from semisynth_gl.dataset.sample import StoredFrame, assemble_frame, decode_file, wrong_sizes
from semisynth_gl.inputs.errors import ReadError, counted
from semisynth_gl.judge.findings import Verdict

_ABOUT = frozenset({INDEX, PLAN, CARD})
_SHOWN = 20
# A pair that lacks one of these roles cannot be judged.
_NEEDED = frozenset({"left", "right", "disparity_left", "provenance"})


class StoredShard:
    """A shard as it is stored.

    Attributes:
        split: the split of the shard's pairs.
        numbers: the pairs' numbers in their split.
        fault: why the shard's record cannot be read; None where it can.
    """

    def __init__(self, index: StoredIndex, shard: Shard) -> None:
        self.split = shard.split
        self.numbers = range(shard.first, shard.end)
        self._shard = shard
        self._index = index
        self._record: Record | None = None
        self.fault: str | None = None
        self._samples: Mapping[int, Mapping[str, StoredFile]] = {}
        try:
            self._record = read_record(index.root, shard, packed=index.plan.layout.packed)
            self._samples = {sample.pair: sample.files for sample in self._record.samples}
        except ReadError as error:
            why = "the shard is not finished, or its record was changed"
            self.fault = f"{record_path(shard.name)} {error.reason}: {why}"

    def check(self, verdict: Verdict) -> None:
        """Compare the record with the index, and the tar's digest and list of members with the record."""
        record, made = self._record, self._index.made
        if record is None:
            verdict.add("shard", str(self.fault))
            return
        entry = record if made is None else made.shard_entries[self._shard.number]
        for key in ("bytes", "sha256"):
            ours, theirs = getattr(record, key), getattr(entry, key)
            if ours != theirs:
                verdict.add("shard", f"{self._shard.name}: {key} is {ours!r} in its record, {theirs!r} in the index")
        if record.tar is not None:
            self._check_tar(record, verdict)

    def _check_tar(self, record: Record, verdict: Verdict) -> None:
        name = tar_path(self._shard.name)
        try:
            with (self._index.root / name).open("rb") as file:
                digest = hashlib.file_digest(cast("BufferedReader", file), "sha256").hexdigest()
                file.seek(0)
                with tarfile.open(fileobj=file) as tar:
                    members = [(member.name, member.isreg(), member.offset_data, member.size) for member in tar]
        except FileNotFoundError:
            verdict.add("shard", f"{name} is missing")
            return
        except ReadError as error:
            verdict.add("shard", f"{name} {error.reason}")
            return
        except (OSError, tarfile.TarError, ValueError, OverflowError, RecursionError) as error:
            verdict.add("shard", f"{name} cannot be read as a tar: {error}")
            return
        if digest != record.sha256:
            verdict.add("shard", f"{name} has the sha256 {digest[:12]}, its record {record.sha256:.12}")
        expected = [
            (name, True, file.offset, file.bytes) for files in self._samples.values() for name, file in files.items()
        ]
        if members != expected:
            first = min((file for file, *_ in set(members) ^ set(expected)), default="their order")
            counts = f"{name} has {counted(len(members), 'file')}, its record lists {len(expected)}"
            verdict.add("shard", f"{counts}; the first difference is {first}")

    def listed(self, number: int) -> Mapping[str, StoredFile] | None:
        """Return a pair's files by name, as the record lists them; None where it has no such pair or is unreadable."""
        return self._samples.get(number)

    def read(self, number: int, name: str) -> bytes:
        """Read a file of pair ``number``; its name is relative to the dataset's folder, or a member of the tar.

        Raises:
            ReadError: where the file or, of a tar, its shard's record is missing or cannot be read.
        """
        root = self._index.root
        if not self._index.plan.layout.packed:
            try:
                return read_whole(root, name)
            except ReadError as error:
                raise ReadError(Path(name), error.reason) from None
        if self._record is None:
            raise ReadError(Path(name), f"cannot be read from its shard: {self.fault}")
        try:
            return read_members(root, self._shard, self._record, number, [name])[name]
        except ReadError as error:
            raise ReadError(Path(name), f"cannot be read from its shard: {error.path} {error.reason}") from None

    def check_digest(self, number: int, name: str, data: bytes, verdict: Verdict) -> None:
        """Compare a file's digest with the record; files in a tar have none, since the whole tar has one digest."""
        file = self._samples.get(number, {}).get(name)
        if file is None or file.sha256 is None:
            return
        digest = hashlib.sha256(data).hexdigest()
        if digest != file.sha256:
            verdict.add("sha256", f"{name} has {digest[:12]}, its shard's record {file.sha256:.12}")


def unmade_pairs(index: StoredIndex, shard: Shard, present: AbstractSet[str]) -> range:
    """Return the numbers of a shard's pairs that an unfinished dataset does not have yet.

    The range is empty for a finished dataset, and for a shard that has a record. ``present`` has the names of all of
    the dataset's files.
    """
    numbers = range(shard.first, shard.end)
    if index.fault is None or record_path(shard.name) in present:
        return numbers[:0]
    if index.plan.layout.packed:
        return numbers[:0] if tar_path(shard.name) in present else numbers
    made = [number for number in numbers if not present.isdisjoint(index.plan.files(shard.split, number).values())]
    # A worker makes the pairs of a shard in order, so the pairs after the last one with a file are not made yet.
    return range(made[-1] + 1 if made else shard.first, shard.end)


def check_index(index: StoredIndex, present: AbstractSet[str], unmade: int, verdict: Verdict) -> None:
    """Check that the index agrees with itself, and that the names of the dataset's files are as the index says.

    Args:
        index: the dataset's index.
        present: names of all files of the dataset.
        unmade: number of pairs that are not made yet.
        verdict: gets the findings.
    """
    if index.fault is not None:
        verdict.add("index", index.fault)
    if unmade:
        verdict.add("index", f"{unmade} of {counted(sum(index.plan.pairs.values()), 'pair')} not made yet")
    # The plan has the config without the keys that this version does not know.
    stored = PLAN if index.made is None else INDEX
    values = JSON_OBJECT.decode(read_whole(index.root, stored), Path(stored))
    digest, recorded = digest_of(values["config_values"]), index.plan.config_sha256
    if digest != recorded:
        verdict.add("index", f"config_values have the digest {digest[:12]}, config_sha256 is {recorded:.12}")
    lists, links = index.plan.lists, index.plan.links
    root = index.root
    # Loaders take any file that they find for a part of a pair.
    foreign = sorted(
        name
        for name in present - _ABOUT - lists.keys() - _shard_files(index) - index.plan.copies.keys()
        if name != LOCK and not (name in links and is_local(root) and (root / name).is_symlink())
    )
    for name in foreign[:_SHOWN]:
        verdict.add("files", f"{name} does not belong here: the index lists no such file")
    if len(foreign) > _SHOWN:
        verdict.add("files", f"{counted(len(foreign) - _SHOWN, 'more file')} that the index does not list")
    if index.fault is not None:
        return  # an unfinished dataset lacks the files that are written last
    for name in sorted(_ABOUT - present):
        verdict.add("files", f"{name} is missing")
    for name, expected in lists.items():
        _check_list(index, name, expected, verdict)


def _check_list(index: StoredIndex, name: str, expected: bytes, verdict: Verdict) -> None:
    try:
        data = read_whole(index.root, name)
    except ReadError as error:
        verdict.add("files", f"{name} {error.reason}")
        return
    if data != expected:
        lines, expected_lines = data.decode("utf-8", "replace").splitlines(), expected.decode().splitlines()
        missing = sorted(set(expected_lines) - set(lines))
        example = f"; it lacks {missing[0]}" if missing else ""
        counts = f"{counted(len(lines), 'line')}, not the {len(expected_lines)} of its layout"
        verdict.add("files", f"{name} has {counts}{example}")


def _shard_files(index: StoredIndex) -> set[str]:
    """Return the names of the files, records and logs of all shards."""
    names = [shard.name for shard in index.plan.shards]
    paths = {path(name) for name in names for path in (record_path, log_path)}
    if index.plan.layout.packed:
        return paths.union(map(tar_path, names))
    return paths.union(
        *(
            index.plan.files(split, number).values()
            for split, pairs in index.plan.pairs.items()
            for number in range(pairs)
        )
    )


def read_pair(index: StoredIndex, shard: StoredShard, number: int, verdict: Verdict) -> StoredFrame | None:
    """Read a pair's files, and compare their names and digests with the layout and with the shard's record.

    Faults of the files become findings. The result is None where the pair cannot be judged further.
    """
    if index.plan.layout.packed and shard.fault is not None:
        return None  # the shard has the finding
    expected = index.plan.files(shard.split, number)
    listed = shard.listed(number)
    if listed is not None:
        for name in sorted(set(expected.values()) - listed.keys()):
            verdict.add("files", f"{name} is not in the shard's record, but layout and outputs ask for it")
        for name in sorted(listed.keys() - set(expected.values())):
            verdict.add("files", f"{name} does not belong to the pair, but the shard's record lists it")
    values: dict[str, Any] = {}
    for role, name in expected.items():
        try:
            data = shard.read(number, name)
            shard.check_digest(number, name, data, verdict)
            values[role] = decode_file(index.plan.layout, role, data, Path(name), index.plan.encodings)
        except ReadError as error:
            verdict.add("files", f"{error.path} {error.reason}")
    if not values.keys() >= _NEEDED:
        return None
    for role, fault in wrong_sizes(values, index.plan.size):
        verdict.add("size", f"{expected[role]} {fault}")
    try:
        return assemble_frame(index.plan.key(shard.split, number), values, index.plan.encodings)
    except ReadError as error:
        verdict.add("files", f"{error.path} {error.reason}")
        return None


def is_of_one_size(frame: StoredFrame) -> bool:
    """Return whether all arrays of a pair have the size of its camera."""
    values = {**frame.arrays(), "provenance": {"lens": frame.provenance.get("lens")}}
    return not any(wrong_sizes(values, (frame.camera.height_px, frame.camera.width_px)))


def check_origin(frame: StoredFrame, index: StoredIndex, verdict: Verdict) -> None:
    """Compare a pair's provenance with the index, and with the pair's place in the dataset."""
    provenance, plan = frame.provenance, index.plan
    stated = {name: getattr(plan, name) for name in ("program", "version", "config_sha256", "seed")}
    for key, expected in ({"config": plan.name} | stated).items():
        if provenance.get(key) != expected:
            verdict.add("origin", f"{key} is {provenance.get(key)!r}, in the index {expected!r}")
    recorded = {group: names for group, names in index.plan.plugin_records.items() if group != "layouts"}
    if provenance.get("plugins", {}) != recorded:
        verdict.add("origin", f"plugins are {provenance.get('plugins', {})!r}, in the index {recorded!r}")
    place: dict[str, object] = {"pair": frame.index, "split": frame.split}
    if index.plan.views > 1:
        place["view"] = frame.index % index.plan.views
    for key, expected in place.items():
        if provenance.get(key) != expected:
            verdict.add("origin", f"{key} is {provenance.get(key)!r}, by the place of its files {expected!r}")
