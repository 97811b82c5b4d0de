"""The table of channels, views and frames."""

import pickle
from dataclasses import replace

import hand_made_pairs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import SQUARE, noise_layers, one_model, posed
from scipy.spatial.transform import Rotation

from semisynth_gl.codecs import Encodings
from semisynth_gl.codecs.codec import Codec
from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.frame.camera import EYES, CameraDeviation, Crop, StereoCamera
from semisynth_gl.frame.channels import CHANNELS, OUTSIDE, ROLES, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.layouts.roles import FILE_ROLES

CAMERA = StereoCamera.centred(5, 4, 6.0, 0.1)


def make_array(name, seed=0):
    channel = CHANNELS[name]
    shape = (4, 5) if channel.components == 1 else (4, 5, channel.components)
    return np.random.default_rng(seed).integers(0, 200, shape).astype(channel.dtype)


def make_view(names=tuple(CHANNELS), seed=0):
    return ViewArrays({name: make_array(name, seed) for name in names})


# The table


@pytest.mark.parametrize("channel", CHANNELS.values(), ids=lambda channel: channel.name)
def test_a_row_of_the_table_fits_the_others(channel):
    codec = Encodings().codec(channel)
    assert isinstance(codec, Codec)
    array = make_array(channel.name)
    decoded = codec.decode(codec.encode(array), channel.name)
    assert decoded.dtype == channel.dtype
    np.testing.assert_array_equal(decoded, array)
    nothing = np.full_like(array, channel.fill)
    np.testing.assert_array_equal(codec.decode(codec.encode(nothing), channel.name), nothing)
    assert (channel.output is None) == (channel.name in ("image", "disparity"))
    if channel.mask is not None:
        mask = CHANNELS[channel.mask]
        assert (mask.dtype, mask.components, mask.fill) == (np.uint8, 1, 0)
        assert (mask.mask, mask.output) == (None, channel.output or mask.name)
        # A pixel without a value has no point that another image could show.
        assert np.isinf(channel.fill)


def test_roles_are_unique_and_files_have_the_same():
    assert len(ROLES) == len(EYES) * len(CHANNELS)
    assert [role for role, (_, channel) in ROLES.items() if channel is ViewArrays.image] == list(EYES)
    assert {role: FILE_ROLES[role].output for role in ROLES} == {role: each.output for role, (_, each) in ROLES.items()}


# Views


def test_a_view_has_its_channels_under_their_names():
    view = make_view(("image", "flow"))
    assert view.image is view["image"]
    assert list(view) == ["image", "flow"]
    assert view.get("depth") is None
    assert list(view.with_channels({"depth": make_array("depth")})) == ["image", "flow", "depth"]
    with pytest.raises(AttributeError, match=r"no normals: the output normals of this view was not made"):
        view.normals  # noqa: B018 - the access raises
    with pytest.raises(AttributeError, match="no disparity: truth of this view was not made"):
        view.disparity  # noqa: B018 - the access raises


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("albedo", np.zeros((4, 5), np.float32), "expected channels of image, disparity, .*, got albedo"),
        ("image", np.zeros((4, 5, 3), np.uint16), r"must be \(H, W, 3\) or \(H, W\) uint8, got \(4, 5, 3\) uint16"),
        ("disparity", np.zeros((4, 5)), r"disparity must be \(H, W\) float32, got \(4, 5\) float64"),
        ("disparity", np.zeros((), np.float32), r"got \(\) float32"),
        ("flow", np.zeros((4, 5, 3), np.float32), r"flow must be \(H, W, 2\) float32, got \(4, 5, 3\)"),
    ],
)
def test_a_view_refuses_what_is_not_in_the_table(name, array, words):
    with pytest.raises(InputError, match=words):
        ViewArrays({name: array})
    with pytest.raises(InputError, match=words):
        make_view(("image", "disparity")).with_channels({name: array})


def test_a_view_and_a_frame_are_pickled_for_other_processes():
    frame = Frame(CAMERA, make_view(), make_view(("image", "disparity"), seed=1))
    stored = StoredFrame(CAMERA, frame.left, frame.right, name="lab-000003", index=3, provenance={"pair": 3})
    for original in (frame, stored):
        came = pickle.loads(pickle.dumps(original))  # noqa: S301 - the test's own bytes
        assert type(came) is type(original)
        assert came.camera == CAMERA
        assert list(came.arrays()) == list(original.arrays())
        for role, array in original.arrays().items():
            np.testing.assert_array_equal(came.arrays()[role], array)
    assert (came.name, came.index, came.provenance) == ("lab-000003", 3, {"pair": 3})
    assert came.encodings.disparity.suffix == ".pfm"


