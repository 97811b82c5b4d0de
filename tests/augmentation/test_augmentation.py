"""Augmentations: sampling within the ranges, colours, refused values."""

from dataclasses import replace

import numpy as np
import pytest
from hand_made_pairs import make_frame
from hypothesis import given
from hypothesis import strategies as st

from semisynth_gl.augmentation.augmentation import PRESETS, Augmentation
from semisynth_gl.augmentation.colour import mean_luminance, recoloured
from semisynth_gl.frame.camera import EYES, Crop, StereoCamera
from semisynth_gl.frame.channels import ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError

SIDES, CROP = (240, 320), (120, 160)
STRONG = replace(
    PRESETS["raft-stereo"], mirrored=0.5, right_roll_deg=(-0.3, 0.3), gamma=(0.8, 1.25), blur_px=(0, 1),
    noise=(0, 4), rectangle_px=(5, 10),
)  # fmt: skip


def many(augmentation, count=400):
    return [augmentation.sample(CROP, SIDES, 7, sequence) for sequence in range(count)]


def test_equal_arguments_give_equal_changes_and_others_give_others():
    first = STRONG.sample(CROP, SIDES, 7, 3, 1)
    assert first == STRONG.sample(CROP, SIDES, 7, 3, 1)
    others = [STRONG.sample(CROP, SIDES, *key) for key in ((8, 3, 1), (7, 4, 1), (7, 3, 2))]
    assert all(first.warp != other.warp for other in others)


def test_draws_fill_their_ranges():
    sampled = many(STRONG)
    scales = np.array([each.warp.scale_y for each in sampled])
    assert 2**-0.2 <= scales.min() < 0.9
    assert 1.28 < scales.max() <= 2**0.4
    assert abs(np.log(scales).mean() - 0.1 * np.log(2)) < 0.02
    stretches = np.array([each.warp.scale_x / each.warp.scale_y for each in sampled])
    assert 2**-0.2 <= stretches.min() < 0.9
    assert 1.1 < stretches.max() <= 2**0.2
    assert abs(np.mean([each.mirrored for each in sampled]) - 0.5) < 0.1
    assert abs(np.mean([bool(each.rectangles) for each in sampled]) - 0.5) < 0.1
    assert {len(each.rectangles) for each in sampled} == {0, 1, 2}
    own = [
        {name for name, value in each.colours["left"].items() if value != each.colours["right"][name]}
        for each in sampled
    ]
    assert abs(np.mean([{"brightness", "hue_turns", "gamma"} <= names for names in own]) - 0.2) < 0.07
    assert all("noise" in names for names in own)
    balances = np.array(
        [[each.colours[eye]["white_balance"] for eye in EYES] for each in many(PRESETS["semisynth"], 100)]
    )
    assert 0.95 <= balances.min() < 0.955
    assert 1.045 < balances.max() <= 1.05
    assert len(np.unique(balances)) == balances.size


def test_a_scale_is_raised_until_the_crop_fits():
    small = Augmentation(scale=(0.1, 1), right_y_px=(-3, 3))
    sides, crop = (400, 600), (250, 400)
    for sequence in range(50):
        sampled = small.sample(crop, sides, 0, sequence)
        height, width = sampled.source_size
        assert height <= sides[0]
        assert width <= sides[1]
    small.check(crop, sides)
    # At scale 0.1, the margin for a shift of 20 px exceeds the image; a roll of 5 degrees leaves a fifth of it.
    for moving, crop, needed in (
        (Augmentation(scale=(0.1, 1), right_y_px=(-20, 20)), (320, 720), "expected smaller movements: a crop"),
        (Augmentation(right_roll_deg=(-5, 5)), (320, 720), "an upper end of 3.903 or more, got 1"),
        (Augmentation(stretch=(0.9, 1)), (375, 1000), "an upper end of 1.003 or more, got 1"),
    ):
        with pytest.raises(InputError, match=needed):
            moving.check(crop, (375, 1242))


@pytest.mark.parametrize("crop", [None, (32, 48)])
def test_the_default_changes_nothing(crop):
    pair = make_frame(1)
    sampled = Augmentation().sample(crop, (32, 48), 0, 0)
    changed = sampled.applied(pair, np.random.default_rng(0))
    assert changed.camera == pair.camera
    for role, array in changed.arrays().items():
        rtol = 1e-6 if role.startswith("depth") else 0  # depth goes through float32 inverse depth
        np.testing.assert_allclose(array, pair.arrays()[role], rtol, err_msg=role)
    raw = {f"{name}_{eye}" for name in ("raw", "raw_map") for eye in EYES}
    assert set(pair.arrays()) - set(changed.arrays()) == raw
    assert PRESETS["psmnet"] == Augmentation()


