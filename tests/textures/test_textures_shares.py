"""Who is on the surfaces: images in equal parts, and flat patches as often as was asked for."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from pydantic import ValidationError
from tiny_datasets import cheap

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.scene.sampler import SceneSampler
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.atlas import Patch
from semisynth_gl.textures.clips import AtlasLimits
from semisynth_gl.textures.crops import texture_measure
from semisynth_gl.textures.flat import flat_count, lower_contrast
from semisynth_gl.textures.pictures import Picture
from semisynth_gl.textures.prepare import prepare_atlas
from semisynth_gl.textures.procedural import procedural_atlas
from semisynth_gl.textures.selection import build_atlas
from semisynth_gl.textures.shares import MOST_TIMES, equal_shares, patch_chances


def octaves(seed, side_px=256):
    """Like a photograph: the same contrast at 1, 2, 4, ... 32 pixels."""
    rng = np.random.default_rng(seed)
    layers = [rng.integers(0, 43, (side_px // n, side_px // n, 3), dtype=np.uint8).repeat(n, 0).repeat(n, 1)
              for n in (1, 2, 4, 8, 16, 32)]  # fmt: skip
    return np.sum(layers, axis=0).astype(np.uint8)


@given(st.lists(st.integers(1, 300), min_size=1, max_size=40))
def test_images_have_an_equal_say_but_for_those_with_too_few_patches(counts):
    by_name = {str(number): count for number, count in enumerate(counts)}
    shares = equal_shares(by_name)
    assert sum(shares.values()) == pytest.approx(1)
    most = {name: MOST_TIMES * count / sum(counts) for name, count in by_name.items()}
    assert all(shares[name] <= most[name] + 1e-12 for name in shares)
    free = [shares[name] for name in shares if shares[name] < most[name] - 1e-9]
    assert free == pytest.approx([max(shares.values())] * len(free))


@pytest.mark.parametrize(
    ("counts", "shares"),
    [
        ({"large": 400, "a": 40, "b": 40}, [1 / 3, 1 / 3, 1 / 3]),
        ({"large": 99, "a": 1}, [0.96, 0.04]),
        ({"a": 7}, [1.0]),
        ({"large": 30, "a": 9, "b": 1}, [0.45, 0.45, 0.1]),
    ],
)
def test_shares_of_some_photographs(counts, shares):
    found = equal_shares(counts)
    assert [found[name] for name in counts] == pytest.approx(shares)


def test_flat_patches_have_their_share_whatever_their_number():
    sources = [*("a",) * 20, "b", "b", "a", "b"]
    flat = np.array([False] * 22 + [True] * 2)
    chances = patch_chances(sources, flat, 0.3)
    assert chances[flat] == pytest.approx([0.15, 0.15])
    assert chances[:20].sum() == pytest.approx(0.7 - chances[20:22].sum())
    assert chances[20:22].sum() == pytest.approx(0.7 * MOST_TIMES * 2 / 22)
    # Without flat patches, without others, and without a share: 21 patches of a, and b's three are capped.
    plain = np.where(np.array(sources) == "b", MOST_TIMES / 24, (1 - 3 * MOST_TIMES / 24) / 21)
    for mask, share in ((flat, 0.0), (flat & False, 0.3), (flat | True, 0.3)):
        assert patch_chances(sources, mask, share) == pytest.approx(plain)
    assert patch_chances([], np.array([], bool), 0.3).size == 0


def worn(config, patches, scenes):
    """The patches of many surfaces: those of small ones, and those of walls and panels."""
    library = build_library(config.models, config.particles, Split(0))
    sampler = SceneSampler(config, 0, library, patches)
    sampled = [sampler.sample(number) for number in range(scenes)]
    patch = np.concatenate([each.patch for each in sampled])
    large = np.array([each.large for each in patches])[patch]
    return patch[~large], patch[large]


def test_surfaces_wear_photographs_equally_often_and_flat_patches_as_wanted():
    counts = {"huge": 60, "middling": 20, "little": 9}
    small = [Patch(name, 0, 0, 64, 0, 1, 9.0) for name, count in counts.items() for _ in range(count)]
    small += [Patch(name, 0, 0, 64, 0, 1, 1.0, contrast=0.1) for name in counts for _ in range(2)]
    large = [Patch(name, 0, 0, 64, 0, 1, texture, large=True) for name in counts for texture in (9.0, 1.0)]
    patches = tuple(replace(patch, first_layer=layer) for layer, patch in enumerate([*small, *large]))
    particles = {"layers": [{"disparity_px": [2, 12], "count": 150}]}
    config = cheap(
        textures={"flat_share": 0.3, "large_px": 64}, particles=particles, structures={"panels": 8, "ground": 0}
    )
    for seen in worn(config, patches, 12):
        assert len(seen) > 100
        tolerance = 4 * np.sqrt(0.25 / len(seen))  # four standard deviations
        names = Counter(patches[number].source for number in seen)
        assert [names[name] / len(seen) for name in counts] == pytest.approx([1 / 3] * 3, abs=tolerance)
        flat = np.mean([patches[number].texture < config.textures.min_texture for number in seen])
        assert flat == pytest.approx(0.3, abs=tolerance)
    plain = config.model_copy(update={"textures": config.textures.model_copy(update={"flat_share": 0.0})})
    (without, _) = worn(plain, tuple(patch for patch in patches if patch.texture > 1), 3)
    assert all(patches[number].texture > 1 for number in without)


def test_surfaces_wear_a_subject_as_often_as_a_photograph_alone():
    patches = [Patch(name, 0, 0, 64, 0, 1, 9.0, subject="a") for name in "abc" for _ in range(15)]
    patches += [Patch("alone", 0, 0, 64, 0, 1, 9.0) for _ in range(15)]
    config = cheap(particles={"layers": [{"disparity_px": [2, 12], "count": 150}]})
    numbered = tuple(replace(patch, first_layer=layer) for layer, patch in enumerate(patches))
    seen, _ = worn(config, numbered, 12)
    assert np.mean([patches[number].source == "alone" for number in seen]) == pytest.approx(
        0.5, abs=2 / len(seen) ** 0.5
    )
    assert len(seen) > 1000


def test_contrast_is_lowered_and_nothing_else():
    frames = np.stack([octaves(1, 64), octaves(2, 64)])
    for limit in (0.01, 0.5, 4.0):
        lowered, contrast, texture = lower_contrast(frames, limit, np.random.default_rng(0))
        assert 0 < contrast < 1
        assert texture == min(map(texture_measure, lowered))
        assert max(map(texture_measure, lowered)) < limit
        assert np.abs(lowered.mean(axis=(0, 1, 2)) - frames.mean(axis=(0, 1, 2))).max() < 0.51
    # A pixel's level follows from its own level alone, and what was lighter is not darker.
    for channel in range(3):
        pairs = np.unique(np.stack([frames[..., channel].ravel(), lowered[..., channel].ravel()]), axis=1)
        assert len(np.unique(pairs[0])) == pairs.shape[1]
        assert (np.diff(pairs[1].astype(int)) >= 0).all()
    assert np.unique(lowered).size > 6


def test_no_two_patches_keep_the_same_part_of_their_contrast():
    frames = octaves(1, 64)[np.newaxis]
    rng = np.random.default_rng(0)
    left = [lower_contrast(frames, 4.0, rng)[2] for _ in range(50)]
    assert (min(left) < 1.2, max(left) > 3.2, len({round(texture, 3) for texture in left}) > 30) == (True, True, True)


def built(pictures, **keys):
    section = TexturesSection(patch_px=64, scales=(1.0,), **keys)
    return build_atlas([], section, AtlasLimits(), np.random.default_rng(0), pictures)[0]


@pytest.mark.parametrize(("flat_share", "count"), [(0.02, 1), (0.3, 21), (0.5, 48), (0.8, 192)])
def test_photographs_without_flat_crops_give_flat_patches_all_the_same(flat_share, count):
    pictures = [Picture(f"p{number}", octaves(number)) for number in range(3)]  # 16 crops each
    atlas = built(pictures, flat_share=flat_share)
    flat = [patch for patch in atlas.patches if patch.texture < 4]
    assert (len(flat), atlas.report.total("kept_flat"), atlas.report.total("lowered")) == (count,) * 3
    assert f"{count} of them made by lowering" in atlas.report.summary()
    assert len(atlas.patches) == 48 + count == len(atlas.layers)
    of_images = Counter(patch.source for patch in flat)
    assert max(of_images.values()) - min(of_images[picture.name] for picture in pictures) <= 1
    squares = {(patch.source, patch.left_px, patch.top_px): patch for patch in atlas.patches if patch.contrast == 1}
    for patch in flat:
        whole = squares[patch.source, patch.left_px, patch.top_px]
        assert patch.described()["contrast"] == patch.contrast < 1
        assert "contrast" not in whole.described()
        shown, full = (atlas.pixels(each)[0, ..., :3].astype(float) for each in (patch, whole))
        assert np.abs(shown - (full.mean(axis=(0, 1)) * (1 - patch.contrast) + full * patch.contrast)).max() <= 0.51
        assert texture_measure(atlas.pixels(patch)[0, ..., :3]) == patch.texture


def test_flat_crops_come_first_and_no_photograph_has_them_all():
    half = octaves(0)
    half[:, 128:] = 90  # 8 flat crops; the others have none
    pictures = [Picture("half", half), *(Picture(f"p{number}", octaves(number)) for number in range(1, 4))]
    atlas = built(pictures, flat_share=0.25)  # of 56 others
    flat = Counter((patch.source, patch.contrast < 1) for patch in atlas.patches if patch.texture < 4)
    assert sum(flat.values()) == 19
    assert (flat["half", False], flat["half", True]) in {(4, 0), (5, 0)}
    assert all(flat[f"p{number}", True] in {4, 5} for number in range(1, 4))
    assert atlas.report.surface_shares == pytest.approx({picture.name: 0.25 for picture in pictures})


def test_large_and_procedural_patches_are_flat_as_wanted(tmp_path):
    for number in range(5):
        Image.fromarray(octaves(number)).save(tmp_path / f"{number}.png")
    keys = {"patch_px": 64, "flat_share": 0.4, "large_px": 128}
    atlas = prepare_atlas(TexturesSection(source="images", images=(str(tmp_path),), **keys), Split(0))
    large = [patch for patch in atlas.patches if patch.large]
    assert [(patch.texture < 4) == (patch.contrast < 1) for patch in large] == [True] * 7
    assert sum(patch.texture < 4 for patch in large) == flat_count(0.4, 6) == 2
    assert len({patch.source for patch in large if patch.contrast == 1}) == 5
    for patch in large:
        assert texture_measure(atlas.pixels(patch)[0, ..., :3]) == patch.texture
    procedural = procedural_atlas(np.random.default_rng(0), 20, 32, 0.4, 4.0)
    assert sum(patch.texture < 4 for patch in procedural.patches) == 8 == procedural.report.total("kept_flat")
    assert "8 patches nearly without texture, on 40.0% of the surfaces" in procedural.report.summary()


def test_an_uneven_say_is_said():
    many = [Picture(f"p{number}", octaves(number)) for number in range(6)]
    assert "note" not in built(many).report.summary()
    summary = built([*many, Picture("small", octaves(9)[:64, :64])]).report.summary()
    assert "1 image with few patches, on less than half of an equal share" in summary
    assert "(14.3%): small 4.1%;" in summary
    assert "14.3%" not in built([*many, Picture("sky", octaves(9)[:64, :64] // 20)], flat_share=0.3).report.summary()
    assert "only 2 images, each on about 50% of the surfaces" in built(many[:2]).report.summary()


@pytest.mark.parametrize("keys", [{"min_texture": 0}, {"max_patches": 1}])
def test_flat_patches_that_cannot_be_are_refused(keys):
    TexturesSection(**keys)
    with pytest.raises(ValidationError, match=r"flat_share is 0\.1: expected a min_texture above 0"):
        TexturesSection(flat_share=0.1, **keys)
