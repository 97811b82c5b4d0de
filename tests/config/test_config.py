import json
import re
from pathlib import Path

import numpy as np
import pytest
from config_texts import parse_config
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from semisynth_gl.config import Config, Range, load_config, packaged_configs
from semisynth_gl.config.explain import explain, summaries
from semisynth_gl.inputs.errors import InputError

CAMERA = "camera: {width_px: 64, height_px: 48, focal_px: 50, baseline_m: 0.1}\n"
DISPARITY = "disparity: {min_px: 1, max_px: 20}\n"


def written(folder: Path, text: str, name: str = "mine.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def complaint(folder: Path, text: str, overrides=()) -> str:
    with pytest.raises(InputError) as caught:
        load_config(written(folder, text), overrides)
    return str(caught.value)


@pytest.mark.parametrize("name", packaged_configs())
def test_packaged_configs_load_by_name_and_by_file_name(name):
    config = load_config(name)
    assert config.name == name
    assert load_config(f"{name}.yaml") == config


def test_packaged_configs_have_the_benchmarks_numbers():
    camera = load_config("kitti").camera
    assert (camera.width_px, camera.height_px, camera.focal_px, camera.baseline_m) == (
        1242,
        375,
        Range(721.54, 721.54),
        Range(0.5372, 0.5372),
    )
    camera = load_config("middlebury").camera
    assert (camera.width_px, camera.height_px, camera.focal_px, camera.baseline_m, camera.doffs_px) == (
        1500,
        1000,
        Range(1164, 2700),
        Range(0.16, 0.38),
        Range(40, 200),
    )
    target = load_config("middlebury").disparity.target
    assert target.form == "histogram"
    assert len(target.shares) == 29
    assert target.shares[4] == 0.141


def test_a_minimal_config_has_defaults(tmp_path):
    config = load_config(written(tmp_path, "name: mine\n" + CAMERA + DISPARITY))
    assert config.textures.source == "builtin"
    assert config.sequence.length == 1


@pytest.mark.parametrize(("ablation", "factor"), [("geometry", "models"), ("textures", "textures")])
def test_configs_of_an_ablation_differ_only_in_their_factor(ablation, factor):
    configs = [load_config(name).model_dump() for name in packaged_configs() if name.startswith(f"ablation-{ablation}")]
    assert len(configs) >= 2
    for other in configs[1:]:
        assert {key for key in other if configs[0][key] != other[key]} == {"name", factor}


def test_extends_merges_sections_and_finds_files_beside(tmp_path):
    written(tmp_path, "name: base\n" + CAMERA + DISPARITY + "textures: {patch_px: 64}\n", "base.yaml")
    child = written(tmp_path, "extends: base.yaml\nname: child\ncamera: {width_px: 65}\ntextures: {scales: [1]}\n")
    config = load_config(child)
    assert (config.name, config.camera.width_px, config.camera.height_px) == ("child", 65, 48)
    assert (config.textures.patch_px, config.textures.scales) == (64, (1.0,))


def test_errors_name_file_line_and_key(tmp_path):
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
    lines = complaint(tmp_path, text).splitlines()
    path = tmp_path / "mine.yaml"
    assert f"{path}:4: camera.height_px: input should be a valid integer, got 'tall'" in lines
    assert (
        f"{path}:5: camera.focal_px: expected [low, high] with low <= high, but 9 > 3: the range is empty, got [9, 3]"
        in lines
    )
    assert f"{path}:6: camera.baseline_m: expected at least 1e-06, got -1" in lines
    assert f"{path}:7: camera.widht_px: unknown key; did you mean camera.width_px?" in lines
    assert any(
        line.startswith(f"{path}:9: zzz: unknown key; expected one of: antialias, background, camera,")
        for line in lines
    )


def test_errors_in_an_extended_file_name_that_file(tmp_path):
    written(tmp_path, "name: base\n" + CAMERA + "disparity:\n  min_px: 30\n  max_px: 20\n", "base.yaml")
    message = complaint(tmp_path, "extends: base.yaml\n")
    assert message.startswith(f"{tmp_path / 'base.yaml'}:5: disparity.max_px: expected min_px < max_px, got 30 and 20")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("name: mine\n" + CAMERA, "mine.yaml: disparity is missing"),
        ("name: two words\n" + CAMERA + DISPARITY, "name: expected a text of the form"),
        (
            "name: m\n" + CAMERA + DISPARITY + "particles:\n  layers:\n  - {disparity_px: 3}\n",
            "particles.layers.0: count is missing",
        ),
        ("name: m\n" + CAMERA + DISPARITY + "background: {cuboid: 0, plane: 0}\n", "weight above 0"),
        ("name: m\n" + CAMERA + DISPARITY + "models: {simple: 0, complex: 0, user: 0}\n", "weight above 0"),
        (
            "name: m\n" + CAMERA + DISPARITY + "textures: {sequence: 1}\n",
            "textures.sequence: input should be a valid boolean",
        ),
        ("name: m\n" + CAMERA.replace("50", ".nan") + DISPARITY, "expected finite numbers"),
        (
            "name: m\n" + CAMERA.replace("focal_px: 50", "focal_mm: 5") + DISPARITY,
            "focal_mm and sensor_width_mm go together",
        ),
        ("- a list\n", "expected sections"),
        ("", "expected sections"),
        ("name: m\nname: n\n", "not valid YAML: found duplicate key"),
        ("camera: [1, 2\n", "not valid YAML"),
        ("extends: mine.yaml\n", "extend each other in a circle"),
        ("extends: nowhere\n", "no such config: nowhere"),
        ("extends: [1]\n", "expected the name of a config"),
        ("camera: 3\n", "camera: expected a section with keys of its own, got 3"),
    ],
)
def test_wrong_configs_are_refused(tmp_path, text, word):
    message = complaint(tmp_path, text)
    assert word in message
    assert "mine.yaml" in message or "missing" in message


