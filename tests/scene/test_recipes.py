"""Recipes: which sequences use them, their scenes, and datasets of several recipes."""

import json
import pickle
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from samplers import patches
from tiny_datasets import cheap, findings

from semisynth_gl.config import Config, load_config
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.histogram import Histogram, count_pixels, total_variation
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.scene.mix import RecipeMixSampler, recipe_numbers
from semisynth_gl.scene.sampler import SceneSampler
from semisynth_gl.scene.sources import recipe_libraries
from semisynth_gl.seeds.splits import Split

PATCHES = patches()
FLOW = ["visibility", "instances", "depth", "flow", "flow_backward", "disparity_change"]

# Together they change every section that a recipe may change. Any six successive sequences include each recipe.
RECIPES = [
    {"recipe": "plain"},
    {
        "recipe": "walls",
        "camera": {"baseline_m": [0.05, 0.1], "doffs_px": 1},
        "background": {"cuboid": 0, "plane": 1},
        "structures": {"ground": 1, "panels": [1, 3], "panel_size_px": [10, 40]},
        "particles": {"layers": [{"disparity_px": [3, 20], "count": [2, 6]}], "thinness": [0.2, 1]},
    },
    {
        "recipe": "solids",
        "disparity": {"target": {"form": "uniform"}},
        "particles": {"size_px": [30, 60]},
        "models": {"complex": 0, "kinds": {"cube": 4, "pyramid": 0}},
        "textures": {"texels_per_pixel": 3},
    },
]


def mixed(config, recipes=RECIPES):
    return Config.model_validate(config.model_dump(mode="json") | {"scenes": recipes})


def small(variants=1):
    """Make a config of 64 x 48 pixels with solved numbers of particles, whose models have few triangles."""
    return cheap(
        particles={"layers": None, "size_px": [10, 30]},
        models={"complex": 0, "variants": variants, "kinds": {"sphere": 0, "torus": 0, "capsule": 0, "cylinder": 0}},
        textures={"source": "procedural"},
        sequence={"length": 2},
    )


def sampler_of(config, seed=3):
    return RecipeMixSampler(config, seed, recipe_libraries(config, Split(seed)), PATCHES)


# The share of each recipe


@given(st.lists(st.floats(0.01, 10), min_size=1, max_size=6), st.integers(0, 2**32), st.integers(0, 10**9))
def test_successive_sequences_have_each_recipe_as_often_as_its_share_says(weights, seed, first):
    given_shares = np.array(weights) / sum(weights)
    recipes = recipe_numbers(first + np.arange(500), given_shares.tolist(), seed)
    so_far = np.arange(1, 501)
    for recipe, share in enumerate(given_shares):
        # Independent random choices would sometimes be off by more than 20.
        assert np.abs(np.cumsum(recipes == recipe) - share * so_far).max() < 4.5


def test_a_preview_shows_each_recipe_and_says_what_it_is(program, tmp_path):
    path = tmp_path / "mix.yaml"
    path.write_text(json.dumps(mixed(small()).model_dump(mode="json", exclude_none=True)))
    code, out, err = program("preview", "--config", path, "--out", "sheet.png")
    assert code == 0, err
    assert "4 pairs in sheet.png\n" in out
    said = re.findall(r"^(\w+), (\d+)% of the scenes: shown as pairs? ([\d, ]+)$", out, re.MULTILINE)
    assert [(name, share) for name, share, _ in said] == [("plain", "33"), ("walls", "33"), ("solids", "33")]
    shown = sorted(int(index) for *_, indices in said for index in indices.split(", "))
    assert shown == sampler_of(mixed(small()), seed=0).overview(4)


# Configs with recipes


BASE = (
    "extends: middlebury\nname: mine\n"
    "scenes: []\nparticles: {density: dense, drift: 0.1}\nmodels: {kinds: {mug: 3, chair: 0}}\n"
    "structures: {ground: 1, ground_disparity_px: [60, 80]}\n"
)


