"""Datasets in every layout: the same bytes however they come about, and nothing lost whatever happens."""

import errno
import json
import os
import shutil
import signal
import subprocess
import threading
import time
from contextlib import closing

import numpy as np
import pytest
from backends import backend_fault
from recorder import Recorder
from tiny_datasets import PAIRS, SEED, command, digests, findings, tiny

from semisynth_gl.config import load_config
from semisynth_gl.dataset.files import DatasetFiles
from semisynth_gl.dataset.places import Folder
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.dataset.shard import ShardBusyError, ShardWriter
from semisynth_gl.engines.local import LocalEngine
from semisynth_gl.generation import shard_job
from semisynth_gl.generation.generate import generate
from semisynth_gl.generation.in_flight import encoded
from semisynth_gl.inputs.errors import ContextLostError, InputError
from semisynth_gl.layouts import layout_names
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.scene.sources import prepare_sources

# Reached only where something that must happen never does.
PATIENCE_S = 120


@pytest.fixture(scope="module")
def config():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})


@pytest.fixture(scope="module", params=["middlebury", "webdataset"])
def undisturbed(request, config, tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed") / request.param
    generate(config, out, PAIRS, SEED, layout=request.param, shard_pairs=3)
    return request.param, out, digests(out)


def resumed(config, out, layout):
    """Run again, and tell which pairs were made and which were kept."""
    recorder = Recorder()
    generate(config, out, PAIRS, SEED, layout=layout, shard_pairs=3, listener=recorder)
    return {pair.index for pair in recorder.pairs if not pair.kept}


@pytest.mark.parametrize("name", ["kitti", "eth3d", "sceneflow"])
def test_a_benchmarks_config_has_the_benchmarks_layout(config, tmp_path, name):
    own = config.model_copy(update={"layout": load_config(name).layout})
    assert (own.layout, own.digest()) == (name, config.digest())  # a layout changes no pair
    assert generate(own, tmp_path / "own", 1, SEED).plan.layout_name == name
    assert generate(own, tmp_path / "chosen", 1, SEED, layout="middlebury").plan.layout_name == "middlebury"
    # A dataset grows in the layout that it was begun with.
    assert generate(own, tmp_path / "chosen", 2, SEED).plan.layout_name == "middlebury"
    assert findings(tmp_path / "own") == []


def test_without_a_layout_the_number_of_pairs_decides(config, tmp_path):
    kitti = config.model_copy(update={"layout": "kitti"})
    first = {"shard_pairs": 1, "shards": range(1)}
    for name, chosen, pairs in (("few", config, 9_999), ("many", config, 10_000), ("own", kitti, 10_000)):
        result = generate(chosen, tmp_path / name, pairs, SEED, **first)
        assert result.plan.layout_name == {"few": "middlebury", "many": "webdataset", "own": "kitti"}[name]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["files.disparity=png16"], "choose another `layout`: middlebury, webdataset"),
        (["outputs=[correspondence]"], "choose another `layout`: middlebury, middlebury-2014, webdataset"),
        (["disparity.signed=true"], "choose another `layout`: eth3d, middlebury, middlebury-2014, sceneflow, "),
    ],
)
def test_what_a_configs_layout_cannot_hold_is_refused_with_those_that_can(tmp_path, settings, said):
    with pytest.raises(InputError, match=f"the layout kitti .*{said}"):
        generate(load_config("kitti", settings), tmp_path / "out", 1)


@pytest.mark.parametrize("layout", layout_names())
def test_every_layout_reads_back_and_verifies_clean(config, tmp_path, layout):
    generate(config, tmp_path, 2, SEED, layout=layout, shard_pairs=1)
    assert findings(tmp_path, 40) == []
    with PairRenderer(config, SEED) as pairs:
        frame = pairs.render(1).frame
    dataset = open_dataset(tmp_path)
    assert len(dataset) == 2
    read = dataset[1]
    if read.encodings.image.lossless:
        np.testing.assert_array_equal(read.left.image, frame.left.image)
        np.testing.assert_array_equal(read.right.image, frame.right.image)
    for side in ("left", "right"):
        came, made = read.view(side).disparity, frame.view(side).disparity
        np.testing.assert_allclose(came, made, rtol=0, atol=read.encodings.disparity.error_px)
        # Whether a hidden point is outside follows from its disparity, which codecs may round.
        share = 0 if read.encodings.disparity.lossless else 1e-3
        assert (read.view(side).visibility != frame.view(side).visibility).mean() <= share
    assert read.camera == frame.camera or layout.startswith(("middlebury", "eth3d"))
    assert read.camera.focal_px == frame.camera.focal_px
    with pytest.raises(IndexError):
        dataset[2]


