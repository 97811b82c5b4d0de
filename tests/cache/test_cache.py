"""The cache returns what was built, never a stale entry, and never makes a run fail."""

import hashlib
import logging
import os
from dataclasses import fields, is_dataclass
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image
from tiny_datasets import cheap

from semisynth_gl import cache
from semisynth_gl.cache import CacheEntry, cache_folder, cached
from semisynth_gl.config.scene_sections import ModelsSection, ParticlesSection, TexturesSection
from semisynth_gl.geometry import model_library
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.plugins import modules_sha256
from semisynth_gl.scene import disparity_solver
from semisynth_gl.scene.catalogue import make_catalogue
from semisynth_gl.scene.sources import recipe_libraries
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures import prepare
from semisynth_gl.textures.prepare import prepare_atlas

LARGER = "v 0 0 0\nv 3 0 0\nv 2 2 0\nf 1 2 3\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Give each test an empty cache."""
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def built(monkeypatch):
    """Record the names of the functions that built a result."""
    names = []
    for home, name in ((prepare, "build_atlas"), (prepare, "procedural_atlas"), (model_library, "_build")):
        original = getattr(home, name)
        monkeypatch.setattr(home, name, lambda *a, _of=original, _as=name, **k: names.append(_as) or _of(*a, **k))
    return names


@pytest.fixture
def photographs(tmp_path):
    home = tmp_path / "photographs"
    (home / "below").mkdir(parents=True)
    for number, name in enumerate(("0.png", "1.png", "2.png", "below/3.png")):
        save(home / name, number)
    return home


