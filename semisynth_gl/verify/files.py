"""Completeness: is every file there that a loader or the dataset itself counts on, and none that misleads one."""

import hashlib
import json
from pathlib import Path
from typing import Any

from semisynth_gl.dataset.places import PARTIAL
from semisynth_gl.dataset.reader import INDEX, PLAN, RECORDS, Index
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.layouts.layout import ARRAYS
from semisynth_gl.read.error import ReadError
from semisynth_gl.verify.finding import Verdict
from semisynth_gl.verify.shards import StoredShard

_ABOUT = frozenset({INDEX, PLAN, "README.md", "croissant.json"})
_SHOWN = 20
# Without these a pair cannot be judged.
_NEEDED = frozenset({"left", "right", "disparity_left", "provenance"})


def check_index(index: Index, verdict: Verdict) -> None:
    """Check the index against itself, and what lies in the dataset's folder against it."""
    if index.fault is not None:
        verdict.add("index", f"{index.fault}: the dataset is not finished; run its generate command again")
    if not index.pairs:
        verdict.add("index", f"{INDEX} tells of no pair")
    config, digest = index.config, index.values.get("config_sha256")
    if digest_of(config) != digest:
        verdict.add("index", f"config_values have the digest {digest_of(config)[:12]}, config_sha256 is {digest!s:.12}")
    held = set(index.place.names())
    lists = _lists(index)
    expected = _ABOUT | lists.keys() | _paths(index)
    # Loaders take what they find for a pair.
    foreign = sorted(
        name for name in held - expected if not name.startswith(f"{PARTIAL}/") and not _is_link(index, name)
    )
    for name in foreign[:_SHOWN]:
        verdict.add("files", f"{name} does not belong here: nothing in the index tells of it")
    if len(foreign) > _SHOWN:
        verdict.add("files", f"{len(foreign) - _SHOWN} more files do not belong here")
    if index.fault is not None:
        return  # what follows is written last
    for name in sorted(_ABOUT - held):
        verdict.add("files", f"{name} is missing")
    for name, wanted in lists.items():
        _check_list(index, name, wanted, verdict)


def _check_list(index: Index, name: str, wanted: bytes, verdict: Verdict) -> None:
    try:
        came = index.place.read(name)
    except FileNotFoundError:
        verdict.add("files", f"{name} is missing")
        return
    if came != wanted:
        lines, expected = came.decode("utf-8", "replace").splitlines(), wanted.decode().splitlines()
        lacking = sorted(set(expected) - set(lines))
        example = f"; it lacks {lacking[0]}" if lacking else ""
        verdict.add("files", f"{name} has {len(lines)} lines, not the {len(expected)} of its layout{example}")


def _lists(index: Index) -> dict[str, bytes]:
    return {
        f"{index.folder(split)}{path}": data
        for split, pairs in index.pairs.items()
        for path, data in index.layout.lists(
            [index.key(split, number) for number in range(pairs)], index.encodings
        ).items()
    }


def _paths(index: Index) -> set[str]:
    """All files of all shards."""
    paths = {f"{RECORDS}/{name}.json" for name in index.shard_names()}
    if index.layout.packed:
        return paths | {f"{RECORDS}/{name}.tar" for name in index.shard_names()}
    return paths.union(
        *(index.files(split, number).values() for split, pairs in index.pairs.items() for number in range(pairs))
    )


def _is_link(index: Index, name: str) -> bool:
    return (
        index.place.local is not None
        and (index.place.local / name).is_symlink()
        and name
        in {
            f"{index.folder(split)}{path}"
            for split, pairs in index.pairs.items()
            for path in index.layout.links([index.key(split, number) for number in range(pairs)])
        }
    )


def read_pair(index: Index, shard: StoredShard, number: int, verdict: Verdict) -> StoredFrame | None:
    """Read a pair's files and check that its set of them is complete; None where it cannot be judged further."""
    if index.layout.packed and not shard.recorded:
        return None  # said of the shard
    wanted = index.files(shard.split, number)
    listed = shard.listed(number)
    if listed is not None:
        for name in sorted(set(wanted.values()) - listed):
            verdict.add("files", f"{name} is not in the shard's record, but its layout and outputs ask for it")
        for name in sorted(listed - set(wanted.values())):
            verdict.add("files", f"{name} does not belong to the pair, but the shard's record lists it")
    values: dict[str, Any] = {}
    for role, name in wanted.items():
        try:
            data = shard.read(number, name)
            shard.check_digest(number, name, data, verdict)
            values[role] = index.layout.decode_file(role, data, Path(name), index.encodings)
        except ReadError as error:
            verdict.add("files", f"{error.path} {error.reason}")
    if not values.keys() >= _NEEDED:
        return None
    try:
        return index.layout.assemble(index.key(shard.split, number), values, index.encodings)
    except ReadError as error:
        verdict.add("files", f"{error.path} {error.reason}")
        return None


def check_sizes(frame: StoredFrame, index: Index, verdict: Verdict) -> bool:
    """Compare the sizes of all arrays with the camera's and the config's; return whether all arrays are of one size."""
    camera = frame.camera
    size = (camera.height_px, camera.width_px)
    wanted = (index.number("camera", "height_px"), index.number("camera", "width_px"))
    if wanted != size:
        verdict.add("size", f"its camera has {size[1]} x {size[0]}, the config {wanted[1]} x {wanted[0]}")
    fits = True
    for name in ARRAYS:
        array = getattr(frame, name)
        if array is not None and array.shape[:2] != size:
            fits = False
            verdict.add("size", f"{name} is {array.shape[1]} x {array.shape[0]}, its camera has {size[1]} x {size[0]}")
    return fits


def check_pair(frame: StoredFrame, index: Index, verdict: Verdict) -> None:
    """Compare what the pair says of its origin with the index and with its place in it."""
    for key in ("program", "version", "config", "config_sha256", "seed"):
        if frame.provenance.get(key) != index.values.get(key):
            verdict.add("origin", f"it has {key} {frame.provenance.get(key)!r}, the index {index.values.get(key)!r}")
    for key, value in (("pair", frame.index), ("split", frame.split)):
        if frame.provenance.get(key) != value:
            verdict.add(
                "origin", f"it says that its {key} is {frame.provenance.get(key)!r}, its place that it is {value!r}"
            )


def digest_of(config: Any) -> str:  # noqa: ANN401 - whatever the JSON holds
    """SHA-256 of config values in the form that ``config_sha256`` is taken of, 64 hex digits."""
    return hashlib.sha256(json.dumps(config, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
