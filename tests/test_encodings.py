"""Every encoding of images and disparities, read back by other people's readers and by verify."""

import io
import json
import sys
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest
from backends import backend_fault
from PIL import Image
from recorder import Recorder
from tiny_datasets import lean, tiny

from semisynth_gl import encodings as names
from semisynth_gl.cli import main
from semisynth_gl.dataset.reader import open_dataset, read_index
from semisynth_gl.encodings import DISPARITY_ENCODINGS, IMAGE_ENCODINGS, Encodings
from semisynth_gl.errors import InputError
from semisynth_gl.frame import OUTSIDE, VISIBLE
from semisynth_gl.generation.generate import generate
from semisynth_gl.layouts import Key, find_layout
from semisynth_gl.layouts.layout import share_beyond
from semisynth_gl.layouts.middlebury import SCENES
from semisynth_gl.pairs.pipeline import render_pair
from semisynth_gl.read.encodings import DISPARITY_DECODERS, IMAGE_DECODERS, read_with
from semisynth_gl.read.error import ReadError
from semisynth_gl.verify.dataset import verify_dataset
from semisynth_gl.write.encodings import DISPARITY_ENCODERS, IMAGE_ENCODERS

SHAPES = [(1, 1), (1, 7), (9, 1), (30, 41)]
OF_CODECS = {"qoi", "jxl"}


def image_of(shape):
    rng = np.random.default_rng(3)
    smooth = np.add.outer(np.arange(shape[0]), np.arange(shape[1]))[..., None] * np.array([1, 2, 3])
    return (smooth + rng.integers(0, 5, (*shape, 3))).astype(np.uint8)


def disparity_of(shape, low=0.01, high=255.9):
    rng = np.random.default_rng(4)
    disparity = rng.uniform(low, high, shape).astype(np.float32)
    disparity[rng.random(shape) < 0.2] = np.inf
    return disparity


def decode_file(encoding, path):
    if encoding in IMAGE_DECODERS:
        return read_with(IMAGE_DECODERS[encoding])(path)
    return read_with(DISPARITY_DECODERS[encoding].decode)(path)


