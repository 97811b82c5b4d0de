"""Plug-ins: the example package from end to end, and packages with unusable plug-ins."""

import json
import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from config_texts import parse_config
from installed_plugins import build_example, find_anew, unpack, write_package
from tiny_datasets import cheap, digests, findings

from semisynth_gl import open_dataset
from semisynth_gl.cli import semisynth_gl
from semisynth_gl.codecs import Encodings
from semisynth_gl.config import load_config
from semisynth_gl.config.explain import explain
from semisynth_gl.dataset.documents import DatasetPlan, parse
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import read_index
from semisynth_gl.geometry.kinds import SIMPLE_KINDS
from semisynth_gl.geometry.model_library import build_family, build_library
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.layouts import PairKey, find_layout
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.prepare import prepare_atlas

ACME = {"package": "acme-stereo", "version": "1.2.0"}
PLUGINS = {"layouts": {"flat": ACME}, "textures": {"posters": ACME}, "models": {"knots": ACME}}
MISSING = "comes from the plug-in package 'acme-stereo==1.2.0', which is not installed"
CUBES = dict.fromkeys({*SIMPLE_KINDS} - {"cube"}, 0.0)
CONFIG = cheap(
    models={"complex": 0.0, "variants": 3, "kinds": CUBES, "families": {"knots": 2.0}},
    textures={"source": "posters", "max_patches": 8, "patch_px": 64, "scales": [2.0]},
)


@pytest.fixture(autouse=True)
def _found_anew():
    yield
    find_anew()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Install the example into a folder."""
    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as patch:
        unpack(build_example(tmp_path_factory.mktemp("package"), patch), folder)
    return folder


@pytest.fixture(scope="module")
def made(site, tmp_path_factory):
    """Write a config that uses the example's plug-ins; generate its dataset with a worker process."""
    folder = tmp_path_factory.mktemp("made")
    config = folder / "acme.yaml"
    config.write_text(json.dumps(CONFIG.model_dump(mode="json", exclude_none=True)))
    command = ["generate", "--config", config, "--out", folder / "set", "--pairs", "3", "--layout", "flat"]
    command += ["--shard-pairs", "2", "--engine", "local", "--workers", "1"]
    path = os.pathsep.join(filter(None, [str(site), os.environ.get("PYTHONPATH")]))
    subprocess.run([sys.executable, "-m", "semisynth_gl", *command], env=os.environ | {"PYTHONPATH": path}, check=True)
    return config, folder / "set"


@pytest.fixture
def acme(site, monkeypatch):
    monkeypatch.syspath_prepend(str(site))
    find_anew()


@pytest.fixture
def install(tmp_path):
    """Return a context manager that installs a package with the given code."""

    @contextmanager
    def installed(code, version="0.3"):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        write_package(folder, code, version)
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(str(folder))
            find_anew()
            yield
        find_anew()

    return installed


def run_command(*arguments):
    """Run a command in this process; return its output or its error."""
    done = CliRunner().invoke(semisynth_gl, [str(argument) for argument in arguments], standalone_mode=False)
    return done.output if done.exception is None else str(done.exception)


@pytest.mark.usefixtures("acme")
def test_the_examples_make_a_dataset_that_all_commands_know(made, tmp_path):
    config, out = made
    assert "3 pairs, nothing found" in run_command("verify", out, "--oracle")
    pair = open_dataset(out)[2]
    assert pair.left.image.shape == (48, 64, 3)
    assert (out / "pairs" / "000002_seen_left.png").is_file()
    assert (out / "pairs.txt").read_text() == "".join(f"pairs/00000{i}_left.png\n" for i in range(3))
    documents = [read_index(out).plan.values(), *(json.loads(path.read_text()) for path in out.glob("shards/*.json"))]
    assert [document["plugins"] for document in documents] == [PLUGINS] * 4
    assert pair.provenance["plugins"] == {group: PLUGINS[group] for group in ("textures", "models")}
    shown = run_command("doctor")
    for noun in ("layout 'flat'", "texture source 'posters'", "family of models 'knots'", "scene recipe 'attic'"):
        assert f"Plug-in: {noun} of the package acme-stereo 1.2.0" in shown
    # The same command does nothing the second time.
    before = digests(out)
    assert "3 pairs in" in run_command("generate", "--config", config, "--out", out, "--pairs", 3, "--layout", "flat")
    assert digests(out) == before
    # Verify compares each pair's plug-ins with the index.
    shutil.copytree(out, tmp_path / "set")
    index = tmp_path / "set" / "index.json"
    values = json.loads(index.read_text())
    values["plugins"]["models"]["knots"]["version"] = "1.1.0"
    index.write_text(json.dumps(values))
    assert ["origin" in line for line in findings(tmp_path / "set")] == [True] * 3


