"""Building an atlas: which crops it keeps, what the report counts, fair shares, and the same result per seed."""

import hashlib
from collections import Counter
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from photograph_like import noise, octaves, save
from PIL import Image, ImageFilter

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures import clips
from semisynth_gl.textures.canvas import PaintedPicture
from semisynth_gl.textures.clips import natural_key
from semisynth_gl.textures.crops import Square, cut_crop, texture_measure
from semisynth_gl.textures.images import read_image
from semisynth_gl.textures.selection import PATCHES_PER_SUBJECT, build_atlas

FLAT = np.full((64, 64, 3), 90, dtype=np.uint8)
KEYS = {"patch_px": 32, "scales": (1.0,), "min_texture": 3.0, "min_sharpness": 0.0, "min_difference": 0.0}


def build(images, pictures=None, *, seed=0, **keys):
    section = TexturesSection(**{**KEYS, "max_patches": 100, **keys})
    return build_atlas(images, section, np.random.default_rng(seed), pictures)


def check_consistent(atlas, images_given, min_texture=3.0):
    report, side = atlas.report, atlas.report.patch_px
    assert atlas.layers.shape == (sum(patch.layer_count for patch in atlas.patches), side, side, 4)
    assert atlas.layers.dtype == np.uint8
    assert atlas.layers.flags.c_contiguous
    assert (atlas.layers[..., 3] == 255).all()
    assert report.total("kept") == len(atlas.patches)
    accounted = report.images_used + report.images_unused + report.images_too_small + report.images_not_opened
    assert accounted + len(report.images_skipped) == images_given
    at = 0
    for patch in atlas.patches:
        assert patch.first_layer == at
        at += patch.layer_count
        assert patch.texture == min(texture_measure(layer[..., :3]) for layer in atlas.pixels(patch)) >= min_texture
    by_source = [list(own) for _, own in groupby(atlas.patches, lambda patch: patch.source)]
    assert len(by_source) == len({patch.source for patch in atlas.patches})
    for own in by_source:
        places = [(patch.side_px, patch.top_px, patch.left_px) for patch in own]
        assert places == sorted(places)
    assert sum(report.surface_shares.values()) == pytest.approx(1)
    assert set(report.surface_shares) == {patch.source for patch in atlas.patches}


def longest_clip(atlas):
    return max(patch.layer_count for patch in atlas.patches)


def test_patches_hold_the_pixels_of_their_squares(tmp_path):
    paths = save(tmp_path, a=noise(70, 100), b=noise(64, 64, 1))
    pictures = {name: noise(70, 100, number) for number, name in enumerate(("p", "q/r"), start=2)}
    atlas = build(paths, [PaintedPicture(*each) for each in pictures.items()], scales=(1, 1.5, 2))
    check_consistent(atlas, 4)
    assert {patch.side_px for patch in atlas.patches} == {32, 48, 64}
    for patch in atlas.patches:
        square = Square(patch.source, patch.left_px, patch.top_px, patch.side_px)
        image = pictures.get(patch.source)
        expected = cut_crop(read_image(tmp_path / patch.source) if image is None else image, square, 32)
        np.testing.assert_array_equal(atlas.layers[patch.first_layer, ..., :3], expected)
    assert atlas.pictures == {name: hashlib.sha256(pixels.tobytes()).hexdigest() for name, pixels in pictures.items()}


def test_report_counts_every_image_and_crop(tmp_path):
    half = noise(96, 192)  # 9 crops with texture, 9 flat ones
    half[:, 96:] = 90
    paths = save(tmp_path, half=half, flat=FLAT, small=noise(31, 200), good=noise(96, 96, 2))
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"no image")
    atlas = build([*paths, broken, tmp_path / "absent.png"], max_patches=12)
    check_consistent(atlas, 6)
    report = atlas.report
    assert (report.images_used, report.images_unused, report.images_too_small) == (2, 1, 1)
    assert [skipped.path.name for skipped in report.images_skipped] == ["absent.png", "broken.jpg"]
    assert (report.total("kept"), report.total("flat"), report.total("surplus")) == (12, 13, 6)
    for said in ("12 patches", "13 flat", "6 surplus", "2 not usable", "broken.jpg: is not an image"):
        assert said in report.summary()


