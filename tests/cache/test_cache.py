"""What is kept between runs: the same as what was built, never stale, and never in the way."""

import hashlib
import json
import logging
import os
import pickle
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import built as fixed
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from tiny_datasets import cheap

from semisynth_gl import cache
from semisynth_gl.cache import SUFFIX, Entry, cache_folder, cache_summary, cached, file_states
from semisynth_gl.config.scene_sections import ModelsSection, ParticlesSection, TexturesSection
from semisynth_gl.geometry import model_library, model_reader
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.geometry.model_reader import read_surfaces
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene import pilots
from semisynth_gl.scene.sources import recipe_libraries
from semisynth_gl.scene.structures import take_stock
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures import clips, prepare
from semisynth_gl.textures.drawn import KINDS
from semisynth_gl.textures.images import OUT_OF_MEMORY, ImageError, read_image
from semisynth_gl.textures.prepare import prepare_atlas

TRIANGLE = "v 0 0 0\nv 2 0 0\nv 2 2 0\nf 1 2 3\n"
LARGER = "v 0 0 0\nv 3 0 0\nv 2 2 0\nf 1 2 3\n"
PARTICLES = ParticlesSection()


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cache of the test's own."""
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def built(monkeypatch):
    """Names of what was built, not found."""
    names = []

    def counting(home, name):
        original = getattr(home, name)
        monkeypatch.setattr(home, name, lambda *a, **k: names.append(name) or original(*a, **k))

    counting(prepare, "build_atlas")
    counting(prepare, "procedural_atlas")
    counting(model_library, "_build")
    return names


@pytest.fixture
def photographs(tmp_path):
    home = tmp_path / "photographs"
    (home / "below").mkdir(parents=True)
    for i in range(6):
        save(home / (f"{i}.png" if i < 4 else f"below/{i}.png"), i)
    return home


