import re

import numpy as np
import pytest
from config_texts import parse_config
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from semisynth_gl.config import Config, Range, load_config, packaged_configs
from semisynth_gl.config.explain import explain
from semisynth_gl.config.load import summaries
from semisynth_gl.inputs.errors import InputError

CAMERA = "camera: {width_px: 64, height_px: 48, focal_px: 50, baseline_m: 0.1}\n"
DISPARITY = "disparity: {min_px: 1, max_px: 20}\n"


def written(folder, text, name="mine.yaml"):
    path = folder / name
    path.write_text(text)
    return path


def complaint(folder, text, overrides=()):
    with pytest.raises(InputError) as caught:
        load_config(written(folder, text), overrides)
    return str(caught.value)


@pytest.mark.parametrize(("ablation", "factor"), [("geometry", "models"), ("textures", "textures")])
def test_configs_of_an_ablation_differ_only_in_their_factor(ablation, factor):
    first, *others = (load_config(name).model_dump() for name in packaged_configs() if f"ablation-{ablation}" in name)
    assert others
    for other in others:
        assert {key for key in other if first[key] != other[key]} == {"name", factor}


def test_extends_merges_sections_and_finds_files_beside(tmp_path):
    written(tmp_path, "name: base\n" + CAMERA + DISPARITY + "textures: {patch_px: 64}\n", "base.yaml")
    child = written(tmp_path, "extends: base.yaml\nname: child\ncamera: {width_px: 65}\ntextures: {scales: [1]}\n")
    config = load_config(child)
    assert (config.name, config.camera.width_px, config.camera.height_px) == ("child", 65, 48)
    assert (config.textures.patch_px, config.textures.scales) == (64, (1.0,))


def test_errors_name_file_line_key_what_was_expected_and_what_came(tmp_path):
    text = (
        "name: mine\n"
        "camera:\n"
        "  width_px: 64\n"
        "  height_px: tall\n"
        "  focal_px: [9, 3]\n"
        "  baseline_m: -1\n"
        "  widht_px: 3\n"
        "disparity: {min_px: 1, max_px: 20}\n"
        "zzz: 1\n"
    )
    for line, words in zip(
        sorted(complaint(tmp_path, text).splitlines()),
        (
            "4: camera.height_px: expected a valid integer, got 'tall'",
            "5: camera.focal_px: expected a number or [low, high] with low <= high, up to 1e+06, got [9, 3]",
            "6: camera.baseline_m: expected 1e-06 to 1e+06, got -1",
            "7: camera.widht_px: unknown key; did you mean camera.width_px?",
            "9: zzz: unknown key; `semisynth-gl configs NAME` lists all keys of a config",
        ),
        strict=True,
    ):
        assert line == f"{tmp_path / 'mine.yaml'}:{words}"


MINIMAL = "name: m\n" + CAMERA + DISPARITY


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("name: mine\n" + CAMERA, "mine.yaml: disparity is missing"),
        (
            "name: two words\n" + CAMERA + DISPARITY,
            "mine.yaml:1: name: expected letters, digits and hyphens",
        ),
        (MINIMAL + "particles:\n  layers:\n  - {disparity_px: 3}\n", ":6: particles.layers.0: count is missing"),
        (MINIMAL + "particles: {layers: [{cont: 3}]}\n", "0.cont: unknown key; did you mean count?"),
        (MINIMAL + "background: {cuboid: 0, plane: 0}\n", ":4: background.plane: expected a weight above 0"),
        (MINIMAL + "splits: {validation: 0.6, test: 0.5}\n", "splits.test: validation and test add up to 1.1"),
        (MINIMAL + "textures: {sequence: 1}\n", "textures.sequence: expected a valid boolean, got 1"),
        ("name: m\n" + CAMERA.replace("50", ".nan") + DISPARITY, ":2: camera.focal_px: expected a number or"),
        ("name: m\n" + CAMERA.replace("focal_px: 50", "focal_mm: 5") + DISPARITY, "give either focal_px, or focal_mm"),
        ("- a list\n", "mine.yaml:1: expected sections"),
        ("camera: 3\n", "mine.yaml:1: camera: expected keys and values, got 3"),
        ("extends: mine.yaml\n", "extend each other in a circle"),
        ("extends: nowhere\n", "mine.yaml:1: extends: no such config: nowhere"),
        (MINIMAL.replace("1, max_px: 20", "64, max_px: 99"), ":3: disparity.min_px: no point is in both images"),
        ("", "and disparity:, the file is empty"),
        (MINIMAL + "a: {b: 1, b: 2}\n", ':4: not valid YAML: found duplicate key "b"'),
        (MINIMAL.replace("48", "48, 2"), "camera.2: unknown key; `semisynth-gl"),
        (MINIMAL + "scenes: [{recipe: a, wieght: 2}]\n", ":4: scenes.0.wieght: unknown key; did you mean weight?"),
        ("extends: [1]\n", "mine.yaml:1: extends: expected the name of a config, got [1]"),
    ],
)
def test_wrong_configs_are_refused(tmp_path, text, word):
    assert word in complaint(tmp_path, text)


