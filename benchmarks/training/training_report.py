"""The page of what networks learnt from each training set, made from the report in JSON."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from semisynth_gl.bench.summary import markdown

TEXT = """\
Each run trains the same network for as many steps, on pairs of one set alone, and is judged on real pairs that it has
not seen: *bad-1* is the share of pixels, of those that both eyes see and that have a truth, whose disparity is off by
more than 1 px, in %; the mean over the real pairs. *real* is no rival but a mark: it learns from the real pairs that it
is judged by. *spread* is the standard deviation over the runs of a set, which differ in weights, crops and changes of
colour, and in the pairs where those are rendered while it trains. Two means that differ by less than twice a spread are
not told apart.

Real pairs are shrunk by whole factors until they show no more than the searched range, pairs of the sets by the least
of these factors; bad-1 is of the shrunk pairs, and pixels whose square lies on more than one surface have no truth."""
_NONE = "-"


def runs_by_set(report: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the runs of each set, the best mean first."""
    found: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for run in report["runs"]:
        found[run["set"]].append(run)
    return dict(sorted(found.items(), key=lambda each: mean_of(each[1])))


def mean_of(runs: Sequence[Mapping[str, Any]]) -> float:
    """Return the mean of runs over real pairs and seeds, %."""
    return float(np.mean([run["mean"] for run in runs]))


def headline(report: Mapping[str, Any]) -> str:
    """Say what was trained and where."""
    machine, budget = report["machine"], report["setup"]["budget"]
    height, width = budget["crop_px"]
    source = f"{budget['pairs']} pairs a set" if budget["pairs"] else "pairs rendered while it trains"
    threads = f"{machine['threads']} thread{'s' * (machine['threads'] != 1)}"
    return (
        f"{source}; {budget['steps']:,} steps of {budget['batch']} crops of {width} x {height} px; "
        f"{report['parameters']:,} parameters, disparities to {budget['max_disparity_px']} px, {machine['precision']}; "
        f"{machine['processor']}, {machine['device']}, {threads}; {machine['date']}"
    )


def table(report: Mapping[str, Any]) -> str:
    """Lay the sets out in Markdown: means and spreads, then each real pair."""
    sets = runs_by_set(report)
    parts = [_means(report, sets), "Each real pair, mean over the runs, bad-1 in %:", _pairs(report, sets)]
    if report["left_out"]:
        parts.append("Not trained: " + ", ".join(report["left_out"]) + ".")
    return "\n\n".join(parts)


def _means(report: Mapping[str, Any], sets: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    rows = []
    for name, runs in sets.items():
        values = [run["mean"] for run in runs]
        spread = f"{np.std(values, ddof=1):.2f}" if len(values) > 1 else _NONE
        each = ", ".join(f"{value:.1f}" for value in values)
        minutes = f"{np.mean([run['seconds'] for run in runs]) / 60:.1f}"
        rows.append((name, each, f"{np.mean(values):.2f}", spread, minutes, report["sets"][name]))
    baseline = report["semi_global"]
    rows.append(("SGBM", _NONE, f"{baseline['mean']:.2f}", _NONE, _NONE, "OpenCV's semi-global matching, untrained"))
    return markdown(("set", "bad-1 of each run, %", "mean", "spread", "minutes", "what it is"), rows)


def _pairs(report: Mapping[str, Any], sets: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    names = report["setup"]["pairs"]
    rows = [
        (name, *(f"{np.mean([run['pairs'][pair] for run in runs]):.1f}" for pair in names))
        for name, runs in sets.items()
    ]
    rows.append(("SGBM", *(f"{report['semi_global']['pairs'][pair]:.1f}" for pair in names)))
    return markdown(("set", *names), rows, text_last=False)
