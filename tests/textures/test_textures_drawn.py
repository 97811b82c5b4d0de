"""Patches without the user's photographs: painted pictures, procedural ones, and scikit-image's photographs."""

import json
from dataclasses import replace
from importlib.machinery import ModuleSpec
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
from photograph_like import octaves, save
from tiny_datasets import cheap

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.dataset.generate import generate
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures import clips, image_files, prepare
from semisynth_gl.textures.borders import Rectangle
from semisynth_gl.textures.canvas import SIDE_PX, PaintedPicture
from semisynth_gl.textures.crops import DuplicateFinder, cover, cut_crop, sharpness_measure
from semisynth_gl.textures.crops import texture_measure as texture_of
from semisynth_gl.textures.image_files import builtin_photographs
from semisynth_gl.textures.images import read_image
from semisynth_gl.textures.prepare import pack_atlas, prepare_atlas, unpack_atlas
from semisynth_gl.textures.procedural import procedural_atlas
from semisynth_gl.textures.selection import build_atlas
from semisynth_gl.textures.sources import KINDS, PLAIN, SOURCES, open_source, painted_pictures

SECTION = TexturesSection(patch_px=64, scales=(1.0, 2.0))
VALIDATION = Split(11, "validation", {"validation": 0.1, "test": 0.1})


def built(pictures, files=None, **keys):
    return build_atlas(files or [], SECTION.model_copy(update=keys), np.random.default_rng(0), pictures)


# Mean level of each kind of picture. The fifth digit depends on how Pillow antialiases letters.
MEANS = (
    *(106.724, 105.986, 89.671, 98.336, 101.564, 177.068, 102.118, 123.360, 121.464, 167.005, 171.468, 97.740),
    *(106.464, 193.192, 121.438, 126.125, 73.654, 59.404, 190.787, 137.562, 107.152, 181.015, 187.185, 192.738),
)


