"""What pairs of photographs say to `calibrate`: how far they are off rectified, grey cameras, signed disparities."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from config_texts import parse_config
from PIL import Image
from shared_material import SHARED, needs_shared
from skimage.data import stereo_motorcycle

from semisynth_gl.calibration import rectification
from semisynth_gl.calibration.arrays import DisparityBounds, Size
from semisynth_gl.calibration.disparity_range import chosen_range, disparity_range, read_values
from semisynth_gl.calibration.draft import describe
from semisynth_gl.calibration.matching import given_pairs, match_images, match_pair, open_matcher, pairs_among
from semisynth_gl.calibration.photographs import are_grey
from semisynth_gl.calibration.rectification import measure_rectification
from semisynth_gl.calibration.rig import Rig, plain_rig
from semisynth_gl.calibration.vertical import MATCHING_PX, Matches, deviation_ranges, fit_deviation
from semisynth_gl.calibration.write import write
from semisynth_gl.cli.calibrate import calibrate
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.config import Range
from semisynth_gl.frame.camera import Deviation, StereoCamera
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures.atlas import to_grey

REAL = SHARED / "real"
CAMERA = StereoCamera(741, 500, 994.978, 0.193001, 311.193, 342.279, 254.877)
WIDE = StereoCamera.centred(741, 500, 400.0, 0.2)


def right_from_rectified(roll_deg, pitch_deg):
    """Right-handed rotations: first about z, then about x."""
    (s, q), (c, p) = np.sin(np.deg2rad((roll_deg, pitch_deg))), np.cos(np.deg2rad((roll_deg, pitch_deg)))
    return np.array([[1, 0, 0], [0, p, -q], [0, q, p]]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def project(points, camera, y_px=0.0, roll_deg=0.0, ratio=1.0, pitch_deg=0.0):
    """Where a right camera that deviates sees points (N, 3) of the left one's frame."""
    seen = (points - [camera.baseline_m, 0, 0]) @ right_from_rectified(roll_deg, pitch_deg).T
    focal = camera.focal_px * ratio, camera.focal_y_px * ratio
    x, y = (focal[axis] * seen[:, axis] / seen[:, 2] for axis in (0, 1))
    return np.stack([x + camera.cx_right_px, y + camera.cy_px + y_px], axis=1)


def correspondences(camera, *deviation, count=500, seed=0):
    """Exact matches of points at all depths."""
    rng = np.random.default_rng(seed)
    left = rng.uniform(0, (camera.width_px - 1, camera.height_px - 1), (count, 2))
    depth = 1 / rng.uniform(1 / 60, 1 / 1.5, count)
    centre = [camera.cx_left_px, camera.cy_px]
    focal = camera.focal_px, camera.focal_y_px
    points = np.c_[(left - centre) / focal, np.ones(count)] * depth[:, None]
    return Matches(left, project(points, camera, *deviation))


def needs_opencv():
    pytest.importorskip("cv2", reason="OpenCV, the extra opencv, is not installed")


@pytest.mark.parametrize("camera", [CAMERA, WIDE, replace(CAMERA, fy_over_fx=1.1)])
@pytest.mark.parametrize(
    "deviation",
    [
        (0.0, 0.0, 1.0, 0.0),
        (2.5, 0.0, 1.0, 0.0),
        (0.0, 1.5, 1.0, 0.0),
        (0.0, 0.0, 1.02, 0.0),
        (0.0, 0.0, 1.0, 0.7),
        (-4.0, -2.0, 0.97, -1.5),
        (10.0, 4.0, 1.05, 3.0),
    ],
)
def test_the_fit_is_exact_where_matches_are(camera, deviation):
    found = fit_deviation(correspondences(camera, *deviation), camera, pitch=True)
    np.testing.assert_allclose(found.numbers(), deviation, atol=1e-6)
    assert found.share == 1
    if deviation[3] == 0:
        found = fit_deviation(correspondences(camera, *deviation), camera, pitch=False)
        np.testing.assert_allclose(found.numbers(), deviation, atol=1e-6)