@pytest.mark.parametrize(
    "keys",
    [
        "particles: {layers: [{count: [0, 6]}]}",
        "camera: {focal_mm: 4, sensor_width_mm: 6}",
        "models: {kinds: {chair: 2}, simple: 0}",
        "structures: {ground_disparity_px: null}",
    ],
)
def test_a_recipe_goes_over_its_config_as_a_file_over_the_one_it_extends(tmp_path, keys):
    (tmp_path / "base.yaml").write_text(BASE)
    (tmp_path / "alone.yaml").write_text(f"extends: base.yaml\n{keys}\n")
    item = "".join(f"    {line}\n" for line in keys.splitlines())
    (tmp_path / "mix.yaml").write_text(f"extends: base.yaml\nscenes:\n  - recipe: other\n{item}  - recipe: plain\n")
    mix, alone, base = (load_config(tmp_path / f"{name}.yaml") for name in ("mix", "alone", "base"))
    other, plain = mix.recipes()
    assert (other.name, other.share, plain.name, plain.share) == ("other", 0.5, "plain", 0.5)
    assert other.config.digest() == alone.digest() != base.digest()
    assert plain.config.digest() == base.digest() != mix.digest()
    for again in (Config.model_validate(mix.model_dump(mode="json")), pickle.loads(pickle.dumps(mix))):  # noqa: S301
        assert again.digest() == mix.digest()
        assert [recipe.config for recipe in again.recipes()] == [recipe.config for recipe in mix.recipes()]
    assert load_config(tmp_path / "mix.yaml", {"scenes": []}).digest() == base.digest()


def test_recipes_of_weight_0_are_left_out():
    config = mixed(cheap(), [{"recipe": "a", "weight": 0}, {"recipe": "b", "weight": 2}])
    assert [(recipe.name, recipe.share) for recipe in config.recipes()] == [("b", 1.0)]


@pytest.mark.parametrize(
    ("item", "said"),
    [
        ("{recipe: a, particles: {densty: 3}}", "mix.yaml:3: scenes.0.particles.densty: unknown key; did you mean"),
        ("{recipe: a, camera: {width_px: 64}}", "scenes.0.camera.width_px: a recipe cannot change this key"),
        ("{recipe: a, camera: 5}", "scenes.0.camera: expected keys and values, got 5"),
        ("{recipe: a, disparity: {max_px: 0.1}}", "scenes.0.disparity.max_px: a recipe cannot change this key"),
        ("{recipe: a, weight: 0}", "mix.yaml:2: scenes: expected a weight above 0"),
        ("{recipe: a}\n- {recipe: a}", "recipes with different names"),
        ("{recipe: a, camera: {baseline_m: null}}", "mix.yaml:3: scenes.0.camera.baseline_m: give either"),
        ("{recipe: a, disparity: {target: {form: uniform, high_px: 900}}}", "scenes.0.disparity.target"),
    ],
)
def test_wrong_recipes_are_refused(tmp_path, item, said):
    (tmp_path / "mix.yaml").write_text(f"extends: middlebury\nscenes:\n- {item}\n")
    with pytest.raises(InputError, match=re.escape(said)):
        load_config(tmp_path / "mix.yaml")


# The scenes of a mix


def test_scenes_of_stated_recipes_are_those_of_the_recipes_alone():
    config = mixed(small(variants=2), [RECIPES[2], RECIPES[1]])
    mix, alone = sampler_of(config), {}
    for each in config.recipes():
        own = each.config
        alone[each.name] = SceneSampler(own, 3, build_library(own.models, own.particles, Split(3)), PATCHES)
    seen = set()
    for index in (9, 0, 5, 12, 1, 4, 8, 13):
        sampled = mix.sample(index, index % 2)
        seen.add(sampled.recipe)
        expected = alone[sampled.recipe].sample(index, index % 2)
        assert (sampled.scene.camera, sampled.scene.near_m) == (expected.scene.camera, expected.scene.near_m)
        for name in ("camera_from_world", "world_from_model", "layer", "uv_scale", "uv_offset"):
            np.testing.assert_array_equal(getattr(sampled.scene, name), getattr(expected.scene, name), err_msg=name)
        # Model numbers of a mix count over all its recipes, so compare models by name and vertices.
        for number, same in zip(sampled.scene.model, expected.scene.model, strict=True):
            assert mix.models[number].name == alone[sampled.recipe].models[same].name
            np.testing.assert_array_equal(mix.models[number].positions, alone[sampled.recipe].models[same].positions)
        for frames in (-1, 1):
            moved, same = sampled.motion(frames), expected.motion(frames)
            np.testing.assert_array_equal(moved.world_from_model, same.world_from_model)
            np.testing.assert_array_equal(moved.instance, same.instance)
    assert seen == {"walls", "solids"}


