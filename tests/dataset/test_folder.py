"""The folder of a dataset: runs make missing shards, keep the user's files, and exclude each other."""

import fcntl
import shutil
from contextlib import nullcontext, suppress
from itertools import count
from pathlib import Path

import pytest
from hand_made_datasets import config_of, plan_of, write_dataset
from tiny_datasets import tiny

from semisynth_gl.dataset.documents import INDEX, LOCK, PLAN
from semisynth_gl.dataset.folder import begin, locked, read_plan
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.dataset.root import names_below, open_root
from semisynth_gl.inputs.errors import InputError

PAIRS = {"train": 4, "validation": 1}
LAYOUTS = ("middlebury", "webdataset", "middlebury-2014", "sceneflow", "kitti")
RECORD = "shards/semisynth-lab-train-000000.json"


def config_for(layout):
    return config_of(outputs=["visibility", "instances"] if layout == "kitti" else ["visibility"])


def write(out, layout, pairs=None, **options):
    return write_dataset(out, layout, pairs or PAIRS, 2, config_for(layout), **options)


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    root = tmp_path_factory.mktemp("clean")
    for layout in LAYOUTS:
        write(root / layout, layout)
    return root


def copied(clean, layout, to):
    return shutil.copytree(clean / layout, to, symlinks=True)


