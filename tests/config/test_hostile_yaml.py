"""YAML, numbers and options that are traps: one message each, at once, before anything is allocated."""

import math
import subprocess
import sys
import tracemalloc
import typing

import click
import numpy as np
import pytest
from annotated_types import MaxLen
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from semisynth_gl.calibration.rig import Size
from semisynth_gl.calibration.rig_files import read_rigs
from semisynth_gl.cli import semisynth_gl
from semisynth_gl.config import Config, Range, load_config
from semisynth_gl.config.distributions import read_histogram
from semisynth_gl.config.yaml_values import (
    DEEPEST,
    MOST_BYTES,
    MOST_KEYS,
    MOST_VALUES,
    YamlError,
    read_documents,
    read_yaml,
)
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.inputs.errors import InputError, SemisynthError
from semisynth_gl.metrics.truth import read_limits

START = "name: m\ncamera: {width_px: 64, height_px: 48, focal_px: 50, baseline_m: 0.1}\n"
START += "disparity: {min_px: 1, max_px: 20}\n"
DIGITS = "9" * 5000


def growing_aliases(levels):
    """Nine aliases of nine aliases of ...: 9 to the power of ``levels`` values."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, levels)]
    return "\n".join(lines)


# Text below START, the line of the fault counted from there, the key, and what is said.
TRAPS = {
    "growing aliases": (growing_aliases(12), 1, "a0", "anchors (&a0) are not accepted"),
    "merge key": ("textures:\n  <<: {patch_px: 64}", 2, "textures", "merge keys (<<) are not accepted"),
    "merge key of an alias": ("textures:\n  <<: *a", 2, "textures", "merge keys"),
    "alias to nothing": ("textures: *a", 1, "textures", "aliases (*a) are not accepted"),
    "alias to itself": ("textures: &a [*a]", 1, "textures", "anchors (&a)"),
    "a glob without quotes": ("textures: {images: [*.jpg]}", 1, "textures.images.0", "put quotes around the *"),
    "an anchor alone": ("sequence: {length: &n 3}", 1, "sequence.length", "anchors (&n)"),
    "a known tag": ("sequence: {length: !!int 3}", 1, "sequence.length", "tags (tag:yaml.org,2002:int)"),
    "a tag of Python's": ("name2: !!python/object/apply:os.system [ls]", 1, "name2", "tags (tag:yaml.org,2002:python"),
    "binary": ("name2: !!binary aGVq", 1, "name2", "tags ("),
    "a set": ("name2: !!set {a, b}", 1, "name2", "tags ("),
    "a tag of one's own": ("name2: !mine 3", 1, "name2", "tags (!mine)"),
    "a date that is none": ("sequence: {length: 2024-13-45}", 1, "sequence.length", "valid integer, got '2024-13-45'"),
    "a date": ("sequence: {length: 2024-01-02}", 1, "sequence.length", "valid integer, got '2024-01-02'"),
    "a time that is none": ("sequence: {length: 2024-01-02 99:99:99}", 1, "sequence.length", "valid integer"),
    "an int of 5000 digits": (f"sequence:\n  length: {DIGITS}", 2, "sequence.length", "a number of 5000 characters"),
    "a negative int of 5000 digits": (f"sequence: {{length: -{DIGITS}}}", 1, "sequence.length", "5001 characters"),
    "a hex number of 5000 digits": (f"sequence: {{length: 0x{DIGITS}}}", 1, "sequence.length", "5002 characters"),
    "a float of 5000 digits": (f"sequence: {{frame_s: {DIGITS}.5}}", 1, "sequence.frame_s", "5002 characters"),
    "a range of 5000 digits": (f"imperfections: {{noise: [1, {DIGITS}]}}", 1, "imperfections.noise.1", "5000 "),
    "an int of signs alone": ("sequence: {length: +_}", 1, "sequence.length", "expected a number, got '+_'"),
    "an int of 90 digits": (f"sequence: {{length: {DIGITS[:90]}}}", 1, "sequence.length", "less than or equal to"),
    "a huge float": ("sequence: {frame_s: 1e99999}", 1, "sequence.frame_s", "input should be"),
    "nested lists": (f"name2: {'[' * 3000}{']' * 3000}", 1, "name2.0.0", f"more than {DEEPEST} lists and mappings"),
    "nested mappings": (f"name2: {'{a: ' * 5000}1{'}' * 5000}", 1, "name2.a.a", f"more than {DEEPEST} lists"),
    "nested lists without end": (f"name2: {'[' * 3000}", 1, "name2.0.0", f"more than {DEEPEST} lists"),
    "nested blocks": ("name2:\n" + "".join(f"{' ' * n}a:\n" for n in range(1, 400)), 21, "name2.a.a", "more than"),
    "nested dashes": (f"name2:\n {'- ' * 4000}1", 2, "name2.0.0", f"more than {DEEPEST} lists"),
    "many values": (f"name2: [{'1,' * 100_000}]", 1, "name2.9", f"more than {MOST_VALUES} values"),
    "many keys": ("\n".join(f"k{n}: 1" for n in range(10_000)), 992, "", f"more than {MOST_KEYS} keys"),
    "a key that is a list": ("[1, 2]: 3", 1, "", "expected a text as a key"),
    "a key that is a mapping": ("? {a: 1}\n: 3", 1, "", "expected a text as a key"),
    "a long key": (f"? {'k' * 5000}\n: 3", 1, "", "a key of 5000 characters"),
    "a key twice": ("sequence: {length: 1,\n length: 2}", 2, "sequence.length", "not valid YAML: found duplicate key"),
    "a character that none may use": ('licences: {images: "a\x07b"}', 1, "", "the character '\\x07' is not allowed"),
    "two documents": ("---\nname: n", 1, "", "not valid YAML: expected a single document"),
    "an escape beyond Unicode": ('licences: {images: "\\UFFFFFFFF"}', None, "", "not valid YAML"),
    "an end in a text": ('licences: {images: "abc', 2, "", "not valid YAML"),
}  # fmt: skip


@pytest.mark.parametrize("name", TRAPS)
def test_traps_in_a_file_name_file_line_and_key(tmp_path, name):
    text, line, key, said = TRAPS[name]
    path = tmp_path / "mine.yaml"
    path.write_text(START + text + "\n")
    with pytest.raises(InputError) as caught:
        load_config(path)
    message = str(caught.value)
    place = str(path) if line is None else f"{path}:{line + START.count(chr(10))}"
    assert message.startswith(f"{place}: {key}"), message
    assert said in message
    assert len(message) < 1000


@pytest.mark.parametrize("name", [name for name, (text, *_) in TRAPS.items() if len(text) < 6000])
def test_traps_in_an_override_name_the_override(name):
    text = TRAPS[name][0]
    with pytest.raises(InputError) as caught:
        load_config("kitti", [f"licences={text}"] if ": " in text.partition("\n")[0] else [f"outputs={text}"])
    message = str(caught.value)
    assert message.startswith("override ")
    assert len(message) < 3000


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (START + "#" + "x" * MOST_BYTES, f"it has more than {MOST_BYTES} bytes"),
        (START + "\n" * MOST_BYTES, f"it has more than {MOST_BYTES} bytes"),
        (START + "licences: {images: '" + "x" * 200_000 + "'}", "licences.images: string should have at most 1000"),
        (START + "\n".join(f"k{n}: 1" for n in range(900)), "and 880 more faults"),
    ],
)
def test_long_files_get_a_short_message(tmp_path, text, said):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_config(path)
    assert said in str(caught.value)
    assert len(str(caught.value)) < 20_000
    assert str(caught.value).startswith(str(path))


def test_traps_take_no_memory():
    tracemalloc.start()
    try:
        for name in ("growing aliases", "an int of 5000 digits", "nested mappings"):
            with pytest.raises(YamlError):
                read_yaml(TRAPS[name][0])
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 20_000_000


@settings(max_examples=150, deadline=None)
@given(st.text(st.sampled_from("ab01.:-+_eExX[]{},&*!|>'\"%@`#?<~ \n\t\\/\x07\udcff\u2028"), max_size=60))
def test_any_text_is_a_value_or_an_error(text):
    try:
        value, lines = read_yaml(text)
    except YamlError:
        return
    assert value is None or isinstance(value, (bool, int, float, str, list, dict))
    assert all(line >= 1 for line in lines.values())


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("{a: 1, b: [2.5, -3, 0x1F, 0o17, 0b11, 012, 1_000]}", {"a": 1, "b": [2.5, -3, 31, 15, 3, 12, 1000]}),
        ("[.inf, -.inf, 1e3, 1.e2, .5]", [math.inf, -math.inf, 1000, 100, 0.5]),
        ("[~, null, true, False, yes, 'no', on]", [None, None, True, False, "yes", "no", "on"]),
        ("{1: a, true: b, '<<': c}", {"1": "a", "true": "b", "<<": "c"}),
        ("2024-01-02", "2024-01-02"),
        ("%YAML 1.1\n---\na: 012", {"a": 12}),
        ("a: |\n  x\n  y\n", {"a": "x\ny\n"}),
        ("", None),
    ],
)
def test_plain_yaml_is_read(text, value):
    assert read_yaml(text)[0] == value
    assert read_documents(text) == ([] if text == "" else [value])


def test_documents_are_read_one_by_one_within_limits_of_all():
    text = "a: 1\n---\n[b]\n---\n"
    assert read_documents(text) == [{"a": 1}, ["b"], None]
    with pytest.raises(YamlError, match="expected a single document"):
        read_yaml(text)
    for many, said in (("---\n" * (MOST_VALUES + 1), MOST_VALUES), ("a: 1\n---\n" * (MOST_KEYS + 1), MOST_KEYS)):
        with pytest.raises(YamlError, match=f"more than {said} "):
            read_documents(many)


def test_configs_that_extend_each_other_without_end(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(f"extends: ../{tmp_path.name}/mine.yaml\n")
    with pytest.raises(InputError, match="more than 16 configs in a chain"):
        load_config(path)


def test_overrides_are_bounded_too():
    for override, said in (
        ("a." * 5000 + "b=1", "expected a key of at most 20 parts"),
        (("camera.width_px", 10**5000), "camera.width_px: input should be"),
        (("camera.baseline_m", 10**5000), "camera.baseline_m: expected finite numbers of at most 1e"),
        (("camera.sensor_width_mm", 10**5000), "camera.sensor_width_mm: "),
        (("sequence.frame_s", 10**400), "sequence.frame_s: "),
    ):
        with pytest.raises(InputError) as caught:
            load_config("kitti", [override])
        assert said in str(caught.value)
        assert len(str(caught.value)) < 500


# Every number of a config ------------------------------------------------------------------------------------------


def models_below(annotation):
    """All sections that an annotation has."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in typing.get_args(annotation) for model in models_below(part)]