def save(path, seed, side=64):
    pixels = np.random.default_rng(seed).integers(0, 256, (side, side, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path, compress_level=0)  # so that all have the same size


def textures(home, **values):
    given = {"source": "images", "images": (str(home),), "patch_px": 32, "scales": (1.0,), "max_patches": 8}
    return TexturesSection(**given | values)


def models(*homes, **values):
    return ModelsSection(simple=0.0, complex=0.0, folders=tuple(map(str, homes)), **values)


def assert_same_array(one, other):
    assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    assert one.flags.c_contiguous == other.flags.c_contiguous
    assert one.flags.writeable == other.flags.writeable


def assert_same_atlas(one, other):
    assert_same_array(one.layers, other.layers)
    assert repr(one.patches) == repr(other.patches)
    assert repr(one.report) == repr(other.report)
    assert one.patches == other.patches
    assert one.report == other.report


def assert_same_library(one, other):
    assert len(one.models) == len(other.models)
    for mesh, again in zip(one.models, other.models, strict=True):
        for field in fields(Mesh):
            value, found = getattr(mesh, field.name), getattr(again, field.name)
            if isinstance(value, np.ndarray):
                assert_same_array(value, found)
            else:
                assert repr(value) == repr(found)
    assert_same_array(one.chances, other.chances)
    assert repr(one.silhouette.fill) == repr(other.silhouette.fill)
    assert_same_array(one.silhouette.heights, other.silhouette.heights)
    assert one.skipped == other.skipped


@pytest.mark.parametrize(
    "values",
    [
        {},
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
    assert len(built) == 1
    assert_same_atlas(first, again)
    prepare_atlas(section, Split(4))
    assert len(built) == 2
    again.layers[:] = 0  # what is found may be written to, and stays
    assert_same_atlas(first, prepare_atlas(section, Split(3)))
    assert len(built) == 2


def test_work_that_takes_seconds_is_logged_where_nothing_is_found(photographs, folder, caplog):
    caplog.set_level(logging.INFO, "semisynth_gl")
    section, kinds = textures(photographs), ModelsSection(complex=0.0, variants=1)
    for _ in range(2):
        prepare_atlas(section, Split(3))
        build_library(kinds, PARTICLES, Split(3))
    atlas, library = "making patches of photographs (images: 6)", "making models"
    assert caplog.messages == [f"{work}; later runs find them in {folder}" for work in (atlas, library)]


def test_models_that_are_found_equal_those_that_were_built(tmp_path, built):
    (tmp_path / "m/below").mkdir(parents=True)
    (tmp_path / "m/one.obj").write_text(TRIANGLE)
    (tmp_path / "m/below/two.obj").write_text(LARGER)
    (tmp_path / "m/empty.obj").write_text("")
    for section in (models(tmp_path / "m"), ModelsSection(variants=1, complex=0.0)):
        built.clear()
        first, again = build_library(section, PARTICLES, Split(1)), build_library(section, PARTICLES, Split(1))
        assert built == ["_build"]
        assert_same_library(first, again)
        again.models[0].positions[:] = 0
        assert_same_library(first, build_library(section, PARTICLES, Split(1)))
        assert build_library(section, PARTICLES, Split(2)).silhouette.fill != first.silhouette.fill
        assert built == ["_build", "_build"]


def test_pilot_scenes_that_are_found_equal_those_that_were_drawn(monkeypatch):
    drawn = []
    draw = pilots.draw_stage
    monkeypatch.setattr(pilots, "draw_stage", lambda *arguments: drawn.append(arguments) or draw(*arguments))
    monkeypatch.setattr(pilots, "_PILOTS", 3)

    def found(seed=0, **changes):
        config = cheap(**{"background": {"cuboid": 0, "room": 1}} | changes)
        (library,) = recipe_libraries(config, Split(0))
        return pilots.draw_pilots(config, seed, take_stock(library))

    first, again = found(), found()
    assert len(drawn) == 3
    assert [pilot.camera for pilot in again] == [pilot.camera for pilot in first]
    for one, other in zip(first, again, strict=True):
        assert_same_array(one.bare_px, other.bare_px)
    assert len({pilot.bare_px.tobytes() for pilot in first}) == 3
    # What surfaces wear moves nothing.
    found(textures={"source": "procedural"}, imperfections={"blur_px": 1})
    assert len(drawn) == 3
    for number, changes in enumerate(
        (
            {"seed": 1},
            {"camera": {"baseline_m": 0.5}},
            {"disparity": {"max_px": 25}},
            {"background": {"cuboid": 0, "street": 1}},
            {"room": {"furniture": [9, 9]}},
            {"structures": {"panels": [3, 3]}},
            {"models": {"variants": 2}},
        ),
        2,
    ):
        found(**changes)
        assert len(drawn) == 3 * number, changes


def rebuilt(home):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SEMISYNTH_GL_CACHE", "off")
        return prepare_atlas(textures(home), Split(0))


def test_photographs_that_change_come_or_go_count(photographs, built):
    prepare_atlas(textures(photographs), Split(0))
    before = (photographs / "0.png").stat()

    def set_back():
        save(photographs / "0.png", 77)
        os.utime(photographs / "0.png", ns=(before.st_atime_ns, before.st_mtime_ns))

    def swap():
        for path in (photographs / "1.png", photographs / "2.png"):
            os.utime(path, ns=(5, 5))
        prepare_atlas(textures(photographs), Split(0))
        (photographs / "1.png").rename(photographs / "other")
        (photographs / "2.png").rename(photographs / "1.png")
        (photographs / "other").rename(photographs / "2.png")

    for change in (
        lambda: save(photographs / "0.png", 7),
        set_back,
        swap,
        lambda: save(photographs / "new.png", 8),
        (photographs / "3.png").unlink,
    ):
        change()
        built.clear()
        found = prepare_atlas(textures(photographs), Split(0))
        assert built == ["build_atlas"]
        assert_same_atlas(found, rebuilt(photographs))


def test_what_may_go_otherwise_the_next_time_is_not_kept(photographs, built, monkeypatch):
    def fail(path):
        raise ImageError(path, OUT_OF_MEMORY)

    section = textures(photographs, max_patches=24)
    with monkeypatch.context() as patch:
        patch.setattr(clips, "read_image", lambda path: fail(path) if path.name == "1.png" else read_image(path))
        assert len(prepare_atlas(section, Split(0)).report.images_skipped) == 1
        patch.setattr(clips, "read_image", fail)
        with pytest.raises(InputError):
            prepare_atlas(section, Split(1))
    assert prepare_atlas(section, Split(0)).report.images_skipped == ()
    assert len(built) == 3


def test_a_model_that_does_not_fit_into_memory_is_read_again_the_next_time(tmp_path, monkeypatch):
    (tmp_path / "m").mkdir()
    for name in ("one.obj", "two.obj"):
        (tmp_path / "m" / name).write_text(TRIANGLE)

    def read_one(path):
        if path.name == "two.obj":
            raise MemoryError
        return read_surfaces(path)

    with monkeypatch.context() as patch:
        patch.setattr(model_reader, "read_surfaces", read_one)
        library = build_library(models(tmp_path / "m"), PARTICLES, Split(0))
        assert [skipped.path.name for skipped in library.skipped] == ["two.obj"]
    assert build_library(models(tmp_path / "m"), PARTICLES, Split(0)).skipped == ()


def test_keys_that_do_not_decide_the_patches_do_not_count(photographs, built):
    prepare_atlas(textures(photographs), Split(0))
    prepare_atlas(textures(photographs, wrap="repeat", anisotropy=8), Split(0))
    assert len(built) == 1


def test_another_version_of_a_builder_finds_nothing(photographs, built, tmp_path, monkeypatch):
    (tmp_path / "m").mkdir()
    (tmp_path / "m/one.obj").write_text(TRIANGLE)
    for changed, expected in (
        (None, ["build_atlas", "_build"]),
        (prepare, ["build_atlas"]),
        (model_library, ["_build"]),
    ):
        built.clear()
        if changed:
            monkeypatch.setattr(changed, "VERSION", 999)
        for _ in range(2):
            prepare_atlas(textures(photographs), Split(0))
            build_library(models(tmp_path / "m"), PARTICLES, Split(0))
        assert built == expected


def test_every_user_of_the_cache_has_a_version():
    package = Path(cache.__file__).parent
    users = {path for path in package.rglob("*.py") if "semisynth_gl.cache import Entry, cached" in path.read_text()}
    assert users == {Path(builder.__file__) for builder in fixed.BUILDERS.values()}


def test_what_is_kept_of_fixed_inputs_is_another_only_with_another_version(tmp_path, monkeypatch):
    results = fixed.built(tmp_path)
    assert not fixed.faults(results)
    recorded = json.loads(fixed.RECORDED.read_text("utf-8"))
    pictures = {f"atlas/{kind.__name__}" for kind in KINDS}  # tests/textures/test_textures_drawn.py draws them
    assert {"versions", *results, *pictures} == set(recorded)
    assert {name.partition("/")[0] for name in results} == set(fixed.BUILDERS)
    # A vertex a hundredth of a radius away, and another kind of drawn picture.
    positions = results["models/user"]["positions"] + 1e-2 / 30_000
    others = {"models/user": results["models/user"] | {"positions": positions}, "atlas/batik": {"pixels": 1.0}}
    assert fixed.faults(others) == [
        f"{name} is not what it was: raise VERSION in {module}, then record again with `python tests/built.py`"
        for name, module in (("models/user", model_library.__name__), ("atlas/batik", prepare.__name__))
    ]
    monkeypatch.setattr(prepare, "VERSION", 999)
    [fault] = fixed.faults({"atlas/frames": results["atlas/frames"]})
    assert fault.startswith(f"{prepare.__name__}.VERSION is 999, recorded is {recorded['versions']['atlas']}: record")


def test_other_packages_find_nothing(photographs, built, tmp_path, monkeypatch):
    (tmp_path / "m").mkdir()
    (tmp_path / "m/one.obj").write_text(TRIANGLE)
    for module in (prepare, model_library):
        monkeypatch.setattr(module, "package_versions", lambda *names: dict.fromkeys(names, "1"))
    prepare_atlas(textures(photographs), Split(0))
    build_library(models(tmp_path / "m"), PARTICLES, Split(0))
    monkeypatch.setattr(prepare, "package_versions", lambda *names: dict.fromkeys(names, "2"))
    prepare_atlas(textures(photographs), Split(0))
    monkeypatch.setattr(model_library, "installed_packages", lambda: ["a_reader-1.dist-info"])
    build_library(models(tmp_path / "m"), PARTICLES, Split(0))
    assert built == ["build_atlas", "_build", "build_atlas", "_build"]


def test_models_are_read_again_when_their_folder_changes(tmp_path, built):
    home = tmp_path / "m"
    home.mkdir()
    (home / "one.obj").write_text(TRIANGLE)
    (home / "one.bin").write_text("beside it")
    section = models(home)
    before = (home / "one.obj").stat()

    def set_back():
        (home / "one.obj").write_text(LARGER)
        os.utime(home / "one.obj", ns=(before.st_atime_ns, before.st_mtime_ns))

    for change, expected in (
        (lambda: None, True),
        (lambda: None, False),
        (set_back, True),
        (lambda: (home / "one.bin").write_text("otherwise"), True),
        (lambda: (home / "two.obj").write_text(TRIANGLE), True),
        (lambda: (home / "two.obj").rename(home / "three.obj"), True),
        ((home / "one.bin").unlink, True),
        (lambda: None, False),
    ):
        built.clear()
        change()
        found = build_library(section, PARTICLES, Split(0))
        assert bool(built) == expected
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("SEMISYNTH_GL_CACHE", "off")
            assert_same_library(found, build_library(section, PARTICLES, Split(0)))
    (home / "one.obj").unlink()
    (home / "three.obj").unlink()
    with pytest.raises(InputError, match="at least one usable model"):
        build_library(section, PARTICLES, Split(0))


def test_single_files_and_missing_folders_are_not_kept(tmp_path, built):
    (tmp_path / "one.obj").write_text(TRIANGLE)
    for _ in range(2):
        assert len(build_library(models(tmp_path / "one.obj"), PARTICLES, Split(0)).models) == 1
    assert len(built) == 2
    with pytest.raises(InputError, match="does not exist"):
        build_library(models(tmp_path / "absent"), PARTICLES, Split(0))


def pair(number=0, version=1, work=None, builds=None):
    """A result of numbers and arrays from the cache; ``builds`` gets an item when it is built."""
    return cached(
        "pair",
        version,
        lambda: {"number": number},
        work=work,
        build=lambda: (None if builds is None else builds.append(number)) or ([number, 0.1, None, "ä"], *ARRAYS),
        pack=lambda result: Entry({"head": result[0]}, {"none": result[1], "x": result[2]}),
        unpack=lambda entry: (entry.values["head"], entry.arrays["none"], entry.arrays["x"]),
    )


ARRAYS = np.zeros((0, 3)), np.arange(3000, dtype=np.float32).reshape(300, 10)


def assert_pair(found, number=0):
    assert found[0] == [number, 0.1, None, "ä"]
    for array, expected in zip(found[1:], ARRAYS, strict=True):
        assert_same_array(array, expected)


def test_a_result_is_built_once_for_each_key_and_version():
    builds = []
    for number, version in [(0, 1), (0, 1), (1, 1), (0, 2), (1, 1), (0, 1)]:
        assert_pair(pair(number, version, builds=builds), number)
    assert builds == [0, 1, 0]


def cut_off(share):
    return lambda data: data[: int(share * len(data))]


def overwritten(share, other):
    return lambda data: data[: (at := int(share * len(data)))] + other + data[at + len(other) :]


CHANGES = st.one_of(
    st.builds(cut_off, st.floats(0, 1)),
    st.builds(overwritten, st.floats(0, 1), st.binary(min_size=1, max_size=40)),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(CHANGES)
def test_a_damaged_entry_gives_the_same_result(folder, change):
    pair()
    [path] = folder.iterdir()
    path.write_bytes(change(path.read_bytes()))
    builds = []
    assert_pair(pair(builds=builds))
    assert_pair(pair(builds=builds))
    assert len(builds) < 2
    path.unlink()


class Trap:
    """Fails the test where it is unpickled."""

    def __reduce__(self):
        return pytest.fail, ("the cache ran a pickle",)


@pytest.mark.parametrize("foreign", ["an array", "a pickle", "pickled arrays", "fewer arrays", "a smaller shape"])
def test_what_is_no_entry_is_made_again(folder, foreign):
    pair()
    [path] = folder.iterdir()
    whole = path.read_bytes()
    with path.open("wb") as file:
        if foreign == "an array":
            np.save(file, ARRAYS[1])
        elif foreign == "a pickle":
            pickle.dump(Trap(), file)
        elif foreign == "pickled arrays":
            np.savez(file, values=np.array([Trap()], object), x=ARRAYS[1])
        elif foreign == "fewer arrays":
            np.savez(file, values=np.frombuffer(b'{"head": [0, 0.1, null]}', np.uint8), x=ARRAYS[1])
        else:
            file.write(whole.replace(b"(300, 10)", b"(100, 10)"))
    builds = []
    for _ in range(2):
        assert_pair(pair(builds=builds))
    assert builds == [0]


@pytest.mark.parametrize("place", ["off", "OFF", "below a file", "a file", "/proc/nothing/cache"])
def test_without_a_folder_that_can_be_written_all_goes_on(tmp_path, monkeypatch, caplog, place):
    caplog.set_level(logging.INFO, "semisynth_gl")
    (tmp_path / "file").write_text("")
    chosen = {"a file": tmp_path / "file", "below a file": tmp_path / "file/cache"}.get(place, place)
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", str(chosen))
    builds = []
    for _ in range(2):
        assert_pair(pair(work="making pairs", builds=builds))
    assert builds == [0, 0]
    assert caplog.messages == ["making pairs"] * 2
    assert cache_summary().startswith("off")


def test_a_file_that_is_gone_is_left_to_the_builder(tmp_path):
    key = lambda: {"files": file_states([tmp_path / "absent"])}  # noqa: E731
    assert cached("gone", 1, key, build=lambda: 5, pack=pytest.fail, unpack=pytest.fail) == 5


def test_a_full_disk_is_no_fault(folder, tmp_path, monkeypatch):
    pair(0)
    partial = tmp_path / "partial"
    partial.symlink_to("/dev/full")
    with monkeypatch.context() as patch:
        patch.setattr(cache.tempfile, "mkstemp", lambda *_, **__: (os.open(partial, os.O_WRONLY), str(partial)))
        assert_pair(pair(1), 1)
    assert not partial.is_symlink()
    assert len(list(folder.iterdir())) == 1
    monkeypatch.setattr(cache, "LIMIT_SHARE", 0.0)
    assert_pair(pair(1), 1)
    assert len(list(folder.iterdir())) == 1


def test_entries_that_were_unused_for_longest_go_first(folder, monkeypatch):
    folder.mkdir()
    (folder / "photographs.npz").write_text("the user's")
    (folder / f"x{SUFFIX}").write_bytes(bytes(300))  # of a process that was killed
    os.utime(folder / f"x{SUFFIX}", ns=(1, 1))
    for number in range(3):
        known = set(folder.iterdir())
        pair(number)
        [path] = set(folder.iterdir()) - known
        os.utime(path, ns=(number + 2, number + 2))
    pair(0)
    monkeypatch.setattr(cache, "LIMIT_BYTES", 3 * path.stat().st_size)
    pair(3)
    monkeypatch.setattr(cache, "LIMIT_BYTES", 100)
    pair(4)  # too large by itself: none goes for it
    builds = []
    monkeypatch.undo()
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", str(folder))
    for number in (0, 2, 3, 1, 4):
        pair(number, builds=builds)
    assert builds == [1, 4]
    assert (folder / "photographs.npz").exists()
    assert not (folder / f"x{SUFFIX}").exists()


def test_two_processes_at_once(photographs, folder):
    script = (
        "import hashlib, sys\n"
        "from semisynth_gl.cache import cache_folder\n"
        "from semisynth_gl.config.scene_sections import TexturesSection\n"
        "from semisynth_gl.seeds.splits import Split\n"
        "from semisynth_gl.textures.prepare import prepare_atlas\n"
        "section = TexturesSection(source='images', images=(sys.argv[1],), patch_px=32, scales=(1.0,), max_patches=8)\n"
        "sys.stdin.readline()\n"
        "for _ in range(20):\n"
        "    atlas = prepare_atlas(section, Split(0))\n"
        "    print(hashlib.sha256(atlas.layers).hexdigest())\n"
        "    for path in cache_folder().iterdir():\n"
        "        path.unlink(missing_ok=True)\n"
    )
    command = [sys.executable, "-c", script, str(photographs)]
    running = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in running:
        process.stdin.write("\n")
        process.stdin.flush()
    said = [process.communicate(timeout=300) for process in running]
    expected = hashlib.sha256(rebuilt(photographs).layers).hexdigest()
    for out, errors in said:
        assert errors == ""
        assert out.split() == [expected] * 20
    assert list(folder.iterdir()) == []


def test_where_the_cache_lies(tmp_path, monkeypatch):
    home = tmp_path / "home"
    monkeypatch.setenv("HOME", str(home))
    for variable, base, expected in (
        ("", "", home / ".cache/semisynth-gl"),
        ("", "relative", home / ".cache/semisynth-gl"),
        ("", str(tmp_path / "x"), tmp_path / "x/semisynth-gl"),
        ("~/y", str(tmp_path / "x"), home / "y"),
        ("off", "", None),
    ):
        monkeypatch.setenv("SEMISYNTH_GL_CACHE", variable)
        monkeypatch.setenv("XDG_CACHE_HOME", base)
        assert cache_folder() == expected
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", str(tmp_path))
    assert cache_summary() == f"{tmp_path}, 0 MB of at most 4000 MB"
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", "off")
    assert cache_summary() == "off"