def test_a_range_beyond_the_width_is_taken_where_points_may_be_in_both_images(tmp_path):
    path, beyond = written(tmp_path, MINIMAL), ["disparity.min_px=64", "disparity.max_px=99"]
    for seen in (["background.plane=1"], ["camera={baseline_m: null, baselines: [1, 9]}"], ["rig.right_roll_deg=2"]):
        assert load_config(path, [*beyond, *seen])


def test_unknown_names_get_the_nearest(tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"no such config: midlebury; did you mean middlebury\?"):
        load_config("midlebury")
    with pytest.raises(InputError, match="no such config"):
        load_config(tmp_path / "none.yaml")
    for name in ("a" * 5000, "a\0b"):
        with pytest.raises(InputError, match="no such config"):
            load_config(name)
        assert "mine.yaml:1: extends: no such config" in complaint(
            tmp_path, f'extends: "{name}"\n'.replace("\0", "\\0")
        )
    (tmp_path / "middlebury").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_config("middlebury").name == "middlebury"


def test_overrides_are_yaml_and_name_themselves(tmp_path):
    path = written(tmp_path, "name: mine\n" + CAMERA + DISPARITY)
    config = load_config(path, ["camera.focal_px=[40, 1e2]", "textures.sequence=true"])
    assert (config.camera.focal_px, config.textures.sequence) == (Range(40, 100), True)
    assert load_config(path, {"camera.focal_px": [40, 100.0], "textures.sequence": True}) == config
    assert load_config(path, {"camera": {"focal_px": [40, 100.0]}, "textures": {"sequence": True}}) == config
    for setting, word in (
        ("camera.width=3", r"^override camera\.width: unknown key; did you mean camera\.width_px\?"),
        ("camera.width_px=x", r"^override camera\.width_px: expected a valid integer, got 'x'"),
        ("camera.width_px.more=3", r"camera\.width_px: expected a valid integer"),
        ("camera.width_px", "expected dotted.key=value"),
        ("extends=kitti", "only a file can"),
        ("scenes.0.weight=2", "lists are set whole"),
        ("camera.width_px=[", "^override camera.width_px: .* not valid YAML"),
    ):
        with pytest.raises(InputError, match=word):
            load_config(path, [setting])


@pytest.mark.parametrize("overrides", [dict, lambda given: list(given.items())])
def test_the_callers_values_stay_as_they_are(overrides):
    given = {"disparity": {"min_px": 15, "max_px": 290}, "disparity.max_px": 300}
    assert load_config("middlebury", overrides(given)).disparity.max_px == 300
    assert given == {"disparity": {"min_px": 15, "max_px": 290}, "disparity.max_px": 300}


# Faults that involve several keys