def test_binary_files_are_refused(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match=r"mine\.yaml: cannot be read as YAML|mine\.yaml.*not valid YAML"):
        load_config(path)


def test_unknown_names_get_the_nearest(tmp_path):
    with pytest.raises(InputError, match=r"no such config: midlebury; did you mean middlebury\?"):
        load_config("midlebury")
    with pytest.raises(InputError, match="no such config"):
        load_config(tmp_path / "none.yaml")


def test_a_folder_of_a_configs_name_does_not_hide_it(tmp_path, monkeypatch):
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
        ("camera.width=3", r"override camera\.width: unknown key; did you mean camera\.width_px\?"),
        ("camera.width_px=x", r"override camera\.width_px: input should be a valid integer, got 'x'"),
        ("camera.width_px.more=3", r"camera\.width_px: input should be a valid integer"),
        ("camera.width_px", "expected dotted.key=value"),
        ("camera.width_px=[", "not valid YAML"),
    ):
        with pytest.raises(InputError, match=word):
            load_config(path, [setting])


MEANT = {
    "camera.widht_px": "camera.width_px",
    "width_px": "camera.width_px",
    "camra.width_px": "camera.width_px",
    "camra.widht_px": "camera.width_px",
    "Camera.width_px": "camera.width_px",
    "texture.source": "textures.source",
    "output": "outputs",
    "layers": "particles.layers",
    "particles.max_px": "disparity.max_px",
    "background.panels": "background.plane or structures.panels",
    "images": "textures.images or licences.images",
    "textures.image": "textures.images or files.image",
    "models.kind.chair": "models.kinds",
    "disparity.target.frm": "disparity.target.form",
}


@pytest.mark.parametrize("overrides", [dict, lambda given: list(given.items())])
def test_the_callers_values_stay_as_they_are(overrides):
    given = {"disparity": {"min_px": 15, "max_px": 290}, "disparity.max_px": 300}
    assert load_config("middlebury", overrides(given)).disparity.max_px == 300
    assert given == {"disparity": {"min_px": 15, "max_px": 290}, "disparity.max_px": 300}


PACKAGED = r"\S*/configs/[a-z-]+\.yaml:\d+"


