"""Changing a config's image size: ``scale`` keeps the scenes, and new camera keys crop the view."""

from pathlib import Path

import numpy as np
import pytest
from samplers import patches

from semisynth_gl.config import Range, load_config, packaged_configs
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene.mix import RecipeMixSampler
from semisynth_gl.scene.sources import recipe_libraries
from semisynth_gl.seeds.splits import Split

# A config with every key that is in image pixels.
ALL_IN_PIXELS = Path(__file__).resolve().parents[1] / "data" / "all-in-pixels.yaml"


def leaves(values, key=()):
    """Yield the scalar values of a config with their paths of keys."""
    for name, value in values.items() if isinstance(values, dict) else enumerate(values):
        if isinstance(value, dict | list):
            yield from leaves(value, (*key, name))
        else:
            yield (*key, name), value


@pytest.mark.parametrize("name", [*packaged_configs(), ALL_IN_PIXELS])
@pytest.mark.parametrize("factor", [3, 0.5])
def test_all_that_is_in_pixels_of_an_image_is_scaled(name, factor):
    before, after = (
        dict(leaves(load_config(name, scale).model_dump(mode="json"))) for scale in ((), {"scale": factor})
    )
    assert before.keys() == after.keys()
    scaled = 0
    for key, value in before.items():
        named = next(part for part in reversed(key) if isinstance(part, str))
        if named == "texels_per_pixel":
            expected = value / factor
        elif named.endswith("_px") and not {"textures", "projector"}.intersection(key) and value is not None:
            border = 0.5 if named[:2] in ("cx", "cy") else 0
            expected = (value + border) * factor - border
            scaled += 1
        else:
            expected = value
        if named in ("width_px", "height_px"):
            expected = round(expected)
        assert after[key] == (pytest.approx(expected) if isinstance(expected, float) else expected), key
    assert scaled > (25 if name == ALL_IN_PIXELS else 8)


@pytest.mark.parametrize(
    ("name", "factor", "keys"),
    [
        ("middlebury", 2.56, ["background.room=1"]),
        ("kitti", 2, ["background.street=1", "structures={ground: 1, panels: 3, ground_disparity_px: 30}"]),
    ],
)
def test_scenes_stay_what_they_are_at_another_resolution(tmp_path, name, factor, keys):
    # Keys in the scaled file are in pixels of the original size; keys beside ``scale`` are in pixels of the new size.
    particles = "particles.layers=[{disparity_px: [10, 80], count: 30}]"
    base = load_config(name, [*keys, particles, "disparity.target={form: uniform}", "models={variants: 1, complex: 0}"])
    (tmp_path / "base.yaml").write_text(str(base.model_dump(mode="json", exclude_none=True)))
    configs = [load_config(tmp_path / "base.yaml", scale) for scale in ([], [f"scale={factor}"])]
    assert configs[1].camera.width_px == factor * base.camera.width_px
    samplers = [RecipeMixSampler(config, 3, recipe_libraries(config, Split(3)), patches()) for config in configs]
    for index in range(2):
        one, other = (sampler.sample(index).scene for sampler in samplers)
        np.testing.assert_allclose(one.world_from_model, other.world_from_model, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(one.uv_scale, other.uv_scale, rtol=1e-6)
        assert other.camera.focal_px == pytest.approx(factor * one.camera.focal_px)


def test_a_scale_is_of_what_it_stands_over(tmp_path):
    (tmp_path / "half.yaml").write_text("extends: middlebury\nscale: 0.5\nparticles: {size_px: [50, 60]}\n")
    half = load_config(tmp_path / "half.yaml")
    assert (half.camera.width_px, half.particles.size_px) == (750, Range(50, 60))
    whole = load_config(tmp_path / "half.yaml", ["particles.most=7", "scale=2"])
    assert (whole.camera, whole.particles.size_px, whole.particles.most) == (
        load_config("middlebury").camera,
        Range(100, 120),
        7,
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("extends: middlebury\nscale: .nan\n", r"lab.yaml:2: scale: expected 1e-06 to 1e\+06, got nan"),
        ("extends: middlebury\nscale: 1e9\n", r"lab.yaml:2: scale: expected 1e-06 to 1e\+06, got 1000000000.0"),
        ("name: x\nscale: 2\n", "lab.yaml:2: scale: expected a key extends"),
        ("extends: middlebury\nscale: 64\n", "camera.width_px: expected less than or equal to 16384"),
    ],
)
def test_a_scale_that_cannot_be_is_refused(tmp_path, text, said):
    (tmp_path / "lab.yaml").write_text(text)
    with pytest.raises(InputError, match=said):
        load_config(tmp_path / "lab.yaml")


# Keys that override a camera of 1280 x 720 px with principal points (650, 640, 350), and the resulting points.
CUTS = [
    ({"width_px": 640}, (330, 320, 350)),
    ({"width_px": 640, "height_px": 360}, (330, 320, 170)),
    ({"width_px": 640, "cx_left_px": 300}, (300, 320, 350)),
    ({"width_px": 640, "doffs_px": 0}, (330, None, 350)),
    ({"width_px": 640, "height_px": 360, "focal_px": 450}, (330, 320, 170)),
    ({"focal_px": 450}, (650, 640, 350)),
]


@pytest.mark.parametrize(("keys", "points"), CUTS)
def test_principal_points_keep_their_place_beside_the_middle(tmp_path, keys, points):
    (tmp_path / "rig.yaml").write_text(
        "extends: middlebury\ncamera: {width_px: 1280, height_px: 720, focal_px: 900, cx_left_px: 650, "
        "cx_right_px: 640, cy_px: 350}\nscenes: [{recipe: a, camera: {cx_left_px: [642, 652]}}, {recipe: b}]\n"
    )
    (tmp_path / "other.yaml").write_text(f"extends: rig.yaml\ncamera: {keys}\n")
    by_file = load_config(tmp_path / "other.yaml")
    by_override = load_config(tmp_path / "rig.yaml", {f"camera.{key}": value for key, value in keys.items()})
    for config in (by_file, by_override):
        camera = config.camera
        found = [each and each.middle for each in (camera.cx_left_px, camera.cx_right_px, camera.cy_px)]
        assert found == [each and pytest.approx(each) for each in points]
    if keys == {"width_px": 640}:
        assert by_file.recipes()[0].config.camera.cx_left_px == Range(322, 332)
