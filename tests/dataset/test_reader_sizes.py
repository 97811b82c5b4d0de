"""Files of another size than the dataset's images have: every file of every layout is refused by name."""

import json
from dataclasses import replace
from itertools import cycle

import hand_made_datasets
import numpy as np
import pytest
from hand_made_datasets import config_of, write_dataset
from hand_made_pairs import CAMERA

from semisynth_gl.codecs import Encodings
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.dataset.sample import EncodedPair, encode_pair
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.frame.channels import OUTPUTS
from semisynth_gl.inputs.errors import ReadError
from semisynth_gl.judge.verify import verify_dataset
from semisynth_gl.layouts import Key, find_layout, layout_names

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
        values = json.loads(value["provenance"]) if "provenance" in value else value
        values["camera"]["width_px"] = 50
        return codec.encode(value | {"provenance": json.dumps(values)} if "provenance" in value else values), "50 x 32"
    camera = value if isinstance(value, StereoCamera) else value.camera
    wider = replace(camera, width_px=50)
    return codec.encode(wider if value is camera else replace(value, camera=wider)), "50 x 32"


def roles_of(layout):
    """The roles of a layout's files, with all outputs that it has files for."""
    return list(layout.files(Key("lab", "train", 0), layout.encodings or Encodings(), outputs_of(layout)))


def outputs_of(layout):
    """All outputs that a layout has files for; no raw images from JPEG."""
    lossless = (layout.encodings or Encodings()).image.lossless
    return [output for output in OUTPUTS if output not in layout.lacks and (lossless or output != "raw")]


def written(out, name, monkeypatch):
    """Write a dataset in which pair k has the k-th role's file changed, and one more pair, which is as it should be.

    Returns:
        By number of the pair, what `other_size` returned beside the file.
    """
    layout = find_layout(name)
    roles, made = roles_of(layout), {}

    def encode(layout, key, frame, provenance, ndisp, encodings):
        files = encode_pair(layout, key, frame, provenance, ndisp, encodings).files
        if key.index < len(roles):
            role = roles[key.index]
            path = layout.files(key, encodings)[role]
            files[path], made[key.index] = other_size(files[path], path, layout.role(role).codec(encodings))
        return EncodedPair(files, 0.0)

    monkeypatch.setattr(hand_made_datasets, "encode_pair", encode)
    eye = {"fx_px": 50, "distortion": [0, 0, 0, 0]}
    lens = {"raw_width_px": 64, "raw_height_px": 48, "left": eye, "right": eye}
    config = config_of(outputs=outputs_of(layout), lens=lens)
    write_dataset(out, name, {"train": len(roles) + 1}, 100, config)
    return made


@pytest.mark.parametrize("name", layout_names())
def test_a_file_of_another_size_is_refused(tmp_path, monkeypatch, name):
    made = written(tmp_path / "set", name, monkeypatch)
    roles = roles_of(find_layout(name))
    assert {"left", "right", "disparity_left", "provenance"} <= set(roles)
    assert len(made) == len(roles)
    dataset = open_dataset(tmp_path / "set")
    for number, role in enumerate(roles):
        path = dataset.about.plan.files("train", number)[role]
        with pytest.raises(ReadError) as refused:
            dataset[number]
        assert str(refused.value).startswith(f"{tmp_path}/set/{path}: expected "), role
        assert str(made[number]) in refused.value.reason, role
    assert dataset[len(roles)].left.image.shape == (*SIZE, 3)
    verdicts = list(verify_dataset(read_index(tmp_path / "set")))[1:]
    for number, role in enumerate(roles):
        path = dataset.about.plan.files("train", number)[role]
        sizes = [finding.message for finding in verdicts[number].findings if finding.check == "size"]
        assert len(sizes) == 1, role
        assert path in sizes[0]
    assert not [finding for finding in verdicts[-1].findings if finding.check == "size"]


def test_a_pair_of_another_dataset_is_refused(tmp_path):
    """All of its files are of one size, and of another one than the dataset's."""
    write_dataset(tmp_path / "set", "eth3d", {"train": 1}, 1)
    index = json.loads((tmp_path / "set/index.json").read_text())
    index["config_values"]["camera"]["height_px"] = 64
    (tmp_path / "set/index.json").write_text(json.dumps(index))
    with pytest.raises(ReadError, match=r"im0\.png: expected shape \(64, 48, 3\)"):
        open_dataset(tmp_path / "set")[0]