def save(path, seed, side=64):
    pixels = np.random.default_rng(seed).integers(0, 256, (side, side, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path, compress_level=0)  # all files have the same size


def textures(home, **values):
    given = {"source": "images", "images": (str(home),), "patch_px": 32, "scales": (1.0,), "max_patches": 8}
    return TexturesSection(**given | values)


@pytest.fixture
def own(tmp_path):
    """A folder of two models."""
    (tmp_path / "m").mkdir()
    (tmp_path / "m/one.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 2 0\nf 1 2 3\n")
    (tmp_path / "m/two.obj").write_text(LARGER)
    return tmp_path / "m"


def library(home, **values):
    section = {"simple": 0.0, "complex": 0.0, "variants": 1, "folders": (str(home),)}
    return build_library(ModelsSection(**section | values), ParticlesSection(), Split(0))


def plain(value):
    """Turn a result into nested lists that == can compare."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.flags.writeable, hashlib.sha256(value.tobytes()).hexdigest()
    if is_dataclass(value):
        return [plain(getattr(value, field.name)) for field in fields(value)]
    return [plain(each) for each in value] if isinstance(value, list | tuple) else repr(value)


@pytest.mark.parametrize(
    "values",
    [
        {"max_patches": 24, "scales": (1, 1.5), "min_texture": 4},
        {"sequence": True},
        {"source": "procedural", "max_patches": 3, "images": ()},
    ],
)
def test_an_atlas_that_is_found_equals_the_one_that_was_built(photographs, built, values):
    (photographs / "broken.png").write_bytes(b"no image")
    save(photographs / "small.png", 9, 20)
    section = textures(photographs, **values)
    first, again = prepare_atlas(section, Split(3)), prepare_atlas(section, Split(3))
    assert plain(first) == plain(again)
    again.layers[:] = 0  # writing to a result must not change the cache
    assert plain(first) == plain(prepare_atlas(section, Split(3)))
    assert len(built) == 1
    prepare_atlas(section, Split(4))
    assert len(built) == 2


def test_models_that_are_found_equal_those_that_were_built(own, built):
    (own / "empty.obj").write_text("")
    for values in ({}, {"simple": 1.0}):
        assert plain(library(own, **values)) == plain(library(own, **values))
    assert built == ["_build"] * 2


def test_pilot_scenes_that_are_found_equal_those_that_were_drawn(monkeypatch):
    sample = Mock(wraps=disparity_solver.sample_static_scene)
    monkeypatch.setattr(disparity_solver, "sample_static_scene", sample)
    monkeypatch.setattr(disparity_solver, "_PILOTS", 3)

    def found(seed=0, **changes):
        config = cheap(background={"cuboid": 0, "room": 1}, **changes)
        (library,) = recipe_libraries(config, Split(0))
        return disparity_solver.sample_pilots(config, seed, make_catalogue(library))

    assert plain(found()) == plain(found())
    found(textures={"source": "procedural"}, imperfections={"blur_px": 1})  # textures do not change the pilots
    assert sample.call_count == 3
    for number, changes in enumerate(({"seed": 1}, {"camera": {"baseline_m": 0.5}}, {"models": {"variants": 2}}), 2):
        found(**changes)
        assert sample.call_count == 3 * number, changes


def test_photographs_that_change_come_or_go_count(photographs, built):
    section = textures(photographs)
    prepare_atlas(section, Split(0))
    before = (photographs / "0.png").stat()

    def change_with_the_old_time():
        save(photographs / "0.png", 77)
        os.utime(photographs / "0.png", ns=(before.st_atime_ns, before.st_mtime_ns))

    for change in (
        change_with_the_old_time,
        lambda: save(photographs / "new.png", 8),
        (photographs / "2.png").unlink,
    ):
        change()
        prepare_atlas(section, Split(0))
    assert built == ["build_atlas"] * 4
    prepare_atlas(textures(photographs, wrap="repeat", anisotropy=8), Split(0))  # these keys do not change the patches
    assert built == ["build_atlas"] * 4


def test_models_are_read_again_when_their_folder_changes(own, built):
    for count, change in enumerate(
        (
            lambda: (own / "one.bin").write_text("beside it"),
            lambda: (own / "one.obj").write_text(LARGER),
            lambda: (own / "one.bin").write_text("another"),
            lambda: (own / "two.obj").rename(own / "three.obj"),
        ),
        1,
    ):
        change()
        for _ in range(2):
            library(own)
        assert len(built) == count


ARRAYS = np.zeros((0, 3)), np.arange(3000, dtype=np.float32).reshape(300, 10)


def pair(number=0, builds=None):
    """Get a result of numbers and arrays from the cache; append to ``builds`` if it was built."""

    def build():
        if builds is not None:
            builds.append(number)
        return CacheEntry({"head": [number, 0.1, None, "ä"]}, dict(zip(("none", "x"), ARRAYS, strict=True)))

    return cached("pair", {"number": number}, build, announce="making pairs")


def assert_pair(found, number=0):
    assert found.values == {"head": [number, 0.1, None, "ä"]}
    assert list(found.arrays) == ["none", "x"]
    assert plain(list(found.arrays.values())) == plain(ARRAYS)


def test_a_result_is_built_once_for_each_key_code_and_packages_and_announced(folder, caplog, monkeypatch):
    caplog.set_level(logging.INFO, "semisynth_gl")
    builds = []
    for number, code, packages in [(0, "a", "b"), (1, "a", "b"), (0, "x", "b"), (0, "a", "x")] * 2:
        monkeypatch.setattr(cache, "modules_sha256", {Path(cache.__file__).parent: code}.__getitem__)
        monkeypatch.setattr(cache, "_installed_packages", lambda packages=packages: packages)
        assert_pair(pair(number, builds), number)
    assert builds == [0, 1, 0, 0]
    assert caplog.messages == ["making pairs"] * 4
    assert len(list(folder.iterdir())) == 4


def test_every_module_of_a_package_counts(tmp_path):
    for name, inner in (("one", "x"), ("same", "x"), ("other", "y")):
        (tmp_path / name / "inner").mkdir(parents=True)
        (tmp_path / name / "a.py").write_text("a")
        (tmp_path / name / "inner/b.py").write_text(inner)
    one, same, other = (modules_sha256(tmp_path / name) for name in ("one", "same", "other"))
    assert one == same != other


def test_a_damaged_entry_is_made_again(folder):
    pair()
    [path] = folder.iterdir()
    whole = path.read_bytes()
    middle = len(whole) // 2
    for content in (b"", whole[:middle], whole[:middle] + b"damage" + whole[middle + 6 :]):
        path.write_bytes(content)
        builds = []
        for _ in range(2):
            assert_pair(pair(builds=builds))
        assert builds == [0]


@pytest.mark.parametrize("place", ["off", "OFF", "file", "file/cache"])
def test_without_a_folder_that_can_be_written_all_goes_on(tmp_path, monkeypatch, place):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", place if place.lower() == "off" else str(tmp_path / place))
    builds = []
    for _ in range(2):
        assert_pair(pair(builds=builds))
    assert builds == [0, 0]


def test_the_oldest_entries_go_first(folder, monkeypatch):
    folder.mkdir()
    (folder / "photographs.npz").write_text("the user's")
    for number in range(3):
        known = set(folder.iterdir())
        pair(number)
        [path] = set(folder.iterdir()) - known
        os.utime(path, ns=(number, number))
    monkeypatch.setattr(cache, "LIMIT_BYTES", 3 * path.stat().st_size)
    pair(3)
    assert (folder / "photographs.npz").exists()
    builds = []
    for number in (1, 2, 3, 0):
        pair(number, builds=builds)
    assert builds == [0]


@pytest.mark.parametrize(
    ("variable", "base", "expected"), [("", "", ".cache/semisynth-gl"), ("", "x", "x/semisynth-gl"), ("~/y", "x", "y")]
)
def test_where_the_cache_lies(tmp_path, monkeypatch, variable, base, expected):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", variable)
    monkeypatch.setenv("XDG_CACHE_HOME", base and str(tmp_path / base))
    assert cache_folder() == tmp_path / expected
