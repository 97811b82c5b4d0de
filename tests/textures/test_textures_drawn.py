"""Pictures in memory as a source of patches, and the pictures that the program draws itself."""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import built as fixed
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from tiny_datasets import cheap

from semisynth_gl.config.scene_sections import TEXTURE_SOURCES, TexturesSection
from semisynth_gl.dataset.generate import generate
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures import prepare
from semisynth_gl.textures.atlas import Atlas
from semisynth_gl.textures.canvas import SIDE_PX
from semisynth_gl.textures.clips import AtlasLimits
from semisynth_gl.textures.crops import DuplicateFinder, Square, crop_boxes, cut_crop, fingerprint, sharpness_measure
from semisynth_gl.textures.crops import texture_measure as texture_of
from semisynth_gl.textures.drawn import KINDS, PLAIN, drawn_pictures
from semisynth_gl.textures.image_files import builtin_photographs
from semisynth_gl.textures.pictures import Picture
from semisynth_gl.textures.prepare import named_images, pack_atlas, prepare_atlas, split_pictures, unpack_atlas
from semisynth_gl.textures.selection import build_atlas
from semisynth_gl.textures.sheet import draw_texture_sheet
from semisynth_gl.textures.sources import SOURCES, describe_source

SECTION = TexturesSection(patch_px=64, scales=(1.0, 2.0))
TRAIN, VALIDATION, TEST = (
    Split(11, name, {"validation": 0.1, "test": 0.1}) for name in ("train", "validation", "test")
)


