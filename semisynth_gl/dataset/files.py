"""A dataset's files as a run writes them: the plan first, shards in any order, the index last."""

from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from itertools import islice
from typing import IO, Any

from semisynth_gl.codecs.json_object import JSON_OBJECT
from semisynth_gl.dataset.begun import complete_record, lost_files, plan_document, plan_of, read_beginning, read_object
from semisynth_gl.dataset.contents import Shard
from semisynth_gl.dataset.documents import IndexDocument, PlanDocument
from semisynth_gl.dataset.locks import lock, open_locked
from semisynth_gl.dataset.own import (
    check_ways,
    foreign_names,
    own_files,
    remove_dataset,
    remove_folders,
    remove_unfinished,
)
from semisynth_gl.dataset.places import Folder, Place
from semisynth_gl.dataset.plan import Plan, differences
from semisynth_gl.dataset.remote import Remote
from semisynth_gl.dataset.schema import CARD, INDEX, JOURNAL_SUFFIX, LOCK, PLAN, PROGRAM, is_unfinished_file
from semisynth_gl.inputs.errors import InputError, abbreviate
from semisynth_gl.seeds.splits import SplitName

_QUESTIONS = 16


class DatasetFiles:
    """The files of a dataset, new or resumed. Nothing on disk changes before `open`.

    With ``overwrite``, an earlier dataset of this program is replaced, and an unfinished dataset of the same plan is
    resumed. Other people's files are never deleted.

    Attributes:
        begun: whether the place already holds a dataset, finished or not.
        lost: the files, links and folders about the whole dataset that a finished dataset lacks; see `lost_files`.
        complete: whether the dataset is already complete.

    Raises:
        InputError: where the place is a file, holds other people's files, or holds a dataset of another plan; the
            message names the keys that differ. Also where a link would lead files out of the folder.
    """

    def __init__(self, place: Place, plan: Plan, *, overwrite: bool) -> None:
        self._place = place
        self._plan = plan
        self._overwrite = overwrite
        self._lock: IO[bytes] | None = None
        self._created = place.local is not None and not place.local.exists()
        if place.local is not None and place.local.exists() and not place.local.is_dir():
            raise InputError(f"{place.address}: expected a folder to write to, but it is a file")
        self._beginning = read_beginning(place)
        if self._beginning is None:
            # Another run may have begun the dataset since the line above: `open` resumes it.
            names = foreign_names(place)
            if names and read_beginning(place) is None:
                advice = "`overwrite` replaces only what this program wrote. " if overwrite else ""
                raise InputError(
                    f"{place.address}: the folder is not empty (it holds {abbreviate(names, 3)}), and is no dataset of "
                    f"this program. {advice}Choose another for `out`"
                )
        elif overwrite:
            own_files(place, plan_of(self._beginning))
        else:
            self._check_same(self._beginning)
        self.begun = self._beginning is not None
        same = self._beginning is not None and self._beginning.pairs == dict(plan.pairs)
        finished = same and not overwrite and place.size(INDEX) is not None
        self.lost = lost_files(place, plan) if finished else []
        self.complete = finished and not self.lost and not self.missing(plan.shards, quick=True)
        if not self.complete:
            check_ways(place, plan)

    def replaces(self, sources: Mapping[SplitName, Mapping[str, str]]) -> bool:
        """Return whether `open`, with these digests of patches and models by split, will delete an earlier dataset."""
        if not self._overwrite or self._beginning is None:
            return False
        # An unfinished dataset with equal plan and sources is no earlier dataset: a killed run with `overwrite` began
        # it, and this run goes on with it.
        return self._place.size(INDEX) is not None or read_object(self._place, PLAN) != self._values(sources)

    def open(self, sources: Mapping[SplitName, Mapping[str, str]]) -> None:
        """Begin or resume the dataset; ``sources`` are the digests of its patches and models, by name in each split.

        Raises:
            InputError: where the place cannot be written to, the dataset was begun with other sources, or another run
                writes to the dataset that this run would replace, or is replacing it.
        """
        values, place, replaces = self._values(sources), self._place, self.replaces(sources)
        try:
            self._take_lock(alone=replaces)
            self._beginning = read_beginning(place)
            if replaces and self._beginning is not None:
                remove_dataset(place, self._beginning)
                self._beginning = None
            elif self._beginning is not None:
                self._check_same(self._beginning)
                changed = differences(self._beginning.sources, values["sources"])
                if changed:
                    raise InputError(
                        f"{place.address}: photographs or models are not those that the dataset was begun with: "
                        f"{abbreviate(changed)}. Give the same again, or choose another folder for `out`"
                    )
            # Remove the index first, so that the dataset no longer claims to be finished; but never without a plan.
            if place.size(INDEX) is not None:
                if self._beginning is not None and read_object(place, PLAN) is None:
                    place.write(PLAN, JSON_OBJECT.encode(plan_document(self._plan, self._beginning.values)))
                place.remove(INDEX)
            if self._beginning is None or self._beginning.values != values:
                place.write(PLAN, JSON_OBJECT.encode(values))
            if self._lock is not None:
                lock(self._lock.fileno(), shared=True)
        except BlockingIOError:
            other_run = "writes to" if replaces else "is replacing"
            raise InputError(
                f"{place.address}: another run {other_run} this dataset: wait for its end, or stop it"
            ) from None
        except OSError as error:
            raise InputError(f"{place.address}: the folder cannot be written to: {error.strerror or error}") from None

    def missing(self, shards: Iterable[Shard], *, quick: bool = False) -> list[Shard]:
        """Return the shards for which `complete_record` finds no record; if ``quick``, only the first one."""
        read_record = partial(complete_record, self._place)
        if self._place.local is not None or quick:
            missing = (shard for shard in shards if read_record(shard) is None)
            return list(islice(missing, 1 if quick else None))
        # Stores answer slowly, but many requests at once.
        with ThreadPoolExecutor(_QUESTIONS) as pool:
            shards = list(shards)
            return [shard for shard, record in zip(shards, pool.map(read_record, shards), strict=True) if not record]

    def finish(self, index: IndexDocument, card: bytes) -> None:
        """Write the files about the whole dataset, and finally the index, which says that the dataset is complete."""
        place = self._place
        for name, data in (self._plan.all_lists | {CARD: card}).items():
            place.write(name, data)
        if isinstance(place, Folder):
            for name in self._plan.folders:
                place.make_folder(name)
            for name, target in self._plan.all_links.items():
                place.link(name, target)
        elif isinstance(place, Remote) and (copies := self._plan.copies):
            place.copy(copies)
        place.write(INDEX, JSON_OBJECT.encode(index.values))
        if isinstance(place, Folder) and self._is_alone():
            remove_unfinished(place)

    def close(self) -> None:
        """Unlock the dataset, and remove its folder if this run created it and it holds no pair."""
        place = self._place
        if self._created and isinstance(place, Folder) and self._is_alone():
            with suppress(OSError):
                names = place.names()
                begun = any(place.size(name) for name in names if name.endswith(JOURNAL_SUFFIX))
                if not begun and all(name == PLAN or is_unfinished_file(name) for name in names):
                    remove_unfinished(place)
                    place.remove(PLAN)
                    remove_folders(place, self._plan)
                    place.local.rmdir()
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _check_same(self, beginning: PlanDocument) -> None:
        """Raise InputError where the dataset was begun with another plan; only its numbers of pairs may be smaller."""
        address, values, began = self._place.address, self._plan.values(), beginning.version
        if began != values["version"]:
            raise InputError(
                f"{address}: holds a dataset that was begun with another version, whose pairs may differ: "
                f"version ({began} there, {values['version']} now). Go on with {PROGRAM} {began}, choose another "
                "folder for `out`, or give `overwrite` to replace it. A finished dataset can be read as it is"
            )
        keys = ("config_values", "seed", "layout", "shard_pairs")
        changed = differences({key: beginning.values[key] for key in keys}, {key: values[key] for key in keys})
        changed += differences({"plugins": beginning.plugin_records}, {"plugins": values.get("plugins", {})})
        pairs = beginning.pairs
        if set(pairs) != set(values["pairs"]):
            changed += differences({"pairs": pairs}, {"pairs": values["pairs"]})
        if changed:
            raise InputError(
                f"{address}: holds a dataset that was begun with other values: {abbreviate(changed)}. Give "
                "the same to go on with it, choose another folder for `out`, or give `overwrite` to replace it"
            )
        counts = [(name, pairs[name], count) for name, count in self._plan.pairs.items()]
        fewer = [f"{name} ({there} there, {now} now)" for name, there, now in counts if now < there]
        if fewer:
            raise InputError(
                f"{address}: holds a dataset of more pairs: {abbreviate(fewer)}. Ask for as many or more "
                "to go on with it, choose another folder for `out`, or give `overwrite` to replace it"
            )

    def _values(self, sources: Mapping[SplitName, Mapping[str, str]]) -> dict[str, Any]:
        """Return the content of plan.json: the plan with its sources, in JSON's types."""
        return self._plan.values() | {"sources": {split: dict(digests) for split, digests in sources.items()}}

    def _take_lock(self, *, alone: bool) -> None:
        """Lock the dataset: exclusively where this run begins or replaces it, else together with other runs.

        If two runs begin a dataset at the same time, one waits until the other has written the plan.
        """
        place = self._place
        if isinstance(place, Folder):
            path = place.own_path(LOCK, in_place=True)
            self._lock = open_locked(path, lambda: not alone and read_beginning(place) is not None, patient=not alone)

    def _is_alone(self) -> bool:
        """Return True only if no other run works on the dataset; then none can start before `close`."""
        if self._lock is None:
            return True
        try:
            return lock(self._lock.fileno(), shared=False)
        except BlockingIOError:
            return False