def test_workers_change_no_byte(undisturbed, config, tmp_path):
    layout, _, wanted = undisturbed
    recorder = Recorder()
    generate(
        config, tmp_path / "o", PAIRS, SEED, layout=layout, shard_pairs=3, engine=LocalEngine(2, 300.0),
        listener=recorder,
    )  # fmt: skip
    assert digests(tmp_path / "o") == wanted
    assert sorted(pair.index for pair in recorder.pairs) == list(range(PAIRS))


def test_another_seed_gives_other_bytes(undisturbed, config, tmp_path):
    layout, _, wanted = undisturbed
    generate(config, tmp_path / "o", PAIRS, SEED + 1, layout=layout, shard_pairs=3)
    other = digests(tmp_path / "o")
    assert other.keys() == wanted.keys()
    pixels = [name for name in wanted if name.endswith((".tar", "im0.png", "disp0GT.pfm"))]
    assert pixels
    assert all(other[name] != wanted[name] for name in pixels)


def test_a_complete_dataset_is_left_alone(undisturbed, config, tmp_path):
    layout, out, wanted = undisturbed
    shutil.copytree(out, tmp_path / "o", symlinks=True)
    assert resumed(config, tmp_path / "o", layout) == set()
    assert digests(tmp_path / "o") == wanted


def test_what_was_cut_off_is_made_again(undisturbed, config, tmp_path):
    """As after a loss of power: the newest files are shorter, or empty."""
    layout, out, wanted = undisturbed
    shutil.copytree(out, tmp_path / "o", symlinks=True)
    o = tmp_path / "o"
    newest = "shards/semisynth-middlebury-train-000002"
    victim = o / (f"{newest}.tar" if layout == "webdataset" else "MiddEval3/trainingF/middlebury-000006/im0.png")
    os.truncate(victim, 1000)
    os.truncate(o / "shards/semisynth-middlebury-train-000001.json", 70)
    os.truncate(o / "index.json", 0)
    assert resumed(config, o, layout) == {3, 4, 5, 6}
    assert digests(o) == wanted


def test_a_dataset_grows_to_what_a_larger_one_is(undisturbed, config, tmp_path):
    layout, _, wanted = undisturbed
    generate(config, tmp_path / "o", 4, SEED, layout=layout, shard_pairs=3)
    assert resumed(config, tmp_path / "o", layout) == {3, 4, 5, 6}
    assert digests(tmp_path / "o") == wanted
    with pytest.raises(InputError, match=r"train \(7 there, 6 now\)"):
        generate(config, tmp_path / "o", 6, SEED, layout=layout, shard_pairs=3)


def test_shards_by_machine_make_the_whole(undisturbed, config, tmp_path):
    layout, _, wanted = undisturbed
    for shards, missing in ((range(2, 3), 2), (range(2), 0)):
        made = generate(config, tmp_path / "o", PAIRS, SEED, layout=layout, shard_pairs=3, shards=shards)
        assert made.missing == missing
        assert (tmp_path / "o/index.json").exists() == (missing == 0)
    assert digests(tmp_path / "o") == wanted


def test_a_stop_keeps_the_pairs_in_hand(undisturbed, config, tmp_path):
    layout, _, wanted = undisturbed
    made = generate(
        config,
        tmp_path / "o",
        PAIRS,
        SEED,
        layout=layout,
        shard_pairs=3,
        listener=Recorder(lambda pair: pair.index == 4),
    )
    assert (made.stopped, made.missing) == (True, 2)
    assert resumed(config, tmp_path / "o", layout) == {5, 6}
    assert digests(tmp_path / "o") == wanted


@pytest.fixture
def with_encoders(monkeypatch):
    """Takes the driver for a GPU's, and gives each worker two threads that encode."""
    monkeypatch.setattr(shard_job, "is_software", lambda _: False)
    monkeypatch.setattr(shard_job, "_ENCODERS", 2)


