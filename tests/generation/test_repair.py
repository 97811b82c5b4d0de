"""What a finished dataset has lost is made again by its command, and no link leads what a run writes out of it."""

import json
import os
import shutil
from pathlib import Path

import pytest
from backends import backend_fault
from hand_made_datasets import SEED, config_of, sources_of, write_dataset
from recorder import Recorder
from tiny_datasets import cheap, digests

from semisynth_gl.dataset.begun import read_beginning
from semisynth_gl.dataset.files import DatasetFiles
from semisynth_gl.dataset.places import Folder, open_place
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.dataset.remote import Remote
from semisynth_gl.generation.generate import generate
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.verification.dataset import verify_dataset

PAIRS = {"train": 2, "validation": 1}
LAYOUTS = ("middlebury", "webdataset", "middlebury-2014", "sceneflow", "kitti")
INDEX, PLAN, CARD = "index.json", "shards/plan.json", "README.md"
SHARD = "semisynth-lab-train-000000"


@pytest.fixture(autouse=True)
def _quick_disk(monkeypatch):
    """The tests kill no kernel, so nothing has to wait for the disk."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


def config_for(layout):
    return config_of(outputs=["visibility", "instances"] if layout == "kitti" else ["visibility"])


def write(out, layout, **options):
    return write_dataset(out, layout, options.pop("pairs", PAIRS), 2, config_for(layout), **options)


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    root = tmp_path_factory.mktemp("clean")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        for layout in LAYOUTS:
            write(root / layout, layout)
    return root


def copied(clean, layout, to):
    return shutil.copytree(clean / layout, to, symlinks=True)


def tree(folder):
    """Every file, link and folder below a folder, with what it holds or leads to; logs say how long it took."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        found[name] = str(path.readlink()) if path.is_symlink() else path.read_bytes() if path.is_file() else None
    return found


def parts_of(folder):
    """A file, link or empty folder of each kind: all but those of the second pair and of the validation pairs."""
    return [
        name
        for name, content in tree(folder).items()
        if (content is not None or not any((folder / name).iterdir()))
        and not any(part in name for part in ("validation", "000001", "0001", "000002"))
    ]


def remove(path):
    path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()


def assert_whole(folder, wanted):
    assert tree(folder) == wanted
    verdicts = list(verify_dataset(read_index(folder)))
    assert [
        finding for verdict in verdicts for finding in verdict.findings if finding.check in ("files", "shard")
    ] == []
    assert len(open_dataset(folder)) == sum(PAIRS.values())


