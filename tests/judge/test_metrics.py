"""Metrics compared with results by hand, and with the benchmarks' evaluation loops in plain Python."""

import math

import numpy as np
import pytest

from semisynth_gl.judge import PROTOCOLS
from semisynth_gl.judge.evaluate import paint_error_map
from semisynth_gl.judge.protocol import Truth
from semisynth_gl.judge.score import figures, mean_figures, score, tally

INF, NAN = math.inf, math.nan


def f32(values):
    return np.array(values, np.float32)


def scored(prediction, truth, protocol, **limits):
    return score(f32(prediction), Truth(f32(truth), **limits), protocol)


def sums_of(prediction, truth, protocol, mask=None, **known):
    return tally(PROTOCOLS[protocol].compare(prediction, Truth(truth, **known)), PROTOCOLS[protocol], mask)


# --- by hand ---


@pytest.mark.parametrize(
    ("protocol", "prediction", "truth", "ndisp", "expected"),
    [
        # inf is bad, -inf becomes 0 and 500 becomes 40; nan is never bad.
        ("middlebury", [INF, -INF, 500, 10, 3], [10, 10, 10, 10, INF], 40,
         {"invalid": 25, "coverage": 75, "bad-4": 75, "D1-all": 75, "D1-est": 200 / 3, "avgerr": 40 / 3}),
        ("middlebury", [NAN, 10, 3], [10, 10, INF], None, {"avgerr": NAN, "A50": NAN, "bad-0.5": 0, "invalid": 0}),
        ("middlebury", [INF, INF], [1, 2], None, {"bad-4": 100, "invalid": 100, "avgerr": NAN, "A50": NAN}),
        # Disparities above the width, 8 px, are ignored.
        ("eth3d", [INF, NAN, 8.5, -8.5, -8, 8, 1, 1], [2] * 6 + [-INF, NAN], None,
         {"coverage": 1 / 3, "avgerr": 8, "bad-4": 1, "A50": 10, "A99": 10}),
        ("eth3d", [INF, NAN], [1, 2], None, {"bad-0.5": 1, "D1-all": 1, "coverage": 0, "avgerr": INF, "A50": INF}),
        # Both holes get the smaller neighbour, 11.
        ("kitti", [20, INF, NAN, 11, 0], [10, 10, 10, 10, INF], None,
         {"avgerr": 13 / 4, "D1-all": 0.25, "D1-est": 0.5, "coverage": 0.5}),
        ("paper", [INF, -5, 10.5, 1], [10, 10, 10, INF], 20, {"avgerr": 25.5 / 3, "bad-4": 200 / 3, "invalid": 0}),
    ],
)  # fmt: skip
def test_invalid_values_count_as_in_each_benchmark(protocol, prediction, truth, ndisp, expected):
    found = scored([prediction], [truth], protocol, ndisp=ndisp)
    assert {name: found[name] for name in expected} == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("scale", [2, 4])
def test_middlebury_scales_half_and_quarter_sizes(scale):
    small = f32([[1.0, 2.0], [3.0, INF]])
    truth = np.full((2 * scale, 2 * scale), 2.0 * scale, np.float32)
    found = scored(small, truth, "middlebury")
    # One of four pixels is right, two are off by ``scale``, one is invalid.
    assert (found["invalid"], found["avgerr"]) == (25, pytest.approx(2 * scale / 3))
    # ndisp 5 of the smaller size is rounded up: to 3, times 2 = 6; to 2, times 4 = 8.
    largest = {2: 6.0, 4: 8.0}[scale]
    clipped = scored(np.full((2, 2), 99.0), truth * 0, "middlebury", ndisp=5)
    assert clipped["avgerr"] == largest


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_an_empty_mask_has_no_figures(protocol):
    truth = f32([[1.0, 2.0]])
    assert all(map(math.isnan, score(truth, truth, protocol, mask=np.zeros((1, 2), bool)).values()))
    counted, rules = sums_of(truth, truth, protocol, np.zeros((1, 2), bool)), PROTOCOLS[protocol]
    assert all(map(math.isnan, mean_figures({"a": counted}, rules).values()))
    # Means ignore it.
    other = sums_of(truth + 1, truth, protocol)
    assert mean_figures({"a": counted, "b": other}, rules) == figures(other, rules)


