"""Photographs of one subject: recognised by names, kept in one split, with one share of the patches."""

from collections import Counter
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from photograph_like import octaves, save

from semisynth_gl.config.model import SplitsSection
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.seeds.splits import SPLITS, Split
from semisynth_gl.textures.prepare import prepare_atlas, share_photographs, split_images
from semisynth_gl.textures.subjects import group_by_subject, subject_numbers

HELD_OUT = {"validation": 0.1, "test": 0.1}


def views(seed):
    """Make two overlapping images of a scene."""
    wide = octaves(seed, 240, 360)
    return wide[:, 40:], wide[:, :320]


ONE_SUBJECT = [
    ["Australia/im0.png", "Australia/im1.png", "Australia/im1E.png", "Australia/im1L.png"],
    ["Piano_im0.png", "Piano_im1.png"],
    ["Art/view0.png", "Art/view3.png", "Art/view6.png", "Art/Illum1/Exp0/view1.png", "Art/Illum3/Exp2/view5.png"],
    ["room/im0.png", "room/ambient/L1/im0e0.png", "room/ambient/F0/im1e4.png"],
    ["a/left_0001.jpg", "a/right_0001.jpg"],
    ["a/imageLeft7.jpg", "a/imageRight7.jpg"],
    ["a/hall_l.jpg", "a/hall_r.jpg"],
    ["a/0017L.jpg", "a/0017R.jpg"],
    ["left/0001.png", "right/0001.png"],
    ["leftImg8bit/x/x_1_leftImg8bit.png", "rightImg8bit/x/x_1_rightImg8bit.png"],
    ["kitti/image_2/000017_10.png", "kitti/image_3/000017_10.png", "kitti/image_2/000017_11.png"],
    ["drive/image_02/data/0000000005.png", "drive/image_03/data/0000000005.png"],
    ["mav0/cam0/data/14036365.png", "mav0/cam1/data/14036365.png"],
    ["a/cam1_0004.png", "a/cam2_0004.png", "a/cam3_0004.png"],
    ["eth3d/delivery_area_1l/im0.png", "eth3d/delivery_area_1s/im1.png"],
]
OTHERS = [
    # Frames of a video and scenes of a dataset.
    ["left/0001.png", "right/0002.png"],
    ["image_2/000017_10.png", "image_3/000018_10.png"],
    ["eth3d/delivery_area_1l.png", "eth3d/delivery_area_2l.png", "eth3d/delivery_area_3l.png"],
    ["Australia/im0.png", "Chess/im0.png", "Chess_2/im1.png"],
    # Names that only resemble those of views.
    ["a/im9.png", "a/im10.png", "a/im12.png"],
    ["a/view1.png", "a/view9.png"],
    ["a/bright.png", "a/blight.png", "a/cleft.png", "a/cright.png"],
    ["a/hall.png", "a/hall_l.png", "a/hallway_r.png"],
    ["a/IMG_0001.jpg", "a/IMG_0002.jpg", "a/IMG_0003.jpg"],
    ["a/left.png", "b/right.png"],
    # Folders with several photographs.
    [f"place/{number}.png" for number in range(5)],
    ["a/1.png", "a/2.png", "b/1.png", "b/2.png"],
]


@pytest.mark.parametrize("names", ONE_SUBJECT, ids=lambda names: names[0])
def test_names_tell_views_of_one_subject(names):
    photographs = [Path("place") / name for name in ["other/IMG_7.png", *names]]
    assert group_by_subject(photographs) == [photographs[:1], photographs[1:]]
    assert subject_numbers(photographs) == [0, *[1] * len(names)]


@pytest.mark.parametrize("names", OTHERS, ids=lambda names: names[0])
def test_names_that_tell_nothing_make_no_subject(names):
    assert subject_numbers(list(map(Path, names))) == list(range(len(names)))