def by_opencv(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


def by_another(encoding, data):
    """An image as a program that has nothing of this one reads it; for JPEG XL there is libjxl alone."""
    if encoding == "jxl":
        return pytest.importorskip("imagecodecs").jpegxl_decode(data)
    return np.asarray(Image.open(io.BytesIO(data), formats=[encoding.upper()]))


def test_every_name_has_its_encoder_and_its_reader():
    assert set(IMAGE_ENCODERS) == set(IMAGE_DECODERS) == set(IMAGE_ENCODINGS)
    assert set(DISPARITY_ENCODERS) == set(DISPARITY_DECODERS) == set(DISPARITY_ENCODINGS)
    assert Encodings() == Encodings("png", "pfm")
    assert Encodings("jxl", "png16").image_names == ("im0.jxl", "im1.jxl")
    assert Encodings("jxl", "png16").disparity_names == ("disp0GT.png", "disp1GT.png")


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("encoding", IMAGE_ENCODINGS)
def test_images_come_back_bit_for_bit(tmp_path, encoding, shape):
    if encoding in OF_CODECS:
        pytest.importorskip("imagecodecs")
    image = image_of(shape)
    data = IMAGE_ENCODERS[encoding](image)
    np.testing.assert_array_equal(by_another(encoding, data), image)
    (tmp_path / "image").write_bytes(data)
    np.testing.assert_array_equal(decode_file(encoding, tmp_path / "image"), image)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_tiff_comes_back_bit_for_bit(tmp_path, shape):
    disparity = disparity_of(shape, high=900)
    data = DISPARITY_ENCODERS["tiff"].encode(disparity)
    for came in (by_opencv(data), np.asarray(Image.open(io.BytesIO(data)))):
        assert came.dtype == np.float32
        np.testing.assert_array_equal(came, disparity)
    (tmp_path / "d.tiff").write_bytes(data)
    np.testing.assert_array_equal(decode_file("tiff", tmp_path / "d.tiff"), disparity)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_png16_is_kittis(tmp_path, shape):
    disparity = disparity_of(shape)
    data = DISPARITY_ENCODERS["png16"].encode(disparity)
    steps = by_opencv(data)
    assert steps.dtype == np.uint16
    np.testing.assert_array_equal(steps == 0, np.isinf(disparity))
    finite = np.isfinite(disparity)
    assert np.abs(steps[finite] / 256 - disparity[finite]).max(initial=0) <= 1 / 512
    (tmp_path / "d.png").write_bytes(data)
    came = decode_file("png16", tmp_path / "d.png")
    assert came.dtype == np.float32
    np.testing.assert_array_equal(came, np.where(steps > 0, steps / np.float32(256), np.inf))


def test_a_png16_ends_at_256_px_and_keeps_0_for_no_truth():
    last = np.float32(65535.5 / 256)
    disparity = np.array([[np.inf, np.nan, 0, -1, 1e-6, 1 / 256, 255.996, np.nextafter(last, 0), last, 256, 1e30]])
    steps = by_opencv(DISPARITY_ENCODERS["png16"].encode(disparity.astype(np.float32)))
    assert steps[0].tolist() == [0, 0, 0, 0, 1, 1, 65535, 65535, 0, 0, 0]


@pytest.mark.parametrize("encoding", ["qoi", "jxl", "tiff", "png16"])
def test_wrong_files_are_named(tmp_path, encoding):
    if encoding in OF_CODECS:
        pytest.importorskip("imagecodecs")
        encode, read = IMAGE_ENCODERS[encoding], read_with(IMAGE_DECODERS[encoding])
        good, other = encode(image_of((30, 41))), image_of((30, 41))[..., 0]
    else:
        encode, read = DISPARITY_ENCODERS[encoding].encode, read_with(DISPARITY_DECODERS[encoding].decode)
        good, other = encode(disparity_of((30, 41))), image_of((30, 41))
    file = tmp_path / "file"
    foreign = io.BytesIO()
    Image.fromarray(other).save(foreign, "TIFF" if encoding == "tiff" else "PNG")
    for data in (b"", good[: len(good) // 2], good[:-1], b"abc" * 50, foreign.getvalue()):
        file.write_bytes(data)
        with pytest.raises(ReadError):
            read(file)
    with pytest.raises(ReadError, match="is missing"):
        read(tmp_path / "none")


def test_grey_is_no_colour(tmp_path):
    codecs = pytest.importorskip("imagecodecs")
    (tmp_path / "i.jxl").write_bytes(codecs.jpegxl_encode(image_of((30, 41))[..., 0].copy(), lossless=True))
    with pytest.raises(ReadError, match="expected 8-bit RGB"):
        decode_file("jxl", tmp_path / "i.jxl")


@pytest.fixture(scope="module")
def shot():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return render_pair(lean(), 0, 5)


def test_what_png16_cannot_say_is_invalid_everywhere(shot):
    frame = shot
    limit = 255.998046875
    grown = {side: getattr(frame, f"disparity_{side}") * np.float32(12) for side in ("left", "right")}
    frame = type(frame)(
        frame.camera, frame.left, frame.right, grown["left"], grown["right"], frame.visibility_left,
        frame.visibility_right,
    )  # fmt: skip
    beyond = {side: disparity >= limit for side, disparity in grown.items()}
    assert 0.01 < beyond["left"].mean() < 0.9
    chosen = Encodings(disparity="png16")
    assert share_beyond(frame, chosen) == max(where.mean() for where in beyond.values())
    assert share_beyond(frame, Encodings()) == 0
    read = there_and_back(frame, {"pair": 0, "camera": asdict(frame.camera)}, chosen)
    del read.provenance["camera"]
    assert read.provenance == {
        "pair": 0,
        "disparity_beyond": {side: int(where.sum()) for side, where in beyond.items()},
    }
    np.testing.assert_array_equal(np.isinf(read.disparity_left), beyond["left"])
    np.testing.assert_array_equal(np.isinf(read.disparity_right), beyond["right"])
    assert (frame.visibility_left[beyond["left"]] == VISIBLE).any()
    assert (read.visibility_left[beyond["left"]] == OUTSIDE).all()
    np.testing.assert_array_equal(read.visibility_left[~beyond["left"]], frame.visibility_left[~beyond["left"]])
    assert read.calibration.vmax_px < 256
    assert "disparity_beyond" not in there_and_back(frame, {"pair": 0}, Encodings()).provenance


def there_and_back(frame, provenance, encodings):
    """Encode a pair in Middlebury's layout, and read the files."""
    layout, key = find_layout("middlebury"), Key("x", "train", 0)
    written = layout.encode(key, frame, provenance, 999, encodings)
    values = {
        role: layout.decode_file(role, written[path], Path(path), encodings)
        for role, path in layout.files(key, encodings).items()
        if path in written
    }
    return layout.assemble(key, values, encodings)


def findings(folder, rays=100):
    """What is found beside the digest, which gives every change of a file away."""
    return [
        str(finding)
        for verdict in verify_dataset(read_index(folder), rays)
        for finding in verdict.findings
        if finding.check != "sha256"
    ]


@pytest.mark.parametrize("chosen", [("png", "png16"), ("png", "tiff"), ("qoi", "pfm"), ("jxl", "png16")], ids="-".join)
def test_a_dataset_reads_back_and_verifies_clean(shot, tmp_path, chosen):
    if chosen[0] in OF_CODECS:
        pytest.importorskip("imagecodecs")
    encodings = Encodings(*chosen)
    config = lean(files={"image": chosen[0], "disparity": chosen[1]})
    config = config.model_copy(update={"outputs": ("visibility", "instances", "depth")})
    recorder = Recorder()
    generate(config, tmp_path, 1, 5, listener=recorder)
    assert [pair.share_beyond for pair in recorder.pairs] == [0]
    scene = tmp_path / SCENES / "middlebury-000000"
    assert {*encodings.image_names, *encodings.disparity_names} <= {file.name for file in scene.iterdir()}
    assert len(list(scene.iterdir())) == 12
    index = read_index(tmp_path)
    assert index.encodings == encodings
    read = open_dataset(tmp_path)[0]
    np.testing.assert_array_equal(read.left, shot.left)
    np.testing.assert_array_equal(read.right, shot.right)
    np.testing.assert_allclose(
        read.disparity_right, shot.disparity_right, rtol=0, atol=1 / 512 if chosen[1] == "png16" else 0
    )
    assert findings(tmp_path) == []
    # Ten times what is rounded.
    path = scene / encodings.disparity_names[0]
    path.write_bytes(DISPARITY_ENCODERS[chosen[1]].encode(read.disparity_left + np.float32(0.02)))
    assert any(": depth: left" in finding for finding in findings(tmp_path, 0))


def test_a_dataset_beyond_256_px_is_told_of_and_verifies_clean(shot, tmp_path, monkeypatch, capsys):
    del shot
    # 16 times as many pixels to a radian: disparities go to 430 px.
    config = tiny(files={"disparity": "png16"}).model_dump(mode="json")
    for section, keys in (
        ("camera", ("focal_px", "cx_left_px", "cx_right_px", "cy_px", "doffs_px")),
        ("disparity", ("min_px", "max_px")),
        ("background", ("wall_disparity_px", "plane_disparity_px")),
    ):
        for key in keys:
            value = config[section][key]
            config[section][key] = [each * 16 for each in value] if isinstance(value, list) else value and value * 16
    config["disparity"]["target"]["bin_px"] *= 16
    config["camera"] |= {"width_px": 900, "height_px": 60}
    config["particles"] |= {"size_px": [60.0, 200.0]}
    (tmp_path / "config.yaml").write_text(json.dumps(config))
    out = tmp_path / "out"
    arguments = ["--config", str(tmp_path / "config.yaml"), "--out", str(out), "--pairs", "1", "--seed", "1"]
    monkeypatch.setattr(sys, "argv", ["semisynth-gl", "generate", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 0
    assert "in 1 pairs more than 1% of the pixels have a disparity that png16 cannot hold" in capsys.readouterr().err
    assert findings(out) == []
    path = out / SCENES / "middlebury-000000" / "pair.json"
    pair = json.loads(path.read_text())
    pair["disparity_beyond"]["left"] += 1000_000
    path.write_text(json.dumps(pair))
    assert any("beyond the encoding" in finding for finding in findings(out, 0))


def test_a_dataset_without_the_section_is_the_default(tmp_path):
    index = {"program": "semisynth-gl", "layout": "middlebury", "config_values": {"name": "old"}}
    (tmp_path / "index.json").write_text(json.dumps(index))
    assert read_index(tmp_path).encodings == Encodings()
    index["config_values"]["files"] = {"image": "webp"}
    (tmp_path / "index.json").write_text(json.dumps(index))
    with pytest.raises(InputError, match=r"files\.image 'webp'"):
        _ = read_index(tmp_path).encodings


@pytest.mark.parametrize("encoding", sorted(OF_CODECS))
def test_a_missing_imagecodecs_is_told_before_anything_is_made(tmp_path, monkeypatch, encoding):
    def refuse(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(names, "import_module", refuse)
    message = r"needs the package imagecodecs.*pip install 'semisynth-gl\[codecs\]'"
    with pytest.raises(InputError, match=message):
        generate(lean(files={"image": encoding}), tmp_path / "out", 1, 0)
    assert not (tmp_path / "out").exists()
    (tmp_path / "i").write_bytes(b"qoif" + bytes(7) + b"\x01")
    for call in (
        lambda: IMAGE_ENCODERS[encoding](image_of((3, 4))),
        lambda: decode_file(encoding, tmp_path / "i"),
    ):
        with pytest.raises(InputError, match=message):
            call()
