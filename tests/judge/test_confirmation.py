"""Predictions judged without truth, on views whose disparities are known, and on files."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from semisynth_gl.cli import semisynth_gl
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge import evaluate_views, unconfirmed

INF = np.float32(np.inf)


def walls():
    """True disparities of both views of a wall 4 px before which another one stands, at 10 px."""
    left, right = (np.full((6, 60), 4, np.float32) for _ in range(2))
    left[:, 30:40] = right[:, 20:30] = 10
    return left, right


def test_the_truth_is_confirmed_but_where_one_eye_alone_sees():
    left, right = walls()
    # Columns 24 to 29 of the left view are hidden; the first four lie outside of the right one.
    assert unconfirmed(left, right) == pytest.approx(100 * 6 / 56)
    assert unconfirmed(left[:, :20], right[:, :20]) == 0


@pytest.mark.parametrize(("off", "counts"), [(0.9, False), (1.1, True), (-1.1, True), (INF, True), (np.nan, True)])
def test_what_is_off_by_more_than_a_pixel_is_not_confirmed(off, counts):
    left, right = walls()
    left[:3, 45:50] += np.float32(off)
    assert unconfirmed(left, right) == pytest.approx(100 * (6 + 2.5 * counts) / 56)
    left, right = walls()
    right[:3, 41:46] += np.float32(off)  # the same points, in the other view
    assert unconfirmed(left, right) == pytest.approx(100 * (6 + 2.5 * counts) / 56)


@given(st.floats(0, 20), st.integers(1, 30))
def test_a_mirrored_pair_is_confirmed_alike(disparity, width):
    flat = np.full((2, width + 25), disparity, np.float32)
    assert unconfirmed(flat, flat) == unconfirmed(flat[:, ::-1], flat[:, ::-1]) == 0


@pytest.mark.parametrize(
    ("left", "right", "words"),
    [
        (np.ones((2, 3)), np.ones((2, 4)), "the left view has 3 x 2, the right one 4 x 2"),
        (np.full((2, 3), INF), np.ones((2, 3)), "no disparity leads into the right image"),
        (np.full((2, 3), 9.0), np.ones((2, 3)), "no disparity leads into the right image"),
    ],
)
def test_views_that_cannot_be_compared_are_refused(left, right, words):
    with pytest.raises(InputError, match=words):
        unconfirmed(left.astype(np.float32), right.astype(np.float32))


def test_the_command_prints_and_writes_what_python_returns(tmp_path):
    (one, other), (left, right) = walls(), (tmp_path / "left", tmp_path / "right")
    for folder in (left, right):
        (folder / "b").mkdir(parents=True)
    np.save(left / "a.npy", one[:, :20])
    np.save(right / "a.npy", other[:, :20])
    (left / "b" / "c.pfm").write_bytes(PFM.encode(one))
    np.save(right / "b" / "c.npy", other)
    arguments = ["evaluate", "--pred", left, "--pred-right", right, "--json", tmp_path / "out.json"]
    done = CliRunner().invoke(semisynth_gl, list(map(str, arguments)), standalone_mode=False)
    rows = [line.split() for line in done.output.splitlines()[2:]]
    assert rows == [["b/c", "10.71"], ["a", "0.00"], ["mean", "5.36"]]
    assert json.loads((tmp_path / "out.json").read_text()) == evaluate_views(left, right)
    (right / "a.npy").rename(right / "d.npy")
    with pytest.raises(InputError, match="same names in both folders; in one are a, d"):
        evaluate_views(left, right)