def test_a_large_image_does_not_crowd_out_the_others_and_scales_take_turns(tmp_path):
    paths = save(tmp_path, huge=noise(640, 640), a=noise(64, 64, 1), b=noise(64, 64, 2), c=noise(32, 32, 3))
    for most, of_each in ((10, 3), (50, 4)):  # the large image fills what the small ones leave
        counts = Counter(patch.source for patch in build(paths, max_patches=most).patches)
        assert counts == {"huge.png": most - 1 - 2 * of_each, "a.png": of_each, "b.png": of_each, "c.png": 1}
    atlas = build(paths[:1], scales=(1, 2, 4), max_patches=12)
    assert Counter(patch.side_px for patch in atlas.patches) == {32: 4, 64: 4, 128: 4}


def test_the_same_seed_gives_the_same_whatever_the_order(tmp_path):
    paths = save(tmp_path, **{f"i{i}": noise(96, 128, i) for i in range(6)})
    first, again = build(paths, max_patches=20), build(paths[::-1], max_patches=20)
    assert (first.patches, first.report) == (again.patches, again.report)
    np.testing.assert_array_equal(first.layers, again.layers)
    assert build(paths, max_patches=20, seed=1).patches != first.patches


def test_sources_do_not_depend_on_where_the_folder_lies(tmp_path, monkeypatch):
    paths = save(tmp_path / "one", a=noise(32, 32)) + save(tmp_path / "two", a=noise(32, 32, 1))
    assert [patch.source for patch in build(paths).patches] == ["one/a.png", "two/a.png"]
    monkeypatch.chdir(tmp_path)
    assert [patch.source for patch in build([Path("one/a.png")]).patches] == ["a.png"]


def test_no_more_images_are_opened_than_needed(tmp_path, monkeypatch):
    paths = save(tmp_path, **{f"i{i:02d}": noise(96, 96, i) for i in range(30)})
    opened: list[Path] = []

    def read_and_note(path):
        opened.append(path)
        return read_image(path)

    monkeypatch.setattr(clips, "read_image", read_and_note)
    atlas = build(paths, max_patches=20)
    check_consistent(atlas, 30)
    assert len(opened) == 20 / PATCHES_PER_SUBJECT
    assert atlas.report.images_not_opened == 25
    assert len({patch.source for patch in atlas.patches}) == 5


def test_blurred_crops_are_left_out_where_reducing_does_not_sharpen_them(tmp_path):
    soft = np.asarray(Image.fromarray(octaves(1)).filter(ImageFilter.GaussianBlur(5)))
    sharp = {"patch_px": 64, "min_texture": 1, "min_sharpness": 0.3}
    atlas = build(save(tmp_path, sharp=octaves(0), soft=soft), scales=(1, 4), **sharp)
    check_consistent(atlas, 2, min_texture=1)
    counts = {(count.source, count.side_px): count for count in atlas.report.counts}
    assert (counts["sharp.png", 64].kept, counts["sharp.png", 256].kept) == (16, 1)
    assert (counts["soft.png", 64].kept, counts["soft.png", 64].blurred) == (0, 16)
    assert counts["soft.png", 256].kept == 1  # a quarter of its size is sharp
    with pytest.raises(InputError, match="16 blurred"):
        build(save(tmp_path / "soft", soft=soft), **sharp)


def test_the_same_photograph_twice_counts_once(tmp_path):
    pixels = np.asarray(Image.fromarray(noise(24, 32)).resize((128, 96), Image.Resampling.BICUBIC))
    paths = save(tmp_path, a=pixels, other=noise(96, 128, 5), darker=(pixels * 0.8).astype(np.uint8))
    Image.fromarray(pixels).save(tmp_path / "b.jpg", quality=70)
    paths.append(tmp_path / "b.jpg")
    atlas = build(paths, min_difference=0.04)
    check_consistent(atlas, 4)
    assert (atlas.report.total("kept"), atlas.report.total("duplicate")) == (24, 24)
    same = [patch for patch in atlas.patches if patch.source != "other.png"]
    assert len({(patch.left_px, patch.top_px) for patch in same}) == len(same) == 12
    again = build(paths[::-1], min_difference=0.04)
    assert (atlas.patches, atlas.report) == (again.patches, again.report)
    assert build(paths, min_difference=0).report.total("kept") == 48
    tiled = build(save(tmp_path / "tiled", tiled=np.tile(noise(32, 32), (2, 2, 1))), min_difference=0.04)
    assert (tiled.report.total("kept"), tiled.report.total("duplicate")) == (1, 3)
    # Frames of a video may resemble each other.
    frames = save(tmp_path / "video", **{f"f{i}": noise(32, 32) for i in range(17)})
    assert build(frames, min_difference=0.04).report.total("kept") == 1
    assert build(frames, min_difference=0.04, sequence=True).report.total("kept") == 2


