"""Truncated or tampered datasets: readers refuse them with file and key, and verify finds them."""

import json
import math
import shutil
from functools import partial

import numpy as np
import pytest
from hand_made_datasets import SEED, config_of, write_dataset
from hand_made_pairs import make_frame
from planted_faults import change_json
from processes import assert_refused

from semisynth_gl.dataset.folder import begin, read_plan
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import open_dataset, read_index, read_record
from semisynth_gl.dataset.root import open_root
from semisynth_gl.inputs.errors import SemisynthError
from semisynth_gl.judge.truth import find_truth
from semisynth_gl.judge.verify import verify

PAIRS = {"train": 2, "validation": 1}
INDEX, PLAN = "index.json", "shards/plan.json"
RECORD, TAR = "shards/semisynth-lab-train-000000.json", "shards/semisynth-lab-train-000000.tar"
LAYOUTS = ("middlebury", "webdataset")


@pytest.fixture(scope="module")
def plans():
    return {name: make_plan(config_of(), SEED, name, PAIRS, 2) for name in LAYOUTS}


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    root = tmp_path_factory.mktemp("clean")
    for name in LAYOUTS:
        write_dataset(root / name, name, PAIRS, 2)
    return root


@pytest.fixture(params=LAYOUTS)
def dataset(request, clean, tmp_path):
    return shutil.copytree(clean / request.param, tmp_path / request.param, symlinks=True)


def keys_of(value, above=()):
    """Yield the paths and values of all keys below a value; of a list, only of the first item."""
    items = value.items() if isinstance(value, dict) else enumerate(value[:1]) if isinstance(value, list) else ()
    for key, child in items:
        yield (*above, key), child
        yield from keys_of(child, (*above, key))


def tampered(values, path, value):
    """Return a document as JSON, with another value at a path of keys."""
    values = json.loads(json.dumps(values))
    *above, last = path
    node = values
    for key in above:
        node = node[key]
    node[last] = value
    return json.dumps(values)


def read_all(folder):
    """Read every pair and compare it with the truth."""
    opened = open_dataset(folder)
    for number in range(len(opened)):
        truth = make_frame(opened.pair(number)[1], ("visibility",)).arrays()
        for role, array in opened[number].arrays().items():
            np.testing.assert_array_equal(array, truth[role])


def found(folder):
    """Return the messages of verify."""
    try:
        return [finding.message for finding in verify(folder, rays=0).findings]
    except SemisynthError as error:
        return [str(error)]


def refusal(read, *arguments):
    """Return a reader's error message; None if it reads."""
    try:
        read(*arguments)
    except SemisynthError as error:
        return str(error)
    return None


# The config's keys that readers use.
READ_BY = ("name", "outputs", "truth", "camera", "width_px", "sequence", "length", "files", "image")
# Keys of records and of the index that readers ignore.
UNREAD = {"redrawn", "share_beyond", "left_out", "plugins"}


@pytest.mark.parametrize("name", [INDEX, PLAN, RECORD])
def test_a_key_with_a_wrong_value_is_refused_by_name(clean, plans, tmp_path, name):
    dataset, plan = tmp_path / "set", plans["webdataset"]
    (dataset / "shards").mkdir(parents=True)
    values, root, shard = json.loads((clean / "webdataset" / name).read_text()), open_root(dataset), plan.shards[0]
    readers = {
        INDEX: [partial(read_index, dataset)],
        PLAN: [partial(read_index, dataset), partial(read_plan, root)],
        RECORD: [partial(read_record, root, shard, packed=True)],
    }[name]
    for keys, original in keys_of(values):
        if keys[0] == "config_values" and not all(key in READ_BY for key in keys[1:]):
            continue
        if name == INDEX and (keys[0] in {"splits", "redraws", "bytes"} or (keys[0] in plan.values() and keys[1:])):
            continue  # the plan's own test covers them
        if UNREAD.intersection(keys):
            continue
        for value in (3 if isinstance(original, str) else "x", math.nan):
            (dataset / name).write_text(tampered(values, keys, value))
            for read in readers:
                assert name in str(refusal(read)), (keys, value)
    (dataset / name).write_text('{"program": ' + "[" * 100_000 + "]" * 100_000 + "}")
    with pytest.raises(SemisynthError, match=name):
        readers[0]()


@pytest.mark.parametrize("camera", [False, True])
def test_a_pair_of_which_the_provenance_says_another_thing_is_refused(clean, tmp_path, camera):
    dataset = shutil.copytree(clean / "middlebury", tmp_path / "set", symlinks=True)
    path = dataset / read_index(dataset).plan.files("train", 0)["provenance"]
    values = json.loads(path.read_text())
    changed = {"camera": values["camera"] | {"width_px": 7}} if camera else {"lens": "wide"}
    path.write_text(json.dumps(values | changed))
    said = f"{path}: " + ("expected a height and width" if camera else "lens: expected an object")
    assert said in str(refusal(read_all, dataset))
    assert any(path.name in message for message in found(dataset))


@pytest.mark.parametrize("name", [INDEX, PLAN, RECORD])
def test_a_file_cut_off_or_with_a_changed_byte_breaks_nothing(dataset, plans, name):
    path, plan = dataset / name, plans[dataset.name]
    data = path.read_bytes()
    if name == PLAN:
        (dataset / INDEX).unlink()
    rng = np.random.default_rng(5)
    for length in np.linspace(0, len(data) - 3, 4).astype(int):
        path.write_bytes(data[:length])
        assert any(name in message for message in found(dataset))
        assert name != PLAN or "neither resumed nor replaced" in refusal(read_plan, open_root(dataset))
        assert (refusal(read_all, dataset) is None) == (name == RECORD and dataset.name == "middlebury")
    for _ in range(8):
        changed = bytearray(data)
        for at in rng.integers(len(data), size=3):
            changed[at] = rng.choice([*b'0123456789-+.eE"{}[],:/\\', 0, 0x80, 0xFF])
        path.write_bytes(bytes(changed))
        found(dataset)
        for use in (read_all, find_truth):
            refusal(use, str(dataset))
        refusal(begin, open_root(dataset), plan)


def test_a_tar_that_is_cut_or_anothers_is_refused(clean, tmp_path):
    dataset = shutil.copytree(clean / "webdataset", tmp_path / "set")
    data = (dataset / TAR).read_bytes()
    # The last case keeps the length but breaks the members.
    for changed in (*(data[:length] for length in (0, 100, 700, len(data) // 2)), data[512:] + data[:512]):
        (dataset / TAR).write_bytes(changed)
        assert (TAR if len(changed) < len(data) else "00000000.left.png: expected a PNG") in refusal(read_all, dataset)
        assert any(TAR in message for message in found(dataset))
    (dataset / TAR).write_bytes(data)
    change_json(dataset / RECORD, lambda record: record["samples"][0]["files"].pop("00000000.left.png"))
    assert f"{RECORD}: has no entry for 00000000.left.png" in refusal(read_all, dataset)


@pytest.mark.parametrize("command", ["verify", "evaluate", "report"])
def test_commands_end_with_one_message(clean, tmp_path, program, command):
    dataset = shutil.copytree(clean / "webdataset", tmp_path / "set")
    change_json(dataset / INDEX, lambda index: index.update(pairs={"train": "many"}))
    arguments = {
        "verify": [dataset],
        "evaluate": ["--pred", tmp_path, "--gt", dataset],
        "report": [dataset, "--out", tmp_path / "page.html"],
    }[command]
    assert_refused(program(command, *arguments), "index.json: pairs.train: ")
