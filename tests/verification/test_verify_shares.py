"""Limits of verify's checks where pixels are few or alike: good pairs of every kind pass, and faults do not."""

import numpy as np
import pytest

from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.verification.agreement import UNCERTAIN, Agreement, Points, check_mask_agreement, most_share
from semisynth_gl.verification.photometry import check_images
from semisynth_gl.verification.verdict import Verdict
from semisynth_gl.verification.view_consistency import match_views, one_surface

LIMITS = {"outside": OUTSIDE, "occluded": OCCLUDED, "visible": VISIBLE}


def mask_findings(label, pixels, wrong):
    """What is said of a mask in which some of a class's certain pixels are wrong, among many of another class."""
    other = VISIBLE if label != "visible" else OCCLUDED
    expected = np.full(1_500_000, other, np.uint8)
    expected[:pixels] = LIMITS[label]
    mask = expected.copy()
    mask[:wrong] = other
    verdict = Verdict("a")
    check_mask_agreement("mask", "visibility_right", "visibility_right", mask, expected, "the disparities", verdict)
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
        check_mask_agreement("mask", "name", "name", mask, expected, "the disparities", verdict)
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


def facing_wall(disparity_px, off_px=0.0, phase=0.3):
    """The verdict on a pair of a wall that faces the camera, of one texel per pixel, with another disparity stored.

    Drivers interpolate between texels, each at its place between two pixels: here at one place for all pixels.
    """
    height, width = 60, 200
    rough = np.random.default_rng(0).uniform(0, 255, (height, width + 50))
    texels = sum(np.roll(rough, shift, (0, 1)) for shift in ((0, 0), (0, 1), (1, 0), (1, 1))) / 4

    def seen(shift):
        u = np.arange(width) + shift
        left, fraction = np.floor(u).astype(int), u % 1
        return (texels[:, left] * (1 - fraction) + texels[:, left + 1] * fraction).round().astype(np.uint8)

    stored = np.full((height, width), disparity_px + off_px, np.float32)
    match = match_views(stored, stored, -1)
    verdict = Verdict("a")
    check_images(seen(phase), seen(phase + disparity_px), match, one_surface(match, match.inside), verdict)
    return verdict


@pytest.mark.parametrize("disparity_px", [4.1, 4.3, 4.7])
@pytest.mark.parametrize("phase", [0.2, 0.3, 0.5, 0.7])
def test_interpolation_moves_a_facing_wall_and_that_is_no_fault(disparity_px, phase):
    verdict = facing_wall(disparity_px, phase=phase)
    assert 0.01 < abs(verdict.measures["best_shift_px"]) < 0.1
    assert verdict.findings == []
    found = facing_wall(disparity_px, 0.5, phase).findings
    assert any(finding.check == "images" for finding in found)
