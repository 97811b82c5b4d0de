"""Plug-ins: the package of examples/ from end to end, and what is said of plug-ins that cannot be used."""

import json
import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from installed_plugins import EXAMPLE, build_example, find_anew, unpack, write_package
from semisynth_gl.dataset.places import open_place
from semisynth_gl.generation.shard_job import ShardJob
from tiny_datasets import cheap, digests, findings

from semisynth_gl import make_model, open_dataset
from semisynth_gl.cli import semisynth_gl
from semisynth_gl.codecs import Encodings
from semisynth_gl.config import Config, Range, load_config
from semisynth_gl.config.explain import explain
from semisynth_gl.config.load import parse_config
from semisynth_gl.config.plugin_recipes import plugin_recipe
from semisynth_gl.dataset.documents import PlanDocument, parse_document
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.reader import read_index
from semisynth_gl.geometry.families import build_family, find_family
from semisynth_gl.geometry.kinds import SIMPLE_KINDS
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.inputs.errors import InputError, ReadError
from semisynth_gl.layouts import Key, find_layout, layout_names
from semisynth_gl.layouts.foreign import check_layout
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.prepare import prepare_atlas

PLUGINS = {
    "layouts": {"flat": {"package": "acme-stereo", "version": "1.2.0"}},
    "textures": {"posters": {"package": "acme-stereo", "version": "1.2.0"}},
    "models": {"knots": {"package": "acme-stereo", "version": "1.2.0"}},
}
MISSING = "comes from the plug-in package acme-stereo 1.2.0, which is not installed: pip install acme-stereo==1.2.0"
CONFIG = cheap(
    models={
        "complex": 0.0,
        "variants": 3,
        "kinds": dict.fromkeys({*SIMPLE_KINDS} - {"cube"}, 0.0),
        "families": {"knots": 2.0},
    },
    textures={"source": "posters", "max_patches": 8, "patch_px": 64, "scales": [2.0]},
)


@pytest.fixture(autouse=True)
def _found_anew():
    find_anew()
    yield
    find_anew()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        return build_example(tmp_path_factory.mktemp("package"), patch)


@pytest.fixture(scope="module")
def site(wheel, tmp_path_factory):
    """A folder in which the example is installed."""
    folder = tmp_path_factory.mktemp("site")
    unpack(wheel, folder)
    return folder