def test_signs_are_those_of_the_section_rig():
    """A roll turns what is seen clockwise, a pitch moves it up, y and a longer focal length move what is low down."""
    rotation = Deviation(np.deg2rad(1.2), np.deg2rad(-0.7)).rotation
    np.testing.assert_allclose(rotation, right_from_rectified(1.2, -0.7), atol=1e-15)
    right_of_centre, middle = np.array([[2.0, 0.0, 4.0]]), np.array([[0.2, 0.0, 4.0]])
    assert project(right_of_centre, CAMERA, roll_deg=1)[0, 1] > CAMERA.cy_px + 1
    assert project(middle, CAMERA, pitch_deg=1)[0, 1] < CAMERA.cy_px - 1
    assert project(middle, CAMERA, y_px=1)[0, 1] == CAMERA.cy_px + 1
    low = np.array([[0.2, 1.0, 4.0]])
    assert project(low, CAMERA, ratio=1.01)[0, 1] > project(low, CAMERA)[0, 1] + 1


def test_wrong_matches_and_noise_hardly_count():
    deviation = (3.0, 0.8, 1.01, 0.0)
    matches, rng = correspondences(CAMERA, *deviation, count=800), np.random.default_rng(1)
    matches.right[:] += rng.normal(0, 0.3, matches.right.shape)
    wrong = rng.random(800) < 0.25
    matches.right[wrong, 1] = rng.uniform(0, 500, wrong.sum())
    found = fit_deviation(matches, CAMERA, pitch=False)
    assert (np.abs(np.subtract(found.numbers(), deviation)) < [0.1, 0.01, 4e-4, 1e-9]).all()
    assert 0.7 < found.share < 0.8
    assert 0.25 < found.residual_px < 0.35


def test_ranges_are_the_spread_over_pairs():
    drawn = [(1.0, 0.5, 1.0, 0.0), (1.6, 0.9, 1.0, 0.0), (1.3, 0.7, 1.0, 0.0)]
    pairs = [(correspondences(CAMERA, *each, seed=seed), CAMERA) for seed, each in enumerate(drawn)]
    ranges, deviations = deviation_ranges(pairs, 741)
    assert list(ranges) == ["right_y_px", "right_roll_deg"]
    assert ranges["right_y_px"] == pytest.approx((1.0, 1.6))
    assert ranges["right_roll_deg"] == pytest.approx((0.5, 0.9))
    assert len(deviations) == 3
    # Of images twice as wide.
    assert deviation_ranges(pairs, 1482)[0]["right_y_px"] == pytest.approx((2.0, 3.2))
    assert deviation_ranges([], 741) == ({}, ())


@pytest.mark.parametrize("part", [0.8, 1.25])
@pytest.mark.parametrize("key", [0, 1, 2, 3])
def test_what_moves_rows_by_less_than_matching_can_tell_is_left_out(key, part):
    limit = part * MATCHING_PX
    most = (
        limit,
        np.rad2deg(limit / ((WIDE.width_px - 1) / 2)),
        1 + limit / ((WIDE.height_px - 1) / 2),
        np.rad2deg(limit * WIDE.focal_px / ((WIDE.height_px - 1) / 2) ** 2),
    )
    deviation = [0.0, 0.0, 1.0, 0.0]
    deviation[key] = most[key]
    ranges, (found,) = deviation_ranges([(correspondences(WIDE, *deviation), WIDE)], 741)
    name = ("right_y_px", "right_roll_deg", "focal_ratio", "right_pitch_deg")[key]
    if part > 1:
        assert ranges == {name: pytest.approx((most[key], most[key]))}
    elif key == 3:
        # What is no pitch for certain is told as a shift.
        assert list(ranges) == ["right_y_px"]
        assert found.y_px < -MATCHING_PX
    else:
        assert ranges == {}


def warped(image, camera, y_px, roll_deg, ratio, pitch_deg):
    """A rectified right photograph as a right camera that deviates sees it."""
    import cv2

    rectified = np.array([[camera.focal_px, 0, camera.cx_right_px], [0, camera.focal_px, camera.cy_px], [0, 0, 1]])
    own = np.diag([ratio, ratio, 1]) @ np.diag([camera.focal_px, camera.focal_px, 1])
    own[:2, 2] = camera.cx_right_px, camera.cy_px + y_px
    homography = own @ right_from_rectified(roll_deg, pitch_deg) @ np.linalg.inv(rectified)
    return cv2.warpPerspective(image, homography, image.shape[1::-1], flags=cv2.INTER_CUBIC)


