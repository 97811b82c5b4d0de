"""Camera imperfections, motion blur, and checks that make the renderer try again."""

import io
import json
from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from scenes import assert_equal
from tiny_datasets import cheap, with_lens

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs import pipeline
from semisynth_gl.pairs.cameras import moments
from semisynth_gl.pairs.checks import faults
from semisynth_gl.pairs.imperfections import ImageImperfections, apply_imperfections, sample_imperfections
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.textures.crops import least_texture


def applied(picture, point=None, **values):
    return apply_imperfections(picture, ImageImperfections(**values), np.random.default_rng(1), point)


def plain(picture, sampled, rng):
    """Apply exposure, white balance, noise and gamma to the whole image at once by their formulas."""
    red, blue = sampled.white_balance if picture.ndim == 3 else (0, 0)
    gains = 2.0 ** (sampled.exposure_stops + np.array([red, 0, blue] if picture.ndim == 3 else [0]))
    values = (picture.reshape(*picture.shape[:2], -1) * gains.astype(np.float32)).astype(np.float32)
    if sampled.noise > 0:
        values += rng.standard_normal(values.shape, np.float32) * np.float32(sampled.noise)
    values = np.clip(values, 0, 255)
    if sampled.gamma != 1:
        values = 255 * (values / 255) ** np.float32(sampled.gamma)
    return np.rint(values).astype(np.uint8).reshape(picture.shape)


@pytest.mark.parametrize("shape", [(301, 443, 3), (3, 50_000, 3), (301, 443)])
def test_blocks_and_levels_give_the_bytes_of_the_whole_image(shape):
    picture = np.random.default_rng(4).integers(0, 256, shape, dtype=np.uint8)
    for stops, balance, noise, gamma in product((0.0, 0.31), ((0.0, 0.0), (0.5, -1.0)), (0.0, 2.7), (1.0, 0.5)):
        drawn = ImageImperfections(exposure_stops=stops, white_balance=balance, noise=noise, gamma=gamma)
        ours, theirs = np.random.default_rng(7), np.random.default_rng(7)
        np.testing.assert_array_equal(apply_imperfections(picture, drawn, ours), plain(picture, drawn, theirs))
        assert ours.random() == theirs.random()


def test_blur_spreads_a_point_evenly():
    point = np.zeros((41, 41, 3), np.uint8)
    point[20, 20] = 255
    blurred = applied(point, blur_px=1.5)[..., 0].astype(float)
    x = np.arange(41) - 20
    assert blurred.sum() == pytest.approx(255, rel=0.15)
    assert np.sqrt((blurred * x**2).sum() / blurred.sum()) == pytest.approx(1.5, rel=0.2)


def test_vignetting_is_the_fourth_power_of_a_cosine():
    # The image spans several processing blocks; its principal point is not in the middle.
    grey, point = np.full((400, 500, 3), 200, np.uint8), (180.0, 260.5)
    y, x = np.mgrid[:400, :500]
    squared = ((x - point[0]) ** 2 + (y - point[1]) ** 2) / (250**2 + 200**2)
    for share in (0.1, 0.5, 0.95):
        # tan of the angle at half the diagonal, where cos^4 is 1 - share.
        tangent = np.tan(np.arccos((1 - share) ** 0.25))
        expected = 200 * np.cos(np.arctan(tangent * np.sqrt(squared))) ** 4
        assert np.abs(applied(grey, point, vignetting=share) - expected[..., None]).max() <= 0.501


@pytest.mark.parametrize("shape", [(301, 443, 3), (1, 1, 3), (150, 131)])
def test_sharpening_adds_what_a_gaussian_takes_from_the_luminance(shape):
    picture = np.random.default_rng(3).integers(0, 256, shape, np.uint8)
    luminance = picture @ (0.299, 0.587, 0.114) if len(shape) == 3 else picture.astype(float)
    blurred = np.pad(luminance, 2, "edge")
    kernel = np.array([1, 4, 6, 4, 1]) / 16
    for axis in (0, 1):
        blurred = np.apply_along_axis(np.convolve, axis, blurred, kernel, "valid")
    for amount in (0.3, 2.0):
        detail = amount * (luminance - blurred)
        expected = np.clip(picture + (detail[..., None] if len(shape) == 3 else detail), 0, 255)
        assert np.abs(applied(picture, sharpening=amount) - expected).max() <= 0.501


def test_jpeg_is_pillows():
    image = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    for picture, quality in product((image, image[..., 1], image[:1, :1]), (1, 60, 100)):
        data = io.BytesIO()
        Image.fromarray(picture).save(data, "JPEG", quality=quality, subsampling=2)
        np.testing.assert_array_equal(applied(picture, jpeg_quality=quality), np.asarray(Image.open(data)))