@pytest.mark.parametrize(
    ("keys", "blamed", "also"),
    [
        # The section of a packaged config, in which a key was replaced.
        ({"disparity.max_px": 1}, r"disparity\.max_px: expected min_px < max_px", "disparity.min_px"),
        ({"background.plane": 0}, r"background\.plane: expected a weight above 0", "background.cuboid"),
        # The config as a whole.
        ({"disparity.max_px": 40}, r"disparity\.max_px: disparity.target wants", "disparity.target"),
        ({"background.plane_disparity_px": 300}, r"background.plane_disparity_px: .* goes up", "disparity.max_px"),
        # A recipe of the packaged config.
        ({"disparity.max_px": 30, "disparity.target": {"form": "gamma", "mean_px": 9, "spread_px": 5}, "scenes": [
            {"recipe": "near", "structures": {"panel_disparity_px": 90}}]},
         r"scenes\.0\.structures\.panel_disparity_px: structures.panel_disparity_px goes up", "disparity.max_px"),
    ],
)  # fmt: skip
def test_a_fault_is_of_the_users_file_or_option_and_not_of_the_config_below(tmp_path, keys, blamed, also):
    sections = {}
    for key, value in keys.items():
        section, _, name = key.rpartition(".")
        (sections.setdefault(section, {}) if section else sections)[name] = value
    lines = ["extends: kitti", "name: lab", *(f"{name}: {json.dumps(each)}" for name, each in sections.items())]
    path = written(tmp_path, "\n".join(lines))
    faults = {}
    for place, name, overrides in ((rf"{path}:\d+: ", path, {}), (r"override ", "kitti", keys)):
        with pytest.raises(InputError) as caught:
            load_config(name, overrides)
        faults[place] = str(caught.value)
        # In a file, a section on one line is one place.
        begin = rf"{place}({blamed}|{blamed.partition('.')[0]}: |{blamed.partition(':')[0]}: )"
        assert re.match(begin, faults[place]), faults[place]
        assert not re.match(PACKAGED, faults[place])
    if "scenes" not in keys:
        assert all(re.search(rf"\(with .*{also} of {PACKAGED}", fault) for fault in faults.values()), faults


def test_keys_that_a_message_names_are_found_where_they_were_set(tmp_path):
    path = written(tmp_path, "extends: middlebury\nname: lab\ndisparity:\n  max_px: 40\n")
    with pytest.raises(InputError, match=rf"^{path}:4: disparity.max_px: .* raise the second \(with .*{PACKAGED}\)$"):
        load_config(path)
    with pytest.raises(InputError, match=rf"^override disparity.max_px: .* raise the second \(with .*{PACKAGED}\)$"):
        load_config("middlebury", ["disparity.max_px=40"])
    with pytest.raises(InputError, match=r"^override disparity.max_px: disparity.target wants .* \(with .*\)$"):
        load_config("kitti", ["disparity.max_px=40", "scenes=[]"])
    with pytest.raises(InputError, match=rf"^override models.complex: .* \(with models.simple of {PACKAGED}"):
        load_config("ablation-geometry-complex", ["models.complex=0"])
    # A recipe that an option makes impossible is named, after the option.
    with pytest.raises(
        InputError, match=rf"^override disparity.max_px: structures.* \(with scenes.1.structures.* of {PACKAGED}"
    ):
        load_config("middlebury", ["disparity.max_px=100"])
    # A fault of each recipe is said once, of the config; a fault of one names it.
    path = written(tmp_path, "extends: middlebury\nname: lab\noutputs: [disparity_change]\nrig: {right_y_px: 1}\n")
    with pytest.raises(InputError, match=rf"^{path}:4: rig: the output disparity_change.* of {path}:3\)$"):
        load_config(path)
    # What stands in one place is not said twice.
    with pytest.raises(InputError, match=r"got 50 and 40: the range is empty$"):
        load_config("middlebury", ["disparity={min_px: 50, max_px: 40}"])


def test_values_that_hold_themselves_are_refused():
    endless = []
    endless.append(endless)
    with pytest.raises(InputError, match=r"override camera.focal_px: its value is nested too deeply"):
        load_config("middlebury", {"camera.focal_px": endless})