@pytest.mark.parametrize(("kind", "mean"), [*zip(KINDS, MEANS, strict=True)], ids=[kind.__name__ for kind in KINDS])
def test_every_kind_is_sharp_and_repeats_nothing_and_all_but_plain_ones_have_contrast_at_all_scales(kind, mean):
    picture = np.asarray(kind(np.random.default_rng(7)))
    assert picture.mean() == pytest.approx(mean, rel=1e-4)
    assert (picture.shape, picture.dtype) == ((SIDE_PX, SIDE_PX, 3), np.uint8)
    whole = Rectangle(0, 0, SIDE_PX, SIDE_PX)
    crops = [cut_crop(picture, square, 256) for square in cover("picture", whole, 256, (1.0,))]
    defaults = TexturesSection()
    least = defaults.min_texture if kind in PLAIN else 4.0
    assert sum(texture_of(crop) >= least for crop in crops) >= 8
    assert sum(sharpness_measure(crop) >= defaults.min_sharpness for crop in crops) >= 8
    assert not DuplicateFinder(defaults.min_difference).find(crops)
    if kind in PLAIN:
        assert np.median([texture_of(crop) for crop in crops]) < 7
        return
    # Contrast that each octave from 1 to 32 pixels loses against the next coarser one.
    grey = picture.mean(axis=2)
    means = [grey.reshape(SIDE_PX // n, n, SIDE_PX // n, n).mean(axis=(1, 3)) for n in (1, 2, 4, 8, 16, 32, 64)]
    lost = [np.sqrt(max(fine.var() - coarse.var(), 0)) for fine, coarse in pairwise(means)]
    assert min(lost) > 1.0
    assert np.abs(np.diff(picture.astype(int), axis=2)).mean() > 3.0


def test_pictures_come_from_the_generator_alone_and_have_names_of_their_own():
    first, again, other = (list(islice(painted_pictures(np.random.default_rng(seed)), 2)) for seed in (3, 3, 4))
    for one, same in zip(first, again, strict=True):
        assert one.name == same.name
        np.testing.assert_array_equal(one.pixels, same.pixels)
    assert not any(np.array_equal(one.pixels, another.pixels) for one in first for another in other)
    names = [f"drawn/{kind.__name__.replace('_', '-')}" for kind in KINDS]
    assert len(set(names)) == len(KINDS)
    assert {picture.name for picture in (*first, *other)} <= set(names)


def test_photographs_and_procedural_patches_are_without_pictures():
    for source in ("photographs", "procedural", "images"):
        assert open_source(source).pictures is None
    photographs = TexturesSection(source="photographs", patch_px=128, max_patches=32)
    files = sorted(builtin_photographs(), key=Path.as_posix)
    assert prepare.split_images(photographs, Split(0)) == files
    assert prepare_atlas(photographs, Split(0)).pictures == {}
    given = photographs.model_copy(update={"source": "images", "images": tuple(map(str, files))})
    np.testing.assert_array_equal(prepare_atlas(photographs, Split(0)).layers, prepare_atlas(given, Split(0)).layers)


def test_pictures_and_files_take_turns_and_no_more_are_painted_than_needed(tmp_path):
    files = save(tmp_path, **{f"{number}": octaves(number, 192) for number in range(6)})
    asked = []

    def endless():
        while True:
            asked.append(len(asked))
            yield PaintedPicture(f"picture-{asked[-1]}", octaves(100 + asked[-1], 192))

    atlas = built(endless(), files, max_patches=16)
    assert len(asked) == 2
    assert atlas.report.images_not_opened == 4
    sources = {patch.source for patch in atlas.patches}
    assert sorted(source.startswith("picture-") for source in sources) == [False, False, True, True]
    # Painted pictures fill the places for which there are no files.
    asked.clear()
    assert len({patch.source for patch in built(endless(), files, max_patches=80).patches}) == len(asked) + 6 > 12


def test_what_is_wrong_with_pictures_is_left_out_or_said():
    good, small = PaintedPicture("good", octaves(0, 192)), PaintedPicture("small", octaves(1)[:40])
    flat = PaintedPicture("flat", np.full((192, 192, 3), 90, np.uint8))
    atlas = built([good, flat, small, PaintedPicture("again", good.pixels)])
    report = atlas.report
    assert ({patch.source for patch in atlas.patches}, report.images_too_small) == ({"good"}, 1)
    assert report.total("flat") == sum(count.flat for count in report.counts if count.source == "flat") > 0
    assert report.total("duplicate") == report.total("kept")
    assert set(atlas.pictures) == {"good"}
    with pytest.raises(InputError, match="1 smaller than 64"):
        built([flat, small])

    for pixels in (np.zeros((9, 9, 3)), np.zeros((9, 9, 4), np.uint8), [[[1, 2, 3]]]):
        with pytest.raises(InputError, match="picture 'mine': expected an array"):
            PaintedPicture("mine", pixels)


def test_pictures_beside_image_sequences_stay_within_the_layers(tmp_path, monkeypatch):
    monkeypatch.setattr(clips, "MOST_LAYERS", 96)
    files = save(tmp_path, **{f"{number}": octaves(number, 192) for number in range(8)})
    pictures = [PaintedPicture(f"picture-{number}", octaves(100 + number, 192)) for number in range(8)]
    atlas = built(pictures, files, sequence=True, max_patches=48)
    assert len(atlas.layers) <= 96
    assert {patch.layer_count for patch in atlas.patches} == {1, 2}


def test_the_cache_and_the_sheet_know_the_pictures(monkeypatch):
    painted = list[int]()

    def source(rng):
        for number in range(4):
            seed = int(rng.integers(1 << 30))
            painted.append(seed)
            yield PaintedPicture(f"mine/{number}", octaves(seed) // np.uint8(255 if number == 2 else 1))

    monkeypatch.setitem(SOURCES, "builtin", replace(SOURCES["builtin"], files=lambda _: (), pictures=source))
    section = TexturesSection(patch_px=64, scales=(1.0,), max_patches=40, large_px=96)
    atlas = prepare_atlas(section, Split(11))
    for same in (prepare_atlas(section, Split(11)), unpack_atlas(pack_atlas(atlas))):
        assert (same.patches, same.report, same.pictures) == (atlas.patches, atlas.report, atlas.pictures)
        np.testing.assert_array_equal(same.layers, atlas.layers)
        np.testing.assert_array_equal(same.large_layers, atlas.large_layers)
    assert {patch.source for patch in atlas.patches if patch.large} == {"mine/0", "mine/1", "mine/3"}
    # Each split has other pictures, and no picture is painted twice.
    of_split = prepare_atlas(section, VALIDATION).pictures
    assert not set(of_split.values()) & set(atlas.pictures.values())
    assert len(painted) == 8


def test_a_dataset_tells_of_its_pictures(tmp_path):
    config = cheap(textures={"source": "builtin", "patch_px": 128, "max_patches": 8})
    generate(config, tmp_path / "o", {"train": 1, "validation": 1}, 2, layout="webdataset")
    values = json.loads((tmp_path / "o/index.json").read_text())
    of_split = [values["splits"][split]["photographs"] for split in ("train", "validation")]
    for images in of_split:
        drawn = [image for image in images if image["name"].startswith("drawn/")]
        assert 0 < len(drawn) < len(images)
        assert {image["licence"] for image in drawn} == {"MIT"}
        assert all(
            "CC0" in image["licence"] or "public domain" in image["licence"] for image in images if image not in drawn
        )
    digests = [image["sha256"] for images in of_split for image in images]
    assert None not in digests
    assert len(set(digests)) == len(digests)


@pytest.mark.parametrize("side_px", [16, 33, 128])
def test_procedural_patches_have_texture_and_come_from_the_generator_alone(side_px):
    first, again, other = (procedural_atlas(np.random.default_rng(seed), 20, side_px).layers for seed in (1, 1, 2))
    assert (first.shape, first.dtype) == ((20, side_px, side_px, 4), np.uint8)
    assert min(texture_of(layer[..., :3]) for layer in first) > 3.0
    np.testing.assert_array_equal(first, again)
    assert len({layer.tobytes() for layer in (*first, *other)}) == 40


def test_builtin_photographs_are_there_and_none_is_an_evaluation_image():
    paths = builtin_photographs()
    assert len(paths) >= 8
    assert not any("motorcycle" in path.name for path in paths)
    for path in paths:
        assert min(read_image(path).shape[:2]) >= 300


@pytest.mark.parametrize("is_installed", [False, True])
def test_photographs_that_are_not_there_are_named(monkeypatch, tmp_path, *, is_installed):
    spec = ModuleSpec("skimage", None, is_package=True)
    spec.submodule_search_locations = [str(tmp_path)]
    monkeypatch.setattr(image_files, "find_spec", lambda _: spec if is_installed else None)
    with pytest.raises(InputError, match="astronaut" if is_installed else "scikit-image") as caught:
        builtin_photographs()
    assert "textures.images" in str(caught.value)