PACKAGED = r"\S*/configs/[a-z-]+\.yaml:\d+"


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("kitti", ["disparity.max_px=1"], rf"disparity.max_px: .* 3 and 1: .* \(with disparity.min_px of {PACKAGED}\)"),
        ("kitti", ["disparity.target.form=gama"], "disparity.target.form: expected one of 'uniform', .*, got 'gama'"),
        ("kitti", ["background.plane=0"], rf"background.plane: .* \(with background.cuboid of {PACKAGED}\)"),
        ("kitti", ["camera.width_px=16384", "camera.height_px=16384"], "camera.height_px: .* at most 134217728"),
        ("kitti", ["textures.patch_px=8192", "textures.max_patches=33"], "textures.max_patches: .* at most 32 "),
        ("kitti", ["disparity.min_px=-1"], "disparity.min_px: .* expected more than 0, as disparity.signed is false"),
        ("kitti", ["disparity.signed=true", "camera.doffs_px=[3, 5]", "disparity.min_px=-4"],
         "disparity.min_px: .* expected more than -3, which is infinitely far away"),
        ("kitti", ["outputs=[disparity_change]", "rig.right_roll_deg=1"], "rig: .* disparity_change needs rectified"),
        ("kitti", ["camera.baselines=[0.1, 0.2]"], "camera.baselines: give either baseline_m, or baselines as a list"),
        ("middlebury", ["camera.cx_right_px=700"], "camera.cx_right_px: cx_right_px needs cx_left_px"),
        ("kitti", ["particles={layers: [], density: dense}"], "particles.density: give either density or layers"),
        ("kitti", ["lens.raw_width_px=9", "lens.raw_height_px=9", "lens.right={fx_px: 9, distortion: [0, 0, 0, 0]}",
                   "lens.left={fx_px: 9, distortion: [0, 0, 0]}"],
         "lens.left.distortion: radial-tangential has 4 or 5 or 8 or 12 coefficients, got 3"),
        ("kitti", ["camera.doffs_px=-40", "disparity.target={form: uniform-depth}"], "camera.doffs_px: .* than 40,"),
        ("kitti", ["disparity.max_px=40", "scenes=[]"],
         rf"disparity.max_px: disparity.target wants 5.1% .* above max_px: .* \(with disparity.target of {PACKAGED}"),
        ("kitti", ["disparity.target={form: uniform, low_px: -99, high_px: 50}"], "disparity.target: .* pixels below"),
        ("kitti", ["background={plane: 1, street: 0, plane_disparity_px: 0}", "scenes=[]"],
         "background.plane_disparity_px: .* goes down to 0 px"),
        # The message comes once, not for each recipe.
        ("kitti", ["camera=null", "scenes=[{recipe: a, camera: {baseline_m: 1}}]"], "camera: .*, got None$"),
        # The other key is in a recipe of the packaged config.
        ("middlebury", ["disparity.target={form: uniform, high_px: 99}", "disparity.max_px=100"],
         rf"disparity.max_px: structures.* \(with scenes.1.structures.ground_disparity_px of {PACKAGED}\)"),
        ("kitti", ["disparity.max_px=30", "disparity.target={form: gamma, mean_px: 9, spread_px: 5}",
                   "scenes=[{recipe: near, structures: {panel_disparity_px: 90}}]"],
         r"scenes.0.structures.panel_disparity_px: .* goes up to 90 px"),
    ],
)  # fmt: skip
def test_the_key_that_was_set_last_is_blamed_and_the_others_named(name, settings, message):
    with pytest.raises(InputError, match=rf"^override {message}"):
        load_config(name, settings)


@pytest.mark.parametrize(
    ("key", "meant"),
    {
        "width_px": "camera.width_px",
        "texture.source": "textures",
        "images": "textures.images or licences.images",
        "models.kind.chair": "models.kinds",
    }.items(),
)
def test_a_wrong_key_names_those_that_may_be_meant(key, meant):
    with pytest.raises(InputError, match=rf"^override {key.partition('.')[0]}.*: unknown key; did you mean .*{meant}"):
        load_config("middlebury", {key: 3})