@pytest.mark.parametrize("as_text", [True, False])
def test_a_wrong_key_names_those_that_may_be_meant(tmp_path, as_text):
    said = {}
    for key in MEANT:
        with pytest.raises(InputError) as caught:
            load_config("middlebury", [f"{key}=3"] if as_text else {key: 3})
        said[key] = str(caught.value)
        assert said[key].startswith(f"override {key.partition('.')[0]}")
    assert {key: re.search(r"unknown key; did you mean (.*)\?$", text)[1] for key, text in said.items()} == MEANT
    path = written(
        tmp_path, "name: m\n" + CAMERA + "disparity: {min_px: 1, max_px: 9}\nwidth_px: 3\ncamra: {cy_px: 3}\n"
    )
    with pytest.raises(
        InputError, match=rf"{path}:\d+: width_px: unknown key; did you mean camera.width_px\?"
    ) as caught:
        load_config(path)
    assert "camra: unknown key; did you mean camera.cy_px" in str(caught.value)
    for key in ("zzz", "seed", "zzz.qqq"):
        with pytest.raises(InputError, match="unknown key; expected one of: antialias, background, camera,"):
            load_config("middlebury", {key: 3})


BINS = "low_px,high_px,share\n1,10,3\n10,19,1\n"
FORMS = "uniform, uniform-depth, gamma, histogram"


def with_target(target: str) -> str:
    return "name: m\n" + CAMERA + f"disparity:\n  min_px: 1\n  max_px: 20\n  target: {target}\n"


def test_a_file_of_a_target_is_sought_beside_what_names_it(tmp_path, monkeypatch):
    for folder in ("old", "run"):
        (tmp_path / folder).mkdir()
    written(tmp_path / "old", BINS, "there.csv")
    written(tmp_path / "run", BINS.replace("10,19,1", "10,19,3"), "here.csv")
    monkeypatch.chdir(tmp_path / "run")
    path = written(tmp_path / "old", with_target("{form: file, path: there.csv}"))
    assert load_config(path).disparity.target.shares == (3, 1)
    for setting in ("disparity.target={form: file, path: here.csv}", "disparity.target.path=here.csv"):
        assert load_config(path, [setting]).disparity.target.shares == (3, 3)
    setting = {"disparity.target": {"form": "file", "path": "here.csv"}}
    assert load_config(path, setting).disparity.target.shares == (3, 3)
    child = written(
        tmp_path / "run", "extends: ../old/mine.yaml\ndisparity: {target: {form: file, path: here.csv}}\n", "child.yaml"
    )
    monkeypatch.chdir(tmp_path)
    assert load_config(child).disparity.target.shares == (3, 3)
    child.write_text("extends: ../old/mine.yaml\ndisparity: {max_px: 21}\n")
    assert load_config(child).disparity.target.shares == (3, 1)


def test_what_is_replaced_lends_its_place_to_nothing(tmp_path):
    text = with_target("\n    form: gamma\n    mean_px: 3\n    spread_px: 2")
    path = tmp_path / "mine.yaml"
    message = complaint(tmp_path, text, ["disparity.target.form=uniform", "disparity.target.mean_px=-3"])
    assert message.startswith("override disparity.target.mean_px: unknown key")
    message = complaint(tmp_path, text, ["disparity.target={form: gamma, mean_px: -3, spread_px: 1}"])
    assert message.startswith("override disparity.target.mean_px: expected mean_px above origin_px, got -3 and 0")
    assert complaint(tmp_path, text, ["camera.width_px.more=3"]).startswith(
        "override camera.width_px: input should be a valid integer"
    )
    place = "override disparity.target.mean_px: "
    assert complaint(tmp_path, text, ["disparity.target.mean_px=-3"]).startswith(place)
    assert complaint(tmp_path, text.replace("spread_px: 2", "spread_px: 0")).startswith(f"{path}:9: disparity.target.s")


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("{form: gamma, mean_px: 3}", ": disparity.target: spread_px is missing; this key has no default"),
        (
            "{form: gamma, mean_px: 3, spred_px: 2}",
            ": disparity.target.spred_px: unknown key; did you mean disparity.target.spread_px?",
        ),
        ("{form: histogram, bin_px: 3, shares: [1, x]}", ": disparity.target.shares.1: input should be a valid number"),
        ("{form: uniform, zzz: 3}", ": disparity.target.zzz: unknown key; expected one of: form, high_px, low_px"),
        ("{mean_px: 3}", f": disparity.target.form: expected one of {FORMS}, mixture, file, which is missing"),
        (
            "{form: gama}",
            f": disparity.target.form: expected one of {FORMS}, mixture, file, got 'gama'; did you mean gamma?",
        ),
        ("{form: [1]}", f": disparity.target.form: expected one of {FORMS}, mixture, file, got [1]"),
        (
            "{form: mixture, parts: [{target: {form: gamma, mean_px: 2, spred_px: 3}}]}",
            ": disparity.target.parts.0.target.spred_px: unknown key; did you mean disparity.target.parts.0.target.spr",
        ),
        (
            "{form: mixture, parts: [{target: {form: gamma, mean_px: 2}}]}",
            ": disparity.target.parts.0.target: spread_px is missing",
        ),
        (
            "{form: mixture, parts: [{weigth: 2}]}",
            ": disparity.target.parts.0.weigth: unknown key; did you mean disparity.target.parts.0.weight?",
        ),
        (
            "{form: mixture, parts: [{target: {form: mixture}}]}",
            f": disparity.target.parts.0.target.form: expected one of {FORMS}, got 'mixture'",
        ),
        (
            "{form: mixture, parts: [{target: {form: file, path: a.csv}}]}",
            f": disparity.target.parts.0.target.form: expected one of {FORMS}, got 'file'",
        ),
        (
            "{form: file}",
            ": disparity.target.path: expected the name of a file, got None",
        ),
        ("{form: file, path: 3}", ": disparity.target.path: expected the name of a file, got 3"),
        ("{form: file, path: a.csv, bin_px: 3}", ": disparity.target.bin_px: expected no key beside form and path"),
    ],
)
def test_faults_of_targets_name_keys_that_users_wrote(tmp_path, target, said):
    lines = complaint(tmp_path, with_target(target)).splitlines()
    assert any(line.startswith(f"{tmp_path / 'mine.yaml'}:6{said}") for line in lines), lines
    minimal = "name: m\n" + CAMERA + DISPARITY
    lines = complaint(tmp_path, minimal, [f"disparity.target={target}"]).splitlines()
    assert any(line.startswith(f"override {said[2:]}") for line in lines), lines


