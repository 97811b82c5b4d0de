"""--overwrite, ended at any moment, and the folders that it must leave alone: no file is lost that is not ours."""

import json
import os
import shutil
from itertools import count
from pathlib import Path

import pytest
from backends import backend_fault
from recorder import Recorder
from tiny_datasets import SEED, cheap, digests, findings

from semisynth_gl.dataset.begun import complete_record, plan_of, read_beginning
from semisynth_gl.dataset.documents import PlanDocument, parse_document
from semisynth_gl.dataset.files import DatasetFiles
from semisynth_gl.dataset.places import Folder, open_place
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.schema import PLAN, is_unfinished_file
from semisynth_gl.generation.generate import generate
from semisynth_gl.inputs.errors import InputError

SOURCES = {"train": {"patches": "0"}}
# What changes a folder, but for the contents of a file that has no other name yet.
CHANGES = ("unlink", "rmdir", "replace", "mkdir")


class Killed(BaseException):
    """The end of a process, as far as the disk can tell."""


class Death:
    """Kills the process at the n-th change of a folder; a dead process changes nothing more."""

    def __init__(self, monkeypatch, moment):
        self.changes, self.moment, self.rmdir = 0, moment, os.rmdir
        for name in CHANGES:
            monkeypatch.setattr(os, name, self._deadly(getattr(os, name)))

    def _deadly(self, change):
        def deadly(*args, **options):
            # An attempt at a folder that is not empty changes nothing.
            self.changes += change is not self.rmdir or (Path(*args).is_dir() and not any(Path(*args).iterdir()))
            if self.changes >= self.moment:
                raise Killed
            return change(*args, **options)

        return deadly


@pytest.fixture(autouse=True)
def _quick_disk(monkeypatch):
    """The tests kill no kernel, so nothing has to wait for the disk."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.fixture(scope="module")
def config():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return cheap(textures={"source": "procedural", "max_patches": 16}, outputs=["visibility", "instances"])


@pytest.fixture(scope="module")
def datasets(config, tmp_path_factory):
    """A finished dataset of two shards in each of three layouts."""
    folder = tmp_path_factory.mktemp("old")
    for layout in ("sceneflow", "middlebury", "webdataset"):
        generate(config, folder / layout, 2, SEED, layout=layout, shard_pairs=1)
    return folder


def copied(folder, to):
    """A copy of a dataset, of linked files: the program renames and removes files, and changes none in place."""
    return shutil.copytree(folder, to, symlinks=True, copy_function=os.link)


def tree(folder):
    """All files with their contents and all folders, but for the lock and what a dead process had in hand."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in Path(folder).rglob("*")
        if not is_unfinished_file(path.relative_to(folder).as_posix())
    }


def begin(folder, plan, sources, *, overwrite):
    files = DatasetFiles(Folder(folder), plan, overwrite=overwrite)
    try:
        files.open(sources)
    finally:
        files.close()


@pytest.mark.parametrize(
    ("before", "after", "seed", "step"),
    [
        ("middlebury", "webdataset", SEED, 1),
        ("webdataset", "webdataset", SEED + 1, 1),
        ("webdataset", "webdataset", SEED, 1),
        # It has a hundred folders, most of them empty.
        ("sceneflow", "kitti", SEED, 29),
    ],
)
def test_killed_at_any_removal_the_same_command_goes_on(datasets, config, tmp_path, before, after, seed, step):
    plan = make_plan(config, seed, after, {"train": 2}, 1)
    old = json.loads((datasets / before / "shards/plan.json").read_text())
    old_plan, old_sources = plan_of(parse_document(old, PlanDocument, Path(PLAN))), old["sources"]
    sources = old_sources if seed == SEED and before == after else SOURCES
    copied(datasets / before, tmp_path / "undisturbed")
    begin(tmp_path / "undisturbed", plan, sources, overwrite=True)
    wanted = tree(tmp_path / "undisturbed")
    assert {name for name, data in wanted.items() if data is not None} == {"shards/plan.json"}
    for moment in count(1, step):
        out, other = tmp_path / f"{moment}", tmp_path / f"{moment}-old"
        copied(datasets / before, out)
        alive = True
        with pytest.MonkeyPatch.context() as patch:
            Death(patch, moment)
            try:
                begin(out, plan, sources, overwrite=True)
            except Killed:
                alive = False
        assert read_beginning(Folder(out)) is not None
        copied(out, other)
        begin(out, plan, sources, overwrite=True)
        assert tree(out) == wanted
        if alive:
            break
        # The earlier dataset is no riddle either: its own command goes on with what is left of it.
        begun = read_beginning(Folder(other))
        if begun.seed == SEED and begun.layout == before:
            begin(other, old_plan, old_sources, overwrite=False)
            assert read_beginning(Folder(other)).values == old_plan.values() | {"sources": old_sources}
        shutil.rmtree(out)
        shutil.rmtree(other)
    assert moment > len(tree(datasets / before)) / 2


@pytest.mark.parametrize(("before", "moment"), [("sceneflow", 40), ("middlebury", 15)])
def test_what_comes_out_in_the_end_is_the_same(datasets, config, tmp_path, before, moment):
    generate(config, tmp_path / "wanted", 2, SEED + 1, layout="kitti", shard_pairs=1)
    copied(datasets / before, tmp_path / "o")
    with pytest.MonkeyPatch.context() as patch:
        Death(patch, moment)
        with pytest.raises(Killed):
            generate(config, tmp_path / "o", 2, SEED + 1, layout="kitti", shard_pairs=1, overwrite=True)
    generate(config, tmp_path / "o", 2, SEED + 1, layout="kitti", shard_pairs=1, overwrite=True)
    assert digests(tmp_path / "o") == digests(tmp_path / "wanted")
    assert findings(tmp_path / "o") == []


