"""An augmented pair equals the pair that the renderer makes with the changed camera."""

from dataclasses import replace

import hand_made_pairs
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tiny_datasets import tiny

from semisynth_gl.augmentation.geometry import PairWarp, mirrored, occluded
from semisynth_gl.frame.camera import EYES, OTHER_EYE, CameraDeviation, Crop, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, OUTPUTS, OUTSIDE, VISIBLE, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import renderer_options
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.mix import RecipeMixSampler
from semisynth_gl.scene.sources import prepare_sources
from semisynth_gl.seeds.splits import Split

RENDERED = ("visibility", "correspondence", "instances", "depth", "normals", "sky")


def make_frame(index, without=(), truth="both"):
    """Make a hand-made pair without raw images and maps, which augmentations do not get."""
    outputs = [output for output in OUTPUTS if output not in {"raw", "raw_map", *without}]
    return hand_made_pairs.make_frame(index, outputs, truth)


@pytest.fixture
def render(backend):
    """Return a function that renders a scene after changing its camera."""
    config = tiny().model_copy(update={"outputs": RENDERED})
    sources = prepare_sources(config, Split(3))
    sampler = RecipeMixSampler(config, 3, sources.libraries, sources.atlas.patches)
    options = renderer_options(config) | {"rectified": False}
    with Renderer(sampler.models, sources.atlas.layers, backend=backend, **options) as renderer:

        def rendered(change):
            scene = sampler.sample(0).scene
            return renderer.render(replace(scene, camera=change(scene.camera)))

        yield rendered


def both(render, warp, sides=(60, 80), corner=(37, 21), fy_over_fx=1.0):
    """Return a pair that a warp changed, and the pair rendered with the changed camera."""

    def seen(camera):
        return replace(camera, fy_over_fx=fy_over_fx)

    def moved(position, start, scale):
        return (position - start - warp.margin + 0.5) * scale - 0.5

    def as_changed(camera):
        return replace(
            camera,
            width_px=sides[1],
            height_px=sides[0],
            focal_px=camera.focal_px * warp.scale_x,
            cx_left_px=moved(camera.cx_left_px, corner[0], warp.scale_x),
            cx_right_px=moved(camera.cx_right_px, corner[0], warp.scale_x),
            cy_px=moved(camera.cy_px, corner[1], warp.scale_y),
            deviation=CameraDeviation(warp.right_roll_rad, 0.0, warp.right_y_px),
            fy_over_fx=fy_over_fx * warp.scale_y / warp.scale_x,
        )

    height, width = warp.source_size(sides)
    changed = warp.applied(render(seen).cropped(Crop(*corner, width, height)), sides)
    expected = render(as_changed)
    for name in ("focal_px", "focal_y_px", "baseline_m", "cx_left_px", "cx_right_px", "cy_px"):
        assert getattr(changed.camera, name) == pytest.approx(getattr(expected.camera, name), abs=1e-9)
    return changed, expected


def smooth(view):
    """Mark the pixels without a jump of disparity in their 3 x 3 neighbourhood."""
    padded = np.pad(np.where(np.isfinite(view.disparity), view.disparity, 1e6), 1, "edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return around.max((2, 3)) - around.min((2, 3)) < 1


@pytest.mark.one_backend
@pytest.mark.parametrize(
    ("warp", "fy_over_fx"),
    [
        (PairWarp(1.31, 1.31), 1.0),
        (PairWarp(1.0, 1.0, 1.5, margin=4), 1.0),
        (PairWarp(0.77, 0.77), 1.0),
        (PairWarp(0.9, 0.9, 1.5, 0.01, margin=6), 1.0),
        (PairWarp(1.3, 1.1, -2, -0.02, margin=8), 1.0),
        (PairWarp(1.1, 1.1, 1.5, 0.03, margin=10), 1.3),
    ],
)
def test_a_scaled_and_moved_pair_is_the_one_that_its_camera_sees(render, warp, fy_over_fx):
    changed, expected = both(render, warp, fy_over_fx=fy_over_fx)
    for eye in EYES:
        found, rendered = changed.view(eye), expected.view(eye)
        assert set(found) == set(rendered)
        alike = smooth(found) & smooth(rendered) & (found.instances == rendered.instances)
        assert alike.mean() > 0.3
        for name, scale in (("disparity", 1), ("correspondence", 1), ("depth", 20 / np.median(rendered.depth))):
            errors = np.abs(found[name] - rendered[name])[alike] * scale
            assert np.quantile(errors, 0.5) < 2e-3, name
            assert np.quantile(errors, 0.9) < 0.04, name
            assert np.quantile(errors, 0.99) < 0.2, name
        assert np.median((found.normals * rendered.normals).sum(-1)[alike]) > 0.9999
        assert (found.sky == rendered.sky)[alike].all()
        # The warped image is softer, but not shifted: a shift by one pixel would at least double the difference.
        levels = found.image.astype(float)
        aside = [np.abs(np.roll(levels, shift, (0, 1)) - rendered.image)[alike].mean() for shift in
                 ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))]  # fmt: skip
        assert aside[0] < 0.5 * min(aside[1:])


