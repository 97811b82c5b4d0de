"""Paths from users: missing, too large, with ~, not valid text; and glob patterns."""

import glob
import os
from pathlib import Path

import numpy as np
import pytest
from config_texts import parse_config
from PIL import Image

from semisynth_gl.calibration.rig_files import read_rig
from semisynth_gl.cli.options import scene_config
from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.config import Config, load_config
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.geometry.model_files import load_models
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.judge.truth import read_limits
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.image_files import find_files, find_images
from semisynth_gl.textures.images import read_image
from semisynth_gl.textures.prepare import prepare_atlas

# Each reader opens one path from a user, a config or a dataset.
READERS = {
    "config": load_config,
    "extends": lambda path: parse_config(f"extends: '{path}'\n"),
    "image": read_image,
    "map": read_disparity_map,
    "calib.txt of a scene": read_limits,
    "calibration": lambda path: read_rig([path]),
    "images": lambda path: prepare_atlas(TexturesSection(source="images", images=(str(path),)), Split(0)),
    "models": lambda path: load_models([path]),
}


@pytest.mark.parametrize("reader", READERS)
def test_a_missing_file_is_named(tmp_path, reader):
    with pytest.raises(SemisynthError, match=str(tmp_path / "absent")):
        READERS[reader](tmp_path / "absent")


def photograph(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(0).integers(0, 256, (80, 80, 3), dtype=np.uint8)
    with path.open("wb") as file:
        Image.fromarray(pixels).save(file, format="PNG")


def test_globs_match_what_python_matches(tmp_path, monkeypatch):
    for name in ("a.png", "b.PNG", "c/d.png", "c/e f.png", "c/.hidden.png", ".dot/g.png", "c/h/i.png", "[j]/k.png"):
        photograph(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    for pattern in ("*", "**/*.png", "c/../*.png", "[a-b].*", ".*/*.png", "[[]j]/*.png", "none/*"):
        matches = [Path(match) for match in glob.glob(pattern, recursive=True)]  # noqa: PTH207 - pathlib's ** differs
        files = [path for path in matches if path.is_file()]
        files += [path for folder in matches if folder.is_dir() for path in folder.rglob("*")]
        expected = {path.resolve() for path in files if path.suffix.lower() == ".png"}
        for source in (pattern, f"{tmp_path}/{pattern}"):
            found = [path.resolve() for path in find_files([source], [".png"])]
            assert sorted(found) == sorted(expected), source


def test_homes_of_nobody_are_told():
    for read in (lambda path: find_images([path]), lambda path: read_rig([path]), load_config):
        with pytest.raises(InputError, match="nosuchuser"):
            read("~nosuchuser/photos")


@pytest.mark.parametrize("name", [b"new\nline", b"it's, [odd] *&!: \"#", b"~"])
def test_photographs_are_found_whatever_their_names(tmp_path, monkeypatch, name):
    folder = tmp_path / os.fsdecode(name)
    photograph(folder / os.fsdecode(b"no\xefse\n.png"))
    monkeypatch.chdir(tmp_path)
    config = scene_config("kitti", [str(folder)], [], ["textures.patch_px=64"])
    assert prepare_atlas(config.textures, Split(0)).report.images_used == 1
    assert Config.model_validate(config.model_dump(mode="json")).digest() == config.digest()