def test_a_later_focal_length_takes_back_the_earlier():
    config = load_config("middlebury", ["camera.focal_mm=4", "camera.sensor_width_mm=6"])
    assert (config.camera.focal_px, config.camera.sensor_width_mm) == (None, 6)
    assert load_config("kitti", ["camera.doffs_px=3"]).camera.cx_right_px is None


@given(st.floats(-1e6, 1e6), st.floats(0, 1e6), st.integers(0, 2**32))
def test_draws_stay_in_their_range(low, width, seed):
    value = Range(low, low + width)
    drawn = [value.sample(np.random.default_rng(seed)), *value.sample_many(np.random.default_rng(seed), 20)]
    assert all(low <= x <= low + width for x in drawn)


def test_digests_follow_values_not_spelling(tmp_path):
    one = load_config(written(tmp_path, "name: mine\n" + CAMERA + DISPARITY, "a.yaml"))
    same = load_config(written(tmp_path, DISPARITY + CAMERA + "name: 'mine'\nsequence: {length: 1}\n", "b.yaml"))
    other = load_config(written(tmp_path, "name: mine\n" + CAMERA + "disparity: {min_px: 1, max_px: 21}\n", "c.yaml"))
    assert one.digest() == same.digest() != other.digest()
    assert Config.model_validate(one.model_dump()) == one


@pytest.mark.parametrize("name", packaged_configs())
def test_a_config_in_full_is_the_same_config_and_explains_every_key(name):
    text, config = explain(name), load_config(name)
    assert parse_config(text).digest() == config.digest()
    blocks = [block.splitlines() for block in text.strip().split("\n\n")]
    assert len(blocks) == len(Config.model_fields)
    for key, lines in zip(Config.model_fields, blocks, strict=True):
        section = getattr(config, key)
        keys = type(section).model_fields if isinstance(section, BaseModel) else ()
        for indent, name_of_key in [("", key), *(("  ", inner) for inner in keys)]:
            [at] = [at for at, line in enumerate(lines) if re.match(rf"{indent}(# )?{name_of_key}:( |$)", line)]
            assert re.match(rf"{indent}# \S", lines[at - 1]), name_of_key


def test_each_packaged_config_says_what_it_is_for():
    assert set(summaries()) == set(packaged_configs())
    assert all(len(summary) > 20 and summary.endswith(".") for summary in summaries().values())