@given(st.lists(st.integers(1, 5), min_size=3, max_size=40), st.integers(0, 2**32), st.booleans())
def test_no_subject_is_in_two_splits(sizes, seed, both):
    numbers = iter(range(sum(sizes)))
    groups = [[Path(f"{next(numbers):03d}.png") for _ in range(size)] for size in sizes]
    held_out = HELD_OUT if both else {"test": 0.3}
    names = [name for name in SPLITS if name == "train" or name in held_out]
    taken = {name: share_photographs(Split(seed, name, held_out), groups, "photographs") for name in names}
    assert sum(map(len, taken.values())) == sum(sizes)
    assert set.union(*taken.values()) == {*chain.from_iterable(groups)}
    for group in groups:
        assert [bool(taken[name].intersection(group)) for name in names].count(True) == 1
    # Another photograph of a subject does not move the others to another split.
    groups[0].append(Path("more.png"))
    again = {name: share_photographs(Split(seed, name, held_out), groups, "photographs") for name in names}
    assert {name: again[name] - {Path("more.png")} for name in names} == taken


def test_both_views_of_image_sequences_are_in_one_split(tmp_path):
    for take in range(3):
        left, right = views(take)
        save(tmp_path / f"take{take}/left", **{f"{frame}": left // (frame + 1) for frame in range(3)})
        save(tmp_path / f"take{take}/right", **{f"{frame}": right // (frame + 1) for frame in range(3)})
    section = TexturesSection(source="images", images=(str(tmp_path),), sequence=True)
    taken = [split_images(section, SplitsSection().split(name, SPLITS, 1)) for name in SPLITS]
    assert [len({path.parent.parent for path in each}) for each in taken] == [1, 1, 1]
    assert list(map(len, taken)) == [6, 6, 6]


def test_one_subject_is_too_few_for_splits(tmp_path):
    left, right = views(0)
    save(tmp_path, im0=left, im1=right)
    section = TexturesSection(source="images", images=(str(tmp_path),), patch_px=64)
    message = "^too few photographs of different subjects to hold some out, 1 in all: 1 for validation"
    with pytest.raises(InputError, match=message):
        prepare_atlas(section, SplitsSection().split("validation", ("train", "validation"), 0))
    assert prepare_atlas(section, Split(0)).report.images_used == 2


def built(folder, **keys):
    keys = {"patch_px": 64, "scales": (1.0,), **keys}
    return prepare_atlas(TexturesSection(source="images", images=(str(folder),), **keys), Split(0))


def test_a_subject_has_one_say_however_many_photographs_show_it(tmp_path):
    many = {f"im{number}": np.roll(octaves(0, 240, 320), 7 * number, axis=1) for number in range(8)}
    save(tmp_path / "many", **many)
    for number in range(1, 5):
        save(tmp_path / "single", **{f"s{number}": octaves(number, 240, 320)})
    full = built(tmp_path, max_patches=80)  # 12 photographs with 20 squares each
    assert set(full.report.subjects.values()) == {"many/im0.png"}
    kept = Counter(patch.subject_name for patch in full.patches)
    assert kept == {"many/im0.png": 16, **{f"single/s{number}.png": 16 for number in range(1, 5)}}
    assert len({patch.source for patch in full.patches}) == 12
    shares = full.report.surface_shares
    assert [shares[f"single/s{number}.png"] for number in range(1, 5)] == pytest.approx([0.2] * 4)
    assert sum(shares[f"many/{name}.png"] for name in many) == pytest.approx(0.2)
    assert "from 12 images of 5 subjects;" in full.report.summary()
    described = [patch.as_json().get("subject") for patch in full.patches]
    assert Counter(described) == {"many/im0.png": 16, None: 64}
    # With fewer patches, all subjects still have the same number.
    assert set(Counter(patch.subject_name for patch in built(tmp_path, max_patches=20).patches).values()) == {4}
    # Each subject has one large patch.
    atlas = built(tmp_path, max_patches=60, large_px=96)
    large = [patch.subject_name for patch in atlas.patches if patch.large]
    assert Counter(large) == {patch.subject_name: 1 for patch in atlas.patches}
    assert len(large) == 5
