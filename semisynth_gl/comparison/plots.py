"""Draw the plots of a comparison as one picture."""

import io

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from semisynth_gl.comparison.compare import Comparison
from semisynth_gl.comparison.measures import MEASURES, PROFILES, Measure, Profile
from semisynth_gl.comparison.sides import Side

_COLUMNS = 4
_PANEL_IN = (3.6, 2.3)
# Readers of any colour vision can tell these two apart.
_DATASET, _PLACE = "#d1730f", "#2a5fa5"


def comparison_png(comparison: Comparison, title: str) -> bytes:
    """Return a PNG with the profiles of both sides, and below them the measures of all pictures.

    A profile is the mean over a side's pictures, with the range between the quartiles.
    """
    sides = ((comparison.place.side, _PLACE, "place"), (comparison.dataset, _DATASET, "dataset"))
    measures = [measure for measure in MEASURES if any(len(side.values[measure.key]) for side, _, _ in sides)]
    profiles = [profile for profile in PROFILES if any(len(side.profiles[profile.key]) for side, _, _ in sides)]
    rows = [-(-len(panels) // _COLUMNS) for panels in (profiles, measures)]
    with mpl.rc_context({"font.size": 8, "axes.titlesize": 9, "axes.spines.top": False, "axes.spines.right": False}):
        width, height = _PANEL_IN
        figure = Figure((_COLUMNS * width, sum(rows) * height + 0.4), dpi=100)
        FigureCanvasAgg(figure)
        figure.suptitle(title, fontsize=10, y=1 - 0.1 / figure.get_figheight())
        # matplotlib's own layouts would take longer than the drawing.
        frame = {"left": 0.05, "right": 0.985, "bottom": 0.03, "top": 1 - 0.6 / figure.get_figheight()}
        grid = figure.add_gridspec(sum(rows), _COLUMNS, hspace=0.5, wspace=0.25, **frame)
        for number, profile in enumerate(profiles):
            axes = figure.add_subplot(grid[divmod(number, _COLUMNS)])
            for side, colour, name in sides:
                _draw_profile(axes, side, profile, colour, name)
            axes.set(title=profile.name, xlabel=profile.label, xscale="log" if profile.edges[0] > 0 else "linear")
            axes.set_ylim(bottom=0)
            if number == 0:
                axes.legend(frameon=False)
        for number, measure in enumerate(measures):
            row, column = divmod(number, _COLUMNS)
            axes = figure.add_subplot(grid[rows[0] + row, column])
            for level, (side, colour, _) in enumerate(sides):
                _draw_values(axes, side, measure, level, colour)
            axes.set(title=f"{measure.name}, {measure.unit}", ylim=(-0.6, 1.6))
            axes.set_yticks(range(len(sides)), [name for _, _, name in sides])
        file = io.BytesIO()
        figure.savefig(file, format="png", metadata={"Software": None})
    return file.getvalue()


def _draw_profile(axes: Axes, side: Side, profile: Profile, colour: str, name: str) -> None:
    rows = side.profiles[profile.key]
    if not len(rows):
        return
    low, high = np.percentile(rows, (25, 75), axis=0)
    axes.stairs(high, profile.edges, baseline=low, fill=True, color=colour, alpha=0.25, linewidth=0)
    axes.stairs(rows.mean(axis=0), profile.edges, baseline=None, color=colour, linewidth=1.4, label=name)


def _draw_values(axes: Axes, side: Side, measure: Measure, level: int, colour: str) -> None:
    values = side.values[measure.key]
    # On one line, the values of many pictures would hide each other; so they are spread in a fixed pattern.
    offset = 0.25 * np.sin(2.4 * np.arange(len(values)))
    axes.plot(values, level + offset, ".", color=colour, alpha=0.5, markersize=4)
    mean, deviation = side.mean(measure), side.deviation(measure)
    if mean is not None:
        axes.errorbar(mean, level, xerr=deviation or 0, color="black", marker="|", markersize=12, linewidth=1.2)
