"""`compare_speed.py` and `pair_costs.py` of benchmarks/: whose the ratios are, and whose each second is."""

import sys
from itertools import count
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import pair_costs
from compare_speed import Checkout, ratios, summary

ROOT = Path(__file__).resolve().parents[2]


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


def test_a_second_counts_for_the_innermost_part_alone(monkeypatch):
    ticks = count()
    monkeypatch.setattr(pair_costs.time, "process_time", lambda: float(next(ticks)))
    clock = pair_costs.Clock()  # looks at 0
    inner = clock.inside("inner", lambda: None)
    outer = clock.inside("outer", inner)
    outer()  # 1 to 4, inner 2 to 3
    clock.on_stage("stage")  # 5
    assert dict(clock.seconds) == {"inner": 1.0, "outer": 2.0, "stage": 2.0}
    clock.on_stage("next")
    assert clock.seconds["next"] == 1.0


def test_the_table_has_means_and_the_ratio_of_each_stage():
    before, after = ({"sample": 0.02 * k, "draw": 0.5, "write": 0.03 * k} for k in (2, 1))
    text = pair_costs.table([(pair_costs.with_sums(before), pair_costs.with_sums(after))] * 3)
    assert "| sample | 40.00 | 20.00 | 0.500 | 0.500 to 0.500 |" in text
    assert "| all but drawing and reading back | 100.00 | 50.00 | 0.500 |" in text
    assert "| all | 600.00 | 550.00 | 0.917 |" in text