@pytest.fixture(scope="module")
def photographs():
    left, right, _ = stereo_motorcycle()
    return to_grey(left), to_grey(right)


@pytest.mark.parametrize("deviation", [(-1.5, 0.6, 1.012, 0.0), (0.0, 0.0, 1.0, 2.0)])
def test_warped_photographs_give_the_deviation(photographs, deviation):
    needs_opencv()
    left, right = photographs
    matches = match_images(left, warped(right, CAMERA, *deviation))
    ranges, (found,) = deviation_ranges([(matches, CAMERA)], 741)
    expected = dict(zip(("right_y_px", "right_roll_deg", "focal_ratio", "right_pitch_deg"), deviation, strict=True))
    if not deviation[3]:
        assert found.numbers() == pytest.approx(deviation, abs=0.15)
        assert found.numbers()[1:3] == pytest.approx(deviation[1:3], abs=0.02)
        assert found.focal_ratio == pytest.approx(deviation[2], abs=6e-4)
        assert set(ranges) == {key for key, value in expected.items() if value not in (0.0, 1.0)}
    else:
        # A shift and a pitch are told apart by a bend of 2 px.
        assert ranges["right_pitch_deg"][0] == pytest.approx(2.0, abs=0.25)


@needs_shared
@pytest.mark.parametrize("scene", ["Cones", "Wood2"])
def test_rectified_photographs_are_as_good_as_matching_can_tell(scene):
    needs_opencv()
    matches, (width, height) = match_pair(REAL / scene / "im0.png", REAL / scene / "im1.png")
    camera = StereoCamera.centred(width, height, 1.35 * width, 0.16)
    ranges, (found,) = deviation_ranges([(matches, camera)], width)
    assert ranges == {}
    assert found.residual_px < 0.2


