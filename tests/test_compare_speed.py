"""`benchmarks/compare_speed.py`: turns alternate, ratios are the second checkout's, strangers are refused."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from compare_speed import Checkout, ratios, summary

ROOT = Path(__file__).resolve().parents[1]


def test_turns_alternate_and_ratios_are_the_second_checkouts():
    order = []
    seconds = {"before": 2.0, "after": 3.0}

    def measure(checkouts):
        order.extend(checkouts)
        return [seconds[checkout] for checkout in checkouts]

    assert ratios(["before", "after"], 3, measure, "title").tolist() == [1.5, 1.5, 1.5]
    assert order == ["before", "after", "after", "before", "before", "after"]


def test_the_summary_has_the_median_and_the_middle_of_the_turns():
    text = summary(np.linspace(0.9, 1.1, 21))
    assert text.startswith("median ratio 1.000 (0.9")
    assert text.endswith("90 % of 21 turns 0.910 to 1.090")


def test_a_folder_without_the_project_is_refused(tmp_path):
    with pytest.raises(SystemExit, match=r"expected the project there|No module named"):
        Checkout(tmp_path, tmp_path / "work")


def test_this_checkout_is_accepted(tmp_path):
    assert Checkout(ROOT, tmp_path).folder == ROOT