@pytest.mark.parametrize(("count", "colour"), [(2, "rgb"), (7, "grey")])
def test_an_exposure_is_the_mean_of_its_moments_rounded_once(count, colour):
    moving = {"camera": {"sway_m": 0.03, "colour": colour}, "sequence": {"length": 3, "frame_s": 0.1}}
    blurred = cheap(**moving, imperfections={"motion_blur": [0.4, 1], "sub_frames": count})
    with PairRenderer(cheap(**moving), 0) as before, PairRenderer(blurred, 0) as after:
        for index in (1, 3):
            sharp, pair = before.render(index).frame, after.render(index)
            recorded = pair.provenance["imperfections"]
            assert recorded["left"] == recorded["right"]
            share = recorded["left"]["motion_blur"]
            assert 0.4 <= share <= 1
            sampled = before.sampler.sample(index)
            frames = [before.renderer.render(sampled.moment(time)) for time in moments(share, count)]
            for eye in EYES:
                mean = np.rint(np.mean([frame.view(eye).image for frame in frames], axis=0))
                assert not np.array_equal(mean, sharp.view(eye).image)
                for name, array in pair.frame.view(eye).items():
                    np.testing.assert_array_equal(array, mean if name == "image" else sharp.view(eye)[name])


FURTHER = {
    "white_balance": [-0.2, 0.2],
    "vignetting": [0.1, 0.4],
    "sharpening": [0, 2],
    "jpeg_quality": [60, 95],
    "motion_blur": [0.3, 1],
}


# The rectified view contains everything that this sensor sees, so that the whole raw image is stored.
RAW = {"lens": {"raw_width_px": 40, "raw_height_px": 30}, "outputs": ["valid", "raw"]}


@pytest.mark.parametrize("changes", [{}, {"rig": {"right_y_px": 5.0}}, RAW])
def test_recorded_values_make_the_image_again_from_the_clean_one(changes):
    """A deviating right eye has another principal point, about which its vignetting is symmetric."""
    keys = {"noise": [2, 6], "exposure_stops": [-0.5, 0.5], "blur_px": [0, 1], "gamma": [0.8, 1.2]}
    imperfections = keys | {key: FURTHER[key] for key in FURTHER if key != "motion_blur"}
    make, name = (with_lens, "raw") if "lens" in changes else (cheap, "image")
    marred = make(**changes, imperfections=imperfections)
    with PairRenderer(make(**changes), 2) as before, PairRenderer(marred, 2) as after:
        sharp, pair = before.render(3).frame, after.render(3)
    recorded = pair.provenance["imperfections"]
    assert json.loads(json.dumps(recorded)) == recorded
    seen = set()
    for eye in EYES:
        rng = generator(2, Purpose.IMPERFECTIONS, 3, eye, 0)
        rng.random(4)
        seen |= {*recorded[eye]["white_balance"], recorded[eye]["vignetting"], recorded[eye]["sharpening"]}
        assert recorded[eye]["jpeg_quality"] in range(60, 96)
        values = ImageImperfections(**recorded[eye])
        point = sharp.camera.intrinsics_px(eye)[:2]
        if name == "raw":
            point = np.array(pair.provenance["lens"][eye]["K"])[:2, 2]
        again = apply_imperfections(sharp.view(eye)[name], values, rng, point)
        np.testing.assert_array_equal(pair.frame.view(eye)[name], again)
        np.testing.assert_array_equal(pair.frame.view(eye).disparity, sharp.view(eye).disparity)
    assert len(seen) == 8


def test_a_further_key_shifts_no_other_draw():
    keys = {"noise": [2, 6], "exposure_stops": [-0.5, 0.5]}

    def sampled(values):
        section = cheap(imperfections=keys | values).imperfections
        return sample_imperfections(section, generator(0, 7, 1), partial(generator, 0, 7, 1))

    first = sampled({})
    assert list(first) == ["blur_px", "exposure_stops", "noise", "gamma"]
    for key in FURTHER.keys() - {"motion_blur"}:
        one, all_ = sampled({key: FURTHER[key]}), sampled(FURTHER)
        assert one.keys() - first.keys() == {key}
        assert first.items() <= one.items() <= all_.items()


def test_a_pair_that_fails_all_attempts_is_an_error_that_says_why():
    config = cheap(imperfections={"exposure_stops": -6}, checks={"attempts": 2})
    with PairRenderer(config, 0) as pairs:
        assert pairs.render(3, checked=False).index == 3
        with pytest.raises(InputError, match=r"in 2 attempts.*too dark.*, after lens and imperfections\."):
            pairs.render(3)