def all_sections(model=Config, found=None):
    found = {} if found is None else found
    if model not in found:
        found[model] = None
        for field in model.model_fields.values():
            for below in models_below(field.annotation):
                all_sections(below, found)
    return list(found)


def leaves(annotation):
    """The types of an annotation that are no containers of types."""
    arguments = typing.get_args(annotation)
    if typing.get_origin(annotation) is typing.Literal:
        return []
    return [leaf for part in arguments for leaf in leaves(part)] if arguments else [annotation]


FIELDS = [(section, name) for section in all_sections() for name in section.model_fields]
NUMBERS = [
    (section, name)
    for section, name in FIELDS
    if {int, float, Range} & set(leaves(section.model_fields[name].annotation))
]


def refusals(section, name, value):
    """The faults of one field of a section with a value, alone, in a list or in a mapping."""
    faults = []
    for shape in (value, [value], {"chair": value}, [value, value]):
        try:
            section.model_validate({name: shape})
        except ValidationError as error:
            faults.append([fault for fault in error.errors() if fault["loc"] and fault["loc"][0] == name])
        else:
            faults.append([])
    return faults


def test_every_number_of_a_config_has_limits():
    assert len(NUMBERS) > 60
    unlimited = [
        f"{section.__name__}.{name} {value if isinstance(value, float) else hex(value)[:20]}"
        for value in (10**5000, 10**30, 1e300, -1e300, math.inf, -math.inf, math.nan)
        for section, name in NUMBERS
        if not all(refusals(section, name, value))
    ]
    assert unlimited == []