@pytest.mark.usefixtures("with_encoders")
def test_pairs_in_flight_have_the_same_bytes(undisturbed, config, tmp_path):
    layout, _, wanted = undisturbed
    generate(config, tmp_path / "o", PAIRS, SEED, layout=layout, shard_pairs=3)
    assert digests(tmp_path / "o") == wanted


@pytest.mark.usefixtures("with_encoders")
def test_a_stop_finishes_the_pairs_in_flight(config, tmp_path):
    recorder = Recorder(lambda pair: pair.index == 0)
    made = generate(config, tmp_path / "o", PAIRS, SEED, shard_pairs=PAIRS, listener=recorder)
    assert (made.stopped, made.missing) == (True, 1)
    assert [pair.index for pair in recorder.pairs] == [0, 1, 2]


def test_pairs_are_encoded_while_others_are_drawn_and_come_in_order():
    drawn = [threading.Event() for _ in range(8)]

    def draw():
        for number, event in enumerate(drawn):
            event.set()
            yield number

    def encode(number):
        # The last ones have nothing to wait for.
        ahead = drawn[min(number + 2, len(drawn) - 1)]
        assert ahead.wait(PATIENCE_S)
        return number, threading.current_thread() is threading.main_thread()

    assert list(encoded(draw(), encode, 2)) == [(number, False) for number in range(8)]
    assert list(encoded(range(3), lambda number: (number, threading.current_thread().name), 0)) == [
        (number, threading.main_thread().name) for number in range(3)
    ]