@pytest.fixture(scope="module")
def made(site, tmp_path_factory):
    """The config of the page's plug-ins, and its dataset: by the command, and a worker that it starts."""
    folder = tmp_path_factory.mktemp("made")
    config = folder / "acme.yaml"
    config.write_text(json.dumps(CONFIG.model_dump(mode="json", exclude_none=True)))
    options = ["--pairs", "3", "--layout", "flat", "--shard-pairs", "2", "--engine", "local", "--workers", "1"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(site), os.environ.get("PYTHONPATH")]))}
    done = subprocess.run(
        [sys.executable, "-m", "semisynth_gl", "generate", "--config", config, "--out", folder / "set", *options],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return config, folder / "set"


@pytest.fixture
def acme(site, monkeypatch):
    monkeypatch.syspath_prepend(str(site))
    find_anew()


@pytest.fixture
def install(tmp_path):
    """Install a package that has these entry points and this code, within a block."""

    @contextmanager
    def installed(entries, code="", folder="site", **names):
        write_package(tmp_path / folder, entries, code, **names)
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(str(tmp_path / folder))
            find_anew()
            yield
        find_anew()

    return installed


def said(*arguments):
    """Run a command here; return its output, or the error that it ends with."""
    done = CliRunner().invoke(semisynth_gl, [str(argument) for argument in arguments], standalone_mode=False)
    return done.output if done.exception is None else str(done.exception)


def test_the_package_has_an_example_of_each_group_in_under_40_lines():
    lengths = {path.stem: path.read_text("utf-8").count("\n") for path in EXAMPLE.rglob("*.[pt][yo]*")}
    assert lengths.keys() == {"__init__", "pyproject", "layouts", "textures", "models", "recipes"}
    assert max(lengths.values()) < 40, lengths


@pytest.mark.usefixtures("acme")
def test_the_examples_make_a_dataset_that_all_commands_know(made):
    config, out = made
    assert "3 pairs, nothing found" in said("verify", out, "--oracle")
    pair = open_dataset(out)[2]
    assert pair.left.image.shape == (48, 64, 3)
    assert (out / "pairs" / "000002_seen_left.png").is_file()
    assert (out / "pairs.txt").read_text() == "".join(f"pairs/00000{i}_left.png\n" for i in range(3))
    for shown in (read_index(out).document.values, json.loads((out / "shards/plan.json").read_text())):
        assert shown["plugins"] == PLUGINS
    records = [json.loads(path.read_text()) for path in out.glob("shards/semisynth-*.json")]
    assert [record["plugins"] for record in records] == [PLUGINS] * 2
    assert pair.provenance["plugins"] == {group: PLUGINS[group] for group in ("textures", "models")}
    assert {each for each in pair.provenance["models"] if "/" in each} <= {
        f"knots/{kind}" for kind in ("2-3", "3-2", "2-5", "3-4")
    }
    index = read_index(out).document.values["splits"]["train"]
    assert {each["name"][:8] for each in index["photographs"]} == {"posters/"}
    assert all(each["sha256"] and each["licence"] == "unknown" for each in index["photographs"])
    licences = {(each["name"].partition("/")[0], each["licence"]) for each in index["models"]}
    assert licences == {("cube", "MIT"), ("knots", "unknown")}
    shown = said("doctor")
    for noun in ("layout 'flat'", "texture source 'posters'", "family of models 'knots'"):
        assert f"Plug-in: {noun} of the package acme-stereo 1.2.0" in shown
    assert "BROKEN" not in shown
    assert "flat" in layout_names()
    # The same command again finds nothing to do.
    before = digests(out)
    options = ("--pairs", 3, "--layout", "flat")
    assert "3 pairs in" in said("generate", "--config", config, "--out", out, *options)
    assert digests(out) == before


@pytest.mark.usefixtures("acme")
def test_another_version_does_not_go_on_with_a_dataset(made, site, tmp_path, monkeypatch):
    config, out = made
    newer = tmp_path / "newer"
    newer.mkdir()
    for path in site.iterdir():
        (newer / path.name.replace("1.2.0", "1.3.0")).symlink_to(path)
    info = newer / "acme_stereo-1.3.0.dist-info"
    target = info.resolve()
    info.unlink()
    info.mkdir()
    for path in target.iterdir():
        (info / path.name).write_text(path.read_text().replace("Version: 1.2.0", "Version: 1.3.0"))
    monkeypatch.syspath_prepend(str(newer))
    find_anew()
    options = ("--pairs", 3, "--layout", "flat")
    refused = said("generate", "--config", config, "--out", out, *options)
    assert "begun with other values: plugins.layouts.flat.version ('1.2.0' there, '1.3.0' now)" in refused
    assert open_dataset(out)[0].left.image.shape == (48, 64, 3)
    assert "nothing found" in said("verify", out)
    assert "acme-stereo 1.2.0, and 1.3.0 is installed: pip install acme-stereo==1.2.0" in said(
        "verify", out, "--oracle"
    )


def test_without_the_package_messages_name_it(made, site, tmp_path, monkeypatch):
    config, out = made
    find_anew()
    missing = f"layout 'flat' {MISSING}"
    for arguments in (
        ("verify", out),
        ("report", out),
        ("generate", "--config", config, "--out", out, "--pairs", 3),
        ("generate", "--config", "middlebury", "--out", out, "--overwrite"),
    ):
        assert missing in said(*arguments), arguments
    with pytest.raises(InputError, match=r"layout 'flat' comes from the plug-in package acme-stereo 1\.2\.0"):
        open_dataset(out)
    # A new dataset knows no package.
    said_of_config = said("generate", "--config", config, "--out", tmp_path / "new")
    assert said_of_config.startswith(f"{config}:1: textures.source: texture source: expected one of builtin, ")
    assert "expected one of crestereo" in said("generate", "--config", "middlebury", "--layout", "flat")
    # In a layout of the program's own, a dataset is read without its textures and models, and goes on with them alone.
    monkeypatch.syspath_prepend(str(site))
    find_anew()
    generate(CONFIG, tmp_path / "set", 1)
    monkeypatch.undo()
    find_anew()
    assert open_dataset(tmp_path / "set")[0].provenance["plugins"]["models"] == PLUGINS["models"]
    assert "nothing found" in said("verify", tmp_path / "set")
    assert f"family of models 'knots' {MISSING}" in said("verify", tmp_path / "set", "--oracle")
    assert f"texture source 'posters' {MISSING}" in said("generate", "--config", config, "--out", tmp_path / "set")
    with pytest.raises(InputError, match="texture source 'posters' comes from"):
        generate(CONFIG, tmp_path / "set", 2)


@pytest.mark.usefixtures("acme")
def test_a_worker_with_another_version_makes_nothing(tmp_path):
    plan = make_plan(CONFIG, 0, "flat", {"train": 1})
    other = replace(plan, plugins={**plan.plugins, "layouts": {"flat": {"package": "acme-stereo", "version": "1.1.0"}}})
    refused = (
        r"other plug-ins than the one that began the dataset: layouts\.flat\.version \('1\.1\.0' there, '1\.2\.0' now"
    )
    with pytest.raises(InputError, match=refused), ShardJob(other, open_place(tmp_path), "auto", {}).open(0):
        pass


@pytest.mark.usefixtures("acme")
def test_verify_compares_the_plugins_of_a_pair_with_the_index(made, tmp_path):
    _, out = made
    shutil.copytree(out, tmp_path / "set")
    index = tmp_path / "set" / "index.json"
    values = json.loads(index.read_text())
    values["plugins"]["models"]["knots"]["version"] = "1.1.0"
    index.write_text(json.dumps(values))
    found = findings(tmp_path / "set")
    assert len(found) == 3
    assert all("origin" in line and "'version': '1.1.0'" in line for line in found)


def test_what_a_file_says_of_plugins_is_checked():
    values = make_plan(load_config("kitti"), 0, "kitti", {"train": 1}).values()
    parse_document(values, PlanDocument, Path("plan.json"))
    for plugins, message in (
        (
            {"layouts": {"x": {"package": "a; rm -rf ~", "version": "1"}}},
            "plugins.layouts.x.package: expected a text of the form",
        ),
        (
            {"layouts": {"x": {"package": "a", "version": "$(b)"}}},
            "x.version: expected a text of the form",
        ),
        ({"layouts": {"x": {"package": "a"}}}, "plugins.layouts.x.version: field required"),
        ({"engines": {"x": {"package": "a"}}}, "plugins.engines.x.version: field required"),
        ({"layouts": []}, "plugins.layouts: input should be a valid dictionary"),
    ):
        with pytest.raises(ReadError) as caught:
            parse_document(values | {"plugins": plugins}, PlanDocument, Path("plan.json"))
        assert message in str(caught.value)
    # A later version may have further groups.
    parse_document(
        values | {"plugins": {"engines": {"x": {"package": "a", "version": "1"}}}}, PlanDocument, Path("plan.json")
    )
    with pytest.raises(ReadError, match=r"layout: expected one of crestereo, .*, got 'flat'"):
        parse_document(values | {"layout": "flat"}, PlanDocument, Path("plan.json"))


# What cannot be used

OTHER = "of the package other-plugins 0.3 (entry point thing = other:thing)"
LAYOUT = """
from semisynth_gl.layouts import Layout, view_stems

class thing(Layout):
    place = "{key.split}/{key.index}_"
    names = view_stems({}, "{channel}_{view}") | {"provenance": "pair"}

    def stems(self, key):
        return {role: self.place.format(key=key) + name for role, name in self.names.items()}

    def folder(self, split, splits):
        return ""

"""
MESH = "import semisynth_gl\nCORNERS, TRIANGLES = [[0, 0, 0], [0, 1, 0], [0, 0, {0}]], [[0, 1, 2]]\n"
POINT = "CORNERS = [[1, 1, 1]] * 3\n"
PICTURE = "picture = lambda rng: rng.integers(0, 256, (99, 99, 3), 'uint8')\n"
PICTURES = "expected a function from a numpy.random.Generator to pictures, arrays (H, W, 3) of uint8"
FUNCTION = "expected a function from a numpy.random.Generator to a semisynth_gl.Mesh"

USES = {
    "layout": ("layouts", lambda: find_layout("thing")),
    "texture source": (
        "textures",
        lambda: prepare_atlas(CONFIG.textures.model_copy(update={"source": "thing"}), Split(0)),
    ),
    "family of models": ("models", lambda: build_family("thing", 2, Split(0))),
    "scene recipe": ("recipes", lambda: plugin_recipe("thing")),
}

# The code of the plug-in, and parts of the message.
FAULTS = {
    "layout": [
        ("import nowhere", "cannot be imported: ModuleNotFoundError: No module named 'nowhere', in *other.py, line 1"),
        ("", "cannot be imported: AttributeError: module 'other' has no attribute 'thing'"),
        ("thing = 3", "expected an instance or a subclass of semisynth_gl.layouts.Layout, got int"),
        ("class thing: pass", "expected an instance or a subclass of semisynth_gl.layouts.Layout, got thing"),
        ("from semisynth_gl.layouts import Layout as thing", "cannot be made: TypeError: Can't instantiate abstract"),
    ],
    "texture source": [
        ("thing = 3", f"{PICTURES}, got int"),
        ("thing = lambda rng: 1 / 0", "fails: ZeroDivisionError: division by zero, in *other.py, line 1"),
        ("thing = lambda: []", "fails: TypeError: <lambda>() takes 0 positional arguments"),
        ("thing = lambda rng: rng.random((99, 99, 3))", f"fails: {PICTURES}, got ndarray"),
        (
            "thing = lambda rng: [rng.random((9, 9, 3))]",
            "'thing/00000': expected an array (H, W, 3) of uint8, got (9, 9",
        ),
        (
            f"{PICTURE}thing = lambda rng: [picture(rng), None]",
            "fails at picture 1: picture 'thing/00001': expected an",
        ),
        (
            f"{PICTURE}def thing(rng):\n    yield picture(rng)\n    raise KeyError('x')",
            "fails at picture 1: KeyError: 'x', in *other.py, line 4",
        ),
    ],
    "scene recipe": [
        (
            "thing = 3",
            "expected a mapping of a config's sections to their keys, or a function that returns *got int",
        ),
        ("thing = lambda: 1 / 0", "fails: ZeroDivisionError: division by zero, in *other.py, line 1"),
        ("thing = lambda rng: {}", "fails: TypeError: <lambda>() missing 1 required positional argument"),
        (
            "thing = {'particles': {'size_px': {1, 2}}}",
            "has values that YAML cannot hold: TypeError: ",
        ),
        (
            "thing = {'particles': {'size_px': float('inf')}}",
            "has values that YAML cannot hold: ValueError: ",
        ),
        ("thing = {'weight': 3}", "got the key weight, which only a config that uses the recipe may set"),
        ("thing = {'particles': {'size': 3}}", "particles.size: a recipe cannot change this key"),
        ("thing = {'camera': {'width_px': 3}}", "camera.width_px: a recipe cannot change this key"),
        ("thing = {'particles': {'drift': -1}}", "particles.drift: expected numbers of 0 or more"),
    ],
    "family of models": [
        ("thing = 3", f"{FUNCTION}, got int"),
        ("def thing(rng):\n    return rng.nothing", "fails for model 0: AttributeError: *other.py, line 2"),
        ("thing = lambda rng: 3", f"fails for model 0: {FUNCTION}, got int; make_model makes a Mesh"),
        (
            f"{MESH}{POINT}thing = lambda rng: semisynth_gl.make_model('x', CORNERS, TRIANGLES)",
            "fails for model 0: model x: has no extent",
        ),
        (
            f"{MESH}{POINT}thing = lambda rng: semisynth_gl.make_mesh('x', CORNERS, [[0, 0]] * 3, TRIANGLES)",
            "fails for model 0: model thing/x: has no extent",
        ),
    ],
}
LAYOUT_FAULTS = [
    ("stems = lambda self, key: 1 / 0", "cannot be used: ZeroDivisionError: division by zero, in *other.py, line 14"),
    (
        "stems = lambda self, key: {}",
        "stems: expected the roles left, right, disparity_left, provenance and others, got no",
    ),
    (
        "names = thing.names | {'disparty_right': 'd'}",
        "stems: there is no role 'disparty_right'; did you mean disparity_r",
    ),
    (
        "names = dict.fromkeys(thing.names, 'x')",
        "expected a path of its own for each file, got 'train/0_x.png' for left",
    ),
    ("place = 'all'", "got 'allimage_left.png' for left of pair 0 of train and for left of pair 1 of train"),
    ("place = '{key.index}_'", "for left of pair 0 of train and for left of pair 0 of validation"),
    ("place = '../{key.split}/{key.index}_'", "left of pair 0 of train: expected a path below the dataset's folder"),
    ("place = '/{key.split}/{key.index}_'", "left of pair 0 of train: expected a path below the dataset's folder"),
    ("place = 'a b/{key.split}/{key.index}_'", "in ASCII without blanks, got 'a b/train/0_image_left.png'"),
    ("place = 'é/{key.split}/{key.index}_'", "in ASCII without blanks, got 'é/train/0_image_left.png'"),
    ("needs = {'depht'}", "needs: expected some of visibility, *got depht"),
    ("encodings = 'png'", "encodings: expected None or Encodings, got 'png'"),
    ("packed = 'yes'", "packed: expected True or False, got 'yes'"),
    ("lists = lambda *_: {'all.txt': 'text'}", "lists: expected bytes for all.txt, got str"),
    (
        "links = lambda *_: {'there': '../..'}",
        "links: expected targets below the dataset's folder, got '../..' for there",
    ),
    (
        "links = lambda *_: {'train/0_image_left.png': '.'}",
        "'train/0_image_left.png' for left of pair 0 of train and for link",
    ),
]
FAULTS["layout"] += [(f"{LAYOUT}thing.{line}", message) for line, message in LAYOUT_FAULTS]


HOSTILE = {
    "raise SystemExit(0)": "SystemExit: 0",
    "raise BaseException('no')": "BaseException: no",
    "raise type('Error', (Exception,), {'__str__': lambda self: 1 / 0})": "Error: its text cannot be shown",
}
for _code, _message in HOSTILE.items():
    _function = f"def thing(*arguments):\n    {_code}"
    for _noun, _what in (
        ("texture source", "fails"),
        ("family of models", "fails for model 0"),
        ("scene recipe", "fails"),
    ):
        FAULTS[_noun].append((_function, f"{_what}: {_message}, in *other.py, line 2"))
    FAULTS["layout"].append((_code, f"cannot be imported: {_message}, in *other.py, line 1"))


@pytest.mark.parametrize("noun", USES)
def test_a_plugin_that_cannot_be_used_is_named_with_its_fault(noun, install):
    group, use = USES[noun]
    for number, (code, message) in enumerate(FAULTS[noun]):
        with install({group: ["thing = other:thing"]}, code, folder=str(number)), pytest.raises(InputError) as caught:
            use()
        text = str(caught.value)
        assert text.startswith(f"{noun} 'thing' {OTHER}: "), code
        for part in message.split("*"):
            assert part in text, code


def test_what_ends_the_program_from_within_is_an_error(install, tmp_path):
    code = f"{LAYOUT}import sys\nthing.encodings_for = lambda *_: sys.exit(0)"
    with install({"layouts": ["thing = other:thing"]}, code):
        message = said("generate", "--config", "middlebury", "--layout", "thing", "--out", tmp_path / "set")
    assert message.startswith("a package ended the command before it was done (SystemExit: 0): see whether")


def test_a_layout_without_a_fault_is_taken(install):
    with install({"layouts": ["thing = other:thing"]}, LAYOUT):
        assert find_layout("thing").files(Key("lab", "test", 7), Encodings())["left"] == "test/7_image_left.png"


def test_a_broken_plugin_keeps_nobody_from_the_others(install):
    entries = {
        "layouts": ["thing = other:nothing"],
        "models": ["knots = nowhere:knot", "number = other:number", "user = other:function"],
        "textures": ["dots = other:function"],
        "recipes": ["loft = other:number"],
    }
    with install(entries, "number = 3\nfunction = lambda rng: [3]"):
        assert "thing" in layout_names()
        assert find_layout("kitti").needs == {"visibility", "instances"}
        shown = said("doctor")
    assert "BROKEN: layout 'thing' of the package other-plugins 0.3" in shown
    assert "BROKEN: family of models 'knots' of the package other-plugins 0.3" in shown
    for plugin, fault in (
        ("family of models 'number'", "(entry point number = other:number): expected a function from a numpy"),
        ("family of models 'user'", "(entry point user = other:function): expected a name of its own"),
        ("texture source 'dots'", "(entry point dots = other:function): fails at picture 0: picture 'dots/00000'"),
        ("scene recipe 'loft'", "(entry point loft = other:number): expected a mapping"),
    ):
        assert f"BROKEN: {plugin} of the package other-plugins 0.3 {fault}" in shown
    assert "Ready: " in shown


@pytest.mark.usefixtures("acme")
def test_a_recipe_of_the_page_makes_a_dataset_that_needs_no_package_later(tmp_path, site):
    config = tmp_path / "attic.yaml"
    values = cheap(textures={"source": "procedural"}).model_dump(mode="json", exclude_none=True)
    recipes = [{"extends": "attic", "structures": {"panels": 2}}, {"extends": "attic", "recipe": "b"}, {"recipe": "c"}]
    config.write_text(json.dumps(values | {"scenes": recipes}))
    loaded = load_config(config)
    assert [recipe.name for recipe in loaded.recipes()] == ["attic", "b", "c"]
    walls = [recipe.config.structures for recipe in loaded.recipes()]
    assert [wall.panels for wall in walls] == [Range(2, 2), Range(1, 4), Range(0, 0)]
    assert [wall.panel_slant_deg for wall in walls] == [Range(30, 75), Range(30, 75), Range(0, 75)]
    assert parse_config(explain(str(config)), "full.yaml").digest() == loaded.digest()
    options = ("--config", config, "--out", tmp_path / "set", "--pairs", 6)
    assert "6 pairs in" in said("generate", *options)
    attic = {"recipes": {"attic": {"package": "acme-stereo", "version": "1.2.0"}}}
    assert read_index(tmp_path / "set").document.values["plugins"] == attic
    assert "Plug-in: scene recipe 'attic' of the package acme-stereo 1.2.0" in said("doctor")
    sys.path.remove(str(site))
    find_anew()
    pairs = open_dataset(tmp_path / "set")
    assert {pair.recipe for pair in pairs} == {"attic", "b", "c"}
    assert all(pair.provenance["plugins"] == attic for pair in pairs)
    assert "6 pairs, nothing found" in said("verify", tmp_path / "set", "--oracle")
    assert said("generate", *options).endswith(f"scene recipe 'attic' {MISSING}")
    with pytest.raises(InputError, match=r"attic\.yaml:1: scenes\.0\.extends: scene recipe: no installed package has"):
        load_config(config)
    with pytest.raises(InputError, match="scene recipe 'attic' comes from the plug-in package acme-stereo 1"):
        generate(loaded, tmp_path / "set", 6)


def test_names_that_are_taken_are_refused_where_they_are_asked_for(install):
    procedural = load_config("kitti", ["textures.source=procedural"]).textures
    uses = {
        "layout 'kitti'": lambda: find_layout("kitti"),
        "texture source 'procedural'": lambda: prepare_atlas(procedural, Split(0)),
        "family of models 'user'": lambda: find_family("user"),
    }
    taken = {"layouts": ["kitti"], "textures": ["builtin", "procedural"], "models": ["user"]}
    entries = {group: [f"{name} = other:thing" for name in names] for group, names in taken.items()}
    with install(entries, "thing = 3"):
        for noun, use in uses.items():
            with pytest.raises(
                InputError, match=rf"^{noun} of the package other-plugins 0\.3 .*got that of a built-in"
            ):
                use()
        assert find_layout("eth3d").needs == {"visibility"}
    entries = {"models": ["knots = other:thing"]}
    with (
        install(entries, folder="first", name="first"),
        install(entries, folder="second", name="second"),
        pytest.raises(InputError, match=r"'knots': expected one package .* got first 0\.3 .* and second 0\.3"),
    ):
        find_family("knots")
    simple = "expected the name of a plug-in's family; the weight of this family is models.simple, got 'simple'"
    for overrides, place in (
        ({"models.families": {"simple": 1}}, "models.families.simple"),
        (["models.families.simple=0"], "`overrides` models.families.simple"),
        ({"scenes": [{"recipe": "a", "models": {"families": {"simple": 1}}}]}, "scenes.0.models.families.simple"),
    ):
        with pytest.raises(InputError) as caught:
            load_config("kitti", overrides)
        assert str(caught.value).removeprefix("overrides: ") == f"{place}: {simple}"


@pytest.mark.usefixtures("acme")
def test_names_in_a_config_are_checked_with_their_place(tmp_path):
    path = tmp_path / "lab.yaml"
    path.write_text(
        "extends: kitti\ntextures:\n  source: poster\nmodels:\n  families: {knots: 1, nots: 0, hinges: 2}\n"
    )
    with pytest.raises(InputError) as caught:
        load_config(path)
    expected = "texture source: expected one of builtin, images, photographs, posters, procedural, got 'poster'"
    assert str(caught.value) == f"{path}:3: textures.source: {expected}; did you mean posters?"
    with pytest.raises(InputError, match=r"lab.yaml:5: models.families.hinges: .* expected one of knots, got 'hinges'"):
        load_config(path, ["textures.source=posters"])
    config = load_config(path, ["textures.source=posters", "models.families.hinges=0"])
    # A weight of 0 leaves out what need not be there.
    assert list(config.used_plugins().values()) == [("textures", "posters"), ("models", "knots")]
    with pytest.raises(
        InputError, match="models: expected a weight above 0 for simple, complex or user, or in families"
    ):
        load_config("kitti", ["models={simple: 0, complex: 0, user: 0, families: {knots: 0}}"])


def test_a_dataset_without_plugins_has_no_key_of_theirs():
    config = load_config("kitti")
    assert config.model_dump(mode="json")["models"]["families"] == {}
    assert "plugins" not in make_plan(config, 0, "kitti", {"train": 1}).values()
    assert Config.model_validate(config.model_dump(mode="json")) == config.model_copy(update={"layout": None})
    assert load_config("kitti", {"models.families": {}}).digest() == config.digest()


@pytest.mark.parametrize("name", layout_names())
def test_the_layouts_of_the_program_pass_what_those_of_plugins_must(name):
    check_layout(find_layout(name))


def test_a_layout_takes_no_name_that_every_dataset_has(install):
    for top in ("shards", "README.md", ".partial"):
        code = f"{LAYOUT}thing.place = '{top}/{{key.split}}-{{key.index}}_'"
        refused = pytest.raises(InputError, match=f"layout thing gives a file the name {top}/train-0_image_left.png")
        with install({"layouts": ["thing = other:thing"]}, code, folder=top), refused:
            make_plan(load_config("kitti"), 0, "thing", {"train": 1})


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
    with pytest.raises(InputError, match=r"too few models of the family knots .* 2 in all"):
        build_family("knots", 2, split("train", models=True))
    atlases = [prepare_atlas(CONFIG.textures, split(name, models=False)) for name in ("train", "test")]
    assert not set(atlases[0].pictures.values()) & set(atlases[1].pictures.values())


@pytest.mark.usefixtures("acme")
def test_a_family_has_its_weight_beside_the_others():
    library = build_library(CONFIG.models, CONFIG.particles, Split(0))
    assert [mesh.name.partition("/")[0] for mesh in library.models] == ["cube"] * 3 + ["knots"] * 3
    np.testing.assert_allclose(library.chances, [1 / 9] * 3 + [2 / 9] * 3)
    assert all(mesh.radius == pytest.approx(1, abs=1e-6) for mesh in library.models)


def test_a_source_may_draw_all_its_pictures_into_one_array(install):
    code = (
        "import numpy\n{}\ndef thing(rng):\n    canvas = numpy.empty((99, 99, 3), 'uint8')\n    for _ in range(3):\n"
        "        canvas[:] = rng.integers(0, 256, canvas.shape)\n        yield {}\n"
    )
    section = CONFIG.textures.model_copy(update={"source": "thing", "scales": (1.0,), "large_px": 99})
    atlases = []
    for number, (note, given) in enumerate([("", "canvas"), ("# another", "canvas.copy()")]):
        with install({"textures": ["thing = other:thing"]}, code.format(note, given), folder=str(number)):
            atlases.append(prepare_atlas(section, Split(0)))
    reused, apart = atlases
    assert len(apart.large_layers) == len(apart.pictures) == 2
    np.testing.assert_array_equal(reused.large_layers, apart.large_layers)


def test_the_cache_knows_the_version_and_the_code_of_a_plugin(install, tmp_path):
    log = tmp_path / "calls"
    call = f"def thing(rng):\n    open({str(log)!r}, 'a').write('.')\n"
    code = f"{MESH}{call}    return semisynth_gl.make_model('x', CORNERS, TRIANGLES)"
    section = CONFIG.models.model_copy(update={"simple": 0.0, "families": {"thing": 1.0}, "variants": 1})
    heights, calls = [], []
    for number, (version, height) in enumerate([("1", 1), ("1", 1), ("1", 20), ("2", 20), ("2", 20)]):
        with install({"models": ["thing = other:thing"]}, code.format(height), folder=str(number), version=version):
            mesh = build_library(section, CONFIG.particles, Split(0)).models[0]
        heights.append(float(np.ptp(mesh.positions[:, 2]) / np.ptp(mesh.positions[:, 1])))
        calls.append(len(log.read_text()))
    np.testing.assert_allclose(heights, [1, 1, 20, 20, 20], rtol=1e-5)
    assert calls == [1, 1, 2, 3, 3]


def surface(mesh):
    """Lengths of edges on the surface and in UV, model units."""
    corners, uv = mesh.positions[mesh.triangles], mesh.uv[mesh.triangles]
    return (np.linalg.norm(np.diff(each, axis=1), axis=2) for each in (corners, uv))


def test_a_model_is_scaled_and_gets_uv_in_its_units():
    corners = np.array([[0, 0, 5], [30, 0, 5], [30, 40, 5], [0, 40, 5], [900, 900, 900]]) * 1.0
    triangles = [[0, 1, 2], [0, 2, 3]]
    for uv in (None, corners[:, :2] / 7, np.zeros((5, 2))):
        mesh = make_model("sheet", corners, triangles, uv)
        assert isinstance(mesh, Mesh)
        assert mesh.radius == pytest.approx(1)
        assert len(mesh.positions) == 4  # no triangle has the fifth
        lengths, in_uv = surface(mesh)
        np.testing.assert_allclose(lengths, in_uv, rtol=1e-5)
    for arguments, message in (
        ((corners, [[0, 1, 5]]), "triangle index 5 is out of range"),
        ((corners, [[0, 1, -1]]), "index -1 is negative"),
        ((corners[:, :2], triangles), r"positions must be \(V, 3\)"),
        ((corners * np.nan, triangles), "not finite"),
        ((corners, triangles, corners[:2, :2]), "5 positions but 2 uv"),
        ((corners, [[0, 0, 1]]), "has no triangle with an area"),
        ((corners, []), "has no triangles"),
        (("cube", triangles), "positions"),
    ):
        with pytest.raises(InputError, match=message):
            make_model("sheet", *arguments)