def test_without_the_package_or_its_version_messages_name_it(made, site, tmp_path, monkeypatch):
    config, out = made
    for arguments in (("verify", out), ("generate", "--config", "middlebury", "--out", out, "--overwrite")):
        assert f"layout 'flat' {MISSING}" in run_command(*arguments), arguments
    # A config does not name the package of a plug-in.
    new = "generate", "--config", config, "--out", tmp_path / "new"
    assert "textures.source: texture source: expected" in run_command(*new)
    newer = shutil.copytree(site, tmp_path / "newer")
    metadata = newer / "acme_stereo-1.2.0.dist-info" / "METADATA"
    metadata.write_text(metadata.read_text().replace("Version: 1.2.0", "Version: 1.3.0"))
    monkeypatch.syspath_prepend(str(newer))
    find_anew()
    refused = run_command("generate", "--config", config, "--out", out, "--pairs", 3, "--layout", "flat")
    assert "plugins.layouts.flat.version ('1.2.0' there, '1.3.0' now)" in refused
    assert f"family of models 'knots' {MISSING}" in run_command("verify", out, "--oracle")


@pytest.mark.usefixtures("acme")
def test_a_dataset_of_a_recipe_is_read_and_verified_without_the_package(tmp_path, site):
    config, out = tmp_path / "attic.yaml", tmp_path / "set"
    values = cheap(textures={"source": "procedural"}).model_dump(mode="json", exclude_none=True)
    recipes = [{"extends": "attic", "structures": {"panels": 2}}, {"extends": "attic", "recipe": "b"}, {"recipe": "c"}]
    config.write_text(json.dumps(values | {"scenes": recipes}))
    loaded = load_config(config)
    walls = [(recipe.name, recipe.config.structures) for recipe in loaded.recipes()]
    found = [(name, wall.panels.high, wall.panel_slant_deg.low) for name, wall in walls]
    assert found == [("attic", 2, 30), ("b", 4, 30), ("c", 0, 0)]
    assert parse_config(explain(loaded)).digest() == loaded.digest()
    options = ("--config", config, "--out", out, "--pairs", 6)
    assert "6 pairs in" in run_command("generate", *options)
    sys.path.remove(str(site))
    find_anew()
    assert {pair.recipe for pair in open_dataset(out)} == {"attic", "b", "c"}
    assert all(pair.provenance["plugins"] == {"recipes": {"attic": ACME}} for pair in open_dataset(out))
    assert "6 pairs, nothing found" in run_command("verify", out, "--oracle")
    with pytest.raises(InputError, match=r"attic\.yaml:1: scenes\.0\.extends: scene recipe: no installed package has"):
        load_config(config)


def test_a_record_without_a_package_is_refused():
    values = make_plan(load_config("kitti"), 0, "kitti", {"train": 1}).values()
    with pytest.raises(ReadError, match=r"plugins\.layouts\.x"):
        parse(DatasetPlan, json.dumps(values | {"plugins": {"layouts": {"x": {}}}}).encode(), Path("plan.json"))


LAYOUT = """
from semisynth_gl.layouts import Layout, view_stems
from semisynth_gl.seeds.splits import SPLITS

names = view_stems({}, "{channel}_{view}") | {"provenance": "pair"}
# changed here
stems = {role: "{split}/{index}_" + name for role, name in names.items()}
PLUGINS = {"layouts": {"thing": Layout(stems=stems, splits_in_root=frozenset(SPLITS))}}
"""


