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
not told apart. *fine* and *plain* are the means over two halves of the real pairs: plain ones have the most windows of
9 x 9 pixels in which the brightness varies by less than 4 levels.

*unconfirmed* needs no truth: the share of pixels whose disparity, at the same point, the network's own prediction for
the right view does not confirm within 1 px, in %. Occluded pixels are among them, alike for all networks.

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


def halves(report: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Return the names of the fine and of the plain real pairs; of an odd number, the one between both is fine."""
    names = sorted(report["setup"]["pairs"], key=report["setup"]["plainness"].__getitem__)
    middle = (len(names) + 1) // 2
    return names[:middle], names[middle:]


def trust(report: Mapping[str, Any]) -> float:
    """Return the correlation over networks of *unconfirmed* and bad-1, both as means over the real pairs."""
    both = [
        (np.mean(list(run["unconfirmed"].values())), np.mean(list(run["pairs"].values()))) for run in report["runs"]
    ]
    return float(np.corrcoef(np.transpose(both))[0, 1]) if len(both) > 2 else float("nan")


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
    fine, plain = halves(report)
    tails = (
        f"Fine: {', '.join(fine)}. Plain: {', '.join(plain)}. Over the {len(report['runs'])} networks, *unconfirmed* "
        f"and bad-1 have a correlation of {trust(report):.2f}."
    )
    each = "Each real pair, mean over the runs, bad-1 in %:"
    parts = [_means(report, sets), tails, each, _pairs(report, sets)]
    if report["left_out"]:
        parts.append("Not trained: " + ", ".join(report["left_out"]) + ".")
    return "\n\n".join(parts)


def _means(report: Mapping[str, Any], sets: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    tails = halves(report)

    def of_tails(figures: Sequence[Mapping[str, float]]) -> list[str]:
        return [
            f"{np.mean([each[name] for each in figures for name in names]):.1f}" if names else _NONE for names in tails
        ]

    rows = []
    for name, runs in sets.items():
        values = [run["mean"] for run in runs]
        spread = f"{np.std(values, ddof=1):.2f}" if len(values) > 1 else _NONE
        each = ", ".join(f"{value:.1f}" for value in values)
        unconfirmed = np.mean([value for run in runs for value in run["unconfirmed"].values()])
        minutes = f"{np.mean([run['seconds'] for run in runs]) / 60:.1f}"
        rows.append((
            name, each, f"{np.mean(values):.2f}", spread, *of_tails([run["pairs"] for run in runs]),
            f"{unconfirmed:.1f}", minutes, report["sets"][name],
        ))  # fmt: skip
    baseline = report["semi_global"]
    rows.append((
        "SGBM", _NONE, f"{baseline['mean']:.2f}", _NONE, *of_tails([baseline["pairs"]]), _NONE, _NONE,
        "OpenCV's semi-global matching, untrained",
    ))  # fmt: skip
    heads = "set", "bad-1 of each run, %", "mean", "spread", "fine", "plain", "unconfirmed", "minutes", "what it is"
    return markdown(heads, rows)


def _pairs(report: Mapping[str, Any], sets: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    names = report["setup"]["pairs"]
    rows = [
        (name, *(f"{np.mean([run['pairs'][pair] for run in runs]):.1f}" for pair in names))
        for name, runs in sets.items()
    ]
    rows.append(("SGBM", *(f"{report['semi_global']['pairs'][pair]:.1f}" for pair in names)))
    return markdown(("set", *names), rows, text_last=False)
