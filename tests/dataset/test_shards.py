"""Shards as files: what several runs on one folder leave of them."""

import errno
import fcntl
import os
import stat
from pathlib import Path
from types import SimpleNamespace

import pytest

from semisynth_gl.config import load_config
from semisynth_gl.dataset.begun import complete_record
from semisynth_gl.dataset.documents import RecordDocument
from semisynth_gl.dataset.files import DatasetFiles
from semisynth_gl.dataset.places import Folder
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.shard import ShardBusyError, ShardWriter

SHARD = make_plan(load_config("middlebury"), 0, "webdataset", {"train": 3}, shard_pairs=3).shards[0]
RANGE = {"split": SHARD.split, "first": SHARD.first, "end": SHARD.end, "redraws": 0, "renderers": ["none"]}

packed_or_not = pytest.mark.parametrize("packed", [True, False], ids=["tar", "files"])


def open_writer(root, *, packed=True):
    return ShardWriter(Folder(root), SHARD, packed=packed, folder="")


def add_pairs(writer, most=3):
    """Add pairs of files that are the same in every run."""
    for index in range(len(writer.samples), most):
        files = {f"{index}.a": bytes([index]) * 700, f"{index}.b": b"b" * index}
        writer.add(files, {"redrawn": [], "share_beyond": 0.0, "renderer": "none", "seconds": 0.5})


def write_shard(root, *, packed=True):
    with open_writer(root, packed=packed) as writer:
        add_pairs(writer)
        return writer.finish(RANGE, {"seconds": 1.5})


def finished_files(root):
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and ".partial" not in path.parts
    }


def test_a_removed_journal_keeps_others_out(tmp_path, monkeypatch):
    """A run opens the journal of another one, which completes the shard before the first has locked it."""
    other, lock = open_writer(tmp_path), fcntl.flock
    add_pairs(other)

    def lock_late(descriptor, how):
        monkeypatch.undo()
        other.finish(RANGE, {"seconds": 1.5})
        other.close()
        lock(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", lock_late)
    with open_writer(tmp_path), pytest.raises(ShardBusyError):
        open_writer(tmp_path)


@packed_or_not
def test_a_complete_shard_stays_as_it_is(tmp_path, packed):
    record = write_shard(tmp_path, packed=packed)
    before = finished_files(tmp_path)
    with open_writer(tmp_path, packed=packed) as writer:
        assert writer.complete
        # A run that is killed here has lost nothing.
        assert finished_files(tmp_path) == before
    assert finished_files(tmp_path) == before
    assert complete_record(Folder(tmp_path), SHARD) == RecordDocument.model_validate(record)


@packed_or_not
@pytest.mark.parametrize("lost", ["record", "file"])
def test_a_shard_that_lacks_something_is_completed(tmp_path, packed, lost):
    """As after a loss of power between the last file and the record, or before the last file was on the disk."""
    with open_writer(tmp_path, packed=packed) as writer:
        add_pairs(writer, 2)
    journal = next((tmp_path / ".partial").glob("*.jsonl")).read_bytes()
    write_shard(tmp_path, packed=packed)
    before = finished_files(tmp_path)
    if lost == "record":
        (tmp_path / f"shards/{SHARD.name}.json").unlink()
        (tmp_path / f".partial/{SHARD.name}.jsonl").write_bytes(journal)
    else:
        (tmp_path / (f"shards/{SHARD.name}.tar" if packed else "2.a")).write_bytes(b"cut")
    with open_writer(tmp_path, packed=packed) as writer:
        assert not writer.complete
        assert len(writer.samples) == (2 if lost == "record" else 0)
        add_pairs(writer)
        writer.finish(RANGE, {"seconds": 1.5})
    assert finished_files(tmp_path) == before


def test_two_machines_write_one_name_at_once(tmp_path, monkeypatch):
    """Both processes have the same number; one writes while the other one is about to rename its file."""
    one, other, rename = Folder(tmp_path), Folder(tmp_path), Path.replace

    def rename_late(file, destination):
        monkeypatch.setattr(Path, "replace", rename)
        other.write("a/b.json", b"other")
        assert one.read("a/b.json") == b"other"
        return rename(file, destination)

    monkeypatch.setattr(os, "getpid", lambda: 7)
    monkeypatch.setattr(Path, "replace", rename_late)
    one.write("a/b.json", b"one")
    assert finished_files(tmp_path) == {"a/b.json": b"one"}
    assert list((tmp_path / ".partial").iterdir()) == []


def test_files_have_the_rights_of_new_files(tmp_path):
    before = os.umask(0o027)
    try:
        Folder(tmp_path).write("shards/plan.json", b"{}")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "shards/plan.json").stat().st_mode) == 0o640


@packed_or_not
@pytest.mark.parametrize("reason", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_two_runs_without_locks_do_the_same_work(tmp_path, monkeypatch, packed, reason):
    """They take turns at the shard's pairs, and one is killed, or both end."""
    write_shard(tmp_path / "alone", packed=packed)
    expected = finished_files(tmp_path / "alone")

    def refuse(*_):
        raise OSError(reason, "no locks here")

    monkeypatch.setattr(fcntl, "flock", refuse)
    for ends in (True, False):
        root = tmp_path / f"ends-{ends}"
        with open_writer(root, packed=packed) as one, open_writer(root, packed=packed) as other:
            for count in (1, 2, 3):
                add_pairs(one, count)
                add_pairs(other, count)
            one.finish(RANGE, {"seconds": 1.5})
            assert finished_files(root) == expected
            assert open_writer(root, packed=packed).complete
            if ends:
                other.finish(RANGE, {"seconds": 1.5})
        assert finished_files(root) == expected
        assert not [path for path in (root / ".partial").iterdir() if path.is_dir()]


def test_nobody_is_known_to_be_alone_without_locks(tmp_path, monkeypatch):
    """Whoever ends first leaves the unfinished files of the others."""

    def refuse(*_):
        raise OSError(errno.ENOLCK, "no locks here")

    monkeypatch.setattr(fcntl, "flock", refuse)
    plan = make_plan(load_config("middlebury"), 0, "webdataset", {"train": 3}, shard_pairs=3)
    runs = [DatasetFiles(Folder(tmp_path), plan, overwrite=False) for _ in range(2)]
    for run in runs:
        run.open({"train": {}})
    with open_writer(tmp_path) as other:
        add_pairs(other, 2)
        runs[0].finish(SimpleNamespace(values={"program": "semisynth-gl"}), b"")
        runs[0].close()
        add_pairs(other)
        other.finish(RANGE, {"seconds": 1.5})
    assert complete_record(Folder(tmp_path), SHARD) is not None