def test_an_equal_dataset_is_made_anew_though_its_removal_was_cut_off(datasets, config, tmp_path):
    """Its files may be the reason for --overwrite: none of them is taken for the new run's work."""
    shutil.copytree(datasets / "middlebury", tmp_path / "o", symlinks=True)
    for image in (tmp_path / "o").rglob("im0.png"):
        image.write_bytes(bytes(image.stat().st_size))
    for moment in (4, 12):
        with pytest.MonkeyPatch.context() as patch:
            Death(patch, moment)
            with pytest.raises(Killed):
                generate(config, tmp_path / "o", 2, SEED, layout="middlebury", shard_pairs=1, overwrite=True)
    recorder = Recorder()
    generate(
        config, tmp_path / "o", 2, SEED, layout="middlebury", shard_pairs=1, overwrite=True, listener=recorder
    )  # fmt: skip
    assert [pair.kept for pair in recorder.pairs] == [False, False]
    assert digests(tmp_path / "o") == digests(datasets / "middlebury")


@pytest.mark.parametrize("layout", ["kitti", "webdataset"])
def test_a_stopped_run_with_overwrite_goes_on(datasets, config, tmp_path, layout):
    copied(datasets / "middlebury", tmp_path / "o")
    made = []
    for stop in (True, False):
        recorder = Recorder(lambda pair, stop=stop: stop and pair.index == 0)
        generate(
            config, tmp_path / "o", 3, SEED, layout=layout, shard_pairs=1, overwrite=True, listener=recorder
        )  # fmt: skip
        made.append([pair.index for pair in recorder.pairs if not pair.kept])
    assert made == [[0], [1, 2]]
    assert any("going on" in message for message in recorder.messages)
    generate(config, tmp_path / "wanted", 3, SEED, layout=layout, shard_pairs=1)
    assert digests(tmp_path / "o") == digests(tmp_path / "wanted")


FOREIGN = (
    ".partial/notes.txt",
    ".partial/thesis/chapter1.tex",
    ".partial/index.json.12",
    ".partial/semisynth-lab.tar",
    ".partial/semisynth-lab-train-000000.zip",
    ".partial/semisynth-lab-train-000000.tar.bak",
    ".partial/lock.txt",
    ".partial/sub/lock",
    "notes.txt",
    "shards/plan.json.bak",
    "MiddEval3/trainingF/middlebury-000000/mine.png",
    "shards/.partial/lock",
)


@pytest.mark.parametrize("name", FOREIGN)
def test_files_of_others_stay_whatever_the_option(datasets, config, tmp_path, name):
    fresh, ours = tmp_path / "fresh", tmp_path / "ours"
    copied(datasets / "middlebury", ours)
    for out in (fresh, ours):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("mine")
    for out, overwrites in ((fresh, (False, True)), (ours, (True,))):
        before = tree(out)
        for overwrite in overwrites:
            with pytest.raises(InputError, match=Path(name).parts[0] if out == fresh else name):
                generate(config, out, 1, SEED, overwrite=overwrite)
        assert tree(out) == before
    # Going on is fine, and passes them by.
    (ours / "index.json").unlink()
    generate(config, ours, 2, SEED, layout="middlebury", shard_pairs=1)
    assert (ours / name).read_text() == "mine"


def test_a_run_that_comes_to_nothing_leaves_files_of_others(config, tmp_path):
    """Somebody puts a file into the new folder while the first pair is drawn, and the run fails."""
    files = DatasetFiles(Folder(tmp_path / "o"), make_plan(config, SEED, "kitti", {"train": 1}), overwrite=False)
    files.open(SOURCES)
    (tmp_path / "o/notes.txt").write_text("mine")
    files.close()
    assert (tmp_path / "o/notes.txt").read_text() == "mine"
    other = DatasetFiles(Folder(tmp_path / "p"), make_plan(config, SEED, "kitti", {"train": 1}), overwrite=False)
    other.open(SOURCES)
    other.close()
    assert not (tmp_path / "p").exists()


def test_killed_before_its_plan_a_run_may_begin_again(config, tmp_path):
    plan = make_plan(config, SEED, "middlebury", {"train": 1})
    for moment in count(1):
        out = tmp_path / str(moment)
        alive = True
        with pytest.MonkeyPatch.context() as patch:
            Death(patch, moment)
            try:
                DatasetFiles(Folder(out), plan, overwrite=False).open(SOURCES)
            except Killed:
                alive = False
        begin(out, plan, SOURCES, overwrite=False)
        if alive:
            break
    assert moment > 3


def test_a_store_is_overwritten_by_the_same_rules(config, datasets, tmp_path):
    fsspec = pytest.importorskip("fsspec")
    memory, address = fsspec.filesystem("memory"), f"memory://{tmp_path.name}-overwrite"
    memory.put(str(datasets / "webdataset"), f"/{tmp_path.name}-overwrite", recursive=True)
    place, plan = open_place(address), make_plan(config, SEED + 1, "webdataset", {"train": 2}, 1)
    assert complete_record(place, plan.shards[0]) is not None
    place.write(".partial/notes.txt", b"mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        DatasetFiles(place, plan, overwrite=True)
    place.remove(".partial/notes.txt")
    DatasetFiles(place, plan, overwrite=True).open(SOURCES)
    assert place.names() == ["shards/plan.json"]
    assert read_beginning(place).values == plan.values() | {"sources": SOURCES}
