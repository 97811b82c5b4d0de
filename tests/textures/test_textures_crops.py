"""Crops cover the image, are squares, and carry exact pixels; the texture measure is what its docstring says."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures.crops import (
    FINGERPRINT_NORM,
    CropBox,
    crop_boxes,
    cut_crop,
    fingerprint,
    least_texture,
    sharpness_measure,
    surely_has_texture,
    texture_measure,
)


@settings(max_examples=200, deadline=None)
@given(
    height=st.integers(1, 300),
    width=st.integers(1, 300),
    patch_px=st.integers(1, 80),
    scales=st.lists(st.floats(1, 5), min_size=1, max_size=3),
)
def test_crops_of_each_scale_that_fits_cover_the_image(
    height: int, width: int, patch_px: int, scales: list[float]
) -> None:
    boxes = crop_boxes(height, width, patch_px, scales)
    assert len(set(boxes)) == len(boxes)
    sides = {round(scale * patch_px) for scale in scales}
    assert {box.side_px for box in boxes} == {side for side in sides if side <= min(height, width)}
    for side in {box.side_px for box in boxes}:
        of_side = [box for box in boxes if box.side_px == side]
        covered = np.zeros((height, width), dtype=bool)
        for left, top, _ in of_side:
            assert left >= 0
            assert top >= 0
            assert left + side <= width
            assert top + side <= height
            covered[top : top + side, left : left + side] = True
        assert covered.all()
        assert len(of_side) == -(-height // side) * -(-width // side)  # no more than it takes


def test_crops_are_evenly_spread() -> None:
    assert [box.left_px for box in crop_boxes(100, 250, 100, [1])] == [0, 75, 150]
    assert crop_boxes(99, 250, 100, [1]) == []
    assert crop_boxes(100, 100, 100, [1]) == [CropBox(0, 0, 100)]


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(5).integers(0, 256, shape, dtype=np.uint8)


def test_a_crop_of_patch_size_is_copied_bit_for_bit() -> None:
    image = noise(50, 60, 3)
    crop = cut_crop(image, CropBox(7, 11, 32), 32)
    np.testing.assert_array_equal(crop, image[11:43, 7:39])
    assert crop.flags.c_contiguous
    assert not np.shares_memory(crop, image)


@pytest.mark.parametrize("factor", [2, 3, 4, 7])
def test_whole_factors_average_exactly(factor: int) -> None:
    patch_px = 16
    image = noise(140, 150, 3)
    side = factor * patch_px
    square = image[3 : 3 + side, 5 : 5 + side].astype(np.int64)
    blocks = square.reshape(patch_px, factor, patch_px, factor, 3).sum(axis=(1, 3))
    expected = (2 * blocks + factor**2) // (2 * factor**2)
    np.testing.assert_array_equal(cut_crop(image, CropBox(5, 3, side), patch_px), expected)


def test_other_factors_average_over_the_covered_area() -> None:
    # 3 pixels onto 2: box filtering in Pillow takes every pixel whose centre lies in the support.
    ramp = np.repeat(np.arange(48, dtype=np.uint8)[np.newaxis, :, np.newaxis], 48, axis=0).repeat(3, axis=2) * 4
    crop = cut_crop(ramp, CropBox(0, 0, 48), 32).astype(np.float64)
    np.testing.assert_allclose(crop.mean(), ramp.mean(), atol=1.0)
    np.testing.assert_allclose(np.diff(crop[0, :, 0]), 6, atol=4)
    flat = np.full((48, 48, 3), 77, dtype=np.uint8)
    np.testing.assert_array_equal(cut_crop(flat, CropBox(0, 0, 48), 32), flat[:32, :32])


@pytest.mark.parametrize("box", [CropBox(-1, 0, 16), CropBox(0, 5, 16), CropBox(0, 0, 8), CropBox(0, 0, 30)])
def test_boxes_outside_or_too_small_are_refused(box: CropBox) -> None:
    with pytest.raises(InputError, match="a crop must"):
        cut_crop(noise(20, 20, 3), box, 16)


@pytest.mark.parametrize("side", [1, 2, 7, 16, 33, 64, 256])
def test_flat_patches_measure_exactly_zero(side: int) -> None:
    for colour in ((0, 0, 0), (255, 255, 255), (13, 200, 77)):
        assert texture_measure(np.full((side, side, 3), colour, dtype=np.uint8)) == 0.0


@pytest.mark.parametrize("side", [64, 100, 256])
def test_the_measure_is_the_median_of_cell_deviations(side: int) -> None:
    patch = noise(side, side, 3)
    luminance = patch @ np.array([0.299, 0.587, 0.114])
    borders = [i * side // 8 for i in range(9)]
    cells = [
        luminance[top:bottom, left:right].std()
        for top, bottom in pairwise(borders)
        for left, right in pairwise(borders)
    ]
    assert texture_measure(patch) == pytest.approx(np.median(cells), rel=1e-9)


@pytest.mark.parametrize("deviation", [2.0, 5.0, 20.0])
def test_grey_noise_measures_its_standard_deviation(deviation: float) -> None:
    grey = np.random.default_rng(1).normal(128, deviation, (256, 256, 1))
    patch = np.rint(grey).clip(0, 255).astype(np.uint8).repeat(3, axis=2)
    assert texture_measure(patch) == pytest.approx(deviation, rel=0.05)


def test_half_of_the_patch_must_have_texture() -> None:
    patch = np.full((64, 64, 3), 128, dtype=np.uint8)
    patch[:, 30:34] = noise(64, 4, 3)  # one strong edge
    assert texture_measure(patch) == 0.0
    patch[:40] = noise(40, 64, 3)
    assert texture_measure(patch) > 30


def grey(values):
    return np.repeat(np.asarray(values, np.uint8)[..., None], 3, axis=2)


def test_the_proof_of_texture_never_says_more_than_the_measure() -> None:
    rng, proven = np.random.default_rng(2), 0
    for height, width in [*rng.integers(1, 300, (120, 2)), (64, 64), (63, 65), (1, 1), (16, 200)]:
        cells = rng.integers(0, 256, (height // 12 + 1, width // 12 + 1, 3)).repeat(12, axis=0).repeat(12, axis=1)
        deviation = float(rng.choice([0, 0.5, 2, 10, 60]))
        fine = rng.normal(0, deviation, (height, width, 3)) + rng.choice([0, 0.1, 1]) * cells[:height, :width]
        image = np.clip(128 + fine, 0, 255).astype(np.uint8)
        # What the proof looks at may be all the texture that there is, or none of it.
        image[::8, ::8] = rng.choice([0, 128, 255]) if rng.random() < 0.3 else image[::8, ::8]
        measure = least_texture([image])
        assert surely_has_texture([image], 0)
        for least in (measure * (1 + 1e-12) + 1e-12, 1.1 * measure + 0.01, 128.0):
            assert not surely_has_texture([image], least)
        proven += surely_has_texture([image], measure / 8) and measure > 1
    assert proven > 20


def test_sharpness_of_known_patterns() -> None:
    ramp = grey(np.tile(np.arange(256), (256, 1)))
    assert sharpness_measure(ramp) == pytest.approx(0.25)
    rng = np.random.default_rng(0)
    white = rng.integers(0, 256, (512, 512, 1), dtype=np.uint8).repeat(3, axis=2)
    assert sharpness_measure(white) == pytest.approx(4, rel=0.05)
    assert sharpness_measure(white[::2, ::2].repeat(8, 0).repeat(8, 1)) == np.inf  # nothing below 8 pixels
    assert sharpness_measure(grey(np.indices((64, 64)).sum(axis=0) % 2 * 255)) == np.inf
    assert sharpness_measure(np.full((40, 40, 3), 7, np.uint8)) == np.inf


def test_sharpness_depends_on_neither_contrast_nor_the_rest_beyond_eighths() -> None:
    pattern = np.random.default_rng(1).integers(0, 60, (64, 64), dtype=np.uint8)
    assert sharpness_measure(grey(pattern * 4)) == pytest.approx(sharpness_measure(grey(pattern)))
    odd = np.pad(grey(pattern), ((0, 7), (0, 3), (0, 0)))
    assert sharpness_measure(odd) == sharpness_measure(grey(pattern))


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 999), side=st.integers(16, 90), gain=st.floats(0.3, 1), offset=st.integers(0, 60))
def test_a_fingerprint_tells_a_patch_from_others_and_not_from_itself(
    seed: int, side: int, gain: float, offset: int
) -> None:
    rng = np.random.default_rng(seed)
    blocks = rng.integers(0, 190, (2, 8, 8), dtype=np.uint8)
    at = np.arange(side) * 8 // side
    one, other = (grey(block[at][:, at]) for block in blocks)
    print_of_one = fingerprint(one)
    assert print_of_one.shape == (112,)
    assert (print_of_one == np.rint(print_of_one)).all()

    def difference(patch: np.ndarray) -> float:
        return 1 - float(print_of_one @ fingerprint(patch)) / FINGERPRINT_NORM**2

    assert abs(difference(one)) < 0.01
    assert difference((one * gain + offset).astype(np.uint8)) < 0.01
    assert difference(other) > 0.3


def test_a_patch_without_changes_is_like_none() -> None:
    assert not fingerprint(np.full((32, 32, 3), 9, np.uint8)).any()
