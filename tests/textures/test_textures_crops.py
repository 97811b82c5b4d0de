"""Crops cover the image inside its black borders and keep exact pixels; sharpness and texture measures."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from photograph_like import noise

from semisynth_gl.textures.borders import Rectangle, inside_borders
from semisynth_gl.textures.crops import (
    FINGERPRINT_NORM,
    Square,
    cover,
    cut_crop,
    fingerprint,
    sharpness_measure,
    texture_measure,
)
from semisynth_gl.textures.image_files import builtin_photographs
from semisynth_gl.textures.images import read_image


@settings(max_examples=100)
@given(
    left_px=st.integers(0, 9),
    top_px=st.integers(0, 9),
    height=st.integers(1, 300),
    width=st.integers(1, 300),
    patch_px=st.integers(1, 80),
    scales=st.lists(st.floats(1, 5), min_size=1, max_size=3),
)
def test_crops_of_each_scale_that_fits_cover_a_part_of_an_image(left_px, top_px, height, width, patch_px, scales):
    squares = cover("a", Rectangle(left_px, top_px, width, height), patch_px, scales)
    assert len(set(squares)) == len(squares)
    sides = {round(scale * patch_px) for scale in scales}
    assert {square.side_px for square in squares} == {side for side in sides if side <= min(height, width)}
    for side in {square.side_px for square in squares}:
        of_side = [square for square in squares if square.side_px == side]
        covered = np.zeros((height, width), dtype=bool)
        for left, top in [(square.left_px - left_px, square.top_px - top_px) for square in of_side]:
            assert 0 <= left <= width - side
            assert 0 <= top <= height - side
            covered[top : top + side, left : left + side] = True
        assert covered.all()
        assert len(of_side) == -(-height // side) * -(-width // side)  # the fewest crops that cover it


@pytest.mark.parametrize("factor", [1, 2, 3, 4, 7])
def test_whole_factors_average_exactly(factor):
    patch_px = 16
    image = noise(140, 150)
    side = factor * patch_px
    square = image[3 : 3 + side, 5 : 5 + side].astype(np.int64)
    blocks = square.reshape(patch_px, factor, patch_px, factor, 3).sum(axis=(1, 3))
    expected = (2 * blocks + factor**2) // (2 * factor**2)
    crop = cut_crop(image, Square("a", 5, 3, side), patch_px)
    np.testing.assert_array_equal(crop, expected)
    assert not np.shares_memory(crop, image)


@pytest.mark.parametrize("side", [64, 100, 256])
def test_the_measure_is_the_median_of_cell_deviations(side):
    patch = noise(side, side)
    luminance = patch @ np.array([0.299, 0.587, 0.114])
    borders = [i * side // 8 for i in range(9)]
    cells = [
        luminance[top:bottom, left:right].std()
        for top, bottom in pairwise(borders)
        for left, right in pairwise(borders)
    ]
    assert texture_measure(patch) == pytest.approx(np.median(cells), rel=1e-9)
    levels = np.random.default_rng(1).normal(128, 5, (side, side)).clip(0, 255).astype(np.uint8)
    assert texture_measure(levels) == texture_measure(grey(levels)) == pytest.approx(5, rel=0.1)


def grey(values):
    return np.repeat(np.asarray(values, np.uint8)[..., None], 3, axis=2)


def test_sharpness_of_known_patterns():
    ramp = grey(np.tile(np.arange(256), (256, 1)))
    assert sharpness_measure(ramp) == pytest.approx(0.25)
    rng = np.random.default_rng(0)
    white = rng.integers(0, 256, (512, 512, 1), dtype=np.uint8).repeat(3, axis=2)
    assert sharpness_measure(white) == pytest.approx(4, rel=0.05)
    assert sharpness_measure(white[::2, ::2].repeat(8, 0).repeat(8, 1)) == np.inf  # no detail below 8 pixels
    assert sharpness_measure(grey(np.indices((64, 64)).sum(axis=0) % 2 * 255)) == np.inf
    assert sharpness_measure(np.full((40, 40, 3), 7, np.uint8)) == np.inf


@settings(max_examples=50)
@given(seed=st.integers(0, 999), side=st.integers(16, 90), gain=st.floats(0.3, 1), offset=st.integers(0, 60))
def test_a_fingerprint_tells_a_patch_from_others_and_not_from_itself(seed, side, gain, offset):
    rng = np.random.default_rng(seed)
    blocks = rng.integers(0, 190, (2, 8, 8), dtype=np.uint8)
    at = np.arange(side) * 8 // side
    one, other = (grey(block[at][:, at]) for block in blocks)
    print_of_one = fingerprint(one)
    assert print_of_one.shape == (112,)
    assert (print_of_one == np.rint(print_of_one)).all()

    def difference(patch):
        return 1 - float(print_of_one @ fingerprint(patch)) / FINGERPRINT_NORM**2

    assert abs(difference(one)) < 0.01
    assert difference((one * gain + offset).astype(np.uint8)) < 0.01
    assert difference(other) > 0.3
    assert not fingerprint(np.full((32, 32, 3), 9, np.uint8)).any()


def bright(height=120, width=160):
    return np.random.default_rng(0).integers(40, 256, (height, width, 3), dtype=np.uint8)


@given(st.integers(0, 25), st.integers(0, 25), st.integers(0, 25), st.integers(0, 25))
def test_straight_borders_are_left_out_and_no_more_than_that_and_what_is_mixed(top, bottom, left, right):
    image = bright()
    image[:top] = image[120 - bottom :] = 0
    image[:, :left] = image[:, 160 - right :] = 0
    mixed = [2 * (side > 0) for side in (left, top, right, bottom)]
    inner = (120 - top - bottom) * (160 - left - right)
    inside = inside_borders(image)
    if inner > 0.5 * 120 * 160:
        x, y = left + mixed[0], top + mixed[1]
        assert inside == Rectangle(x, y, 160 - right - mixed[2] - x, 120 - bottom - mixed[3] - y)
    else:
        assert inside == Rectangle(0, 0, 160, 120)


def test_a_curved_border_leaves_hardly_any_black():
    image = bright(240, 320)
    y, x = np.mgrid[:240, :320]
    across, down = np.abs(x - 159.5) / 160, np.abs(y - 119.5) / 120
    image[(across > 0.9 + 0.1 * down**2) | (down > 0.85 + 0.15 * across**2)] = 0
    left, top, width, height = inside_borders(image)
    part = image[top : top + height, left : left + width]
    assert (part == 0).all(axis=2).mean() < 1e-3
    assert width * height > 0.7 * 240 * 320


def test_a_dark_thing_in_a_corner_or_inside_is_no_border():
    image = bright()
    image[90:, 110:] = 1
    image[40:60, 40:60] = 0
    assert inside_borders(image) == Rectangle(0, 0, 160, 120)


@pytest.mark.parametrize("shape", [(6, 6), (3, 100), (1, 1)])
def test_tiny_and_black_images_stay_whole(shape):
    image = np.zeros((*shape, 3), np.uint8)
    assert inside_borders(image) == Rectangle(0, 0, shape[1], shape[0])
    image[shape[0] // 2 :] = 200
    left, top, width, height = inside_borders(image)
    assert min(width, height) >= 1
    assert left + width <= shape[1]
    assert top + height <= shape[0]


def test_photographs_without_a_border_stay_whole():
    for path in builtin_photographs():
        image = read_image(path)
        assert inside_borders(image) == Rectangle(0, 0, image.shape[1], image.shape[0]), path