def without_a_length(annotation, metadata=()):
    """The lists and mappings of an annotation that may be of any length."""
    if typing.get_origin(annotation) is typing.Annotated:
        annotation, *metadata = typing.get_args(annotation)
    limits = [inner for item in metadata for inner in (item, *getattr(item, "metadata", ()))]
    endless = typing.get_origin(annotation) in (tuple, dict) and not any(isinstance(item, MaxLen) for item in limits)
    inner = [found for part in typing.get_args(annotation) for found in without_a_length(part)]
    return [annotation, *inner] if endless else inner


def test_every_list_of_a_config_has_a_limit():
    endless = {
        f"{section.__name__}.{name}": found
        for section, name in FIELDS
        if (found := without_a_length(section.model_fields[name].annotation, section.model_fields[name].metadata))
    }
    assert endless == {}
    with pytest.raises(InputError, match=r"models\.folders: .* at most 100000 items"):
        load_config("kitti", {"models.folders": ["a"] * 100_001})


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["camera.width_px=16385"], "camera.width_px: input should be less than or equal to 16384"),
        (["camera.width_px=16384", "camera.height_px=16384"], "expected width_px x height_px of at most"),
        (["textures.patch_px=8192"], "512 patches of 8192 x 8192 pixels would take 137 GB"),
        (["textures.patch_px=8192", "textures.max_patches=33"], "expected max_patches of at most 32"),
        (["structures.panels=1001"], "structures.panels: expected at most 1000"),
        (["structures.panels=[0, 1e5]"], "structures.panels: expected at most 1000"),
        (["particles.most=100001"], "particles.most: input should be less than or equal to 100000"),
        (["particles.density=2e5"], "particles.density"),
        (["particles.clutter=[{disparity_px: 3, count: 1e6}]"], "particles.clutter.0.count: expected at most 100000"),
        (["models.variants=101"], "models.variants: input should be less than or equal to 100"),
        (["imperfections.exposure_stops=1000"], "imperfections.exposure_stops: expected at most 20"),
        (["imperfections.exposure_stops=-1000"], "imperfections.exposure_stops: expected at least -20"),
        (["camera.baseline_m=1e-300"], "camera.baseline_m: expected 1e-06 or more"),
        (["disparity.min_px=1e-300"], "disparity.min_px: expected 1e-06 or more"),
        (["checks.attempts=1000000"], "checks.attempts: input should be less than or equal to 10000"),
        (["sequence.length=1000000"], "sequence.length: input should be less than or equal to 100000"),
    ],
)
def test_limits_are_said_with_their_key(overrides, said):
    with pytest.raises(InputError) as caught:
        load_config("kitti", overrides)
    assert said in str(caught.value)


