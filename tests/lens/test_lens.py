"""Raw cameras and rectification compared with OpenCV and with rays; borders; pairs with a lens."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image
from planted_faults import change_file, checks
from tiny_datasets import EYE, LENS, cheap, verified, with_lens

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import GREY8
from semisynth_gl.config import load_config
from semisynth_gl.dataset.generate import generate
from semisynth_gl.frame.camera import EYES, OTHER_EYE, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, VISIBLE
from semisynth_gl.frame.raw_camera import RawCamera, rotation_of
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.lens.rectification import EyeRectification
from semisynth_gl.pairs.pipeline import PairRenderer, render_pair

CAMERA = StereoCamera(160, 120, 150.0, 0.1, 78.0, 84.0, 58.5)
TURN = rotation_of((0.02, -0.03, 0.01))
LENSES = {
    "four": ("radial-tangential", (-0.25, 0.08, 0.001, -0.002)),
    "five": ("radial-tangential", (-0.3, 0.12, 0.0, 0.001, -0.02)),
    "eight": ("radial-tangential", (0.5, -0.1, 0.001, 0.0, 0.01, 0.8, -0.05, 0.02)),
    "twelve": ("radial-tangential", (0.1, -0.05, 0.0, 0.0, 0.01, 0.2, -0.1, 0.0, 0.002, -0.001, 0.001, 0.003)),
    "fisheye": ("fisheye", (-0.03, 0.01, -0.005, 0.001)),
}


def raw_camera(name, focal_px=150.0, size=(200, 150)):
    model, distortion = LENSES[name]
    centre = (size[0] - 1) / 2 + 1.3, (size[1] - 1) / 2 - 0.8
    return RawCamera(*size, focal_px, focal_px * 1.02, *centre, model, distortion, TURN)


@pytest.mark.parametrize("name", LENSES)
def test_the_formulas_are_opencvs(name):
    raw = raw_camera(name)
    rng = np.random.default_rng(0)
    points = np.c_[rng.uniform(-0.5, 0.5, (50, 2)), np.ones(50)] * rng.uniform(1, 5, (50, 1))
    vector, _ = cv2.Rodrigues(np.array(raw.rotation).T)
    lens = vector, np.zeros(3), raw.matrix, np.array(raw.distortion)
    if name == "fisheye":
        expected, _ = cv2.fisheye.projectPoints(points[:, None], *lens)
    else:
        expected, _ = cv2.projectPoints(points, *lens)
    pinhole = CAMERA.matrix("left")
    seen = points @ pinhole.T
    x, y = raw.to_raw(pinhole, seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2])
    np.testing.assert_allclose(np.c_[x, y], expected.reshape(-1, 2), atol=1e-8)
    np.testing.assert_allclose(np.c_[raw.to_rectified(pinhole, x, y)], (seen / seen[:, 2:])[:, :2], atol=1e-5)


@pytest.mark.parametrize("shape", [(120, 160, 3), (120, 160)])
def test_a_lens_that_does_nothing_leaves_each_bit(shape):
    image = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    for eye in EYES:
        raw = RawCamera(160, 120, 150, 150, *CAMERA.intrinsics_px(eye)[:2], "radial-tangential", (0.0,) * 4)
        lens = EyeRectification(raw, CAMERA, eye, "black")
        assert lens.density == 1
        assert lens.valid.all()
        np.testing.assert_array_equal(lens.raw_image(image, 1), image)
        np.testing.assert_array_equal(lens.rectify(image), image)


@pytest.mark.parametrize(("fy_over_fx", "density"), [(1.0, 1), (1.1, 1), (1.1, 1.5)])
@pytest.mark.parametrize("name", LENSES)
def test_the_raw_image_is_what_its_rays_meet(name, fy_over_fx, density):
    raw = raw_camera(name)
    lens = EyeRectification(raw, replace(CAMERA, fy_over_fx=fy_over_fx), "left", "black")

    def colours(x, y):
        return 120 + 60 * np.sin(x / 9) + 50 * np.cos(y / 7 + x / 30)

    y, x = (np.mgrid[: 120 * density, : 160 * density] + 0.5) / density - 0.5
    found = lens.raw_image(np.rint(colours(x, y)).astype(np.uint8), density)
    at = raw.to_rectified(lens.pinhole, *np.mgrid[:150, :200].astype(float)[::-1])
    # Beyond the outermost pixel centres, the image repeats its border.
    expected = colours(at[0].clip(x.min(), x.max()), at[1].clip(y.min(), y.max()))
    inside = (np.abs(at[0] - 79.5) < 80) & (np.abs(at[1] - 59.5) < 60)
    error = (found - expected)[inside]
    assert error.size > 10_000
    assert np.abs(error).max() < 1.2
    # The limit allows for rounding both images to whole levels; a shift by 0.04 px exceeds it.
    assert np.sqrt((error**2).mean()) < 0.38


@pytest.mark.parametrize(("border", "level"), [("black", 0), ("replicate", 200)])
def test_a_border_is_where_no_ray_ends_on_the_sensor(border, level):
    raw = raw_camera("four", focal_px=190.0, size=(160, 120))
    lens = EyeRectification(raw, CAMERA, "right", border)
    x, y = raw.to_raw(lens.pinhole, *np.meshgrid(np.arange(160.0), np.arange(120.0)))
    within = np.minimum(np.minimum(x, 159 - x), np.minimum(y, 119 - y)) >= -1e-3  # OpenCV's maps are float32
    assert 0.02 < 1 - within.mean() < 0.6
    np.testing.assert_array_equal(lens.valid, within)
    image = lens.rectify(np.full((120, 160, 3), 200, np.uint8))
    assert (image[within] == 200).all()
    far = (x < -1) | (x > 160) | (y < -1) | (y > 120)
    assert (image[far] == level).all()


def test_as_much_is_drawn_as_the_sensor_resolves():
    raw = raw_camera("four", focal_px=300.0, size=(400, 300))
    assert EyeRectification(raw, CAMERA, "left", "black").density == pytest.approx(300 * 1.02 / 150, rel=0.02)


def test_a_lens_that_folds_the_view_is_refused():
    raw = replace(raw_camera("four"), distortion=(-1.5, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="bends two directions to one pixel"):
        EyeRectification(raw, CAMERA, "left", "black")


def ends_invalid(valid, flow):
    """Mark the pixels whose flow ends at an invalid pixel (the nearest one)."""
    height, width = valid.shape
    lost = np.zeros_like(valid)
    for row, column in np.argwhere(np.isfinite(flow).all(axis=2)):
        x, y = round(column + float(flow[row, column, 0])), round(row + float(flow[row, column, 1]))
        lost[row, column] = 0 <= x < width and 0 <= y < height and not valid[y, x]
    return lost


# The camera moves so that points enter and leave the borders.
MOVING = {"sequence": {"length": 2}, "camera": {"sway_m": 0.1, "sway_deg": 6}}
FLOWS = ["visibility", "valid", "flow", "flow_backward", "disparity_change"]


@pytest.mark.parametrize("rig", [{}, {"rig": {"right_roll_deg": 1, "right_y_px": 3}}], ids=str)
def test_truth_is_that_without_a_lens_and_masks_leave_out_what_the_sensor_did_not_see(rig):
    outputs = [name for name in FLOWS if name != "disparity_change" or not rig]
    plain = render_pair(cheap(outputs=[name for name in outputs if name != "valid"], **MOVING, **rig), 0)
    # The left eye is turned so far that each eye sees points in the other's border.
    lens = {"left": EYE | {"rotation_deg": [0.2, -4, 0.3]}}
    seen = render_pair(with_lens(outputs=outputs, lens=lens, **MOVING, **rig), 0)
    valid = {eye: seen.view(eye).valid == VISIBLE for eye in EYES}
    for eye in EYES:
        assert (plain.view(eye).image != seen.view(eye).image).mean() > 0.3
        for name in {"disparity", *outputs} - {"visibility", "valid"}:
            np.testing.assert_array_equal(plain.view(eye)[name], seen.view(eye)[name])
        flows = ("flow", "flow_backward")
        lost = {f"{name}_visibility": ends_invalid(valid[eye], plain.view(eye)[name]) for name in flows}
        lost["visibility"] = ends_invalid(valid[OTHER_EYE[eye]], seen.correspondences(eye))
        assert all((beyond & valid[eye]).any() for beyond in lost.values())
        for name, beyond in lost.items():
            mask = plain.view(eye)[name]
            expected = np.where(~valid[eye] | beyond, np.minimum(mask, OCCLUDED), mask)
            np.testing.assert_array_equal(seen.view(eye)[name], expected)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lens": {**LENS, "left": EYE | {"distortion": [0, 0, 0]}}}, "radial-tangential has 4 or 5 or 8 or 12"),
        ({"lens": LENS | {"border": "crop"}}, "'black' or 'replicate'"),
        ({"lens": LENS, "outputs": ["visibility"]}, "visibility marks points as hidden .* add valid to outputs"),
        ({"lens": LENS, "outputs": ["flow"]}, "flow marks points as hidden .* add valid to outputs"),
        ({"lens": LENS, "outputs": ["flow_backward"]}, "flow_backward marks points as hidden .* add valid to outputs"),
        (
            {"lens": LENS | {"border_disparity": False}, "outputs": ["valid", "disparity_change"]},
            "missing where flow leads into a border: add flow to outputs",
        ),
        ({"lens": LENS | {"border_disparity": False}, "outputs": ["depth"]}, "disparity has no .* add valid to"),
        *(({"outputs": [name]}, f"the output {name} needs the section lens") for name in ("valid", "raw", "raw_map")),
    ],
)
def test_a_lens_that_cannot_be_is_refused(changes, message):
    with pytest.raises(Exception, match=message):
        cheap(**changes)


def test_a_scaled_config_has_the_scaled_lens(tmp_path):
    (tmp_path / "whole.yaml").write_text(json.dumps({"extends": "middlebury", "outputs": ["valid"], "lens": LENS}))
    lens = load_config(tmp_path / "whole.yaml", ["scale=0.5"]).lens
    assert (lens.raw_width_px, lens.raw_height_px, lens.left.fx_px.low) == (32, 24, 70)
    assert lens.left.distortion[0].low == -0.3


def test_verify_finds_masks_and_changes_that_ignore_the_lens(tmp_path):
    generate(without_borders(outputs=FLOWS, **MOVING), tmp_path / "d", 2, layout="middlebury")
    assert not verified(tmp_path / "d", 200).findings
    (scene,) = (path.parent for path in (tmp_path / "d").rglob("flow_mask0.png") if path.parent.name.endswith("0"))
    plain = render_pair(cheap(outputs=[name for name in FLOWS if name != "valid"], **MOVING), 0).left
    valid, seen = (np.asarray(Image.open(scene / name)) == VISIBLE for name in ("valid0.png", "flow_mask0.png"))
    known = np.isfinite(PFM.read(scene / "disparity_change0.pfm"))
    lost = valid & ends_invalid(valid, plain.flow)
    ignored = (plain.flow_visibility == VISIBLE) & ~seen
    for name, where, wrong in (
        ("flow_mask0.png", first(ignored & ~valid), VISIBLE),
        ("flow_mask0.png", first(ignored & valid), VISIBLE),
        ("flow_backward_mask0.png", plain.flow_backward_visibility == VISIBLE, VISIBLE),
        ("disparity_change0.pfm", first(lost), 0.25),
        ("disparity_change0.pfm", first(valid & ~lost & seen & known), np.inf),
    ):
        right = (scene / name).read_bytes()
        change_file(scene / name, lambda found, at=where, by=wrong: np.where(at, by, found).astype(found.dtype))
        assert checks(tmp_path / "d") == {name.partition("0")[0].replace("mask", "visibility")}, name
        (scene / name).write_bytes(right)


def first(where):
    """Keep only the first of the marked pixels."""
    return where & (np.cumsum(where).reshape(where.shape) == 1)


def without_borders(**changes):
    return with_lens(lens={"border_disparity": False}, **changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"camera": {"doffs_px": 4}, "disparity": {"signed": True}, "background": {"cuboid": 0, "plane": 1, "sky": 1}},
        {"rig": {"right_roll_deg": 0.5, "right_y_px": 1}},
        MOVING,
    ],
    ids=str,
)
def test_borders_may_have_no_disparity(tmp_path, changes):
    outputs = ["visibility", "valid", "depth", "normals", "instances", "sky", "correspondence"]
    if "sequence" in changes:
        outputs += ["flow", "disparity_change", "flow_backward"]
    kept, out = (make(outputs=outputs, **changes) for make in (with_lens, without_borders))
    of_disparity = {"disparity", "correspondence", "disparity_change", "visibility"}
    with PairRenderer(kept, 0) as one, PairRenderer(out, 0) as other:
        for number in range(2):
            before, after = (renderer.render(number).frame for renderer in (one, other))
            for eye in EYES:
                for name, array in after.view(eye).items():
                    expected = before.view(eye)[name].copy()
                    if name in of_disparity:
                        border = after.view(eye).valid != VISIBLE
                        assert 0 < border.mean() < 0.9
                        if name == "disparity_change":
                            border |= ends_invalid(~border, after.view(eye).flow)
                        expected[border] = 0 if name == "visibility" else np.inf
                    np.testing.assert_array_equal(array, expected, err_msg=name)
    generate(out, tmp_path / "d", 2, layout="middlebury")
    assert not verified(tmp_path / "d", 200).findings
    path = next((tmp_path / "d").rglob("disp0GT.pfm"))
    disparity = PFM.read(path).copy()
    disparity[np.isinf(disparity)] = 5
    path.write_bytes(PFM.encode(disparity))
    assert "disparity_left is known in a border" in str(verified(tmp_path / "d").findings)


def test_verify_finds_a_wrong_border(tmp_path):
    generate(with_lens(), tmp_path / "d", 2, layout="middlebury")
    path = next(tmp_path.rglob("valid0.png"))
    right, disparity = np.asarray(Image.open(path)), path.with_name("disp0GT.pfm")
    # By default, disparity must be finite in the borders too.
    change_file(disparity, lambda known: np.where(right == 0, np.inf, known))
    assert {"disparity", "depth"} <= checks(tmp_path / "d")
    for wrong in (255 - right, *(np.full_like(right, level) for level in (0, 128, 255))):
        path.write_bytes(GREY8.encode(wrong))
        assert "valid" in checks(tmp_path / "d")
    path.write_bytes(GREY8.encode(right))
    mask = path.with_name("mask0nocc.png")
    mask.write_bytes(GREY8.encode(np.asarray(render_pair(cheap(), 0).left.visibility)))
    assert "visibility" in checks(tmp_path / "d")