def save(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(path)
    return path


def test_pairs_are_told_by_name(tmp_path):
    names = ["a/im0.png", "a/im1.png", "b/im0.png", "image_2/0.png", "image_3/0.png", "image_2/1.png", "x/im1.png"]
    files = [save(tmp_path / name, np.zeros((4, 5), np.uint8)) for name in names]
    assert pairs_among(files) == [(files[0], files[1]), (files[3], files[4])]
    assert given_pairs(str(tmp_path / "a/im0*"), str(tmp_path / "x")) == [(files[0], files[6])]
    with pytest.raises(InputError, match="2 left images and 1 right image"):
        given_pairs(str(tmp_path / "image_2"), str(tmp_path / "image_3"))
    with pytest.raises(InputError, match="is on both sides"):
        given_pairs(str(tmp_path / "a"), str(tmp_path / "a"))


def test_without_opencv_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(InputError, match=r"needs OpenCV.*'semisynth-gl\[opencv\]'"):
        open_matcher()


def facts(tmp_path, **options):
    rig = Rig(CAMERA, "calib.txt", DisparityBounds(70, 7.0, 60.0))
    save(tmp_path / "photos/im0.png", stereo_motorcycle()[0])
    return describe("lab", [rig], [str(tmp_path / "photos")], disparity_range([rig], range_px=(7, 60)), **options)


A_PAIR = [(Path("a"), Path("b"))]


@pytest.fixture
def measured(monkeypatch):
    """Measure a pair of 741 x 500 px whose matches are told, by the rig of a camera."""

    def measure(matches, rig):
        monkeypatch.setattr(rectification, "match_pair", lambda *_: (matches, (741, 500)))
        return measure_rectification(A_PAIR, [rig])

    return measure


def test_a_config_gets_the_section_rig(tmp_path, monkeypatch):
    matches = iter(correspondences(CAMERA, y_px, 0.5, 1.0, 0.0) for y_px in (1.0, 2.0))
    monkeypatch.setattr(rectification, "match_pair", lambda *_: (next(matches), (741, 500)))
    found = measure_rectification(A_PAIR * 2, [Rig(CAMERA, "calib.txt")])
    gathered = facts(tmp_path, rectification=found)
    text = write(gathered)
    assert "right_y_px: [1, 2]\n  right_roll_deg: 0.5\n" in text
    assert text.index("camera:") < text.index("\nrig:\n") < text.index("\ndisparity:")
    assert "focal_ratio" not in text
    assert "points that both views of 2 of 2 pairs show" in text
    assert "2 of 2 pairs matched: right_y_px" in gathered.rectification.summary()
    rig = parse_config(text).rig
    assert (rig.right_y_px, rig.right_roll_deg, rig.focal_ratio) == (Range(1, 2), Range(0.5, 0.5), Range(1, 1))


def test_pairs_of_another_resolution_count_and_of_another_shape_do_not(measured):
    matches = correspondences(CAMERA, 2.0, 0.0, 1.0, 0.0)
    large = Rig(CAMERA, "calib.txt").scaled(2)
    assert measured(matches, large).ranges == {"right_y_px": pytest.approx((4.0, 4.0))}
    with pytest.raises(InputError, match="741 x 500 pixels, but the images of the calibration have 640 x 480"):
        measured(matches, plain_rig(700, 0.1, Size(640, 480)))
    summary = measured(Matches(matches.left[:20], matches.right[:20]), large).summary()
    assert "none of 1 pair has enough fitting matches (40, half of all)" in summary
    # Two photographs that are no pair have matches too.
    rng = np.random.default_rng(0)
    unrelated = Matches(*(rng.uniform(0, (740, 499), (400, 2)) for _ in range(2)))
    assert measured(unrelated, large).deviations == ()


def test_views_that_have_changed_places_are_refused(measured):
    for camera in (WIDE, replace(WIDE, cx_right_px=WIDE.cx_left_px - 20)):
        matches = correspondences(camera)
        with pytest.raises(InputError, match=r"pairs: a b: half of the points have disparities .* px or more below"):
            measured(Matches(matches.right, matches.left), Rig(camera, "calib.txt"))
    # What is infinitely far away, but for the errors of matching, is no such pair.
    far = Matches(matches.left, np.add(matches.left, [CAMERA.doffs_px + 2, 0]))
    assert measured(far, Rig(CAMERA, "calib.txt")).ranges == {}


@pytest.mark.parametrize(
    ("deviation", "large"),
    [((5.0, 0.5, 1.005, 0.0), False), ((9.0, 0.0, 1.0, 0.0), True), ((0.0, -2.0, 1.0, 0.0), True),
     ((0.0, 0.0, 0.97, 0.0), True), ((0.0, 0.0, 1.0, 0.0), False)],
)  # fmt: skip
def test_deviations_of_rigs_that_were_never_rectified_are_large(measured, deviation, large):
    assert measured(correspondences(CAMERA, *deviation), Rig(CAMERA, "calib.txt")).is_large(741) is large


def run(*words):
    return CliRunner().invoke(calibrate, [str(word) for word in words])


def test_the_command_matches_pairs_that_lie_beside_each_other(tmp_path, monkeypatch):
    needs_opencv()
    left, right, _ = stereo_motorcycle()
    save(tmp_path / "photos/im0.png", left[100:400, 100:500])
    save(tmp_path / "photos/im1.png", right[100:400, 100:500])
    rig = ("--focal-px", 994.978, "--baseline-m", 0.193, "--size", "400x300", "--range-px", 7, 60, "--trials", 0)
    given = ("--images", tmp_path / "photos", *rig, "--out", tmp_path / "a.yaml")
    done = run(*given)
    assert done.exit_code == 0, done.output
    assert "rectification    1 of 1 pair matched: rectified within the accuracy of matching, 0.2 px" in done.output
    assert "rig:" not in (tmp_path / "a.yaml").read_text()
    done = run(
        *given, "--overwrite", "--other-camera", "--pairs", tmp_path / "photos/im0.png", tmp_path / "photos/im1.png"
    )
    assert isinstance(done.exception, InputError)
    assert "--pairs: needs photographs of the rig" in str(done.exception)
    monkeypatch.setitem(sys.modules, "cv2", None)
    done = run(*given, "--overwrite")
    assert done.exit_code == 0
    assert "note: the deviation of rows in 1 pair was not measured" in done.output
    assert "rectification " not in done.output
    done = run(*given, "--overwrite", "--pairs", tmp_path / "photos/im0.png", tmp_path / "photos/im1.png")
    assert "semisynth-gl[opencv]" in str(done.exception)


def test_grey_photographs_make_grey_cameras(tmp_path):
    left = stereo_motorcycle()[0]
    grey = to_grey(left)
    one, three = save(tmp_path / "a/one.png", grey), save(tmp_path / "a/three.png", np.repeat(grey[..., None], 3, 2))
    coloured, broken = save(tmp_path / "b/rgb.png", left), tmp_path / "c.png"
    broken.write_bytes(b"no image")
    assert are_grey([one, three, broken])
    assert not are_grey([one, coloured])
    assert not are_grey([broken])
    gathered = facts(tmp_path)
    assert "colour:" not in write(gathered)
    text = write(replace(gathered, grey=True))
    assert parse_config(text).camera.colour == "grey"


@pytest.fixture
def map_of(tmp_path):
    def make(values, name="d.pfm"):
        path = tmp_path / name
        path.write_bytes(PFM.encode(np.asarray(values, np.float32)))
        return path

    return make


def test_maps_of_rigs_with_doffs_hold_disparities_below_zero(map_of):
    values = np.random.default_rng(0).uniform(-8, 30, (48, 64)).astype(np.float32)
    values[:4] = np.inf
    path = map_of(values)
    doffs, none = (Rig(StereoCamera.centred(64, 48, 80.0, 0.2, px), "calib.txt") for px in (12.0, 0.0))
    np.testing.assert_array_equal(np.isfinite(read_values(path, [doffs])), np.isfinite(values))
    np.testing.assert_array_equal(np.isfinite(read_values(path, [none])), np.isfinite(values) & (values > 0))
    found = disparity_range([doffs], [path])
    assert found.signed
    assert -12 < found.min_px <= -8
    assert found.target.cumulative(0.0) == pytest.approx(8 / 38, abs=0.02)
    assert not disparity_range([none], [path]).signed
    # What is beyond infinity is no disparity.
    assert (
        np.nanmin(
            read_values(path, [replace(doffs, camera=replace(doffs.camera, cx_right_px=doffs.camera.cx_left_px + 3))])
        )
        > -3
    )


@pytest.mark.parametrize("mark", [0.0, -1.0, -7.5])
def test_a_number_that_many_pixels_share_marks_what_has_no_disparity(map_of, mark):
    values = np.random.default_rng(0).uniform(5, 30, (48, 64)).astype(np.float32)
    values[:2, :20] = mark
    rig = Rig(StereoCamera.centred(64, 48, 80.0, 0.2, 12.0), "calib.txt")
    found = disparity_range([rig], [map_of(values)])
    assert not found.signed
    assert found.min_px == 5


def test_ranges_and_calibrations_may_begin_below_zero(tmp_path):
    assert not chosen_range(None, 60, 30.0).signed
    assert chosen_range(-20, 60, 30.0).signed
    with pytest.raises(InputError, match=r"begins at -30 px, but with doffs = 30 px"):
        chosen_range(-30, 60, 30.0)
    with pytest.raises(InputError, match="low < high, both above 0"):
        chosen_range(-20, 60, 0.0)
    for vmin_px, signed in ((-20.0, True), (0.0, False), (-40.0, False), (7.0, False)):
        rig = Rig(CAMERA, "calib.txt", DisparityBounds(70, vmin_px, 60.0))
        assert disparity_range([rig]).signed == signed
    save(tmp_path / "photos/im0.png", stereo_motorcycle()[0])
    rig = Rig(CAMERA, "calib.txt")
    for range_px, signed in (((7, 60), False), ((-20, 60), True), ((0, 60), True)):
        text = write(describe("lab", [rig], [str(tmp_path / "photos")], disparity_range([rig], range_px=range_px)))
        assert ("\ndisparity:\n  signed: true " in text) == signed
        assert f"\n  min_px: {range_px[0]}\n" in text
