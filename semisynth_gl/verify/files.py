"""Files: each file that a loader or the dataset needs is present and as recorded, and no file misleads a loader."""

import hashlib
import json
import tarfile
from collections.abc import Iterator, Mapping
from contextlib import closing
from io import BufferedReader
from pathlib import Path
from typing import Any, BinaryIO, cast

from semisynth_gl.camera import EYES
from semisynth_gl.dataset.reader import Index, read_record
from semisynth_gl.dataset.sample import StoredFrame, assemble_frame, decode_file
from semisynth_gl.dataset.schema import CARD, CROISSANT, INDEX, PARTIAL, PLAN, record_path, tar_path
from semisynth_gl.errors import InputError, ReadError
from semisynth_gl.splits import SplitName
from semisynth_gl.verify.verdict import Verdict

_ABOUT = frozenset({INDEX, PLAN, CARD, CROISSANT})
_SHOWN = 20
# Without these roles a pair cannot be judged.
_NEEDED = frozenset({"left", "right", "disparity_left", "provenance"})


class StoredShard:
    """One shard as it is stored.

    Args:
        index: the dataset.
        split: the split of its pairs.
        name: the shard's name.
        numbers: the numbers of its pairs in the split.

    Attributes:
        split: as given.
        numbers: as given.
        fault: why the shard's record could not be read, or None.
    """

    def __init__(self, index: Index, split: SplitName, name: str, numbers: range) -> None:
        self.split = split
        self._name = name
        self.numbers = numbers
        self._index = index
        self._record: Mapping[str, Any] = {}
        self.fault: str | None = None
        self._samples: Mapping[int, Mapping[str, Any]] = {}
        try:
            self._record = read_record(index.place, name)
            self._samples = {sample.get("pair"): sample["files"] for sample in self._record["samples"]}
        except ReadError as error:
            self.fault = f"{record_path(name)} {error.reason}: the shard is not finished"
        self._tar: BinaryIO | None = None

    def close(self) -> None:
        """Close the tar."""
        if self._tar is not None:
            self._tar.close()

    def check(self, verdict: Verdict) -> None:
        """Check the record against the index, and the tar's digest and list of members against the record."""
        if self.fault is not None:
            verdict.add("shard", self.fault)
            return
        record = self._record
        listed = {
            entry.get("shard"): entry for entry in self._index.values.get("shards", ()) if isinstance(entry, dict)
        }
        entry = listed.get(self._name)
        if entry is not None:
            for key in ("bytes", "sha256", "first", "end"):
                if entry.get(key) != record.get(key):
                    verdict.add(
                        "shard",
                        f"{self._name}: {key} is {record.get(key)!r} in its record, {entry.get(key)!r} in the index",
                    )
        elif self._index.fault is None:
            verdict.add("shard", f"{self._name} is not in the index")
        if list(self._samples) != list(self.numbers):
            verdict.add(
                "shard",
                f"{self._name}: expected the pairs {self.numbers.start} to {self.numbers.stop - 1}, its record lists "
                f"{len(self._samples)}",
            )
        if "tar" in record:
            self._check_tar(verdict)

    def _check_tar(self, verdict: Verdict) -> None:
        place, name = self._index.place, str(self._record["tar"])
        try:
            with place.open(name) as file:
                digest = hashlib.file_digest(cast("BufferedReader", file), "sha256").hexdigest()
                file.seek(0)
                with tarfile.open(fileobj=file) as tar:
                    members = [member.name for member in tar]
        except FileNotFoundError:
            verdict.add("shard", f"{name} is missing")
            return
        except (OSError, tarfile.TarError) as error:
            verdict.add("shard", f"{name} cannot be read as a tar: {error}")
            return
        if digest != self._record.get("sha256"):
            verdict.add("shard", f"{name} has the sha256 {digest[:12]}, its record {self._record.get('sha256')!s:.12}")
        expected = [file for files in self._samples.values() for file in files]
        if members != expected:
            first = min(set(members) ^ set(expected), default="their order")
            counts = f"{name} has {len(members)} files, its record lists {len(expected)}"
            verdict.add("shard", f"{counts}; the first difference is {first}")

    def listed(self, number: int) -> set[str] | None:
        """Return the names of a pair's files in the record; None without a record."""
        files = self._samples.get(number)
        return None if files is None else set(files)

    def read(self, number: int, name: str) -> bytes:
        """Read a pair's file.

        Args:
            number: the pair's number in its split.
            name: the file's, below the dataset's folder or inside the tar.

        Raises:
            ReadError: where the file is missing or cut off.
        """
        if self._index.layout.packed:
            return self._member(number, name)
        try:
            return self._index.place.read(name)
        except (FileNotFoundError, NotADirectoryError):
            raise ReadError(Path(name), "is missing") from None
        except OSError as error:
            raise ReadError(Path(name), f"cannot be read: {error.strerror}") from None

    def check_digest(self, number: int, name: str, data: bytes, verdict: Verdict) -> None:
        """Compare the digest of a file outside tars with the record; a tar has one digest for all its files."""
        file = self._samples.get(number, {}).get(name)
        if file is None or "sha256" not in file:
            return
        digest = hashlib.sha256(data).hexdigest()
        if digest != file["sha256"]:
            verdict.add("sha256", f"{name} has {digest[:12]}, its shard's record {file['sha256']!s:.12}")

    def _member(self, number: int, name: str) -> bytes:
        file = self._samples.get(number, {}).get(name)
        if file is None:
            raise ReadError(Path(name), "is missing")
        try:
            if self._tar is None:
                self._tar = self._index.place.open(str(self._record["tar"]))
            self._tar.seek(int(file["offset"]))
            data = self._tar.read(int(file["bytes"]))
        except FileNotFoundError:
            raise ReadError(Path(name), f"is missing, with its shard {self._name}") from None
        except (KeyError, TypeError, ValueError, OSError) as error:
            raise ReadError(Path(name), f"cannot be read from its shard {self._name}: {error!r}") from None
        if len(data) < file["bytes"]:
            raise ReadError(Path(name), f"is cut off by the end of its shard {self._name}")
        return data


