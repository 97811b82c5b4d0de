"""Paths that are traps: pipes, devices, links in circles, names that are no text."""

import glob
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from semisynth_gl.calibration.rig_files import read_rigs
from semisynth_gl.cli.options import read_config
from semisynth_gl.codecs.disparity_map import read_disparity_map
from semisynth_gl.codecs.png import GREY8
from semisynth_gl.comparison.maps import map_files
from semisynth_gl.config import Config, load_config
from semisynth_gl.config.distributions import read_histogram
from semisynth_gl.config.load import parse_config
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.geometry.model_files import load_models
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.inputs.user_files import expanded, files_below, open_file, read_file
from semisynth_gl.metrics.truth import read_limits
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.image_files import find_files, find_images
from semisynth_gl.textures.images import ImageError, read_image, stored_size
from semisynth_gl.textures.prepare import prepare_atlas


@pytest.fixture
def traps(tmp_path):
    """Paths that are no regular file; nothing ever writes to the pipe."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "linked-pipe").symlink_to("pipe")
    (tmp_path / "zeros").symlink_to("/dev/zero")
    return [tmp_path / "pipe", tmp_path / "linked-pipe", tmp_path / "zeros", Path("/dev/zero")]


def test_only_regular_files_are_opened(traps, tmp_path):
    for path in traps:
        with pytest.raises(OSError, match="no regular file"):
            open_file(path)
    with pytest.raises(IsADirectoryError):
        open_file(tmp_path)
    with pytest.raises(FileNotFoundError):
        open_file(tmp_path / "none")
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("file")
    assert read_file(tmp_path / "link", 5) == b"12345"
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_file(tmp_path / "link", 4)


# Each reads one path that a user, a config or a dataset names.
READERS = {
    "config": load_config,
    "extends": lambda path: parse_config(f"extends: '{path}'\n", str(path.parent / "mine.yaml")),
    "target": lambda path: load_config("kitti", {"disparity.target": {"form": "file", "path": str(path)}}),
    "histogram": read_histogram,
    "image": read_image,
    "image's size": stored_size,
    "map": read_disparity_map,
    "mask": GREY8.read,
    "calib.txt of a scene": read_limits,
    "calibration": lambda path: read_rigs([path]),
    "images": lambda path: prepare_atlas(TexturesSection(source="images", images=(str(path),)), Split(0)),
    "models": lambda path: load_models([path]),
}


@pytest.mark.parametrize("reader", READERS)
def test_whatever_names_a_file_refuses_what_is_none(traps, reader):
    for path in traps:
        with pytest.raises(SemisynthError) as caught:
            READERS[reader](path)
        assert str(path) in str(caught.value), path


def photograph(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(0).integers(0, 256, (80, 80, 3), dtype=np.uint8)
    with path.open("wb") as file:
        Image.fromarray(pixels).save(file, format="PNG")


def test_what_is_no_file_is_left_out_of_a_folder_with_a_reason(tmp_path):
    photograph(tmp_path / "photos" / "good.png")
    os.mkfifo(tmp_path / "photos" / "pipe.png")
    (tmp_path / "photos" / "broken.jpg").symlink_to("nowhere")
    for source in (tmp_path / "photos", tmp_path / "photos" / "*", tmp_path / "**" / "*.*g"):
        assert [path.name for path in find_images([source])] == ["good.png", "pipe.png"]
    section = TexturesSection(source="images", images=(str(tmp_path / "photos"),), patch_px=64)
    skipped = {file.path.name: file.reason for file in prepare_atlas(section, Split(0)).report.images_skipped}
    assert skipped.keys() == {"pipe.png"}
    assert "no regular file" in skipped["pipe.png"]


def test_models_of_a_folder_leave_out_what_is_no_file(tmp_path):
    (tmp_path / "good.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    os.mkfifo(tmp_path / "pipe.obj")
    meshes, skipped = load_models([tmp_path])
    assert [mesh.name for mesh in meshes] == ["good.obj"]
    assert not skipped


def test_folders_that_are_linked_in_circles_are_searched_once(tmp_path):
    photograph(tmp_path / "a" / "b" / "good.png")
    for number in range(6):  # 6 links that each lead to all: 6 to the power of 40 paths
        (tmp_path / "a" / f"self{number}").symlink_to(".")
        (tmp_path / "a" / "b" / f"up{number}").symlink_to("..")
    for pattern in ("", "**", "**/*.png", "**/**/*.png", "a/**/good.png", "*/*/*.png", "**/b/**/g*.png", "a/b/[g]*"):
        assert find_images([f"{tmp_path}/{pattern}"]) == [tmp_path / "a" / "b" / "good.png"], pattern
    assert sorted(path.name for path in files_below(tmp_path)) == ["good.png"]


@pytest.fixture
def tree(tmp_path, monkeypatch):
    for name in ("a.png", "b.PNG", "c/d.png", "c/e f.png", "c/.hidden.png", ".dot/g.png", "c/h/i.png", "[j]/k.png"):
        photograph(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "pattern",
    ["*.png", "*", "*/*.png", "c/*.png", "**/*.png", "**/*", "./*.png", "c/../*.png", "[a-b].*", "?.png", "c/?/*",
     ".*/*.png", "**/h/*.png", "c/**/*.png", "[[]j]/*.png", "[j]/*.png", "none/*.png", "a.png/*", "**/.hidden.png"],
)  # fmt: skip
def test_globs_match_what_python_matches(tree, pattern):
    matches = [Path(match) for match in glob.glob(pattern, recursive=True)]  # noqa: PTH207 - pathlib has another **
    files = [path for path in matches if path.is_file()]
    files += [path for folder in matches if folder.is_dir() for path in folder.rglob("*")]
    expected = {path.resolve() for path in files if path.suffix.lower() == ".png"}
    for source in (pattern, f"{tree}/{pattern}"):
        assert {path.resolve() for path in find_files([source], [".png"])} == expected


def test_homes_of_nobody_are_told(tmp_path):
    nobody = "~nosuchuser/photos"
    for call in (
        lambda: expanded(nobody),
        lambda: find_images([nobody]),
        lambda: map_files([nobody]),
        lambda: read_rigs([nobody]),
        lambda: load_config(nobody),
        lambda: read_config("kitti", (), (nobody,), ("models.simple=0",)) and load_models([expanded(nobody)]),
        lambda: load_config("kitti", {"disparity.target": {"form": "file", "path": nobody}}),
    ):
        with pytest.raises(InputError, match="there is no user 'nosuchuser'"):
            call()
    config = tmp_path / "mine.yaml"
    config.write_text("extends: ~nosuchuser/a.yaml\n")
    with pytest.raises(InputError, match=r"mine\.yaml:1: extends: .*there is no user"):
        load_config(config)


@settings(max_examples=20, deadline=None)
@given(st.binary(min_size=1, max_size=40).filter(lambda name: not {0, 47} & set(name)))
def test_names_reach_the_config_as_they_are(name):
    text = os.fsdecode(name)
    config = read_config("kitti", (text, f"{text}/**"), (text,), ())
    assert config.textures.images == (text, f"{text}/**")
    assert config.models.folders == (text,)
    assert len(config.digest()) == 64
    assert Config.model_validate(config.model_dump(mode="json")).digest() == config.digest()


@pytest.mark.parametrize("name", [b"latin-\xe9", b"new\nline", b"bell\x07 \x1b[31m", b"- *&!: '\"#", b"~", b"\xff"])
def test_photographs_are_found_whatever_their_names(tmp_path, monkeypatch, name):
    folder = tmp_path / os.fsdecode(name)
    photograph(folder / os.fsdecode(b"no\xefse\n.png"))
    monkeypatch.chdir(tmp_path)
    config = read_config("kitti", (str(folder),), (), ("textures.patch_px=64",))
    assert prepare_atlas(config.textures, Split(0)).report.images_used == 1


def test_paths_that_no_system_takes_are_told():
    for path in ("a\0b", "x" * 5000, f"{'y' * 300}/z"):
        for call in (lambda path=path: find_images([path]), lambda path=path: load_config(path)):
            with pytest.raises(InputError) as caught:
                call()
            assert len(str(caught.value)) < 6000
    with pytest.raises(InputError, match=r"textures\.images\.0: .*zero byte"):
        load_config("kitti", {"textures.images": ["a\0b"]})
    with pytest.raises(ImageError):
        read_image(Path("x" * 300))