@pytest.mark.parametrize(("views", "spoilt"), [(1, "scene"), (1, "image"), (2, "image")])
def test_a_pair_that_fails_is_drawn_again_from_a_sub_seed(monkeypatch, views, spoilt):
    """The next attempt keeps lens and imperfections; pairs that pass are the same as without checks."""
    camera = {} if views == 1 else {"baselines": 2, "baseline_m": [0.1, 0.2]}
    config, judged = with_lens(imperfections={"noise": 3}, camera=camera), []

    def fussy(frame, _config, sampled=None):
        if (sampled is None) == (spoilt == "scene"):
            return []
        judged.append(frame)
        marked = plain[views - 1].frame.right.disparity
        return ["too something: 3 of 4"] if np.array_equal(frame.right.disparity, marked) else []

    with PairRenderer(config, 0) as pairs:
        plain = [pairs.render(number, checked=False) for number in range(2 * views)]
    monkeypatch.setattr(pipeline, "faults", fussy)
    with PairRenderer(config, 0) as pairs:
        made = [pairs.render(number) for number in range(2 * views)]
        assert_equal(pairs.render(0).frame, made[0].frame)
    for number, (pair, unchecked) in enumerate(zip(made, plain, strict=True)):
        again = number < views
        expected = ["too something: 3 of 4" + ", after lens and imperfections" * (spoilt == "image")] if again else None
        assert pair.provenance.get("redrawn") == expected
        assert np.array_equal(pair.frame.left.image, unchecked.frame.left.image) != again
        for key in ("lens", "imperfections"):
            assert pair.provenance[key] == unchecked.provenance[key]
        for eye in EYES if spoilt == "image" else ():
            np.testing.assert_array_equal(pair.frame.view(eye).image, judged[views + number].view(eye).image)


def stated_faults(frame, config, everywhere, least_px):
    """Find the faults from all pixels, as the docstring of the config's section defines them."""
    images, checks = (frame.left.image, frame.right.image), config.checks
    brightness = min(image.mean() for image in images)
    if brightness < checks.min_brightness:
        yield f"too dark: mean {brightness:.1f} levels, at least {checks.min_brightness:g} wanted"
    if (texture := least_texture(images)) < checks.min_texture:
        yield f"too little texture: {texture:.2f} levels, at least {checks.min_texture:g} wanted"
    for view in (frame.left, frame.right):
        valid = view.disparity[np.isfinite(view.disparity)]
        if len(valid) < checks.min_valid * view.disparity.size:
            share = len(valid) / view.disparity.size
            yield f"too few pixels with truth: {share:.3f}, at least {checks.min_valid:g} wanted"
        elif len(valid) and valid.max() > config.disparity.max_px * (1 - 1e-5):
            yield f"cut by the near plane: disparity {valid.max():.3f} px of {config.disparity.max_px:g}"
        elif everywhere and len(valid) < view.disparity.size:
            yield f"too deep: no disparity for {view.disparity.size - len(valid)} pixels in view"
        elif len(valid) and valid.min() < least_px:
            yield f"too deep: disparity {valid.min():.3f} px in a room, at least {least_px:.3f} wanted"


def test_faults_are_those_of_all_pixels():
    rng, kinds, plain_config = np.random.default_rng(0), set(), cheap()
    camera = StereoCamera.centred(160, 130, 90.0, 0.2)
    for _ in range(60):
        limits = (float(rng.choice(values)) for values in ([0, 8, 60], [0, 1, 12], [0, 0.5, 1]))
        checks = dict(zip(("min_brightness", "min_texture", "min_valid"), limits, strict=True))
        config = plain_config.model_copy(update={"checks": plain_config.checks.model_copy(update=checks)})
        arrays = {}
        for eye in ("left", "right"):
            values = rng.choice([2, 8, 9, 60, 130]) + rng.choice([0, 1, 12, 40]) * rng.normal(size=(130, 160, 3))
            # Make every eighth row different, so that a subset of the rows does not represent the image.
            values[rng.integers(8) :: 8] *= rng.choice([0, 1, 8])
            arrays[eye] = np.clip(values, 0, 255).astype(np.uint8)
            disparity = rng.uniform(1, config.disparity.max_px * rng.choice([0.9, 1]), (130, 160)).astype(np.float32)
            disparity[rng.random((130, 160)) < rng.choice([0, 0, 0.01, 0.5, 1])] = np.inf
            disparity[0, 0] = rng.choice([disparity[0, 0], config.disparity.max_px])
            arrays[f"disparity_{eye}"] = disparity
        frame = Frame.from_arrays(camera, arrays)
        everywhere, farthest_m = bool(rng.random() < 0.5), float(rng.choice([np.inf, camera.depth_m(3.0)]))
        expected = dict.fromkeys(stated_faults(frame, config, everywhere, 0.5 * camera.disparity_px(farthest_m)))
        static = SimpleNamespace(farthest_m=farthest_m)
        scene = SimpleNamespace(sky=np.array([not everywhere]), camera=camera)
        sampled = SimpleNamespace(scene=scene, sequence=SimpleNamespace(static=static))
        assert faults(frame, config, sampled) == list(expected)
        kinds |= {" ".join(clause.split()[:3]) for clause in expected} or {"none"}
    deep = {"too deep: no", "too deep: disparity"}
    assert kinds == {"none", "too dark: mean", "too little texture:", "too few pixels", "cut by the"} | deep
