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

from semisynth_gl.calibration.rig_files import read_rigs
from semisynth_gl.cli import semisynth_gl
from semisynth_gl.config import Config, Range, load_config
from semisynth_gl.config.distributions import read_histogram
from semisynth_gl.config.yaml_values import (
    MOST_BYTES,
    YamlError,
    read_yaml,
)
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.inputs.errors import InputError, SemisynthError

START = "name: m\ncamera: {width_px: 64, height_px: 48, focal_px: 50, baseline_m: 0.1}\n"
START += "disparity: {min_px: 1, max_px: 20}\n"
DIGITS = "9" * 5000


def growing_aliases(levels):
    """Nine aliases of nine aliases of ...: 9 to the power of ``levels`` values."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, levels)]
    return "\n".join(lines)


# Text below START, the line of the fault counted from there, and the key.
TRAPS = {
    "growing aliases": (growing_aliases(12), 1, "a0"),
    "merge key": ("textures:\n  <<: {patch_px: 64}", 2, "textures"),
    "alias to itself": ("textures: &a [*a]", 1, "textures"),
    "a glob without quotes": ("textures: {images: [*.jpg]}", 1, "textures.images.0"),
    "a tag of Python's": ("name2: !!python/object/apply:os.system [ls]", 1, "name2"),
    "a date that is none": ("sequence: {length: 2024-13-45}", 1, "sequence.length"),
    "an int of 5000 digits": (f"sequence:\n  length: {DIGITS}", 2, "sequence.length"),
    "a float of 5000 digits": (f"sequence: {{frame_s: {DIGITS}.5}}", 1, "sequence.frame_s"),
    "a range of 5000 digits": (f"imperfections: {{noise: [1, {DIGITS}]}}", 1, "imperfections.noise.1"),
    "a huge float": ("sequence: {frame_s: 1e99999}", 1, "sequence.frame_s"),
    "nested lists": (f"name2: {'[' * 3000}{']' * 3000}", 1, "name2.0.0"),
    "nested mappings": (f"name2: {'{a: ' * 5000}1{'}' * 5000}", 1, "name2.a.a"),
    "nested blocks": ("name2:\n" + "".join(f"{' ' * n}a:\n" for n in range(1, 400)), 21, "name2.a.a"),
    "many values": (f"name2: [{'1,' * 100_000}]", 1, "name2.9"),
    "many keys": ("\n".join(f"k{n}: 1" for n in range(10_000)), 992, ""),
    "a key that is a list": ("[1, 2]: 3", 1, ""),
    "a long key": (f"? {'k' * 5000}\n: 3", 1, ""),
    "a key twice": ("sequence: {length: 1,\n length: 2}", 2, "sequence.length"),
    "a character that none may use": ('licences: {images: "a\x07b"}', 1, ""),
    "two documents": ("---\nname: n", 1, ""),
    "an escape beyond Unicode": ('licences: {images: "\\UFFFFFFFF"}', None, ""),
    "an end in a text": ('licences: {images: "abc', 2, ""),
}


@pytest.mark.parametrize("name", TRAPS)
def test_traps_in_a_file_name_file_line_and_key(tmp_path, name):
    text, line, key = TRAPS[name]
    path = tmp_path / "mine.yaml"
    path.write_text(START + text + "\n")
    with pytest.raises(InputError) as caught:
        load_config(path)
    message = str(caught.value)
    place = str(path) if line is None else f"{path}:{line + START.count(chr(10))}"
    assert message.startswith(f"{place}: {key}"), message
    assert len(message) < 1000


@pytest.mark.parametrize(
    "text",
    [
        "#" + "x" * MOST_BYTES,
        "licences: {images: '" + "x" * 200_000 + "'}",
        "\n".join(f"k{n}: 1" for n in range(900)),
    ],
)
def test_long_files_get_a_short_message(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(START + text)
    with pytest.raises(InputError) as caught:
        load_config(path)
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
        ("", None),
    ],
)
def test_plain_yaml_is_read(text, value):
    assert read_yaml(text)[0] == value


def test_configs_that_extend_each_other_without_end(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(f"extends: ../{tmp_path.name}/mine.yaml\n")
    with pytest.raises(InputError, match="more than 16 configs in a chain"):
        load_config(path)


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
    "overrides",
    [
        ["camera.width_px=16384", "camera.height_px=16384"],
        ["textures.patch_px=8192", "textures.max_patches=33"],
        ["structures.panels=[0, 1e5]"],
        ["particles.clutter=[{disparity_px: 3, count: 1e6}]"],
        ["camera.baseline_m=1e-300"],
        ["imperfections.exposure_stops=-1000"],
    ],
)
def test_limits_are_said_with_their_key(overrides):
    with pytest.raises(InputError) as caught:
        load_config("kitti", overrides)
    assert overrides[-1].partition("=")[0].rpartition(".")[2] in str(caught.value)


def test_numbers_up_to_the_limits_pass():
    load_config(
        "kitti",
        ["camera.width_px=16384", "camera.height_px=8192", "textures.patch_px=8192", "textures.max_patches=32",
         "particles.most=100000", "models.variants=100", "sequence.length=100000"],
    )  # fmt: skip


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


def test_a_plan_of_too_many_shards_is_refused():
    with pytest.raises(InputError, match="10000000 shards"):
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
    assert read_rigs([path], unit="m")[0].camera.baseline_m == pytest.approx(0.1)
    usual = ("700", "320", "-70")
    for place in range(3):
        for value in ("1e300", ".inf", ".nan", DIGITS, "2024-13-45", "[1, 2]"):
            numbers = [value if number == place else text for number, text in enumerate(usual)]
            path.write_text(projections(*numbers))
            with pytest.raises(SemisynthError) as caught:
                read_rigs([path], unit="m")
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
    program = "import sys; from semisynth_gl.calibration.rig_files import read_rigs\n"
    program += "try: read_rigs(sys.argv[1:])\nexcept Exception as error: print(type(error).__name__)"
    path = tmp_path / "calib.txt"
    for text in SLOW.values():
        path.write_text(text)
        command = [sys.executable, "-c", program, str(path)]
        assert subprocess.run(command, text=True, timeout=60, check=True, stdout=-1).stdout == "ReadError\n"


def test_files_of_histograms_are_limited(tmp_path):
    path = tmp_path / "bins.csv"
    many = "".join(f"{n},{n + 1},1\n" for n in range(5000))
    for text in ("0,1e300,1\n", f"0,{DIGITS},1\n", "0,1,inf\n", many, "x" * (1 << 20) + "\n", "0,1,1\n" * 200_000):
        path.write_text(text)
        with pytest.raises(InputError) as caught:
            read_histogram(path)
        assert str(path) in str(caught.value)
        assert len(str(caught.value)) < 500
