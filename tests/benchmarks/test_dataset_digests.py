"""`benchmarks/dataset_digests.py`: which cases it makes, and its messages about cases that it skips."""

import sys
from contextlib import nullcontext
from pathlib import Path

import pytest

from semisynth_gl.codecs import DISPARITY_CODECS, FLOW_CODECS, IMAGE_CODECS
from semisynth_gl.config.load import packaged_configs
from semisynth_gl.frame.channels import OUTPUTS
from semisynth_gl.layouts import layout_names

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import dataset_digests
from dataset_digests import ENCODINGS, FREE_LAYOUTS, MOVING, OF_RIGS, cases

NAMES = [name for name, _ in cases()]


def test_every_config_layout_encoding_and_output_is_made():
    assert len(set(NAMES)) == len(NAMES)
    assert {f"config/{name}" for name in packaged_configs()} <= set(NAMES)
    assert {f"{kind}/{name}" for name in layout_names() for kind in ("layout", "splits")} <= set(NAMES)
    assert {f"output/{name}" for name in OUTPUTS} <= set(NAMES)
    assert {*MOVING[1].split(","), *OF_RIGS} == set(OUTPUTS)
    assert set(FREE_LAYOUTS) <= set(layout_names())
    for number, codecs in enumerate((IMAGE_CODECS, DISPARITY_CODECS, FLOW_CODECS)):
        assert {names[number] for names in ENCODINGS} == set(codecs)


@pytest.mark.parametrize(
    ("before", "only", "said"),
    [
        ("a 1 2\nb 3 4\n", "", ["same: a", "same: b"]),
        ("a 1 9\nb 3 4\n", "", ["same, other descriptions: a", "same: b"]),
        ("a 9 2\nb 3 4\n", "", ["DIFFERENT: a", "same: b"]),
        ("a 1 2\n", "", ["same: a", "DIFFERENT, not made before: b"]),
        ("a 1 2\nb 3 4\nc 5 6\n", "", ["DIFFERENT, no longer made: c", "same: a", "same: b"]),
        ("a 1 2\nb 3 4\nc 5 6\n", "b", ["same: b"]),
    ],
)
def test_a_dataset_that_only_one_run_has_differs(tmp_path, monkeypatch, capsys, before, only, said):
    (tmp_path / "before.txt").write_text(before)
    monkeypatch.setattr(dataset_digests, "cases", lambda: iter([("a", ()), ("b", ())]))
    monkeypatch.setattr(dataset_digests, "make_photographs", lambda _: None)
    monkeypatch.setattr(dataset_digests, "make", lambda name, *_: {"a": "a 1 2", "b": "b 3 4"}[name])
    monkeypatch.setattr(sys, "argv", ["dataset_digests.py", "--compare", str(tmp_path / "before.txt"), "--only", only])
    differs = any(line.startswith("DIFFERENT") for line in said)
    with pytest.raises(SystemExit, match="1") if differs else nullcontext():
        dataset_digests.main()
    assert capsys.readouterr().out.splitlines() == said