# Points


def test_points_lie_on_the_surface_that_was_drawn(open_renderer):
    camera = StereoCamera(64, 48, 50.0, 0.2, 30.0, 33.5, 22.0)
    turn = Rotation.from_euler("xyz", [35, -25, 10], degrees=True).as_matrix()
    corner = (0.1, -0.05, 2.0) - turn @ (1, 1, 0)
    renderer = open_renderer([SQUARE], noise_layers(1, 16), outputs=["depth", "normals"])
    frame = renderer.render(one_model(camera, [posed(2 * turn, corner)]))
    for eye in EYES:
        view, points = frame.view(eye), frame.points(eye)
        assert (points.shape, points.dtype) == ((48, 64, 3), np.float32)
        seen = np.isfinite(view.disparity)
        assert 500 < seen.sum() < seen.size
        assert np.isnan(points[~seen]).all()
        np.testing.assert_allclose(points[..., 2][seen], view.depth[seen], rtol=1e-5)
        # In the square's frame, the points are on its plane and inside it.
        local = (points[seen] - corner) @ turn
        assert np.abs(local[:, 2]).max() < 2e-5
        assert np.abs(local[:, :2] - 1).max() < 1 + 2e-5
        # The normal is perpendicular to the vectors to neighbouring points.
        step = np.cross(points[20, 31] - points[20, 30], points[21, 30] - points[20, 30])
        np.testing.assert_allclose(-step / np.linalg.norm(step), view.normals[20, 30], atol=1e-3)
        # The points project to the centres of their pixels.
        x_px = camera.intrinsics_px(eye)[0] + camera.focal_px * (points[..., 0] - camera.offset_m(eye)) / points[..., 2]
        np.testing.assert_allclose(x_px[seen], np.mgrid[:48, :64][1][seen], atol=1e-3)


@pytest.mark.filterwarnings("error")
def test_what_has_no_disparity_has_no_point():
    camera = StereoCamera.centred(5, 4, 6.0, 0.1, doffs_px=2.0)
    disparity = np.full((4, 5), 3, np.float32)
    disparity[0] = np.inf, np.nan, -2, -3, -np.inf
    view = ViewArrays({"image": make_array("image"), "disparity": disparity})
    frame = Frame(camera, view, ViewArrays({"image": make_array("image")}))
    points = frame.points()
    assert np.isnan(points[0]).all()
    np.testing.assert_allclose(points[1:, :, 2], 6.0 * 0.1 / (3 + 2), rtol=1e-6)
    for eye, said in (("right", "no disparity"), ("middle", "left, right, got 'middle'"), (0, "got 0")):
        with pytest.raises(AttributeError if eye == "right" else InputError, match=said):
            frame.points(eye)
    still = StereoCamera.centred(5, 4, 6.0, 0.0)
    disparity[1:3] = [[0], [-0.0]]
    assert np.isnan(Frame(still, view, view).points("right")).all()


@given(st.integers(0, 6), st.integers(0, 20), st.integers(0, 12), st.booleans())
def test_masks_of_a_crop_are_0_where_its_points_lie_outside_of_it(index, x_px, y_px, deviates):
    pair = hand_made_pairs.make_frame(index)
    if deviates:
        pair = replace(pair, camera=replace(pair.camera, deviation=CameraDeviation(0.04, -0.02, 0.7)))
    crop = pair.cropped(Crop(x_px, y_px, 28, 20))
    masked = crop.with_own_masks()
    rows, columns = np.mgrid[:20, :28]
    for eye in ("left", "right"):
        view = crop.view(eye)
        ways = {"flow_visibility": view.flow, "flow_backward_visibility": view.flow_backward}
        ways["visibility"] = pair.correspondences(eye)[y_px : y_px + 20, x_px : x_px + 28]
        for name, array in masked.view(eye).items():
            expected = view[name]
            if name in ways:
                column, row = np.rint(columns + ways[name][..., 0]), np.rint(rows + ways[name][..., 1])
                expected = np.where((column >= 0) & (column < 28) & (row >= 0) & (row < 20), expected, OUTSIDE)
            np.testing.assert_array_equal(array, expected, err_msg=name)