def octaves(seed: int, height: int = 192, width: int = 256) -> NDArray[np.uint8]:
    """Like a photograph: the same contrast at 1, 2, 4, ... 32 pixels."""
    rng = np.random.default_rng(seed)
    layers = [
        rng.integers(0, 43, (height // n, width // n, 3), dtype=np.uint8).repeat(n, 0).repeat(n, 1)
        for n in (1, 2, 4, 8, 16, 32)
    ]
    return np.sum(layers, axis=0).astype(np.uint8)


def built(
    pictures: Iterator[Picture] | list[Picture],
    files: list[Path] | None = None,
    limits: AtlasLimits | None = None,
    **keys: object,
) -> Atlas:
    section = SECTION.model_copy(update=keys)
    return build_atlas(files or [], section, limits or AtlasLimits(), np.random.default_rng(0), pictures)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_kind_is_sharp_and_repeats_nothing_and_all_but_plain_ones_have_contrast_at_all_scales(kind) -> None:
    picture = fixed.drawn_picture(kind)
    assert not fixed.faults({f"atlas/{kind.__name__}": fixed.of_picture(picture)})
    assert (picture.shape, picture.dtype) == ((SIDE_PX, SIDE_PX, 3), np.uint8)
    boxes = crop_boxes(SIDE_PX, SIDE_PX, 256, (1.0,))
    crops = [cut_crop(picture, box, 256) for box in boxes]
    defaults = TexturesSection()
    least = defaults.min_texture if kind in PLAIN else 4.0
    assert sum(texture_of(crop) >= least for crop in crops) >= 8
    assert sum(sharpness_measure(crop) >= defaults.min_sharpness for crop in crops) >= 8
    finder = DuplicateFinder(defaults.min_difference)
    prints = np.array([fingerprint(crop) for crop in crops])
    assert finder.find([Square("picture", *box) for box in boxes], prints) == {}
    if kind in PLAIN:
        textures = [texture_of(crop) for crop in crops]
        assert np.median(textures) < 7
        return
    # The contrast of each octave from 1 to 64 pixels, as far as it is lost in the next coarser one.
    grey = picture.mean(axis=2)
    means = [grey.reshape(SIDE_PX // n, n, SIDE_PX // n, n).mean(axis=(1, 3)) for n in (1, 2, 4, 8, 16, 32, 64)]
    lost = [np.sqrt(max(fine.var() - coarse.var(), 0)) for fine, coarse in pairwise(means)]
    assert min(lost) > 1.0
    assert np.abs(np.diff(picture.astype(int), axis=2)).mean() > 3.0  # in colour


def test_pictures_come_from_the_generator_alone_and_have_names_of_their_own() -> None:
    first, again, other = (list(islice(drawn_pictures(np.random.default_rng(seed)), 2)) for seed in (3, 3, 4))
    for one, same in zip(first, again, strict=True):
        assert one.name == same.name
        np.testing.assert_array_equal(one.pixels, same.pixels)
    assert not any(np.array_equal(one.pixels, another.pixels) for one in first for another in other)
    names = [f"drawn/{kind.__name__.replace('_', '-')}" for kind in KINDS]
    assert len(set(names)) == len(KINDS)
    assert {picture.name for picture in (*first, *other)} <= set(names)


def test_splits_draw_other_pictures() -> None:
    section = TexturesSection()
    firsts = [next(iter(split_pictures(section, split) or ())) for split in (TRAIN, VALIDATION, TEST)]
    assert len({hashlib.sha256(picture.pixels.tobytes()).digest() for picture in firsts}) == 3


def test_photographs_and_procedural_patches_are_without_pictures() -> None:
    for source in ("photographs", "procedural", "images"):
        assert split_pictures(TexturesSection(source=source), Split(0)) is None
    photographs = TexturesSection(source="photographs", patch_px=128, max_patches=32)
    files = sorted(builtin_photographs(), key=Path.as_posix)
    assert prepare.split_images(photographs, Split(0)) == files
    assert prepare_atlas(photographs, Split(0)).pictures == {}
    given = photographs.model_copy(update={"source": "images", "images": tuple(map(str, files))})
    np.testing.assert_array_equal(prepare_atlas(photographs, Split(0)).layers, prepare_atlas(given, Split(0)).layers)


def test_patches_hold_the_pixels_of_their_pictures() -> None:
    pictures = {name: octaves(number) for number, name in enumerate(("a", "b/c"))}
    atlas = built([Picture(name, pixels) for name, pixels in pictures.items()])
    assert {patch.source for patch in atlas.patches} == {"a", "b/c"}
    for patch in atlas.patches:
        box = Square(patch.source, patch.left_px, patch.top_px, patch.side_px).box
        expected = cut_crop(pictures[patch.source], box, 64)
        np.testing.assert_array_equal(atlas.layers[patch.first_layer, ..., :3], expected)
    assert atlas.pictures == {name: hashlib.sha256(pixels.tobytes()).hexdigest() for name, pixels in pictures.items()}
    assert atlas.report.images_used == 2


def test_pictures_and_files_take_turns_and_no_more_are_drawn_than_needed(tmp_path: Path) -> None:
    files = []
    for number in range(6):
        files.append(tmp_path / f"{number}.png")
        Image.fromarray(octaves(number)).save(files[-1])
    asked = []

    def endless() -> Iterator[Picture]:
        while True:
            asked.append(len(asked))
            yield Picture(f"picture-{asked[-1]}", octaves(100 + asked[-1]))

    atlas = built(endless(), files, max_patches=16)
    assert len(asked) == 2
    assert atlas.report.images_not_opened == 4
    sources = {patch.source for patch in atlas.patches}
    assert sorted(source.startswith("picture-") for source in sources) == [False, False, True, True]
    # Files run out first: pictures make up for them.
    asked.clear()
    assert len({patch.source for patch in built(endless(), files, max_patches=80).patches}) == len(asked) + 6 > 12


def test_what_is_wrong_with_pictures_is_left_out_or_said() -> None:
    good, flat, small = (
        Picture("good", octaves(0)),
        Picture("flat", np.full((192, 192, 3), 90, np.uint8)),
        Picture("small", octaves(1)[:40]),
    )
    atlas = built([good, flat, small, Picture("again", good.pixels)])
    report = atlas.report
    assert ({patch.source for patch in atlas.patches}, report.too_small) == ({"good"}, ("small",))
    assert report.total("flat") == sum(count.flat for count in report.counts if count.source == "flat") > 0
    assert report.total("duplicate") == report.total("kept")
    assert report.named_images == {"flat", "small", "again", "good"}
    assert set(atlas.pictures) == {"good"}
    with pytest.raises(InputError, match="two with the name 'good'"):
        built([good, Picture("good", octaves(5))])
    with pytest.raises(InputError, match="2 images: 1 smaller than a patch of 64"):
        built([flat, small])


@pytest.mark.parametrize(
    ("pixels", "words"),
    [
        (np.zeros((9, 9, 3)), r"\(9, 9, 3\) float64"),
        (np.zeros((9, 9), np.uint8), r"\(9, 9\) uint8"),
        (np.zeros((9, 9, 4), np.uint8), r"\(9, 9, 4\) uint8"),
        (np.zeros((1, 9, 9, 3), np.uint8), r"\(1, 9, 9, 3\) uint8"),
        ([[[1, 2, 3]]], "list"),
    ],
)
def test_pixels_of_another_kind_are_refused(pixels, words) -> None:
    with pytest.raises(InputError, match=f"picture 'mine': expected an array .* got {words}"):
        Picture("mine", pixels)


def test_pictures_beside_image_sequences_stay_within_the_layers(tmp_path: Path) -> None:
    files = []
    for number in range(8):
        files.append(tmp_path / f"{number}.png")
        Image.fromarray(octaves(number)).save(files[-1])
    pictures = [Picture(f"picture-{number}", octaves(100 + number)) for number in range(8)]
    atlas = built(pictures, files, AtlasLimits(layers=96, frames=8), sequence=True, max_patches=48)
    assert atlas.report.longest_clip == 2
    assert len(atlas.layers) <= 96
    assert {patch.layer_count for patch in atlas.patches} == {1, 2}


def test_pictures_are_drawn_once_for_patches_of_both_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []

    def source(rng: np.random.Generator) -> Iterator[Picture]:
        for number in range(4):
            drawn.append(number)
            yield Picture(f"mine/{number}", octaves(int(rng.integers(1 << 30))))

    monkeypatch.setenv("SEMISYNTH_GL_CACHE", "off")
    monkeypatch.setitem(SOURCES, "builtin", replace(SOURCES["builtin"], files=lambda _: (), pictures=source))
    section = TexturesSection(patch_px=64, scales=(1.0,), max_patches=40, large_px=96)
    atlas = prepare_atlas(section, Split(11))
    assert drawn == [0, 1, 2, 3]
    assert {patch.source for patch in atlas.patches if patch.large} == {f"mine/{number}" for number in drawn}
    # Where there is no room to keep them they are drawn again, as they were.
    for room, times in ((0, 2), (2 * octaves(0).nbytes, 2), (4 * octaves(0).nbytes, 1)):
        drawn.clear()
        monkeypatch.setattr(prepare, "_MOST_KEPT_BYTES", room)
        again = prepare_atlas(section, Split(11))
        assert drawn == [0, 1, 2, 3] * times
        assert again.patches == atlas.patches
        np.testing.assert_array_equal(again.large_layers, atlas.large_layers)


def test_the_cache_and_the_sheet_know_the_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    def source(rng: np.random.Generator) -> Iterator[Picture]:
        for number in range(4):
            seed = int(rng.integers(1 << 30))
            yield Picture(f"mine/{number}", octaves(seed) // np.uint8(255 if number == 2 else 1))

    monkeypatch.setitem(SOURCES, "builtin", replace(SOURCES["builtin"], pictures=source))
    section = TexturesSection(patch_px=64, scales=(1.0,), max_patches=40)
    atlas = prepare_atlas(section, Split(11))
    for same in (
        prepare_atlas(section, Split(11)),
        unpack_atlas(
            pack_atlas(atlas, prepare.split_images(section, Split(11))), prepare.split_images(section, Split(11))
        ),
    ):
        assert (same.patches, same.report, same.pictures) == (atlas.patches, atlas.report, atlas.pictures)
        np.testing.assert_array_equal(same.layers, atlas.layers)
    assert "mine/2" in atlas.report.named_images
    found = named_images(section, atlas.report.named_images, Split(11), prepare.split_images(section, Split(11)))
    assert set(found) == atlas.report.named_images
    # Pictures are drawn again as they were, whichever are asked for, and those of a split are its own.
    of_split = prepare_atlas(section, VALIDATION).pictures
    assert not set(of_split.values()) & set(atlas.pictures.values())
    for split, pictures in ((Split(11), atlas.pictures), (VALIDATION, of_split)):
        assert pictures
        assert pictures.keys() <= {f"mine/{number}" for number in (0, 1, 3)}
        for name, digest in pictures.items():
            ((found_name, again),) = named_images(section, [name], split, prepare.split_images(section, split)).items()
            assert (found_name, hashlib.sha256(again.pixels.tobytes()).hexdigest()) == (name, digest)
    assert draw_texture_sheet(atlas, found, "title").width == 1600


def test_a_dataset_tells_of_its_pictures(tmp_path: Path) -> None:
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


def test_every_source_that_a_config_may_name_is_in_the_table() -> None:
    assert set(SOURCES) == set(TEXTURE_SOURCES)
    assert [name for name, source in SOURCES.items() if source.pictures] == ["builtin"]
    assert describe_source("of-a-plugin").files(SECTION) == ()
