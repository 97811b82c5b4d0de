"""The pages of benchmarks/results are those of the JSON beside them."""

import json
import re
import subprocess
import sys
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from click.testing import CliRunner

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import record
from hard_cases import EQUATIONS
from record import MEASUREMENTS, RESULTS, page
from run import SOME_LEFT_OUT


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_a_page_is_what_its_json_says(name):
    report = json.loads((RESULTS / f"{name}.json").read_text())
    text = (RESULTS / f"{name}.md").read_text()
    assert text == page(name, report), f"python benchmarks/record.py --pages writes {name}.md anew"
    assert f"    python benchmarks/record.py {name}\n" in text


@pytest.mark.parametrize("name", MEASUREMENTS)
@pytest.mark.parametrize("code", [0, 1, 2, SOME_LEFT_OUT, -11])
def test_a_measurement_that_failed_writes_no_page(monkeypatch, tmp_path, name, code):
    (tmp_path / f"{name}.json").write_bytes((RESULTS / f"{name}.json").read_bytes())
    monkeypatch.setattr(record, "RESULTS", tmp_path)
    monkeypatch.setattr(subprocess, "run", lambda command, **_: CompletedProcess(command, code))
    done = CliRunner().invoke(record.main, [name])
    complete = code == 0 or (name == "peers" and code == SOME_LEFT_OUT)
    assert done.exit_code == (0 if complete else code)
    assert (tmp_path / f"{name}.md").is_file() == complete


def test_each_bound_of_a_hard_case_is_asserted_by_the_test_it_names():
    tests = "".join(path.read_text() for path in Path(__file__).parents[1].rglob("test_*.py"))
    assert {test for _, _, test in EQUATIONS} <= set(re.findall(r"^def (test_\w+)\(", tests, re.MULTILINE))