def test_a_layout_that_could_not_be_read_back_is_refused(install):
    names = "names = {'left': 'l', 'right': 'r', 'disparity_left': 'd'}"
    with install(LAYOUT.replace("# changed here", names)), pytest.raises(InputError, match="a file for provenance"):
        make_plan(load_config("kitti"), 0, "thing", {"train": 1})
    with install(LAYOUT):
        assert find_layout("thing").files(PairKey("lab", "test", 7), Encodings())["left"] == "test/7_image_left.png"


def test_a_name_that_is_taken_is_refused(install):
    with (
        install("PLUGINS = {'layouts': {'kitti': 3}}"),
        pytest.raises(InputError, match=r"'kitti' of .* other-plugins has the name of another"),
    ):
        load_config("kitti")


@pytest.mark.usefixtures("acme")
def test_names_in_a_config_are_checked_with_their_place(tmp_path):
    path = tmp_path / "lab.yaml"
    path.write_text("extends: kitti\ntextures: {source: poster}\nmodels: {families: {knots: 1, nots: 0, hinges: 2}}\n")
    with pytest.raises(InputError, match=r"lab\.yaml:2: textures\.source: .*, got 'poster'; did you mean posters\?"):
        load_config(path)
    with pytest.raises(InputError, match=r"lab\.yaml:3: models\.families\.hinges: .* expected one of knots, got"):
        load_config(path, ["textures.source=posters"])
    config = load_config(path, ["textures.source=posters", "models.families.hinges=0"])
    # With weight 0, the plug-in need not be installed.
    assert set(config.used_plugins().values()) == {("textures", "posters"), ("models", "knots")}


# Models and pictures


@pytest.mark.usefixtures("acme")
def test_splits_have_models_and_pictures_of_their_own():
    def split(name, models):
        return Split(4, name, {"validation": 0.2, "test": 0.2}, models)

    for models, counts in ((False, (5, 5, 5)), (True, (3, 1, 1))):
        families = [build_family("knots", 5, split(name, models)) for name in ("train", "validation", "test")]
        assert tuple(map(len, families)) == counts
        positions = [mesh.positions.tobytes() for family in families for mesh in family]
        assert len(set(positions)) == len(positions)
    # With ``models``, the splits share out the models that the training split would have without it.
    assert set(positions) == {
        mesh.positions.tobytes() for mesh in build_family("knots", 5, split("train", models=False))
    }
    atlases = [prepare_atlas(CONFIG.textures, split(name, models=False)) for name in ("train", "test")]
    assert not set(atlases[0].pictures.values()) & set(atlases[1].pictures.values())


@pytest.mark.usefixtures("acme")
def test_a_family_has_its_weight_beside_the_others():
    library = build_library(CONFIG.models, CONFIG.particles, Split(0))
    assert [mesh.name.partition("/")[0] for mesh in library.models] == ["cube"] * 3 + ["knots"] * 3
    np.testing.assert_allclose(library.chances, [1 / 9] * 3 + [2 / 9] * 3)


def test_the_cache_knows_the_version_and_the_code_of_a_plugin(install, tmp_path):
    log = tmp_path / "calls"
    code = f"""
from semisynth_gl import make_model

def thing(rng):
    open({str(log)!r}, "a").write(".")
    return make_model("x", [[0, 0, 0], [0, 1, 0], [0, 0, HEIGHT]], [[0, 1, 2]])

PLUGINS = {{"models": {{"thing": thing}}}}
"""
    section = CONFIG.models.model_copy(update={"simple": 0.0, "families": {"thing": 1.0}, "variants": 1})
    calls = []
    for version, height in [("1", "1"), ("1", "1"), ("1", "20"), ("2", "20"), ("2", "20")]:
        with install(code.replace("HEIGHT", height), version):
            mesh = build_library(section, CONFIG.particles, Split(0)).models[0]
        assert np.ptp(mesh.positions[:, 2]) == pytest.approx(float(height) * np.ptp(mesh.positions[:, 1]))
        calls.append(len(log.read_text()))
    assert calls == [1, 1, 2, 3, 3]
