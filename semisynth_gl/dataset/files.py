"""A dataset on disk: what it was begun as, which shards are whole, and the index that says that all are."""

import json
import shutil
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import IO, Any

from pydantic import ValidationError

from semisynth_gl.config import Config
from semisynth_gl.dataset.locks import lock, locked
from semisynth_gl.dataset.places import Place, empty
from semisynth_gl.dataset.plan import Plan, Shard, differences, few
from semisynth_gl.dataset.schema import (
    CARD,
    CROISSANT,
    INDEX,
    LOCK,
    PARTIAL,
    PLAN,
    PROGRAM,
    RECORDS,
    record_path,
    tar_path,
)
from semisynth_gl.errors import InputError
from semisynth_gl.layouts import layout_names
from semisynth_gl.splits import SplitName

_QUESTIONS = 16


class DatasetFiles:
    """A dataset's files, begun or taken up again. Nothing on disk changes before `open`.

    Args:
        place: where it lies.
        plan: what it shall be.
        overwrite: replace an earlier dataset of this program. Other people's files are never deleted.

    Attributes:
        place: where it lies.
        plan: what it shall be.
        complete: whether all of it is there already.

    Raises:
        InputError: where the place holds what is no dataset of this program, or one that was begun as another, with the
            keys that differ, or where it is a file.
    """

    def __init__(self, place: Place, plan: Plan, *, overwrite: bool) -> None:
        self.place = place
        self.plan = plan
        self._overwrite = overwrite
        self._lock: IO[bytes] | None = None
        self._created = place.local is not None and not place.local.exists()
        if place.local is not None and place.local.exists() and not place.local.is_dir():
            raise InputError(f"{place.address}: expected a folder to write to, but it is a file")
        self._there = begun(place)
        self._doomed: list[str] = []
        if self._there is None:
            # Another run may have begun it since the look before: `open` takes up what that one began.
            held = [name for name in _held(place) if name != PARTIAL]
            if held and begun(place) is None:
                advice = "--overwrite replaces only what this program wrote. " if overwrite else ""
                raise InputError(
                    f"{place.address}: the folder is not empty (it holds {_some(held)}), and no dataset of this "
                    f"program. {advice}Choose another with --out"
                )
        elif overwrite:
            self._doomed = self._to_delete()
        else:
            self._check_same(self._there)
        self.complete = not overwrite and place.size(INDEX) is not None and not self.missing(plan.shards, quick=True)

    @property
    def replaces(self) -> bool:
        """Whether `open` will delete an earlier dataset."""
        return bool(self._doomed)

    def open(self, sources: Mapping[SplitName, Mapping[str, str]]) -> None:
        """Begin the dataset, or take it up.

        Args:
            sources: digests of patches and models, by split.

        Raises:
            InputError: where it cannot be written to, was begun with other sources, or shall be replaced while another
                run writes to it.
        """
        values = self.plan.values() | {"sources": {split: dict(digests) for split, digests in sources.items()}}
        try:
            self._take_lock()
            if not self._overwrite:
                self._there = begun(self.place)
            if self._there is not None and not self._overwrite:
                self._check_same(self._there)
                self._check_sources(self._there, values["sources"])
            if self._doomed and self.place.local is not None:
                # The index goes first: from here on the folder does not claim to be finished.
                (self.place.local / INDEX).unlink(missing_ok=True)
                empty(self.place.local, self._doomed)
            for name in self._doomed if self.place.local is None else ():
                self.place.remove(name)
            if self.place.size(INDEX) is not None:
                self.place.remove(INDEX)
            if self._there is None or self._there != values:
                self.place.write(PLAN, _encoded(values))
            if self._lock is not None:
                lock(self._lock.fileno(), shared=True)
        except BlockingIOError:
            raise self._held_by_another() from None
        except OSError as error:
            raise InputError(
                f"{self.place.address}: the folder cannot be written to: {error.strerror or error}"
            ) from None

    def missing(self, shards: Iterable[Shard], *, quick: bool = False) -> list[Shard]:
        """Return those shards that are not whole: without a record, or with files of another size than it says.

        Args:
            shards: which to look at.
            quick: stop at the first one.
        """
        if self.place.local is not None or quick:
            found = (shard for shard in shards if self.record(shard) is None)
            return list(islice(found, 1 if quick else None))
        # Stores answer each question late, and many at once.
        asked = list(shards)
        with ThreadPoolExecutor(_QUESTIONS) as pool:
            return [shard for shard, record in zip(asked, pool.map(self.record, asked), strict=True) if record is None]

    def record(self, shard: Shard) -> dict[str, Any] | None:
        """Return a shard's record, or None where it is not whole."""
        return whole_record(self.place, shard)

    def finish(self, index: Mapping[str, Any], files: Mapping[str, bytes]) -> None:
        """Write what is about the dataset as a whole, the index last, which says that it is complete.

        Args:
            index: in JSON's types.
            files: card and the like, by path.

        Raises:
            OSError: where the disk refuses.
        """
        local = self.place.local
        for split in self.plan.splits:
            folder, keys, layout = self.plan.folder(split), self.plan.keys(split), self.plan.layout
            encodings = layout.encodings_for(self.plan.config)
            for path, data in layout.lists(keys, encodings).items():
                self.place.write(f"{folder}{path}", data)
            if local is None:
                continue  # stores have neither links nor empty folders
            for path in layout.folders():
                (local / folder / path).mkdir(parents=True, exist_ok=True)
            for path, target in layout.links(keys).items():
                link = local / folder / path
                link.parent.mkdir(parents=True, exist_ok=True)
                if not link.is_symlink():
                    link.symlink_to(target)
        for path, data in files.items():
            self.place.write(path, data)
        self.place.write(INDEX, _encoded(index))
        if local is not None and self._is_alone():
            shutil.rmtree(local / PARTIAL, ignore_errors=True)

    def close(self) -> None:
        """Let go of the dataset. What was created and holds no pair is removed."""
        if self._created and self.place.local is not None and self._is_alone():
            with suppress(OSError):
                local = self.place.local
                journals = (local / PARTIAL).glob("*.jsonl")
                if self.place.names(RECORDS) in ([], [PLAN]) and not any(each.stat().st_size for each in journals):
                    shutil.rmtree(local, ignore_errors=True)
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _check_same(self, there: Mapping[str, Any]) -> None:
        """Check that the dataset was begun as the plan says; it may have been smaller."""
        wanted = self.plan.values()
        compared = ("version", "config_values", "seed", "layout", "shard_pairs")
        changed = differences({key: there.get(key) for key in compared}, {key: wanted[key] for key in compared})
        pairs = there.get("pairs", {})
        if set(pairs) != set(wanted["pairs"]):
            changed += differences({"pairs": pairs}, {"pairs": wanted["pairs"]})
        if changed:
            raise InputError(
                f"{self.place.address}: holds a dataset that was begun with other values: {few(changed)}. Give the "
                "same to go on with it, choose another folder with --out, or give --overwrite to replace it"
            )
        fewer = [f"{name} ({pairs[name]} there, {count} now)" for name, count in self.plan.pairs.items()
                 if count < pairs[name]]  # fmt: skip
        if fewer:
            raise InputError(
                f"{self.place.address}: holds a dataset of more pairs: {few(fewer)}. Ask for as many or more to go on "
                "with it, choose another folder with --out, or give --overwrite to replace it"
            )

    def _check_sources(self, there: Mapping[str, Any], sources: Mapping[str, Any]) -> None:
        changed = differences(there.get("sources", {}), sources)
        if changed:
            raise InputError(
                f"{self.place.address}: photographs or models are not those that the dataset was begun with: "
                f"{few(changed)}. Give the same again, or choose another folder with --out"
            )

    def _to_delete(self) -> list[str]:
        """Return what an earlier dataset consists of.

        Raises:
            InputError: where anything else lies there too.
        """
        files = self.place.names()
        own = _files_of(self._there or {})
        foreign = [name for name in files if name not in own and not name.startswith(f"{PARTIAL}/")]
        local = self.place.local
        if foreign:
            raise InputError(
                f"{self.place.address}: --overwrite replaces only what this program wrote, but the folder holds "
                f"{_some(foreign)}. Choose another folder with --out, or remove these yourself"
            )
        if local is None:
            return files
        return [name for name in _held(self.place) if name != PARTIAL]

    def _take_lock(self) -> None:
        """Lock the dataset: for this run alone where it is begun or replaced, else beside other runs.

        Of two runs that begin it at once, one waits until the other has said what it shall be.
        """
        local = self.place.local
        if local is None:
            return
        try:
            self._lock = locked(
                local / LOCK,
                lambda: not self._doomed and begun(self.place) is not None,
                patient=not self._doomed,
            )
        except BlockingIOError:
            raise self._held_by_another() from None
        if self._doomed:
            # What is half done belongs to the dataset that goes.
            empty(local / PARTIAL, [name for name in _names(local / PARTIAL) if name != "lock"])

    def _held_by_another(self) -> InputError:
        return InputError(
            f"{self.place.address}: another run "
            f"{'writes to' if self._doomed else 'is replacing'} this dataset: wait for its end, or stop it"
        )

    def _is_alone(self) -> bool:
        """Whether no other run works on the dataset; if so, none will until `close`."""
        if self._lock is None:
            return True
        try:
            lock(self._lock.fileno(), shared=False)
        except BlockingIOError:
            return False
        return True


