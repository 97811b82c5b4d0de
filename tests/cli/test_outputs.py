"""Where commands may write files and datasets."""

import shutil
from contextlib import nullcontext

import numpy as np
import pytest
from photograph_like import noise, save
from processes import assert_refused
from tiny_datasets import cheap

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.dataset.generate import check_outside_sources, generate
from semisynth_gl.dataset.root import open_root
from semisynth_gl.inputs.errors import InputError

PLAIN = "--focal-px 700 --baseline-m 0.12 --size 64x48 --range-px 1 8 --other-camera --trials 0"
SMALL = "--set camera.width_px=64 --set camera.height_px=48 --set models.variants=1 --set models.complex=0"
# Commands that end with an option that writes a file, and the file's extension.
COMMANDS = {
    "evaluate --pred {home}/pred --gt {home}/gt --json": ".json",
    f"preview --config sceneflow --images {{home}}/photos --pairs 1 {SMALL} --out": ".png",
    "report {home}/set --pairs 1 --out": ".html",
    f"calibrate --images {{home}}/photos {PLAIN} --out": ".yaml",
}


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Make a folder with photographs, a dataset, predictions and their truth."""
    folder = tmp_path_factory.mktemp("home")
    save(folder / "photos", one=noise(300, 300), other=noise(300, 300, 1))
    generate(cheap(textures={"source": "procedural", "max_patches": 16}), folder / "set", 2, 0, layout="middlebury")
    for path in ("pred/a.pfm", "gt/a/disp0GT.pfm"):
        (folder / path).parent.mkdir(parents=True)
        (folder / path).write_bytes(PFM.encode(np.full((20, 30), 3, np.float32)))
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_is_replaced_and_what_cannot_be_one_is_refused_first(program, home, tmp_path, command):
    ending, words = COMMANDS[command], command.format(home=home).split()
    option = words[-1]
    (tmp_path / f"folder{ending}").mkdir()
    for path in (tmp_path / f"no/x{ending}", tmp_path / f"folder{ending}", "", tmp_path / "x.txt"):
        if ending != ".json" or path != tmp_path / "x.txt":
            assert_refused(program(*words, path), option, path)
    path = tmp_path / f"x{ending}"
    path.write_bytes(b"mine")
    if command.startswith("calibrate"):  # users edit configs
        assert_refused(program(*words, path), option, path, "--overwrite")
        assert path.read_bytes() == b"mine"
        words.insert(-1, "--overwrite")
    assert program(*words, path).code == 0
    assert path.read_bytes() != b"mine"
    assert {each.name for each in tmp_path.iterdir()} == {path.name, f"folder{ending}"}


@pytest.mark.parametrize(
    ("source", "out", "apart"),
    [
        ("photos", "photos/set", False),
        ("link", "photos/set", False),
        ("photos/*.png", "photos/set", True),
        ("photos/**/*.png", "photos/set", False),
        ("photos/.hidden", "photos/set", True),
        ("photos", "photos2", True),
        ("models/a", "models/a/set", False),
    ],
)
def test_a_dataset_lies_apart_from_its_photographs_and_models(home, tmp_path, monkeypatch, source, out, apart):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models/a").mkdir(parents=True)
    for name in ("photos", "photos/.hidden"):
        shutil.copytree(home / "photos", tmp_path / name, dirs_exist_ok=True)
    (tmp_path / "link").symlink_to("photos")
    if source.startswith("models"):
        config = cheap(textures={"source": "procedural"}, models={"folders": [source]})
    else:
        config = cheap(textures={"source": "images", "images": [source]})
    with nullcontext() if apart else pytest.raises(InputError, match=out):
        check_outside_sources(open_root(out), config)


@pytest.mark.parametrize(
    ("address", "word"),
    [
        ("", "expected a folder"),
        ("S3:/bucket/set", "slash"),
        ("my-store:/set", "slash"),
    ],
)
def test_places_where_nobody_looks_are_refused(program, tmp_path, address, word):
    pytest.importorskip("fsspec")
    command = f"generate --config sceneflow --pairs 1 {SMALL} --set textures.source=procedural --out"
    assert_refused(program(*command.split(), address), word)
    assert list(tmp_path.iterdir()) == []
