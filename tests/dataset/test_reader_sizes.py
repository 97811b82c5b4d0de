"""Files of another size than the dataset's images have: every file of every layout is refused by name."""

import json
import re
from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest
from hand_made_datasets import config_of, write_dataset
from hand_made_pairs import CAMERA

from semisynth_gl.codecs import Encodings
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import OUTPUTS
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.judge.verify import verify_dataset
from semisynth_gl.layouts import find_layout, layout_names

SIZE = CAMERA.height_px, CAMERA.width_px


def doubled(array):
    return array.repeat(2, axis=0).repeat(2, axis=1)


OTHER_SIZES = cycle((lambda array: array[:-1], lambda array: array[:, :-1], doubled))


def other_size(data, path, codec):
    """A file as it would be of other images, and the shape, or size of the camera, in it."""
    value = codec.decode(data, path)
    if isinstance(value, np.ndarray):
        changed = np.ascontiguousarray(next(OTHER_SIZES)(value))
        return codec.encode(changed), changed.shape
    if isinstance(value, dict):
        value["camera"]["width_px"] = 50
        return codec.encode(value), "50 x 32"
    camera = value if isinstance(value, StereoCamera) else value.camera
    wider = replace(camera, width_px=50)
    return codec.encode(wider if value is camera else replace(value, camera=wider)), "50 x 32"


@pytest.mark.parametrize("name", [name for name in layout_names() if not find_layout(name).packed])
def test_a_file_of_another_size_is_refused(tmp_path, name):
    layout = find_layout(name)
    lossless = (layout.encodings or Encodings()).image.lossless
    outputs = [output for output in OUTPUTS if output not in layout.lacks and (lossless or output != "raw")]
    eye = {"fx_px": 50, "distortion": [0, 0, 0, 0]}
    lens = {"raw_width_px": 64, "raw_height_px": 48, "left": eye, "right": eye}
    write_dataset(tmp_path, name, {"train": 1}, 1, config_of(outputs=outputs, lens=lens))
    dataset = open_dataset(tmp_path)
    plan = dataset.about.plan
    assert dataset[0].left.image.shape == (*SIZE, 3)
    for role, path in plan.files("train", 0).items():
        data = (tmp_path / path).read_bytes()
        changed, size = other_size(data, path, layout.role(role).codec(plan.encodings))
        (tmp_path / path).write_bytes(changed)
        with pytest.raises(ReadError, match=f"^{re.escape(f'{tmp_path}/{path}')}: expected .*{re.escape(str(size))}"):
            dataset[0]
        verdicts = verify_dataset(read_index(tmp_path))
        sizes = [finding for verdict in verdicts for finding in verdict.findings if finding.check == "size"]
        assert [path in finding.message for finding in sizes] == [True], role
        (tmp_path / path).write_bytes(data)


def test_a_pair_of_another_dataset_is_refused(tmp_path):
    """All of its files are of one size, and of another one than the dataset's."""
    write_dataset(tmp_path / "set", "eth3d", {"train": 1}, 1)
    index = json.loads((tmp_path / "set/index.json").read_text())
    index["config_values"]["camera"]["height_px"] = 64
    (tmp_path / "set/index.json").write_text(json.dumps(index))
    with pytest.raises(ReadError, match=r"im0\.png: expected shape \(64, 48, 3\)"):
        open_dataset(tmp_path / "set")[0]
