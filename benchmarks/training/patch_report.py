"""The page of what MC-CNN's patch network learnt from which pairs, made from the report in JSON."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from semisynth_gl.bench.summary import markdown

FOUR = "four-real"
FOUR_PAIRS = ("Cones", "Cloth3", "Reindeer", "Wood2")
"""The real pairs that the row *four-real* learns from; the others judge it."""
TEXT = """\
The network is *fast* of the package mccnn 1.4, with its generator of patches and its loss; weights that it ships were
learnt from scenes of Middlebury, the judged ones among them, and from a contest of satellites. To measure again takes
its packages and the real pairs, and `compare_patches.py` says which: `record.py` alone cannot. *bad-1* is the share of
pixels, of those that both eyes see and that have a truth, whose disparity is off by more than 1 px, in %, of the real
pairs, which no set but *shipped-middlebury* and *four-real* learnt from. *alone* takes the least cost of each pixel.
*SGM* takes the least cost after semi-global matching (libsgm); four rendered pairs of `zero-shot`, which no network
learns from, chose its penalties from a grid. Both average the pairs by Middlebury's weights; *others* is
the plain mean over the real pairs but *four-real*'s. *spread* is the standard deviation over the runs, which differ in
weights, points and changes of colour."""
_WHAT = {
    "census": "signs of differences in 11 x 11 px, nothing learnt",
    "shipped-middlebury": "weights learnt from Middlebury's scenes",
    "shipped-satellites": "weights learnt from pairs of satellites",
    "untrained": "random weights",
    FOUR: f"the real pairs {', '.join(FOUR_PAIRS)}",
    "zero-shot": "the packaged config `zero-shot`: other rigs, other pictures",
    "packaged": "the scenes of the packaged config `middlebury`",
    "calibrated": "what `calibrate` writes from photographs of the place",
}
WAYS = ("winner", "semi_global")


def runs_by_set(report: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the runs of each set, the best first by the least cost alone."""
    found: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for run in report["runs"]:
        found[run["set"]].append(run)
    return dict(sorted(found.items(), key=lambda each: mean_of(each[1], "winner")))


def mean_of(runs: Sequence[Mapping[str, Any]], way: str, names: Sequence[str] = ()) -> float:
    """Return the mean over runs of a way's bad-1, %; over some pairs by their names, or over all."""
    if names:
        return float(np.mean([[run[way]["pairs"][name] for name in names] for run in runs]))
    return float(np.mean([run[way]["mean"] for run in runs]))


def spread_of(runs: Sequence[Mapping[str, Any]], way: str) -> float:
    """Return the standard deviation over runs of a way's bad-1; nan for one run."""
    return float(np.std([run[way]["mean"] for run in runs], ddof=1)) if len(runs) > 1 else float("nan")


def headline(report: Mapping[str, Any]) -> str:
    """Say what was trained and where."""
    machine, budget = report["machine"], report["setup"]["budget"]
    threads = f"{machine['threads']} thread{'s' * (machine['threads'] != 1)}"
    return (
        f"{budget['steps']:,} steps of {budget['batch']} points, of {budget['pairs']} pairs with {budget['points']:,} "
        f"points each, colours of `semisynth`; {machine['processor']}, {threads}; {machine['date']}"
    )


def table(report: Mapping[str, Any]) -> str:
    """Lay the rows out in Markdown: means and spreads, then each real pair."""
    sets = runs_by_set(report)
    others = [name for name in report["setup"]["pairs"] if name not in FOUR_PAIRS]
    rows = []
    for name, runs in sets.items():
        cells: list[str] = []
        for way in WAYS:
            spread = f"{spread_of(runs, way):.2f}" if len(runs) > 1 else "-"
            cells += [f"{mean_of(runs, way):.2f}", spread, f"{mean_of(runs, way, others):.2f}"]
        minutes = np.mean([run["seconds"] for run in runs]) / 60
        rows.append((name, str(len(runs)), *cells, f"{minutes:.0f}" if minutes > 1 else "-", _WHAT[name]))
    heads = (
        "set", "runs", "alone", "spread", "others", "SGM", "spread", "others", "minutes", "what it is",
    )  # fmt: skip
    names = report["setup"]["pairs"]
    pairs = [(name, *(f"{mean_of(runs, 'winner', [pair]):.1f}" for pair in names)) for name, runs in sets.items()]
    return "\n\n".join((
        markdown(heads, rows),
        "Each real pair, mean over the runs, the least cost alone, bad-1 in %:",
        markdown(("set", *names), pairs, text_last=False),
    ))  # fmt: skip
