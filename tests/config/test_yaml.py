"""YAML as plain values with line numbers, and refused texts."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semisynth_gl.config import load_config
from semisynth_gl.config.yaml_values import MOST_BYTES, YamlError, read_yaml
from semisynth_gl.inputs.errors import InputError

# Texts, and the line of the fault or None.
TRAPS = {
    "alias to itself": ("a: &a [*a]", 1),
    "a glob without quotes": ("\nimages: [*.jpg]", 2),
    "an anchor": ("\na: &a b", 2),
    "a tag": ("a: !a b", 1),
    "a tag of Python's": ("a: !!python/object/apply:os.system [ls]", 1),
    "an int of 5000 digits": (f"a: {'9' * 5000}", None),
    "an int without digits": ("\na: +_", None),
    "a float that is none": ("a: !!float x", None),
    "a bool that is none": ("a: !!bool x", None),
    "nested lists": (f"a: {'[' * 700}{']' * 700}", None),
    "a key that is a list": ("[1, 2]: 3", 1),
    "a key twice": ("a: {b: 1,\n b: 2}", 2),
    "a character that none may use": ('a: "a\x07b"', None),
    "an end in a list": ("a: [1, 2\n", 2),
}


@pytest.mark.parametrize("name", TRAPS)
def test_traps_are_refused_with_their_line(tmp_path, name):
    text, line = TRAPS[name]
    with pytest.raises(YamlError) as caught:
        read_yaml(text)
    assert caught.value.line == line
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(InputError) as refused:
        load_config(tmp_path / "mine.yaml")
    assert str(refused.value).startswith(f"{tmp_path / 'mine.yaml'}{'' if line is None else f':{line}'}: ")
    assert len(str(refused.value)) < 500


def test_a_large_file_is_not_read(tmp_path):
    (tmp_path / "mine.yaml").write_text("#" + "x" * MOST_BYTES)
    with pytest.raises(InputError, match=f"mine.yaml: .* larger than {MOST_BYTES >> 10} KiB"):
        load_config(tmp_path / "mine.yaml")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("{a: 1, b: [2.5, -3, 0x1F, 0o17, 0b11, 012, 1_000]}", {"a": 1, "b": [2.5, -3, 31, 15, 3, 12, 1000]}),
        ("[.inf, -.inf, 1e3, 1.e2, .5]", [math.inf, -math.inf, 1000, 100, 0.5]),
        ("[~, null, true, False, yes, 'no', on]", [None, None, True, False, "yes", "no", "on"]),
        ("{1: a, true: b, '<<': c}", {"1": "a", "true": "b", "<<": "c"}),
        ("2024-01-02", "2024-01-02"),
        ("", None),
    ],
)
def test_plain_yaml_is_read(text, value):
    assert read_yaml(text)[0] == value


def test_each_key_and_item_has_its_line():
    _, lines = read_yaml("a:\n  b: 1\n  c:\n  - 2\n  - {d: 3}\n")
    expected = {("a",): 1, ("a", "b"): 2, ("a", "c"): 3, ("a", "c", 0): 4, ("a", "c", 1): 5, ("a", "c", 1, "d"): 5}
    assert lines == expected


@settings(max_examples=100)
@given(st.text(st.sampled_from("ab01.:-+_eExX[]{},&*!|>'\"%@`#?<~ \n\t\\/\x07\udcff\u2028"), max_size=60))
def test_any_text_is_a_value_or_an_error(text):
    try:
        value, lines = read_yaml(text)
    except YamlError:
        return
    assert value is None or isinstance(value, (bool, int, float, str, list, dict))
    assert all(line >= 1 for line in lines.values())