def test_a_dataset_has_one_library():
    config = mixed(small(variants=2), [RECIPES[2], RECIPES[0], RECIPES[1]])
    solids, plain, walls = recipe_libraries(config, Split(3))
    alone = build_library(config.models, config.particles, Split(3))
    assert solids.models == plain.models == walls.models  # meshes compare by identity
    assert sorted(mesh.name for mesh in plain.models) == sorted(mesh.name for mesh in alone.models)
    assert [plain.models[number].name for number in plain.sampled] == [mesh.name for mesh in alone.models]
    np.testing.assert_array_equal(plain.chances, alone.chances)
    assert plain.relief.fill == alone.relief.fill > walls.relief.fill
    chosen = {solids.models[number].name for number in solids.sampled}
    assert "cube" in chosen
    assert "pyramid" not in chosen


def test_a_dataset_of_several_recipes_comes_to_its_target():
    """One recipe states far layers, one has a near target; the solver fits the third one to the rest."""
    far = {"particles": {"layers": [{"disparity_px": [2, 5], "count": [20, 30]}]}}
    near = {"disparity": {"target": {"form": "gamma", "mean_px": 9, "spread_px": 2}}}
    recipes = [{"recipe": "far", **far}, {"recipe": "near", **near}, {"recipe": "rest", "weight": 3}]
    config = mixed(small(), recipes)
    target = config.wanted_histogram()
    with PairRenderer(config, 0) as pairs:
        expected, counts = pairs.sampler.expected(), 0
        for index in range(60):
            counts += count_pixels(pairs.render(index, checked=False).frame.left.disparity, target.edges_px)
        shown = {sampler.recipe: sampler.disparity_solver.expected() for sampler in pairs.sampler.samplers}
    assert min(total_variation(target, shown[name]) for name in ("far", "near")) > 0.25
    assert total_variation(target, expected) < 0.05
    assert total_variation(expected, Histogram.from_counts(target.edges_px, counts)) < 0.06


def test_faults_of_a_recipes_scenes_name_it():
    sampler = sampler_of(mixed(small(), [{"recipe": "few", "particles": {"most": 1}}]))
    with pytest.raises(InputError, match=r"^recipe few: disparity\.target needs about"):
        sampler.sample(0)


# Datasets


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Write a dataset of moving scenes of all recipes, with all outputs that verify checks in rebuilt scenes."""
    values = small().model_dump(mode="json") | {"outputs": FLOW}
    values["camera"] |= {"sway_m": [0.005, 0.02]}
    out = tmp_path_factory.mktemp("mix") / "d"
    generate(mixed(Config.model_validate(values)), out, 12, seed=1, layout="middlebury")
    return out


def test_a_dataset_of_recipes_is_exact(dataset):
    assert findings(dataset, rays=16) == []


def test_pairs_say_their_recipe(dataset):
    pairs = open_dataset(dataset)
    config = read_index(dataset).plan.config
    numbers = recipe_numbers(np.arange(12) // 2, [recipe.share for recipe in config.recipes()], 1)
    names = [recipe["recipe"] for recipe in RECIPES]
    assert [pair.recipe for pair in pairs] == [names[number] for number in numbers]
    assert {pair.recipe for pair in pairs} == set(names)
    assert all(pair.provenance["recipe"] == pair.recipe for pair in pairs)