def open_shards(index: Index) -> Iterator[StoredShard]:
    """Open all shards that a dataset should have, one after the other; a shard is open until the next one.

    Raises:
        InputError: where the index does not say how many pairs a shard has.
    """
    shard_pairs = index.values.get("shard_pairs")
    if not isinstance(shard_pairs, int) or shard_pairs < 1:
        raise InputError(f"{index.place.address}: the index has no shard_pairs, so its shards are not known")
    for shard in index.shards:
        with closing(StoredShard(index, shard.split, shard.name, range(shard.first, shard.end))) as stored:
            yield stored


def check_index(index: Index, verdict: Verdict) -> None:
    """Check the index against itself, and the files in the dataset's folder against the index."""
    if index.fault is not None:
        verdict.add("index", f"{index.fault}: the dataset is not finished; run its generate command again")
    if not index.pairs:
        verdict.add("index", f"{INDEX} lists no pair")
    values = json.dumps(index.config, sort_keys=True, separators=(",", ":"))
    digest, recorded = hashlib.sha256(values.encode()).hexdigest(), index.values.get("config_sha256")
    if digest != recorded:
        verdict.add("index", f"config_values have the digest {digest[:12]}, config_sha256 is {recorded!s:.12}")
    present = set(index.place.names())
    lists, links = _lists_and_links(index)
    # Loaders take whatever files they meet for a pair.
    foreign = sorted(
        name
        for name in present - _ABOUT - lists.keys() - _shard_files(index)
        if not name.startswith(f"{PARTIAL}/") and not (name in links and _is_link(index, name))
    )
    for name in foreign[:_SHOWN]:
        verdict.add("files", f"{name} does not belong here: the index lists no such file")
    if len(foreign) > _SHOWN:
        verdict.add("files", f"{len(foreign) - _SHOWN} more files do not belong here")
    if index.fault is not None:
        return  # the remaining files are written last
    for name in sorted(_ABOUT - present):
        verdict.add("files", f"{name} is missing")
    for name, expected in lists.items():
        _check_list(index, name, expected, verdict)


