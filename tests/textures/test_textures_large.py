"""Large patches (whole pictures): cutting them, and the surfaces that get them."""

import weakref
from dataclasses import replace

import numpy as np
import pytest
from photograph_like import noise
from samplers import patches, sampler_of

from semisynth_gl.config import load_config
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.scene.catalogue import SURFACE_MODELS
from semisynth_gl.scene.instances import map_patches, new_instances
from semisynth_gl.scene.left_view import left_view_hits
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures import prepare
from semisynth_gl.textures.atlas import Patch, atlas_from_arrays
from semisynth_gl.textures.canvas import PaintedPicture
from semisynth_gl.textures.large import MOST_LARGE, with_large_patches
from semisynth_gl.textures.prepare import prepare_atlas
from semisynth_gl.textures.sources import SOURCES


def picture(name, height, width, seed=0):
    return PaintedPicture(name, noise(height, width, seed))


def atlas_of(pictures):
    sources = [each.name for each in pictures]
    return atlas_from_arrays([np.zeros((16, 16, 3), np.uint8)] * len(pictures), sources)


def section(side_px, **keys):
    return TexturesSection(large_px=side_px, **keys)


def with_large(pictures, side_px, seed=0):
    named = {picture.name: picture for picture in pictures}
    return with_large_patches(atlas_of(pictures), named, section(side_px), np.random.default_rng(seed))


def test_a_square_is_as_large_as_its_picture_and_copied_where_that_fits():
    shown = picture("wide", 64, 200)
    atlas = with_large([shown], 64, seed=3)
    small, large = atlas.patches
    assert (small.large, large.large, large.first_layer, large.side_px, large.top_px) == (False, True, 1, 64, 0)
    part = shown.pixels[:, large.left_px : large.left_px + 64]
    np.testing.assert_array_equal(atlas.pixels(large)[0, ..., :3], part)
    np.testing.assert_array_equal(atlas.pixels(small), atlas.layers[:1])
    assert (atlas.large_layers[..., 3] == 255).all()


def test_each_image_has_one_and_there_is_a_limit():
    pictures = [picture(f"p{k}", 20, 30, k) for k in range(MOST_LARGE + 6)]
    atlas = with_large(pictures, 16)
    sources = [patch.source for patch in atlas.patches if patch.large]
    assert len(sources) == len(set(sources)) == MOST_LARGE == len(atlas.large_layers)
    few = with_large(pictures[:3], 16)
    assert {patch.source for patch in few.patches if patch.large} == {"p0", "p1", "p2"}
    none = with_large_patches(atlas_of(pictures), {}, section(16), np.random.default_rng(0))
    assert not any(patch.large for patch in none.patches)


def test_pictures_are_kept_in_memory_where_large_patches_may_be_cut_from_them(monkeypatch):
    monkeypatch.setattr(prepare, "_REMEMBERED", 6)
    pictures, alive = [], []

    def source(_):
        for number in range(20):
            alive.append(sum(pixels() is not None for pixels in pictures))
            pixels = noise(64, 64, number) if number % 2 else np.full((64, 64, 3), 90, np.uint8)
            pictures.append(weakref.ref(pixels))
            yield PaintedPicture(f"mine/{number}", pixels)

    monkeypatch.setitem(SOURCES, "builtin", replace(SOURCES["builtin"], files=lambda _: (), pictures=source))
    for keys, most in (({"large_px": 64}, 6), ({"large_px": 64, "sequence": True}, 0), ({"large_px": 0}, 0)):
        pictures.clear()
        alive.clear()
        atlas = prepare_atlas(TexturesSection(patch_px=32, scales=(1.0,), min_sharpness=0, **keys), Split(77))
        assert len(alive) == 20
        # The latest two may still be in progress.
        assert most <= max(alive) <= most + 2
        large = {patch.source for patch in atlas.patches if patch.large}
        assert large == {f"mine/{number}" for number in range(1, most, 2)}


SMALL = patches()
LARGE = tuple(Patch("l", 0, 0, 1024, 5 + k, 1, 9.0, large=True) for k in range(2))


def test_walls_wear_large_patches_and_none_repeats_across_the_view():
    config = load_config("middlebury", ["textures.large_px=1024", "structures.panels=3", "models.complex=0"])
    sampled = sampler_of(config, atlas_patches=(*SMALL, *LARGE)).sample(0)
    still = sampled.scene.model < len(SURFACE_MODELS)
    assert still.sum() == 9
    patch = sampled.instances["patch"]
    assert set(patch[still]) <= {5, 6}
    plain = sampler_of(config, atlas_patches=SMALL).sample(0).scene
    # A large patch is at least as wide as the image, so a surface repeats it less often than a small one.
    shown = plain.uv_scale[still] / sampled.scene.uv_scale[still]
    assert (shown >= 1024 / 256 - 1e-9).all()
    # Large patches do not change instances with small patches.
    same = patch < 5
    assert same.sum() > 20
    np.testing.assert_array_equal(plain.uv_scale[same], sampled.scene.uv_scale[same])
    np.testing.assert_array_equal(plain.uv_offset[same], sampled.scene.uv_offset[same])
    many = tuple(replace(LARGE[0], first_layer=5 + k) for k in range(24))
    assert len({*sampler_of(config, atlas_patches=(*SMALL, *many)).sample(0).instances["patch"][still]}) == 9


def test_of_a_large_surface_one_patch_spans_the_view():
    camera = StereoCamera.centred(1500, 1000, 1200.0, 0.1)
    # A wall and a table whose visible parts are small, and a thing that repeats a small patch.
    high, large = np.array([[0.01, 0.01], [0.01, 0.01], [1.0, 1.0]]), np.array([True, True, False])
    table = new_instances(3, depth_m=3.0, unit_m=1.0, uv_high=high, large=[True, False, False])
    scale, _ = map_patches(table, camera, section(1024), np.full(3, 1.5), np.full((3, 2), 0.5), large)
    across = scale[:, 0] * 3 * 1500 / 1200
    np.testing.assert_allclose(across, [1, 1.5 * 1500 / 1024, 1.5 * 1500 / 256])


@pytest.mark.parametrize("config", ["middlebury", "kitti"])
def test_what_is_seen_of_a_surface_shows_a_patch_about_once(config):
    kind = {"middlebury": "room", "kitti": "street"}[config]
    overrides = ["scenes=[]", f"background={{cuboid: 0, plane: 0, {kind}: 1}}", "particles.layers=[{count: 20}]"]
    config = load_config(config, [*overrides, "disparity.target={form: uniform}", "models.variants=1"])
    sampler = sampler_of(config, atlas_patches=(*SMALL, *LARGE))
    once, small, models = [], [], 0
    for index in range(4):
        sampled = sampler.sample(index)
        scene, seen = sampled.scene, left_view_hits(sampled.scene, sampler.models)
        for number in np.unique(seen.instance):
            uv = seen.uv[seen.instance == number] * scene.uv_scale[number] + scene.uv_offset[number]
            low, high = np.quantile(uv, (0.1, 0.9), axis=0)
            if sampled.instances["patch"][number] < 5:
                small.append((high - low).max())
                continue
            models += scene.model[number] >= len(SURFACE_MODELS)
            if len(uv) > 30 and sampled.instances["slot"][number] < 0:
                # Unless a patch is enlarged too much, the surface shows none of its mirrored borders.
                once.append(bool((low > -0.01).all() and (high < 1.01).all()))
    assert max(small) < 1.5
    assert models > 5
    assert len(once) > 15
    assert np.mean(once) > 0.85