def tree(folder):
    """Return content, target or None of every file, link and folder; not of logs, which contain durations."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not name.endswith(".log"):
            found[name] = str(path.readlink()) if path.is_symlink() else path.read_bytes() if path.is_file() else None
    return found


@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_a_dataset_lacks_is_made_again(clean, tmp_path, layout):
    wanted, folder = tree(clean / layout), copied(clean, layout, tmp_path / "set")
    plan = read_index(folder).plan
    for name in {INDEX, "README.md", *plan.lists, *plan.links}:
        (folder / name).unlink()
    assert write(folder, layout) == []
    assert tree(folder) == wanted
    of_pair = RECORD.replace(".json", ".tar") if plan.layout.packed else plan.files("train", 1)["left"]
    (folder / RECORD).unlink()
    (folder / of_pair).write_bytes((folder / of_pair).read_bytes()[:20])
    assert write(folder, layout) == [0]
    assert tree(folder) == wanted


@pytest.mark.parametrize(("before", "made"), [(2, [1]), (1, [0, 1]), (3, [1])])
@pytest.mark.parametrize("layout", ["middlebury", "webdataset", "middlebury-2014"])
def test_a_dataset_grows_to_what_a_larger_one_is(clean, tmp_path, layout, before, made):
    write(tmp_path / "set", layout, {"train": before, "validation": 1})
    assert write(tmp_path / "set", layout) == made
    assert tree(tmp_path / "set") == tree(clean / layout)
    with pytest.raises(InputError, match=r"^pairs: expected at least the 4 pairs .*got 2: .*cannot shrink"):
        write(tmp_path / "set", layout, {"train": 2, "validation": 1})
    assert tree(tmp_path / "set") == tree(clean / layout)


def test_a_copy_with_folders_for_links_does_not_grow(clean, tmp_path):
    shutil.copytree(clean / "sceneflow", tmp_path / "copy")
    with pytest.raises(FileExistsError, match="frames_"):
        write(tmp_path / "copy", "sceneflow", PAIRS | {"train": 6})


def test_the_lock_file_of_a_finished_dataset_goes_with_an_error_too(clean, tmp_path):
    folder = copied(clean, "middlebury", tmp_path / "set")
    with suppress(Killed), locked(open_root(folder)):
        raise Killed
    assert tree(folder) == tree(clean / "middlebury")


@pytest.mark.parametrize("others", [False, True])
def test_a_run_that_is_alone_replaces_a_plan_for_which_nothing_was_made(tmp_path, others):
    config = tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})
    root, plan = open_root(tmp_path), make_plan(config, 1, "kitti", {"train": 2}, 2)
    begin(root, plan)
    (tmp_path / f"{PLAN}.7.new").touch()  # of a run that was killed while it wrote the plan
    with locked(root, shared=True) if others else nullcontext():
        with pytest.raises(InputError, match="another run") if others else nullcontext():
            assert generate(config, tmp_path, 1, 2, shards=range(1)).plan.layout_name == "middlebury"
        assert (read_plan(root) == plan) == others
    if not others:
        with pytest.raises(InputError, match="seed"):  # now there is a pair
            generate(config, tmp_path, 1, 3, shards=range(1))


@pytest.mark.parametrize("made_anew", [False, True])
def test_a_lock_that_another_run_removed_meanwhile_locks_nothing(tmp_path, monkeypatch, made_anew):
    def flock(*_):
        (tmp_path / LOCK).unlink()
        if made_anew:
            (tmp_path / LOCK).touch()

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.raises(InputError, match="another run"), locked(open_root(tmp_path)):
        pass


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 4}, "seed"),
        ({"config": config_of(outputs=[])}, r": outputs \(\['visibility'\] there, \[\] now\)\. "),
        ({"layout": "kitti"}, r": layout \('middlebury' there, 'kitti' now\)\. .* --overwrite"),
        ({"shard_pairs": 1}, "shard_pairs"),
        ({"pairs": {"train": 4}}, "validation"),
        ({"pairs": PAIRS | {"test": 1}}, r"test \(no pairs there\)"),
        ({"level": 9}, "photographs or models"),
        ({"version": "9.0"}, r"version \(.* there, '9\.0' now\)"),
    ],
)
def test_another_plan_is_refused_with_the_keys_that_differ(clean, change, said):
    folder, version = clean / "middlebury", {"version": change["version"]} if "version" in change else {}
    same = {"layout": "middlebury", "pairs": PAIRS, "shard_pairs": 2, "config": config_for("middlebury")}
    before = tree(folder)
    with pytest.raises(InputError, match=said):
        begin(open_root(folder), plan_of(**(same | ({} if version else change)))[0].model_copy(update=version))
    assert tree(folder) == before


def test_a_folder_of_others_is_left_alone(tmp_path):
    plan, _ = plan_of("middlebury", PAIRS, 2)
    for name in ("notes.txt", "notes.json.12.new", INDEX, "shards/notes.txt"):
        folder = tmp_path / name.replace("/", "-")
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text("mine")
        for overwrite in (False, True):
            with pytest.raises(InputError, match=f"not empty.*{name}"):
                begin(open_root(folder), plan, overwrite=overwrite)
        assert tree(folder).keys() - {"shards"} == {name}
    with pytest.raises(InputError, match=r"out: .*expected a folder, got a file"):
        read_plan(open_root(folder / name))
    with (
        pytest.raises(InputError, match="cannot be written to"),
        locked(open_root(tmp_path / "notes.txt" / "notes.txt")),
    ):
        pass


@pytest.mark.parametrize("before", LAYOUTS)
def test_overwrite_removes_the_folders_of_the_old_dataset_and_no_others(clean, tmp_path, before):
    folder = copied(clean, before, tmp_path / "set")
    others = ["notes.txt", "notes.json.12.new", "photos/mine.png"]
    for name in (*others, "shards/semisynth-lab-train-000000.json.12.new"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("mine")
    write(folder, "eth3d", overwrite=True)
    assert all((folder / name).read_text() == "mine" for name in others)
    (folder / others[0]).unlink()
    (folder / others[1]).unlink()
    shutil.rmtree(folder / "photos")
    write(tmp_path / "wanted", "eth3d")
    assert tree(folder) == tree(tmp_path / "wanted")


def test_overwrite_makes_a_finished_dataset_anew_and_goes_on_with_an_unfinished_one(clean, tmp_path):
    folder = copied(clean, "middlebury", tmp_path / "set")
    image = folder / read_index(folder).plan.files("train", 0)["left"]
    image.write_bytes(bytes(image.stat().st_size))
    assert write(folder, "middlebury", overwrite=True) == [0, 1, 2]
    assert tree(folder) == tree(clean / "middlebury")
    (folder / INDEX).unlink()
    (folder / RECORD).unlink()
    assert write(folder, "middlebury", overwrite=True) == [0]
    assert tree(folder) == tree(clean / "middlebury")


class Killed(BaseException):
    """Stands for a kill of the process."""


@pytest.mark.parametrize("before", ["sceneflow", "middlebury", "webdataset"])
def test_overwrite_ended_at_any_removal_goes_on(clean, tmp_path, before):
    unlink, wanted = Path.unlink, tree(clean / "webdataset")
    for moment in count(1, 7 if before == "sceneflow" else 2):
        folder, left = copied(clean, before, tmp_path / f"{moment}"), [moment]

        def deadly(path, *rest, left=left, **options):
            left[0] -= 1
            if not left[0]:
                raise Killed
            unlink(path, *rest, **options)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Path, "unlink", deadly)
            with suppress(Killed):
                write(folder, "webdataset", overwrite=True)
        write(folder, "webdataset", overwrite=True)
        assert tree(folder) == wanted
        if left[0] > 0:
            break
    assert moment > 9


@pytest.mark.parametrize("name", [PLAN, RECORD, INDEX])
def test_killed_before_it_renames_a_file_a_run_goes_on(clean, tmp_path, name):
    def deadly(path, to):
        if Path(to) == folder / name:
            raise Killed
        return replace(path, to)

    replace, folder, nothing = Path.replace, tmp_path / "set", tmp_path / "none"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "replace", deadly)
        with suppress(Killed):
            write(folder, "middlebury")
    shutil.copytree(folder, nothing, symlinks=True)
    write(folder, "middlebury")
    assert tree(folder) == tree(clean / "middlebury")
    write(nothing, "webdataset", overwrite=True)
    assert tree(nothing) == tree(clean / "webdataset")


def test_a_store_is_filled_grown_and_overwritten_by_the_same_rules(clean, tmp_path):
    """Uses fsspec's in-memory store in place of a server."""
    address = f"memory://{tmp_path.name}/set"
    write(address, "sceneflow", {"train": 2, "validation": 1})
    assert write(address, "sceneflow") == [1]
    root = open_root(address)
    (root / "notes.txt").write_bytes(b"mine")
    write(address, "webdataset", overwrite=True)
    wanted = {name for name, content in tree(clean / "webdataset").items() if content is not None}
    assert {name for name in names_below(root) if not name.endswith(".log")} == wanted | {"notes.txt"}
    assert len(open_dataset(address)) == 5


def test_many_pairs_have_small_shards():
    def shard_pairs(pairs, **more):
        return make_plan(config_of(**more), 0, "webdataset", {"train": pairs}).shard_pairs

    assert [shard_pairs(pairs) for pairs in (1, 8, 24, 512, 100_000)] == [1, 1, 3, 64, 64]
    # A shard holds whole sequences.
    assert shard_pairs(100, sequence={"length": 5}) == 15