def test_kitti_pools_pixels_and_the_others_average_images():
    one = (f32([[10.0]]), f32([[20.0]]))
    three = (f32([[1.0, 1.0, 1.5]]), f32([[1.0, 1.0, 1.0]]))

    def mean(protocol, **pairs):
        return mean_figures({name: sums_of(*pair, protocol) for name, pair in pairs.items()}, PROTOCOLS[protocol])

    assert (mean("kitti", a=one, b=three)["D1-all"], mean("kitti", a=one, b=three)["avgerr"]) == (0.25, 10.5 / 4)
    assert mean("eth3d", a=three, b=(f32([[0.5]]), f32([[0.5]])))["avgerr"] == pytest.approx(0.5 / 6)
    # Middlebury gives five of its training pairs half the weight.
    assert mean("middlebury", Playtable=one, Piano=three)["avgerr"] == pytest.approx((10 * 0.5 + 0.5 / 3) / 1.5)


def test_kitti_tells_objects_from_the_background():
    truth, off = f32([[10.0] * 4] * 2), f32([[0.0, 9.0, 9.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    objects = np.array([[0, 1, 2, 0], [0, 0, 7, 0]], np.uint8)
    kitti = PROTOCOLS["kitti"]
    both = sums_of(truth + off, truth, "kitti", objects=objects)
    assert [figures(both, kitti)[name] for name in ("D1-bg", "D1-fg", "D1-all")] == [0, 2 / 3, 1 / 4]
    first_column = sums_of(truth, truth, "kitti", np.arange(8).reshape(2, 4) % 4 == 0, objects=objects)
    assert math.isnan(figures(first_column, kitti)["D1-fg"])
    assert mean_figures({"a": both, "b": first_column}, kitti)["D1-fg"] == 2 / 3
    assert "D1-fg" not in score(truth, Truth(truth, objects=objects), "eth3d")


# --- against the benchmarks' loops ---

BELOW_HALF = float(np.nextafter(np.float32(0.5), np.float32(0)))  # in float32, BELOW_HALF + 0.5 is 1
VALUES = [0.0, -1.0, BELOW_HALF, 0.5, 1.0, 2.0, 3.0, 4.0, 3.5, 60.0, 63.0, 70.0, 73.5, INF, -INF, NAN]
TRUTHS = [0.5, 1.0, 2.0, 60.0, 70.0, INF]


def random_case(seed):
    """Return a small prediction and truth, half of them with values where definitions differ; mask, ndisp, isint."""
    rng = np.random.default_rng(seed)
    shape, special = (rng.integers(1, 6), rng.integers(1, 8)), rng.random(2) < 0.5
    prediction, truth = (
        np.where(rng.random(shape) < share, rng.choice(values, shape), rng.uniform(0.25, 90, shape))
        for share, values in zip(0.3 + 0.7 * special, (VALUES, TRUTHS), strict=True)
    )
    return f32(prediction), f32(truth), rng.random(shape) < 0.8, int(rng.integers(1, 81)), bool(rng.random() < 0.5)


def c_round(value):
    return math.copysign(math.floor(abs(value) + 0.5), value)


def naive_fill(disparity):
    """Fill holes by KITTI's loops, on lists of rows with -1 for holes."""
    rows = [[float(v) if math.isfinite(v) and v > 0 else -1.0 for v in row] for row in disparity]
    height, width = len(rows), len(rows[0])
    for row in rows:
        count = 0
        for u in range(width):
            if row[u] < 0:
                count += 1
                continue
            if count and u - count > 0:
                row[u - count : u] = [min(row[u - count - 1], row[u])] * count
            count = 0
        there = [u for u in range(width) if row[u] >= 0]
        if there:
            row[: there[0]] = [row[there[0]]] * there[0]
            row[there[-1] + 1 :] = [row[there[-1]]] * (width - 1 - there[-1])
    for u in range(width):
        there = [v for v in range(height) if rows[v][u] >= 0]
        if there:
            for v in range(there[0]):
                rows[v][u] = rows[there[0]][u]
            for v in range(there[-1] + 1, height):
                rows[v][u] = rows[there[-1]][u]
    return rows


def naive(prediction, truth, mask, protocol, ndisp, isint):
    """Return (error, truth, estimated) of each scored pixel, and the numbers of judged and of estimated pixels."""
    filled = naive_fill(prediction) if protocol == "kitti" else None
    scored, judged, estimated = [], 0, 0
    for y, x in np.ndindex(*truth.shape):
        d, g = prediction[y, x], truth[y, x]
        if not mask[y, x] or g == INF:
            continue
        judged += 1
        has = True
        if protocol == "middlebury":
            has = d != INF
            if has and not math.isnan(d):
                d = max(0.0, min(float(ndisp), float(d)))
                d = c_round(d) if isint else d
        elif protocol == "eth3d":
            has = math.isfinite(d) and abs(d) <= truth.shape[1]
        elif protocol == "kitti":
            has = math.isfinite(d) and d > 0
            d = filled[y][x]
        elif d > ndisp:
            d = float(ndisp)
        estimated += has
        if has or protocol == "kitti":
            scored.append((abs(np.float32(d) - g), g, has))
    return scored, judged, estimated


@pytest.mark.parametrize("seed", range(100))
@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_scores_are_those_of_the_loops(protocol, seed):
    prediction, truth, mask, ndisp, isint = random_case(seed)
    isint &= protocol == "middlebury"
    counted = sums_of(prediction, truth, protocol, mask, ndisp=ndisp, isint=isint)
    scored, judged, estimated = naive(prediction, truth, mask, protocol, ndisp, isint)
    outliers = [(bool(e > 3) and float(np.float32(e) / abs(g)) > 0.05, has) for e, g, has in scored]
    errors = sorted(float(e) for e, _, _ in scored)
    # Middlebury's protocol counts pixels without a score as bad.
    unscored = judged - len(scored) if protocol == "middlebury" else 0
    expected = {"judged": judged, "estimated": estimated, "scored": len(scored)}
    expected |= {f"bad-{t:g}": sum(e > t for e in errors) + unscored for t in (0.5, 1.0, 2.0, 4.0)}
    expected |= {"outliers": sum(out for out, _ in outliers) + unscored}
    expected |= {"outliers_estimated": sum(map(all, outliers))}
    if errors:
        expected |= {"sum_px": pytest.approx(sum(errors), rel=1e-9, nan_ok=True)}
    assert {name: counted[name] for name in expected} == expected
    if errors and np.isfinite(errors).all():
        places = [int(np.floor(np.float32(len(errors)) * np.float32(q))) for q in (0.5, 0.9, 0.95, 0.99)]
        assert [counted[name] for name in ("A50", "A90", "A95", "A99")] == [errors[place] for place in places]
        assert counted["sum_squared_px2"] == pytest.approx(sum(e * e for e in errors), rel=1e-6)


# --- error maps ---


def error_map(prediction, truth, protocol="kitti", visible=None):
    return paint_error_map(PROTOCOLS[protocol].compare(f32(prediction), Truth(truth, visible)))


def test_colours_follow_the_error_and_occlusion_darkens():
    truth = f32([[100.0] * 8, [10.0] * 8])
    errors = f32(
        [[0.0, 0.1875 * 5 / 3, 5.0, 79.9, 80.0, 100.0, 0.3, 0.3], [0.0, 0.1875, 3.0, 47.9, 48.0, 0.1, 6.0, 12.0]]
    )
    # The unit is the larger of 3 px and 5 % of the truth: 5 px in the first row, 3 px in the second.
    visible = np.ones((2, 8), bool)
    visible[0, 0] = False
    picture = error_map(truth + errors, truth, visible=visible)
    expected = {(0, 0): (24, 27, 74), (0, 1): (69, 117, 180), (0, 2): (254, 224, 144), (0, 3): (215, 48, 39)}
    expected |= {(0, 4): (165, 0, 38), (1, 0): (49, 54, 149), (1, 2): (254, 224, 144), (1, 4): (165, 0, 38)}
    assert {at: tuple(picture[at].tolist()) for at in expected} == expected


@pytest.mark.parametrize("protocol", ["middlebury", "eth3d"])
def test_an_invalid_prediction_has_the_worst_colour(protocol):
    truth = f32([[1.0, 1.0, 1.0, INF]])
    picture = error_map([[1.0, 1.0, INF, 1.0]], truth, protocol)
    assert picture[0].tolist() == [[49, 54, 149], [49, 54, 149], [165, 0, 38], [0, 0, 0]]