# Targets


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("{form: gamma, mean_px: 3, spred_px: 2}", "disparity.target: spread_px is missing"),
        ("{form: gamma, mean_px: -3, spread_px: 1}", "disparity.target.mean_px: expected mean_px above origin_px"),
        (
            "{form: gama}",
            "disparity.target.form: expected one of 'uniform', 'uniform-depth', 'gamma', 'histogram', got",
        ),
        ("{form: uniform, hgh_px: 9}", "disparity.target.hgh_px: unknown key; did you mean high_px?"),
        ("{form: uniform, low_px: 30}", "disparity.target: expected low_px < high_px, got 30 and 20"),
    ],
)
def test_faults_of_targets_name_their_keys(tmp_path, target, said):
    text = "name: m\n" + CAMERA + f"disparity:\n  min_px: 1\n  max_px: 20\n  target: {target}\n"
    assert complaint(tmp_path, text).startswith(f"{tmp_path / 'mine.yaml'}:6: {said}")
    assert complaint(tmp_path, MINIMAL, [f"disparity.target={target}"]).startswith(f"override {said}")


def test_a_gamma_between_two_points_of_the_range_is_a_distribution():
    target = {"form": "gamma", "origin_px": 289.98, "mean_px": 289.99, "spread_px": 0.001}
    shares = load_config("middlebury", {"disparity.target": target}).wanted_histogram().shares
    assert shares.sum() == pytest.approx(1)


@pytest.mark.parametrize(
    ("limits", "target", "shares"),
    [
        ((25, 300), {"mean_px": 30, "spread_px": 30}, "56.5% of the pixels below disparity.min_px and 0.0% above"),
        ((40, 100), {"mean_px": 60, "spread_px": 30}, "27.9% of the pixels below disparity.min_px and 10.1% above"),
        ((45, 105), {"mean_px": 65, "spread_px": 30, "origin_px": 5}, "27.9% of the pixels .* and 10.1% above"),
        ((-5, 3), {"mean_px": 4, "spread_px": 0.01}, "0.0% of the pixels below disparity.min_px and 100.0% above"),
    ],
)
def test_the_shares_of_a_gamma_beyond_the_limits_are_its_own(limits, target, shares):
    low, high = limits
    values = {"disparity": {"signed": True, "min_px": low, "max_px": high, "target": {"form": "gamma", **target}}}
    with pytest.raises(InputError, match=rf"disparity.target wants {shares}"):
        load_config("eth3d", values)


def test_a_later_focal_length_takes_back_the_earlier():
    config = load_config("middlebury", ["camera.focal_mm=4", "camera.sensor_width_mm=6"])
    assert (config.camera.focal_px, config.camera.sensor_width_mm) == (None, 6)
    assert load_config("kitti", ["camera.doffs_px=3"]).camera.cx_right_px is None


@given(st.floats(-1e6, 1e6), st.floats(0, 1e6), st.integers(0, 2**32))
def test_draws_stay_in_their_range(low, width, seed):
    value = Range(low, low + width)
    samples = [value.sample(np.random.default_rng(seed)), *value.sample_many(np.random.default_rng(seed), 20)]
    assert all(low <= x <= low + width for x in samples)


def test_digests_follow_values_not_spelling(tmp_path):
    one = load_config(written(tmp_path, "name: mine\n" + CAMERA + DISPARITY, "a.yaml"))
    same = load_config(written(tmp_path, DISPARITY + CAMERA + "name: 'mine'\nsequence: {length: 1}\n", "b.yaml"))
    other = load_config(written(tmp_path, "name: mine\n" + CAMERA + "disparity: {min_px: 1, max_px: 21}\n", "c.yaml"))
    assert one.digest() == same.digest() != other.digest()
    assert Config.model_validate(one.model_dump()) == one


@pytest.mark.parametrize("name", packaged_configs())
def test_a_config_in_full_is_the_same_config_and_explains_every_key(name):
    config = load_config(f"{name}.yaml")
    assert config.name == name
    assert summaries()[name]
    text = explain(config)
    assert parse_config(text).digest() == config.digest()
    blocks = [block.splitlines() for block in text.strip().split("\n\n")]
    assert len(blocks) == len(Config.model_fields)
    for key, lines in zip(Config.model_fields, blocks, strict=True):
        section = getattr(config, key)
        keys = type(section).model_fields if isinstance(section, BaseModel) else ()
        for indent, name_of_key in [("", key), *(("  ", inner) for inner in keys)]:
            [at] = [at for at, line in enumerate(lines) if re.match(rf"{indent}(# )?{name_of_key}:( |$)", line)]
            assert re.match(rf"{indent}# \S", lines[at - 1]), name_of_key
