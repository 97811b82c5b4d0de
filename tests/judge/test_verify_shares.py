"""Limits of verify's checks where pixels are few or alike: good pairs of every kind pass, and faults do not."""

import numpy as np
import pytest

from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.judge.agreement import UNCERTAIN, Agreement, Points, check_mask_agreement, follow, most_share
from semisynth_gl.judge.findings import Verdict
from semisynth_gl.judge.images import check_images

LIMITS = {"outside": OUTSIDE, "occluded": OCCLUDED, "visible": VISIBLE}


def mask_findings(label, pixels, wrong):
    """What is said of a mask in which some of a class's certain pixels are wrong, among many of another class."""
    other = VISIBLE if label != "visible" else OCCLUDED
    expected = np.full(1_500_000, other, np.uint8)
    expected[:pixels] = LIMITS[label]
    mask = expected.copy()
    mask[:wrong] = other
    verdict = Verdict("a")
    check_mask_agreement("mask", "visibility_right", mask, expected, "the disparities", verdict)
    return [finding.message for finding in verdict.findings]


@pytest.mark.parametrize("label", LIMITS)
@pytest.mark.parametrize("pixels", [1, 20, 100, 220, 3000, 100_000])
def test_a_share_of_few_pixels_is_judged_by_more_than_its_limit(label, pixels):
    most = int(most_share(0.05, pixels) * pixels)
    assert mask_findings(label, pixels, min(most, pixels)) == []
    if most < pixels:
        assert mask_findings(label, pixels, most + 1)[0].startswith(f"visibility_right: {(most + 1) / pixels:.2%} of ")


def test_the_limit_is_the_share_of_many_pixels_and_all_of_very_few_may_be_wrong():
    assert most_share(0.05, 10**9) == pytest.approx(0.05, abs=2e-4)
    assert most_share(0.05, 11) > 1 > most_share(0.05, 13)
    # Ten pixels around a thin chain, of 220 that are hidden, are no fault. A class that is another one throughout is.
    assert mask_findings("occluded", 220, 17) == []
    assert mask_findings("occluded", 30, 30) != []
    assert mask_findings("occluded", 300_000, 17_000) != []


def test_of_all_certain_pixels_one_in_two_hundred_may_be_wrong():
    expected = np.repeat(np.uint8([VISIBLE, OCCLUDED, UNCERTAIN]), 50_000)
    for wrong, found in ((500, 0), (800, 0), (900, 1)):
        mask = expected.copy()
        mask[50_000 - wrong // 2 : 50_000 + wrong // 2] ^= VISIBLE ^ OCCLUDED
        mask[100_000:] = OUTSIDE
        verdict = Verdict("a")
        check_mask_agreement("mask", "name", mask, expected, "the disparities", verdict)
        assert len(verdict.findings) == found
        assert verdict.measures["name_disagree_share"] == wrong / 100_000


@pytest.mark.parametrize(("pixels", "most"), [(30, 12), (150, 26), (100_000, 2600)])
def test_outliers_are_judged_in_any_number_of_pixels(pixels, most):
    own = np.zeros((1, pixels, 1))
    targets = Points(np.zeros(pixels, np.int64), np.arange(pixels), np.arange(pixels) * 1.0, np.zeros(pixels), True)  # noqa: FBT003
    for outliers, found in ((most - most // 10, 0), (most + most // 10 + 1, 1)):
        own[0, :outliers] = 3.0
        verdict = Verdict("a")
        corners = np.zeros((2, pixels, 1))
        Agreement(("one", "the other"), own, corners, targets, 0.0).check(
            "left-right", "lr", np.ones(pixels, bool), np.zeros(pixels, bool), verdict
        )
        assert len(verdict.findings) == found, outliers


def waves(phase_px, noise=0.0, shape=(100, 200)):
    y, x = np.indices(shape)
    levels = 128 + 60 * np.sin(0.45 * (x + phase_px) + 0.1 * y)
    return np.rint((levels + np.random.default_rng(0).normal(0, noise, shape)).clip(0, 255)).astype(np.uint8)


@pytest.mark.parametrize("noise", [0, 5, 10])
@pytest.mark.parametrize("off_px", [0, 0.5, -0.5, 1])
@pytest.mark.parametrize("disparity_px", [4.0, 4.3, 4.5])
def test_images_that_fit_half_a_pixel_aside_are_found(noise, off_px, disparity_px):
    way = np.stack([np.full((100, 200), -disparity_px), np.zeros((100, 200))], axis=2)
    points, verdict = follow(way, on_rows=True), Verdict("a")
    images = waves(0, noise), waves(disparity_px + off_px, noise)
    check_images("images", "name", "", images, points, verdict, imperfect=noise > 0)
    assert bool(verdict.findings) == bool(off_px)
