"""``semisynth-gl preview --patches``: the sheet of patches, the table of counts, and their cache."""

from collections import Counter

import numpy as np
import pytest
from photograph_like import noise, octaves, save
from PIL import Image, ImageFilter, ImageOps
from processes import assert_refused
from shared_material import SHARED, needs_shared

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.crop_report import make_texture_sheet
from semisynth_gl.textures.image_files import printable
from semisynth_gl.textures.prepare import prepare_atlas


@pytest.fixture
def photographs(tmp_path):
    """Write photographs: good, partly flat, blurred, a duplicate, too small, and a broken file."""
    folder = tmp_path / "photos"
    good, flat = octaves(0, 288, 288), octaves(1, 288, 288)
    flat[:150] = 200
    soft = Image.fromarray(octaves(2, 288, 288)).filter(ImageFilter.GaussianBlur(5))
    soft = np.asarray(ImageOps.autocontrast(soft, cutoff=1))
    save(folder, good=good, flat=flat, soft=soft, small=good[:30, :40])
    Image.fromarray(good).save(folder / "again.jpg", quality=80)
    (folder / "broken.png").write_bytes(b"no image")
    return folder


def section(folder, **values):
    given = {"source": "images", "images": (str(folder),), "patch_px": 64, "scales": (1.0, 2.0)}
    return TexturesSection(**given | values)


def shows(sheet, tile):
    height, width = tile.shape[:2]
    corners = np.argwhere((sheet == tile[0, 0]).all(axis=2)).tolist()
    return any(np.array_equal(sheet[row : row + height, column : column + width], tile) for row, column in corners)


def test_the_sheet_shows_every_patch_and_the_report_counts_them(photographs):
    atlas = prepare_atlas(section(photographs), Split(0))
    patches = [(patch.source, atlas.pixels(patch)[0, ..., :3]) for patch in atlas.patches]
    sheet = np.asarray(make_texture_sheet(atlas.report, patches, "title"))
    assert all(shows(sheet, pixels) for _, pixels in patches[::11])
    counted = {(count.source, count.side_px): count.kept for count in atlas.report.counts if count.kept}
    assert counted == Counter((patch.source, patch.side_px) for patch in atlas.patches)


PREVIEW = ("preview", "--patches", "--config", "middlebury")


def test_the_command_counts_by_source_and_scale(program, tmp_path, photographs):
    small = ("--set", "textures.patch_px=64", "--set", "textures.scales=[1, 2]")
    code, out, err = program(*PREVIEW, "--images", photographs, *small, "--out", "sheet.png")
    assert (code, err) == (0, "")
    table = {line.split()[0]: line.split()[1:] for line in out.splitlines()}
    columns = ["patches", "at", "1x", "at", "2x", "flat", "blurred", "duplicate", "surplus", "surfaces"]
    assert table["image"] == columns
    atlas = prepare_atlas(section(photographs), Split(0))
    rejected = [str(atlas.report.total(reason)) for reason in ("flat", "blurred", "duplicate")]
    assert (table["all"][0], *table["all"][3:]) == (str(len(atlas.patches)), *rejected, "0", "100.0%")
    assert table["good.png"][-1] == f"{atlas.report.surface_shares['good.png']:.1%}"
    assert "broken.png: is not an image" in out
    assert "1 smaller than 64 pixels" in out
    assert Image.open(tmp_path / "sheet.png").size[0] == 1600


def test_any_file_name_can_be_shown(program, tmp_path):
    (tmp_path / "p").mkdir()
    name = "a\nb \U0001f600 \u6f22 and a long, long name of a photograph.png"
    Image.fromarray(noise(64, 64)).save(tmp_path / "p" / name)
    code, out, err = program(*PREVIEW, "--images", "p", "--set", "textures.patch_px=64")
    assert (code, err) == (0, "")
    assert "a?b" in out
    assert (tmp_path / "preview.png").is_file()
    assert printable("a\udcffb") == "a?b"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "sheet.jpg"], "ends in .png"),
        (["--out", "no/sheet.png"], "does not exist"),
        (["--pairs", "2"], "--patches shows no pairs: leave --pairs out"),
        (["--set", "textures.source=images"], "textures.images is empty: set it to your photographs"),
    ],
)
def test_wrong_input_writes_nothing(program, tmp_path, arguments, words):
    assert_refused(program(*PREVIEW, *arguments), words)
    assert not list(tmp_path.iterdir())


@needs_shared
def test_ordinary_photographs_are_neither_blurred_nor_alike():
    atlas = prepare_atlas(section(SHARED / "textures/*/*.png", patch_px=256), Split(0))
    assert atlas.report.total("kept") > 80
    assert (atlas.report.total("blurred"), atlas.report.total("duplicate")) == (0, 0)