def test_every_packaged_limit_is_on_the_page_of_configs():
    """Numbers up to the limits pass."""
    config = load_config(
        "kitti",
        ["camera.width_px=16384", "camera.height_px=8192", "textures.patch_px=8192", "textures.max_patches=32",
         "particles.most=100000", "models.variants=100", "sequence.length=100000"],
    )  # fmt: skip
    assert config.camera.width_px * config.camera.height_px == 1 << 27


# Every number of the command line ----------------------------------------------------------------------------------


def commands(group=semisynth_gl, path=()):
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


def parts(kind):
    return [part for inner in kind.types for part in parts(inner)] if isinstance(kind, click.Tuple) else [kind]


def test_every_number_of_the_command_line_has_limits():
    numeric = [
        (f"{command} {parameter.opts[0]}", part)
        for command, found in commands()
        for parameter in found.params
        for part in parts(parameter.type)
        if isinstance(part, (click.types.IntParamType, click.types.FloatParamType))
    ]
    assert len(numeric) > 20
    unlimited = []
    for name, kind in numeric:
        for value in (DIGITS, "1" + "0" * 30, "1e300", "inf", "nan", "-1e300", "-1" + "0" * 30):
            try:
                kind.convert(value, None, None)
            except click.BadParameter:
                continue
            unlimited.append(f"{name} {value[:40]}")
    assert unlimited == []


def test_numbers_in_texts_of_options_have_limits(tmp_path):
    generate = ["generate", "--config", "kitti", "--out", str(tmp_path / "none")]
    calibrate = [
        "calibrate",
        "--images",
        "x",
        "--focal-px",
        "9",
        "--baseline-m",
        "1",
        "--out",
        str(tmp_path / "c.yaml"),
    ]
    for arguments, said in (
        *(([*generate, "--shards", text], "--shards") for text in (DIGITS, f"1-{DIGITS}", f"{DIGITS}-1")),
        *(([*generate, "--gpus", text], "--gpus") for text in (DIGITS, f"0,{DIGITS}")),
        *((["bench", "speed", "--workers", text], "--workers") for text in (DIGITS, "1,1025", f"1,{DIGITS}")),
        *(([*calibrate, "--size", text], "--size") for text in (f"{DIGITS}x3", "100000x100")),
    ):
        with pytest.raises((InputError, click.BadParameter)) as caught:
            semisynth_gl.main(arguments, standalone_mode=False)
        error = caught.value
        assert said in (error.format_message() if isinstance(error, click.BadParameter) else str(error))
    assert list(tmp_path.iterdir()) == []


def test_a_plan_of_too_many_shards_is_refused():
    with pytest.raises(InputError, match="10000000 shards of 1 pair: expected at most 1000000"):
        make_plan(load_config("kitti"), 0, "middlebury", {"train": 10_000_000}, 1)


# Calibrations and histograms ---------------------------------------------------------------------------------------

MIDDLEBURY = "cam0=[{f} 0 {cx}; 0 {f} {cy}; 0 0 1]\ncam1=[{f} 0 {cx}; 0 {f} {cy}; 0 0 1]\ndoffs=0\nbaseline={b}\n"
MIDDLEBURY += "width={w}\nheight={h}\nndisp={n}\n"
USUAL = {"f": "700", "cx": "320", "cy": "240", "b": "100", "w": "640", "h": "480", "n": "64"}
HUGE = ("1e300", "1e99", "inf", "nan", "-inf", DIGITS, "1e7000")


