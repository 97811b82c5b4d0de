"""This program reads a stored dataset of format 1, and refuses other formats.

`tests/data/format-1` was written by version 0.1.0, for each LAYOUT by

    semisynth-gl generate --config tests/data/format-1.yaml --layout LAYOUT --pairs 1 --seed 1 \\
        --out tests/data/format-1/LAYOUT

Never regenerate it: a change that cannot read it breaks users' datasets.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from semisynth_gl import InputError, open_dataset
from semisynth_gl.config import load_config
from semisynth_gl.dataset.documents import FORMAT, INDEX, PLAN
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import read_index
from semisynth_gl.judge.verify import verify

DATA = Path(__file__).parents[1] / "data"
KEPT = DATA / "format-1"
# The first pixels of a row, and the sums over the left and the right view, as version 0.1.0 wrote them. CREStereo
# stores 1/32 px; JPEG decoders round differently.
DISPARITY_PX = {"webdataset": [1.3519557, 1.3307121, 1.3094685], "crestereo": [1.34375, 1.34375, 1.3125]}
SUMS = {
    "webdataset": {"image": (76810, 76994), "disparity": (319.32737171649933, 306.65338003635406)},
    "crestereo": {"image": (76801, 77012), "disparity": (319.28125, 306.6875)},
}
SUMS_OF_BOTH = {"visibility": (42970, 40805), "depth": (804.763338804245, 795.613009929657)}


@pytest.fixture(params=SUMS)
def kept(request, tmp_path):
    return shutil.copytree(KEPT / request.param, tmp_path / request.param)


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("layout", SUMS)
def test_a_dataset_of_format_1_is_read_value_by_value(layout):
    [pair] = open_dataset(KEPT / layout)
    for number, view in enumerate((pair.left, pair.right)):
        sums = {channel: each[number] for channel, each in (SUMS[layout] | SUMS_OF_BOTH).items()}
        exact = {channel: array.sum(dtype=np.float64) for channel, array in view.items()}
        assert exact == pytest.approx(sums, rel=1e-3 if layout == "crestereo" else 1e-12)
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
    assert verify(kept, rays=0).findings == []
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