def begun(place: Place) -> dict[str, Any] | None:
    """Return what a dataset was begun as, from its index or, where it is unfinished, its plan; None without either."""
    for name in (INDEX, PLAN):
        values = _json(place, name)
        if values is not None and values.get("program") == PROGRAM and values.get("layout") in layout_names():
            return values
    return None


def whole_record(place: Place, shard: Shard) -> dict[str, Any] | None:
    """Return a shard's record, or None where the shard is not whole: a file is missing or has another size."""
    record = _json(place, record_path(shard.name))
    wanted = {"split": shard.split, "first": shard.first, "end": shard.end}
    if record is None or any(record.get(key) != value for key, value in wanted.items()):
        return None
    sizes = (
        {record["tar"]: record["bytes"]}
        if "tar" in record
        else {name: file["bytes"] for sample in record["samples"] for name, file in sample["files"].items()}
    )
    return record if all(place.size(name) == size for name, size in sizes.items()) else None


def plan_of(values: Mapping[str, Any]) -> Plan:
    """Return the plan that an index or an unfinished dataset's plan tells of.

    Raises:
        InputError: where this version does not understand its config.
    """
    try:
        config = Config.model_validate(values["config_values"])
        return Plan(config, int(values["seed"]), values["layout"], dict(values["pairs"]), int(values["shard_pairs"]))
    except (ValidationError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"the dataset's plan is not this version's: {str(error).splitlines()[0]}") from None


def _files_of(values: Mapping[str, Any]) -> set[str]:
    """Name all files that a dataset may have."""
    own = {INDEX, CARD, CROISSANT, PLAN}
    plan = plan_of(values)
    layout = plan.layout
    encodings = layout.encodings_for(plan.config)
    for split in plan.splits:
        folder, keys = plan.folder(split), plan.keys(split)
        own |= {f"{folder}{path}" for path in (*layout.lists(keys, encodings), *layout.links(keys))}
        if not layout.packed:
            own |= {f"{folder}{path}" for key in keys for path in layout.files(key, encodings).values()}
    for shard in plan.shards:
        own |= {record_path(shard.name), tar_path(shard.name)}
    return own


def _json(place: Place, name: str) -> dict[str, Any] | None:
    try:
        values = json.loads(place.read(name))
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, ValueError):
        return None
    return values if isinstance(values, dict) else None


def _encoded(values: Mapping[str, Any]) -> bytes:
    return (json.dumps(values, indent=1) + "\n").encode()


def _held(place: Place) -> list[str]:
    """Names of what lies in a place, at its top."""
    if place.local is not None:
        return _names(place.local)
    return sorted({name.partition("/")[0] for name in place.names()})


def _names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