def test_nothing_left_is_an_error_with_reasons(tmp_path):
    with pytest.raises(InputError, match="no patch can be cut from 0 images"):
        build([])
    paths = save(tmp_path, flat=FLAT, small=noise(20, 20))
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(InputError) as caught:
        build([*paths, tmp_path / "text.png"])
    with pytest.raises(InputError, match=r"none of 1 image can be read: text\.png is not an image[^\n]*$"):
        build([tmp_path / "text.png"])
    for said in ("3 images", "4 flat", "min_texture", "1 smaller than 32", "text.png: is not an image"):
        assert said in str(caught.value)


def test_numbers_in_names_count_as_numbers():
    ordered = ["2.png", "10b.png", "a.png", "frame01.png", "frame1.png", "frame2.png", "frame10.png"]
    assert [path.name for path in sorted(map(Path, sorted(ordered)), key=natural_key)] == ordered


def frames(folder, count, height=64, width=64):
    return save(folder, **{f"frame{i}": noise(height, width, i) for i in range(1, count + 1)})


def test_layers_of_a_patch_are_the_same_square_of_successive_frames(tmp_path):
    paths = frames(tmp_path / "video", 11) + frames(tmp_path / "other", 2, 32, 32)
    atlas = build(paths, sequence=True)
    check_consistent(atlas, 13)
    assert sorted(patch.layer_count for patch in atlas.patches) == [2, 11, 11, 11, 11]
    for patch in atlas.patches:
        assert patch.source in {"video/frame1.png", "other/frame1.png"}
        for i in range(patch.layer_count):
            image = read_image(tmp_path / patch.source.replace("frame1", f"frame{i + 1}"))
            square = image[patch.top_px : patch.top_px + 32, patch.left_px : patch.left_px + 32]
            np.testing.assert_array_equal(atlas.layers[patch.first_layer + i, ..., :3], square)
    assert longest_clip(build(paths)) == 1


def test_clips_are_cut_to_fit_into_the_layers(tmp_path, monkeypatch):
    paths = frames(tmp_path, 10)  # 4 square crops a frame
    monkeypatch.setattr(clips, "MOST_FRAMES", 8)
    assert longest_clip(build(paths, sequence=True)) == 5  # 10 frames become 5 + 5
    for most in (3, 4, 9, 16, 30):
        monkeypatch.setattr(clips, "MOST_LAYERS", most)
        atlas = build(paths, sequence=True, max_patches=min(most, 100))
        check_consistent(atlas, 10)
        assert len(atlas.layers) <= most
    monkeypatch.setattr(clips, "MOST_FRAMES", 16)
    monkeypatch.setattr(clips, "MOST_LAYERS", 20)
    assert longest_clip(build(paths, sequence=True, max_patches=2)) == 10
    paths[0].write_bytes(b"")
    Image.fromarray(noise(32, 32)).save(paths[-1])
    assert len(build(paths, sequence=True, max_patches=20).layers) <= 20


def test_frames_that_cannot_be_used_are_left_out_of_their_clip_and_a_flat_one_spoils_its_crop(tmp_path):
    half_flat = noise(64, 64, 2)
    half_flat[:32, :32] = 7
    paths = frames(tmp_path / "flat", 3)
    save(tmp_path / "flat", frame2=half_flat)
    atlas = build(paths, sequence=True)
    assert (atlas.report.total("kept"), atlas.report.total("flat"), longest_clip(atlas)) == (3, 1, 3)
    paths = frames(tmp_path, 5, 64, 96)
    whole = paths[1].read_bytes()
    paths[1].write_bytes(whole[: len(whole) // 2])  # the header is complete, pixels are missing
    paths[3].write_bytes(b"")
    exif = Image.Exif()
    exif[0x0112] = 6  # rotated by 90 degrees
    Image.fromarray(noise(64, 96, 5)).save(paths[4], exif=exif)
    atlas = build(paths, sequence=True)
    check_consistent(atlas, 5)
    assert [skipped.path.stem for skipped in atlas.report.images_skipped] == ["frame2", "frame4", "frame5"]
    assert longest_clip(atlas) == 2