@pytest.mark.parametrize("layout", LAYOUTS)
def test_whatever_is_removed_the_same_command_makes_again(clean, tmp_path, layout):
    wanted, names = tree(clean / layout), parts_of(clean / layout)
    assert {INDEX, PLAN, CARD, f"shards/{SHARD}.json", f"shards/{SHARD}.log"} <= set(names)
    folder = copied(clean, layout, tmp_path / "set")
    for name in names:
        remove(folder / name)
        write(folder, layout)
        if name.endswith(".log"):
            # How long it took is not known any more, and nothing needs it.
            assert not (folder / name).exists()
            shutil.copy(clean / layout / name, folder / name)
        assert_whole(folder, wanted)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_is_cut_off_is_made_again(clean, tmp_path, layout):
    wanted = tree(clean / layout)
    folder = copied(clean, layout, tmp_path / "set")
    for name in parts_of(clean / layout):
        path = folder / name
        if path.is_symlink() or path.is_dir() or name == CARD or name.endswith(".log"):
            continue
        path.write_bytes(wanted[name][: len(wanted[name]) // 2])
        write(folder, layout)
        assert_whole(folder, wanted)


def test_what_users_add_to_the_card_stays(clean, tmp_path):
    folder = copied(clean, "middlebury", tmp_path / "set")
    with (folder / CARD).open("a") as card:
        card.write("\nSeen from the roof.\n")
    write(folder, "middlebury")
    assert (folder / CARD).read_text().endswith("Seen from the roof.\n")


def test_a_link_that_leads_elsewhere_is_set_right(clean, tmp_path):
    folder = copied(clean, "middlebury", tmp_path / "set")
    link = next(path for path in (folder / "train").rglob("*") if path.is_symlink())
    target = link.readlink()
    link.unlink()
    link.symlink_to(tmp_path)
    write(folder, "middlebury")
    assert link.readlink() == target
    assert tree(folder) == tree(clean / "middlebury")


def test_a_copy_without_links_is_complete_and_does_not_grow(clean, tmp_path):
    """As `cp -rL` makes it."""
    folder = shutil.copytree(clean / "middlebury", tmp_path / "set")
    before = tree(folder)
    write(folder, "middlebury")
    assert tree(folder) == before
    with pytest.raises(InputError, match=r"carla-highres/trainingF: expected a link to \.\./MiddEval3/trainingF"):
        write(folder, "middlebury", pairs={"train": 3, "validation": 1})
    assert tree(folder) == before


def test_killed_while_it_restores_the_plan_a_dataset_is_no_riddle(clean, tmp_path, monkeypatch):
    """An index or a plan is there at any moment."""
    folder = copied(clean, "middlebury", tmp_path / "set")
    (folder / PLAN).unlink()
    plan, place = make_plan(config_for("middlebury"), SEED, "middlebury", PAIRS, 2), Folder(folder)
    seen = []

    def watched(self, *arguments, of):
        of(self, *arguments)
        seen.append(read_beginning(place) is not None)

    for name in ("write", "remove"):
        of = getattr(Folder, name)
        monkeypatch.setattr(Folder, name, lambda self, *arguments, of=of: watched(self, *arguments, of=of))
    files = DatasetFiles(place, plan, overwrite=False)
    assert files.lost == [PLAN]
    files.open({split: sources.digests() for split, sources in sources_of(plan).items()})
    files.close()
    assert len(seen) > 1
    assert all(seen)


def test_the_command_says_what_it_makes_again(tmp_path):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    config = cheap(textures={"source": "procedural", "max_patches": 16})
    generate(config, tmp_path / "set", 2, SEED)
    wanted = digests(tmp_path / "set")
    for name in (PLAN, "MiddEval3/official_train.txt"):
        (tmp_path / "set" / name).unlink()
        recorder = Recorder()
        generate(config, tmp_path / "set", 2, SEED, listener=recorder)
        assert f"{tmp_path / 'set'}: the dataset lacks {name}: writing it again" in recorder.messages
        assert recorder.pairs == []
        assert digests(tmp_path / "set") == wanted


# Links that lead out of a dataset


def led_out(folder, name, outside):
    """Put a link in the place of a folder, to that folder outside: without its links, and with a file to be removed."""
    path, moved = folder / name, outside / Path(name).name
    if path.exists():
        path.rename(moved)
        for link in moved.rglob("*"):
            if link.is_symlink():
                link.unlink()
    else:
        moved.mkdir()
    (moved / f"{SHARD}.jsonl").touch()
    path.symlink_to(moved)


def without(name):
    def act(folder, layout):
        (folder / name).unlink(missing_ok=True)
        write(folder, layout)

    return act


ATTEMPTS = {
    "the same": write,
    **{f"without {name}": without(name) for name in (PLAN, INDEX, f"shards/{SHARD}.json")},
    "more pairs": lambda folder, layout: write(folder, layout, pairs={"train": 5, "validation": 1}),
    "overwrite": lambda folder, layout: write(folder, layout, overwrite=True),
}
"""What may write to a dataset."""


def refusal(act):
    """What a run says that refuses; None where it does not."""
    try:
        act()
    except (SemisynthError, OSError) as error:
        return str(error)
    return None


@pytest.mark.parametrize("attempt", ATTEMPTS)
@pytest.mark.parametrize("layout", ["middlebury", "webdataset", "middlebury-2014"])
def test_no_link_in_the_place_of_a_folder_leads_a_run_out(clean, tmp_path, layout, attempt):
    folders = [name for name, content in tree(clean / layout).items() if content is None]
    refused = 0
    for number, name in enumerate((".partial", *folders)):
        folder, outside = copied(clean, layout, tmp_path / f"{number}"), tmp_path / f"outside-{number}"
        outside.mkdir()
        led_out(folder, name, outside)
        before = tree(outside)
        said = refusal(lambda folder=folder: ATTEMPTS[attempt](folder, layout))
        if attempt.startswith("without shards") and name == "shards":
            # The test itself has removed the file, through the link.
            del before[f"shards/{attempt.rpartition('/')[2]}"]
        assert tree(outside) == before, name
        assert said is None or f"{name}" in said, (name, said)
        refused += said is not None
        shutil.rmtree(folder)
    # A finished dataset is not written to, nor are folders that hold links of the layout alone.
    assert refused >= (1 if attempt == "the same" and layout == "webdataset" else 2)


IN_PLACE = (".partial/lock", f".partial/{SHARD}.jsonl", f".partial/{SHARD}.tar", f".partial/{SHARD}.0")


@pytest.mark.parametrize("layout", ["middlebury", "webdataset"])
@pytest.mark.parametrize("name", IN_PLACE)
def test_no_link_in_the_place_of_an_unfinished_file_leads_a_run_out(clean, tmp_path, layout, name):
    folder = copied(clean, layout, tmp_path / "set")
    outside = tmp_path / "mine.txt"
    outside.write_text("mine")
    for target in (outside, tmp_path / "absent"):
        (folder / ".partial").mkdir(exist_ok=True)
        (folder / f"shards/{SHARD}.json").unlink(missing_ok=True)
        (folder / INDEX).unlink(missing_ok=True)
        (folder / name).symlink_to(target)
        said = refusal(lambda: write(folder, layout))
        assert outside.read_text() == "mine"
        assert not (tmp_path / "absent").exists()
        if said is None:
            # The name is the program's own, or the layout has no such file.
            assert name.endswith((".0", ".tar"))
        else:
            assert f"{name} is a link, and may lead out of the dataset's folder: remove it" in said
        (folder / name).unlink(missing_ok=True)
    write(folder, layout)
    assert tree(folder) == tree(clean / layout)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_links_of_the_layout_do_not_stand_in_the_way(clean, tmp_path, layout):
    links = [name for name in tree(clean / layout) if (clean / layout / name).is_symlink()]
    assert bool(links) == (layout != "webdataset")
    folder = copied(clean, layout, tmp_path / "set")
    write(folder, layout, pairs={"train": 5, "validation": 1})
    write(folder, layout, overwrite=True)
    assert tree(folder) == tree(clean / layout)
    write(folder, "eth3d", overwrite=True)
    assert read_index(folder).layout_name == "eth3d"
    assert not [name for name in links if os.path.lexists(folder / name)]


def test_a_folder_may_itself_be_reached_by_a_link(clean, tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "set").symlink_to(tmp_path / "disk")
    write(tmp_path / "set", "middlebury")
    assert tree(tmp_path / "disk") == tree(clean / "middlebury")


def test_addresses_of_this_machine_are_folders(tmp_path):
    for protocol in ("file", "local"):
        place = open_place(f"{protocol}://{tmp_path}")
        assert not isinstance(place, Remote)
        assert place.local == tmp_path


def test_a_record_of_what_was_begun_stays_the_plan(clean):
    """The plan that is restored from an index is the one that was written."""
    for layout in LAYOUTS:
        index = json.loads((clean / layout / INDEX).read_text())
        plan = json.loads((clean / layout / PLAN).read_text())
        assert {key: index[key] for key in plan} == plan
