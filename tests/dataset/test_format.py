"""The format of datasets: one kept from format 1, read by this program, and what this one does with other formats.

`tests/data/format-1` was written by version 0.1.0, for each LAYOUT by

    semisynth-gl generate --config tests/data/format-1.yaml --layout LAYOUT --pairs 1 --seed 1 \\
        --out tests/data/format-1/LAYOUT

It is not to be made again: a change that needs it made again has broken the datasets of users.
"""

import io
import json
import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from semisynth_gl import InputError, open_dataset
from semisynth_gl.config import load_config
from semisynth_gl.dataset.documents import FORMAT, INDEX, PLAN
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import read_index
from semisynth_gl.judge.verify import verify_dataset

DATA = Path(__file__).parents[1] / "data"
KEPT = DATA / "format-1"
SHARD = "shards/semisynth-kept-train-000000"
# The files of both views, by channel.
FILES = {
    "webdataset": {
        "image": ("00000000.left.png", "00000000.right.png"),
        "disparity": ("00000000.disp0.pfm", "00000000.disp1.pfm"),
        "visibility": ("00000000.mask0.png", "00000000.mask1.png"),
        "depth": ("00000000.depth0.pfm", "00000000.depth1.pfm"),
    },
    "crestereo": {
        "image": ("000000_left.jpg", "000000_right.jpg"),
        "disparity": ("000000_left.disp.png", "000000_right.disp.png"),
        "visibility": ("000000_left.mask.png", "000000_right.mask.png"),
        "depth": ("000000_left.depth.pfm", "000000_right.depth.pfm"),
    },
}
LAYOUTS = tuple(FILES)
# What the first pixels of a row were when the dataset was made, whatever reads it; CREStereo counts in 1/32 px.
DISPARITY_PX = {"webdataset": [1.3519557, 1.3307121, 1.3094685], "crestereo": [1.34375, 1.34375, 1.3125]}


def stored(layout, name):
    """The values of a file, read without this program."""
    folder = KEPT / layout
    if layout == "webdataset":
        with tarfile.open(folder / f"{SHARD}.tar") as tar:
            data = tar.extractfile(name).read()
    else:
        data = (folder / "CREStereo/shapenet" / name).read_bytes()
    if not name.endswith(".pfm"):
        values = np.asarray(Image.open(io.BytesIO(data)))
        return np.float32(values) / 32 if ".disp." in name else values
    # Three lines of a header, then rows from bottom to top.
    return np.frombuffer(data.split(b"\n", 3)[3], "<f4").reshape(12, 16)[::-1]


@pytest.fixture(params=LAYOUTS)
def kept(request, tmp_path):
    return shutil.copytree(KEPT / request.param, tmp_path / request.param)


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_dataset_of_format_1_is_read_value_by_value(layout):
    [pair] = open_dataset(KEPT / layout)
    for number, view in enumerate((pair.left, pair.right)):
        assert set(view) == set(FILES[layout])
        for channel, names in FILES[layout].items():
            expected = stored(layout, names[number])
            if channel == "visibility":  # files say of points outside of the other image that they are hidden
                x = np.arange(16) + (-view.disparity if number == 0 else view.disparity)
                expected = np.where((expected == 128) & ((x < -0.5) | (x >= 15.5)), 0, expected)
            np.testing.assert_array_equal(view[channel], expected, err_msg=f"{channel} {number}")
    # Decoders of JPEG round in their own ways.
    assert pair.left.image[0, 0].tolist() == pytest.approx([135, 184, 93], abs=2 if layout == "crestereo" else 0)
    assert pair.left.disparity[5, :3].tolist() == pytest.approx(DISPARITY_PX[layout], abs=1e-7)
    assert pair.left.visibility[5].tolist() == [0] + [255] * 15
    camera = pair.camera
    assert (camera.width_px, camera.height_px, camera.focal_px, camera.baseline_m) == (16, 12, 16, 0.5)
    assert (camera.cx_left_px, camera.cx_right_px, camera.cy_px) == (7.25, 7.75, 5.5)
    assert (pair.name, pair.split, pair.index) == ("kept-000000", "train", 0)
    assert (pair.provenance["version"], pair.provenance["seed"]) == ("0.1.0", 1)


def test_verify_knows_a_dataset_of_format_1(kept):
    before = contents(kept)
    assert [finding for verdict in verify_dataset(read_index(kept)) for finding in verdict.findings] == []
    assert contents(kept) == before


def test_a_newer_format_is_refused_and_a_missing_one_is_the_first(kept):
    values = json.loads((kept / INDEX).read_text())
    assert values.pop("format") == 1 <= FORMAT
    (kept / INDEX).write_text(json.dumps(values))
    assert read_index(kept).plan.format == 1
    for name in (INDEX, PLAN):
        newer = {"format": FORMAT + 1, "version": "9.1.0", "pairs": "as nobody knows"}
        (kept / name).write_text(json.dumps(json.loads((kept / name).read_text()) | newer))
    before = contents(kept)
    for use in (open_dataset, lambda out: generate(load_config(DATA / "format-1.yaml"), out, 1, 1, overwrite=True)):
        with pytest.raises(InputError, match=rf"format: expected at most {FORMAT}, .* '9\.1\.0' wrote"):
            use(kept)
    assert contents(kept) == before