def test_every_number_of_a_calibration_has_limits(tmp_path):
    path = tmp_path / "calib.txt"
    path.write_text(MIDDLEBURY.format(**USUAL))
    assert read_rigs([path])[0].size == (640, 480)
    for key in USUAL:
        for value in HUGE:
            path.write_text(MIDDLEBURY.format(**USUAL | {key: value}))
            with np.errstate(all="raise"), pytest.raises(SemisynthError) as caught:
                read_rigs([path])
            assert str(path) in str(caught.value), (key, value)
            assert len(str(caught.value)) < 1000


def projections(focal, cx, shift):
    def camera(t):
        return f"{{rows: 3, cols: 4, data: [{focal}, 0, {cx}, {t}, 0, {focal}, 240, 0, 0, 0, 1, 0]}}"

    return f"image_width: 640\nimage_height: 480\nP1: {camera(0)}\nP2: {camera(shift)}\n"


def test_every_number_of_a_yaml_calibration_has_limits(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("%YAML:1.0\n---\n" + projections("700", "320", "-70"))
    assert read_rigs([path], unit_m=1.0)[0].camera.baseline_m == pytest.approx(0.1)
    usual = ("700", "320", "-70")
    for place in range(3):
        for value in ("1e300", ".inf", ".nan", DIGITS, "-1e300", "2024-13-45", "!!int 3", "*x", "[1, 2]"):
            numbers = [value if number == place else text for number, text in enumerate(usual)]
            path.write_text(projections(*numbers))
            with pytest.raises(SemisynthError) as caught:
                read_rigs([path], unit_m=1.0)
            assert str(path) in str(caught.value), numbers
            assert len(str(caught.value)) < 1500
    for name in ("growing aliases", "merge key", "nested lists", "nested blocks", "many keys", "an end in a text"):
        path.write_text(TRAPS[name][0] + "\n")
        with pytest.raises(SemisynthError):
            read_rigs([path])


# Each of these made a regular expression try again at every place, or at every subset of places.
SLOW = {
    "KITTI's numbers": "P2: " + "11 " * 200 + "x\nP_rect_02: " + "1" * 50_000 + "x\n",
    "spaces before a value": "cam0=" + " " * 200_000 + "x\n",
    "spaces after a key": "a" * 200_000 + " " * 200_000 + "x\n",
    "spaces after KITTI's key": "P2" + "\n" * 100_000 + "x\n" + "P2:" + " " * 100_000 + "x\n",
    "points": "P2: " + "1." * 50_000 + "\n",
}


def test_hostile_calibrations_are_given_up_at_once(tmp_path):
    # In a process that can be ended: a regular expression does not hear of a time limit.
    program = "import sys; from semisynth_gl.calibration.rig_files import _KITTI, calib_values\n"
    program += "for text in sys.stdin.read().split('|'): print(len(_KITTI.findall(text)), len(calib_values(text)))"
    texts = "|".join(SLOW.values())
    subprocess.run([sys.executable, "-c", program], input=texts, text=True, timeout=60, check=True)
    path = tmp_path / "calib.txt"
    for text in SLOW.values():
        path.write_text(text)
        with pytest.raises(SemisynthError):
            read_rigs([path], size=Size(64, 48))


def test_limits_of_scenes_are_limited(tmp_path):
    path = tmp_path / "calib.txt"
    for text in (f"ndisp={DIGITS}", "ndisp=10000000000", "ndisp=1e9", "ndisp=" + " " * 60_000 + "x", "x" * 70_000):
        path.write_text(text)
        with pytest.raises(SemisynthError) as caught:
            read_limits(path)
        assert len(str(caught.value)) < 700
    path.write_text("ndisp = 290 \r\nisint= 1\n")
    assert read_limits(path).ndisp == 290


def test_files_of_histograms_are_limited(tmp_path):
    path = tmp_path / "bins.csv"
    for text in (
        "0,1e300,1\n",
        "-1e300,1,1\n",
        f"0,{DIGITS},1\n",
        "0,1,1e300\n",
        "0,nan,1\n",
        "0,1,inf\n",
        "".join(f"{n},{n + 1},1\n" for n in range(5000)),
        "x" * (1 << 20) + "\n",
        "0,1,1\n" * 200_000,
    ):
        path.write_text(text)
        with pytest.raises(InputError) as caught:
            read_histogram(path)
        assert str(path) in str(caught.value)
        assert len(str(caught.value)) < 500