def test_masks_are_those_of_the_changed_pair_and_truth_does_not_depend_on_colours():
    pair = make_frame(3)
    plain = replace(STRONG, right_y_px=(0, 0), right_roll_deg=(0, 0), occluded=0)
    grey = replace(plain, brightness=(1, 1), saturation=(0, 0), noise=(0, 0), blur_px=(0, 0))
    for sequence in range(5):
        changed, other = (
            changes.applied(pair.cropped(Crop(0, 0, *changes.source_size[::-1])), np.random.default_rng(0))
            for changes in (each.sample((20, 30), (32, 48), 0, sequence) for each in (plain, grey))
        )
        assert (changed.left.image != other.left.image).any()
        masked = changed.with_own_masks().arrays()
        for role, array in changed.arrays().items():
            np.testing.assert_array_equal(array, masked[role], err_msg=role)
            if role not in EYES:
                np.testing.assert_array_equal(array, other.arrays()[role], err_msg=role)


# --- colours ---


IMAGE = np.random.default_rng(0).integers(60, 190, (20, 30, 3)).astype(np.uint8)


def coloured(image=IMAGE, **values):
    return recoloured(image, mean_luminance([image]), np.random.default_rng(1), **values).astype(float)


def test_colours_do_what_their_names_say():
    luminance = IMAGE @ np.array([0.299, 0.587, 0.114])
    np.testing.assert_allclose(coloured(brightness=1.2), IMAGE * 1.2, atol=1)
    np.testing.assert_allclose(coloured(contrast=0.5), IMAGE * 0.5 + luminance.mean() / 2, atol=1)
    np.testing.assert_allclose(coloured(saturation=0), np.repeat(luminance[..., None], 3, 2), atol=1.5)
    balance = np.array([1.1, 0.9, 1.0])
    np.testing.assert_allclose(coloured(white_balance=balance), IMAGE * balance, atol=1)
    # The white balance comes after the saturation.
    grey = coloured(saturation=0, white_balance=balance)
    np.testing.assert_allclose(grey, luminance[..., None] * balance, atol=1.5)
    turned = coloured(hue_turns=0.2)
    assert np.abs(turned - IMAGE).mean() > 10
    soft = (IMAGE // 4 + 90).astype(np.uint8)  # a low contrast avoids clipping
    np.testing.assert_allclose(
        coloured(soft, hue_turns=0.2) @ [0.299, 0.587, 0.114], soft @ [0.299, 0.587, 0.114], atol=1.5
    )
    again = coloured(coloured(soft, hue_turns=0.2).astype(np.uint8), hue_turns=-0.2)
    np.testing.assert_allclose(again, soft, atol=2)
    np.testing.assert_array_equal(coloured(hue_turns=0.0), IMAGE)


@given(
    st.floats(0.3, 2), st.floats(0.3, 2), st.floats(0, 2), st.floats(-0.5, 0.5), st.floats(0.8, 1.2), st.booleans()
)  # fmt: skip
def test_changes_that_are_alike_leave_equal_pixels_equal(brightness, contrast, saturation, hue, balance, grey):
    ends = {"brightness": brightness, "contrast": contrast, "saturation": saturation, "hue_turns": hue}
    alike = Augmentation(**{name: (value, value) for name, value in ends.items()}, white_balance=(balance, balance))
    left = IMAGE[..., 0] if grey else IMAGE
    right = left.copy()
    right[::2] //= 2
    camera = StereoCamera.centred(30, 20, 20.0, 0.1)
    pair = Frame(camera, ViewArrays({"image": left}), ViewArrays({"image": right}))
    changed = alike.sample(None, (20, 30), 0, 0).applied(pair, np.random.default_rng(0))
    np.testing.assert_array_equal(changed.left.image[1::2], changed.right.image[1::2])


def test_grey_images_have_brightness_and_contrast():
    grey = IMAGE[..., 0]
    np.testing.assert_allclose(coloured(grey, brightness=0.8), grey * 0.8, atol=0.51)
    np.testing.assert_allclose(coloured(grey, contrast=1.3), grey * 1.3 - 0.3 * grey.mean(), atol=0.51)
    np.testing.assert_array_equal(coloured(grey, saturation=0.0, hue_turns=0.3), grey)
    noisy = coloured(grey, noise=3.0)
    assert 2.5 < (noisy - grey).std() < 3.5


# --- refusals ---


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"scale": (1.2, 0.9)}, r"scale: expected \(low, high\) in rising order"),
        ({"scale": 1.2}, r"scale: expected \(low, high\) in rising order, got 1.2"),
        ({"scale": (0, 1)}, "scale: must be from 0.1 to 10, got 0"),
        ({"noise": (0, float("nan"))}, "noise: must be a finite number"),
        ({"mirrored": 1.5}, "mirrored: must be from 0 to 1, got 1.5"),
        ({"hue_turns": "red"}, "hue_turns: expected"),
    ],
)
def test_values_that_cannot_be_used_are_refused_by_name(values, message):
    with pytest.raises(InputError, match=message):
        Augmentation(**values)