@pytest.mark.parametrize("threads", [0, 1, 3])
def test_an_error_comes_after_the_pairs_before_it(threads):
    def draw():
        yield from range(4)
        raise InputError("no fifth pair")

    done = []
    with pytest.raises(InputError, match="no fifth pair"):
        done.extend(encoded(draw(), str, threads))
    with pytest.raises(ZeroDivisionError):
        done.extend(encoded(iter([1, 2, 0, 4, 5]), lambda number: 1 // number, threads))
    assert done == ["0", "1", "2", "3", 1, 0]


@pytest.mark.parametrize("threads", [0, 1, 3])
@pytest.mark.parametrize(
    ("error", "most_drawn"), [(GeneratorExit, 6), (ZeroDivisionError, 13), (KeyboardInterrupt, 16)]
)
def test_few_pairs_are_in_flight_and_no_thread_outlives_an_error(threads, error, most_drawn):
    """One of who takes the pairs, at pair 5, of encoding, at pair 12, and of drawing, after 16 pairs."""
    drawn, before = [], threading.active_count()

    def draw():
        for number in range(16):
            drawn.append(number)
            yield number
        if error is KeyboardInterrupt:
            raise error

    def encode(number):
        if error is ZeroDivisionError and number == 12:
            raise ZeroDivisionError
        return number

    def take():
        with closing(encoded(draw(), encode, threads)) as pairs:
            for number in pairs:
                # Those that wait, and the one that has just been drawn.
                assert len(drawn) <= number + threads + 1
                if error is GeneratorExit and number == 5:
                    raise GeneratorExit

    with pytest.raises(error):
        take()
    assert len(drawn) <= most_drawn + threads
    assert threading.active_count() == before


def test_a_full_disk_costs_no_pair(undisturbed, config, tmp_path, monkeypatch):
    layout, _, wanted = undisturbed
    whole, count = ShardWriter.add, [0]

    def add(self, files, facts):
        count[0] += 1
        if count[0] == 6:

            def fail(*_):
                raise OSError(errno.ENOSPC, "No space left on device")

            # In the middle of the pair's files.
            names = list(files)
            files = {name: files[name] for name in names}
            monkeypatch.setattr("semisynth_gl.dataset.shard.json.dumps", fail)
        try:
            return whole(self, files, facts)
        finally:
            monkeypatch.undo() if count[0] == 6 else None

    with monkeypatch.context() as patch:
        patch.setattr(ShardWriter, "add", add)
        with pytest.raises(OSError, match="No space left"):
            generate(config, tmp_path / "o", PAIRS, SEED, layout=layout, shard_pairs=3)
    assert resumed(config, tmp_path / "o", layout) == {5, 6}
    assert digests(tmp_path / "o") == wanted


def test_a_lost_context_is_opened_again(undisturbed, config, tmp_path, monkeypatch):
    layout, _, wanted = undisturbed
    whole, lost = PairRenderer.render, []

    def render(self, index):
        if index == 4 and not lost:
            lost.append(index)
            raise ContextLostError("the driver lost its context while it drew a pair")
        return whole(self, index)

    monkeypatch.setattr(PairRenderer, "render", render)
    recorder = Recorder()
    generate(config, tmp_path / "o", PAIRS, SEED, layout=layout, shard_pairs=3, listener=recorder)
    assert any("lost its context" in message for message in recorder.messages)
    assert digests(tmp_path / "o") == wanted


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGTERM], ids=["kill", "term"])
def test_killed_at_several_moments_it_comes_out_the_same(undisturbed, config, tmp_path, sent):
    """The many moments are in the long fault runs."""
    layout, _, wanted = undisturbed
    out = tmp_path / "o"
    for moment in (1.6, 2.1):
        process = subprocess.Popen(
            command(config, out, layout), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        time.sleep(moment)
        process.send_signal(sent)
        _, said = process.communicate(timeout=60)
        assert "Traceback" not in said
    done = subprocess.run(command(config, out, layout), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert digests(out) == wanted


def test_two_runs_at_once_share_the_work(undisturbed, config, tmp_path):
    layout, _, wanted = undisturbed
    runs = [
        subprocess.Popen(command(config, tmp_path / "o", layout), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    for each in runs:
        _, said = each.communicate(timeout=120)
        assert each.returncode == 0, said
    assert digests(tmp_path / "o") == wanted


@pytest.mark.parametrize("overwrite", [False, True])
def test_two_runs_may_begin_at_the_same_moment(config, tmp_path, overwrite):
    """Neither sees a dataset when it looks; the second takes up what the first began, or is told why it cannot."""
    sources = {"train": {"patches": "0"}}
    place = Folder(tmp_path)

    def looked(seed):
        return DatasetFiles(place, make_plan(config, seed, "webdataset", {"train": 2}), overwrite=overwrite)

    first, same, other_seed, other_sources = looked(SEED), looked(SEED), looked(SEED + 1), looked(SEED)
    first.open(sources)
    begun = (tmp_path / "shards/plan.json").read_bytes()
    same.open(sources)
    with pytest.raises(InputError, match="seed"):
        other_seed.open(sources)
    with pytest.raises(InputError, match="photographs or models"):
        other_sources.open({"train": {"patches": "1"}})
    assert (tmp_path / "shards/plan.json").read_bytes() == begun
    for files in (first, same, other_seed, other_sources):
        files.close()


def test_a_shard_in_other_hands_is_busy(config, tmp_path):
    shard = make_plan(config, SEED, "webdataset", {"train": 2}).shards[0]
    with (
        ShardWriter(Folder(tmp_path), shard, packed=True, folder=""),
        pytest.raises(ShardBusyError),
    ):
        ShardWriter(Folder(tmp_path), shard, packed=True, folder="")
    ShardWriter(Folder(tmp_path), shard, packed=True, folder="").close()


def test_splits_share_neither_photographs_nor_scenes(config, tmp_path):
    made = generate(config, tmp_path / "o", {"train": 3, "validation": 2, "test": 1}, SEED, layout="webdataset")
    assert findings(tmp_path / "o", 20) == []
    index = json.loads((tmp_path / "o/index.json").read_text())
    digests_of = [{photograph["sha256"] for photograph in split["photographs"]} for split in index["splits"].values()]
    assert all(digests_of)
    assert len(set.union(*digests_of)) == sum(map(len, digests_of))
    assert all(photograph["licence"] for split in index["splits"].values() for photograph in split["photographs"])
    assert [len(open_dataset(tmp_path / "o", split)) for split in made.plan.splits] == [3, 2, 1]
    one, other = open_dataset(tmp_path / "o", "train")[0], open_dataset(tmp_path / "o", "test")[0]
    assert one.camera != other.camera
    with pytest.raises(InputError, match="pairs"):
        generate(config, tmp_path / "o", 3, SEED, layout="webdataset")
    few = tiny(textures={"source": "images", "images": [str(tmp_path / "one.png")]})
    from PIL import Image

    noise = np.random.default_rng(0).integers(0, 256, (99, 99, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "one.png")
    with pytest.raises(InputError, match="too few photographs to hold some out, 1 in all"):
        generate(few, tmp_path / "p", {"train": 1, "test": 1}, SEED)


def test_models_are_held_out_where_asked():
    config = tiny()
    config = config.model_copy(update={"splits": config.splits.model_copy(update={"models": True})})
    plan = make_plan(config, 0, "middlebury", {"train": 1, "test": 1})
    names = [{mesh.name for mesh in prepare_sources(config, plan.split(split)).models} for split in plan.splits]
    assert all(names)
    assert not names[0] & names[1]


def test_other_photographs_are_not_mixed_in(tmp_path):
    from PIL import Image

    rng = np.random.default_rng(0)
    picture = tmp_path / "one.png"
    config = tiny(textures={"source": "images", "images": [str(picture)]})
    Image.fromarray(rng.integers(0, 256, (99, 99, 3), dtype=np.uint8)).save(picture)
    generate(config, tmp_path / "o", 1, SEED, shard_pairs=1)
    Image.fromarray(rng.integers(0, 256, (99, 99, 3), dtype=np.uint8)).save(picture)
    with pytest.raises(InputError, match="photographs or models are not those"):
        generate(config, tmp_path / "o", 2, SEED, shard_pairs=1)


def test_other_peoples_files_are_never_deleted(config, tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(InputError, match=r"precious\.txt"):
            generate(config, tmp_path, 1, SEED, overwrite=overwrite)
    generate(config, tmp_path / "o", 1, SEED)
    (tmp_path / "o/notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        generate(config, tmp_path / "o", 1, SEED + 1, overwrite=True)
    (tmp_path / "o/notes.txt").unlink()
    generate(config, tmp_path / "o", 2, SEED + 1, layout="kitti", overwrite=True)
    assert not (tmp_path / "o/MiddEval3").exists()
    assert findings(tmp_path / "o") == []


def test_a_name_of_a_file_proves_nothing(config, tmp_path):
    (tmp_path / "o").mkdir()
    for text in ('{"my": 1}', "not json", "[]"):
        (tmp_path / "o/index.json").write_text(text)
        with pytest.raises(InputError, match="Choose another"):
            generate(config, tmp_path / "o", 1, SEED, overwrite=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="it is a file"):
        generate(config, tmp_path / "file", 1, SEED)
    with pytest.raises(InputError, match="cannot be written"):
        generate(config, tmp_path / "file" / "below", 1, SEED)


def test_object_stores_take_whole_shards(undisturbed, config, tmp_path):
    """fsspec's store in memory stands in for those that need a server."""
    pytest.importorskip("fsspec")
    layout, _, wanted = undisturbed
    address = f"memory://{tmp_path.name}-{layout}"
    made = generate(
        config, address, PAIRS, SEED, layout=layout, shard_pairs=3, listener=Recorder(lambda pair: pair.index == 4)
    )
    assert made.missing == 2
    assert not any(name.endswith("train-000001.json") for name in made.place.names())
    generate(config, address, PAIRS, SEED, layout=layout, shard_pairs=3)
    assert findings(address) == []
    for name in made.place.names():
        (tmp_path / "o" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "o" / name).write_bytes(made.place.read(name))
    assert digests(tmp_path / "o") == wanted
    assert open_dataset(address)[6].left.image.shape == (config.camera.height_px, config.camera.width_px, 3)


def test_a_store_has_a_copy_where_loaders_find_nothing_without_a_link(config, tmp_path):
    pytest.importorskip("fsspec")
    splits = {"train": 2, "validation": 1, "test": 1}
    place = generate(config, f"memory://{tmp_path.name}-copied", splits, SEED, layout="sceneflow").place
    images = {name: place.read(name) for name in place.names() if "/frames_cleanpass/" in name}
    assert len(images) == 8
    for name, data in images.items():
        assert place.read(name.replace("frames_cleanpass", "frames_finalpass")) == data
    assert findings(place.address) == []
    # Copies that an earlier dataset leaves would be read as pairs of this one.
    generate(config, place.address, 1, SEED, layout="middlebury", overwrite=True)
    assert not [name for name in place.names() if "frames_" in name]