def _check_list(index: Index, name: str, expected: bytes, verdict: Verdict) -> None:
    try:
        data = index.place.read(name)
    except FileNotFoundError:
        verdict.add("files", f"{name} is missing")
        return
    if data != expected:
        lines, expected_lines = data.decode("utf-8", "replace").splitlines(), expected.decode().splitlines()
        missing = sorted(set(expected_lines) - set(lines))
        example = f"; it lacks {missing[0]}" if missing else ""
        verdict.add("files", f"{name} has {len(lines)} lines, not the {len(expected_lines)} of its layout{example}")


def _lists_and_links(index: Index) -> tuple[dict[str, bytes], set[str]]:
    """Return the layout's lists of pairs with their contents, and the names of its symbolic links."""
    lists: dict[str, bytes] = {}
    links: set[str] = set()
    for split, pairs in index.pairs.items():
        folder, keys = index.folder(split), [index.key(split, number) for number in range(pairs)]
        lists |= {f"{folder}{path}": data for path, data in index.layout.lists(keys, index.encodings).items()}
        links |= {f"{folder}{path}" for path in index.layout.links(keys)}
    return lists, links


def _shard_files(index: Index) -> set[str]:
    """Return the names of all files of all shards, and of their records."""
    names = [shard.name for shard in index.shards]
    paths = {record_path(name) for name in names}
    if index.layout.packed:
        return paths.union(map(tar_path, names))
    return paths.union(
        *(index.files(split, number).values() for split, pairs in index.pairs.items() for number in range(pairs))
    )


def _is_link(index: Index, name: str) -> bool:
    return index.place.local is not None and (index.place.local / name).is_symlink()


def read_pair(index: Index, shard: StoredShard, number: int, verdict: Verdict) -> StoredFrame | None:
    """Read a pair's files, and compare their names with the layout's and with the shard's record.

    Args:
        index: the dataset.
        shard: the pair's shard, open.
        number: the pair's number in its split.
        verdict: takes findings.

    Returns:
        The pair; None where it cannot be judged further.
    """
    if index.layout.packed and shard.fault is not None:
        return None  # the shard has the finding
    expected = index.files(shard.split, number)
    listed = shard.listed(number)
    if listed is not None:
        for name in sorted(set(expected.values()) - listed):
            verdict.add("files", f"{name} is not in the shard's record, but layout and outputs ask for it")
        for name in sorted(listed - set(expected.values())):
            verdict.add("files", f"{name} does not belong to the pair, but the shard's record lists it")
    values: dict[str, Any] = {}
    for role, name in expected.items():
        try:
            data = shard.read(number, name)
            shard.check_digest(number, name, data, verdict)
            values[role] = decode_file(index.layout, role, data, Path(name), index.encodings)
        except ReadError as error:
            verdict.add("files", f"{error.path} {error.reason}")
    if not values.keys() >= _NEEDED:
        return None
    try:
        return assemble_frame(index.key(shard.split, number), values, index.encodings)
    except ReadError as error:
        verdict.add("files", f"{error.path} {error.reason}")
        return None


def check_sizes(frame: StoredFrame, index: Index, verdict: Verdict) -> bool:
    """Compare the sizes of all arrays with the camera's and the config's; return whether all arrays are of one size."""
    camera = frame.camera
    size = (camera.height_px, camera.width_px)
    configured = (index.number("camera", "height_px"), index.number("camera", "width_px"))
    if configured != size:
        verdict.add("size", f"the camera has {size[1]} x {size[0]}, the config {configured[1]} x {configured[0]}")
    fits = True
    for eye in EYES:
        for channel, array in frame.view(eye).items():
            height, width = array.shape[:2]
            if (height, width) != size:
                fits = False
                verdict.add("size", f"{channel}_{eye} is {width} x {height}, the camera has {size[1]} x {size[0]}")
    return fits


def check_origin(frame: StoredFrame, index: Index, verdict: Verdict) -> None:
    """Compare a pair's provenance with the index and with the pair's place in it."""
    provenance = frame.provenance
    for key in ("program", "version", "config", "config_sha256", "seed"):
        if provenance.get(key) != index.values.get(key):
            verdict.add("origin", f"{key} is {provenance.get(key)!r}, in the index {index.values.get(key)!r}")
    for key, expected in (("pair", frame.index), ("split", frame.split)):
        if provenance.get(key) != expected:
            verdict.add("origin", f"{key} is {provenance.get(key)!r}, by the place of its files {expected!r}")
