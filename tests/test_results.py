"""The pages of benchmarks/results are those of the JSON beside them."""

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from record import MEASUREMENTS, RESULTS, page


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_a_page_is_what_its_json_says(name):
    report = json.loads((RESULTS / f"{name}.json").read_text())
    text = (RESULTS / f"{name}.md").read_text()
    assert text == page(name, report), f"python benchmarks/record.py --pages writes {name}.md anew"
    assert f"    python benchmarks/record.py {name}\n" in text