def test_a_mirror_shows_the_points_on_the_other_side_and_twice_mirrored_is_unchanged():
    pair = make_frame(2)
    mirror = mirrored(pair)
    for eye, other in OTHER_EYE.items():
        expected = pair.points(other)[:, ::-1].copy()
        expected[..., 0] = pair.camera.baseline_m - expected[..., 0]
        np.testing.assert_allclose(mirror.points(eye), expected, rtol=1e-5, atol=1e-5)
        for name in ("image", "visibility"):
            np.testing.assert_array_equal(mirror.view(eye)[name], pair.view(other)[name][:, ::-1], err_msg=name)
    for name in ("flow", "flow_backward", "normals", "correspondence"):
        finite = np.isfinite(pair.left[name]).all(-1)
        expected = pair.left[name].copy()
        expected[finite, 0] *= -1
        np.testing.assert_array_equal(mirror.right[name], expected[:, ::-1], err_msg=name)
    again = mirrored(mirror)
    assert again.camera == pair.camera
    for role, array in again.arrays().items():
        np.testing.assert_array_equal(array, pair.arrays()[role], err_msg=role)


@pytest.mark.parametrize("scales", [(3, 1), (1, 3)])
def test_the_ways_of_a_stretched_deviating_rig_are_those_of_its_camera(scales):
    pair = make_frame(1)
    pair = replace(pair, camera=replace(pair.camera, deviation=CameraDeviation(0.03, -0.02, 0.7, 1.02)))
    stretched = PairWarp(*map(float, scales)).applied(pair, (32 * scales[1], 48 * scales[0]))
    # With a stretch by 3, the middle of three columns or rows is exactly at an original one.
    middle = (slice(scales[1] // 2, None, scales[1]), slice(scales[0] // 2, None, scales[0]))
    for eye in EYES:
        np.testing.assert_allclose(
            stretched.correspondences(eye)[middle], pair.correspondences(eye) * scales, rtol=1e-6, atol=1e-5
        )


TEXTURES = {
    # Waves with steep slopes: with weak ones, rounding to whole levels would look like a shift.
    "long": lambda x, y: 128 + 60 * np.sin(0.4 * x + 0.2 * y) + 60 * np.sin(0.2 * x - 0.4 * y),
    "short": lambda x, y: 128 + 40 * np.sin(0.9 * x + 0.3 * y) + 40 * np.sin(0.5 * x - 1.1 * y) + 30 * np.sin(0.4 * y),
}


@given(st.sampled_from(list(TEXTURES)), st.integers(-16, 16), st.integers(-8, 8))
@example("long", 2, 0)
@settings(max_examples=20)
def test_no_part_of_a_moved_image_is_out_of_place(texture, eighths, hundredths):
    right_y_px, right_roll_rad = eighths / 8, hundredths / 100
    y, x = np.mgrid[:91, :93].astype(float)
    image = np.rint(TEXTURES[texture](x, y)).astype(np.uint8)
    view = ViewArrays({"image": np.stack([image, 255 - image, image], axis=-1)})
    camera = StereoCamera(93, 91, 80.0, 0.2, 40.0, 45.5, 44.25)
    moved = PairWarp(1, 1, right_y_px, right_roll_rad, 13).applied(Frame(camera, view, view), (65, 67))
    np.testing.assert_array_equal(moved.left.image, view.image[13:-13, 13:-13])
    cos, sin = np.cos(right_roll_rad), np.sin(right_roll_rad)
    across, along = x - 45.5, y - 44.25 - right_y_px
    expected = TEXTURES[texture](45.5 + cos * across + sin * along, 44.25 - sin * across + cos * along)
    slopes = np.stack(np.gradient(expected), axis=-1)[13:-13, 13:-13]
    errors = moved.right.image[..., ::2].mean(-1) - expected[13:-13, 13:-13]
    np.testing.assert_allclose(moved.right.image[..., 1], 255.0 - moved.right.image[..., 0], atol=1)
    for part in (np.s_[:32, :33], np.s_[33:, :33], np.s_[:32, 34:], np.s_[33:, 34:]):
        shift = np.linalg.lstsq(slopes[part].reshape(-1, 2), errors[part].ravel(), rcond=None)[0]
        assert np.abs(shift).max() < 0.01


@pytest.mark.parametrize("movement", [(1, 1, 0.4), (1.5, 1.5, -1.0, 0.02), (1.6, 0.9, 1.0, -0.03)])
def test_what_has_no_disparity_has_none_in_a_moved_pair(movement):
    pair = make_frame(2, {"disparity_change"})
    warp = PairWarp(*movement, margin=3)
    crop = pair.cropped(Crop(3, 2, *warp.source_size((16, 20))[::-1]))
    moved = warp.applied(crop, (16, 20))
    unmoved = replace(warp, right_y_px=0, right_roll_rad=0).applied(crop, (16, 20))
    np.testing.assert_array_equal(np.isfinite(moved.left.disparity), np.isfinite(unmoved.left.disparity))
    assert np.isinf(moved.left.disparity).any()
    for eye in EYES:
        ways, known = moved.correspondences(eye), np.isfinite(moved.view(eye).disparity)
        np.testing.assert_allclose(moved.view(eye).correspondence[known], ways[known], atol=2e-4)
        assert np.isinf(moved.view(eye).correspondence[~known]).all()


def test_what_a_change_cannot_do_is_refused():
    pair = make_frame(0)
    crooked = replace(pair, camera=replace(pair.camera, deviation=CameraDeviation(0.01)))
    for change, frame, message in (
        (mirrored, make_frame(0, truth="left"), "mirrored: expected truth of both views"),
        (mirrored, crooked, "mirrored: expected a rectified rig"),
        (
            lambda frame: PairWarp(1, 1, 1.0).applied(frame, (20, 30)),
            crooked,
            "right_roll_deg: expected a rectified rig",
        ),
        (lambda frame: PairWarp(1, 1, 1.0).applied(frame, (20, 30)), pair, "without the output disparity_change"),
    ):
        with pytest.raises(InputError, match=message):
            change(frame)


@pytest.mark.parametrize(
    "deviation", [CameraDeviation(), CameraDeviation(0.03, -0.01, 4), CameraDeviation(-0.04, 0.02, -3)]
)
def test_a_rectangle_hides_what_lies_behind_it(deviation):
    pair = make_frame(4)
    pair = replace(pair, camera=replace(pair.camera, deviation=deviation))
    # Pixels that are outside the whole right image stay outside, even if rounding puts them inside.
    pair.left.visibility[10, 20:40:2] = OUTSIDE
    hidden = occluded(pair, [Crop(10, 6, 12, 9)])
    inside = np.zeros((32, 48), bool)
    inside[6:15, 10:22] = True
    assert (hidden.right.image[inside] == np.rint(pair.right.image.mean((0, 1)))).all()
    for name, nothing in (("disparity", np.inf), ("visibility", OUTSIDE), ("instances", 0), ("depth", np.inf)):
        assert (hidden.right[name][inside] == nothing).all(), name
    for name in ("image", "disparity", "visibility", "instances", "depth"):
        np.testing.assert_array_equal(hidden.right[name][~inside], pair.right[name][~inside], err_msg=name)
    for name in pair.left.keys() - {"visibility"}:
        np.testing.assert_array_equal(hidden.left[name], pair.left[name], err_msg=name)
    # The other frames have the same rectangle, which hides points that move into it.
    ways = {"visibility": pair.correspondences("left")}
    ways |= {f"{name}_visibility": pair.right[name] for name in ("flow", "flow_backward")}
    for name, way in ways.items():
        eye, seen = ("left", True) if name == "visibility" else ("right", ~inside)
        before = pair.view(eye)[name]
        ends = np.mgrid[:32, :48][::-1] + np.moveaxis(np.nan_to_num(way, nan=1e6, posinf=1e6), 2, 0)
        column, row = np.rint(ends)
        behind = (column >= 10) & (column < 22) & (row >= 6) & (row < 15) & (before == VISIBLE)
        assert behind.any()
        expected = np.where(seen, np.where(behind, OCCLUDED, before), OUTSIDE)
        np.testing.assert_array_equal(hidden.view(eye)[name], expected, err_msg=name)
