"""The command line: output, files, messages, exit codes."""

import json
import signal
import subprocess
import sys

import click
import cv2
import numpy as np
import pytest
from photograph_like import noise, save
from PIL import Image
from processes import assert_refused, run_python
from tiny_datasets import CLUTTER_ALONE

from semisynth_gl import cli
from semisynth_gl.cli.progress import Progress
from semisynth_gl.config import load_config, packaged_configs
from semisynth_gl.render.devices import EglDevice

SETTINGS = (*CLUTTER_ALONE, "camera.width_px=160", "camera.height_px=96", "models.variants=1", "models.complex=0")
SMALL = tuple(word for setting in SETTINGS for word in ("--set", setting))
ETH3D = ("generate", "--config", "eth3d", *SMALL, "--images")


@pytest.fixture
def photographs(tmp_path):
    (path,) = save(tmp_path / "photographs", noise=noise(300, 400))
    return path.parent


def test_generate_writes_a_dataset_that_opencv_reads(program, tmp_path, photographs):
    command = ("generate", "--config", "middlebury.yaml", "--images", photographs, "--out", "data/lab", *SMALL)
    command += ("--outputs", "visibility,depth")
    done = run_python("-m", "semisynth_gl", *command, "--pairs", 2, cwd=tmp_path)
    assert done.code == 0, done.err
    assert done.out == "2 pairs in data/lab\n"
    assert "2 of 2 pairs" in done.err
    scene = tmp_path / "data/lab/MiddEval3/trainingF/middlebury-000001"
    assert cv2.imread(str(scene / "im0.png")).shape == (96, 160, 3)
    assert np.isfinite(cv2.imread(str(scene / "disp0GT.pfm"), cv2.IMREAD_UNCHANGED)).all()
    assert cv2.imread(str(scene / "mask0nocc.png"), cv2.IMREAD_UNCHANGED).ndim == 2
    made_by = json.loads((scene / "pair.json").read_text())
    assert (made_by["pair"], made_by["seed"], made_by["images"].keys()) == (1, 0, {"noise.png"})
    index = json.loads((tmp_path / "data/lab/index.json").read_text())
    assert index["pairs"] == {"train": 2}
    assert index["config_values"]["camera"]["width_px"] == 160
    assert index["config_values"]["outputs"] == ["visibility", "depth"]
    assert_refused(program(*command, "--seed", 4, "--pairs", 2), "seed", "overwrite")
    before = scene.stat().st_mtime_ns
    assert program(*command, "--pairs", 2).code == 0
    assert scene.stat().st_mtime_ns == before


def test_preview_draws_a_sheet(program, tmp_path, photographs):
    command = ("preview", "--config", "kitti", "--images", photographs, *SMALL)
    done = program(*command, "--out", "sheet.png", "--pairs", 2)
    assert done.code == 0, done.err
    assert len(Image.open(tmp_path / "sheet.png").convert("RGB").getcolors(1 << 24)) > 1000


def test_doctor_renders_its_test_pair_or_says_what_to_install():
    done = run_python("-m", "semisynth_gl", "doctor", MESA_GL_VERSION_OVERRIDE="3.1")
    assert done.code == 1
    assert "apt-get install" in done.out
    done = run_python("-m", "semisynth_gl", "doctor")
    assert done.code == 0, done.out
    assert "Ready:" in done.out


@pytest.mark.parametrize("cuda", [None, 0])
def test_doctor_tells_where_egl_does_not_list_an_nvidia_gpu(program, monkeypatch, tmp_path, cuda):
    monkeypatch.setattr("semisynth_gl.cli.doctor._NVIDIA_CONTROL", tmp_path)
    monkeypatch.setattr("semisynth_gl.cli.doctor._try", lambda _: True)
    monkeypatch.setattr("semisynth_gl.render.devices.egl_devices", lambda: [EglDevice(0, software=False, cuda=cuda)])
    assert ("the NVIDIA GPU is not among them" in program("doctor").out) == (cuda is None)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("generat", ["No such command"]),
        ("generate --config nope", ["nope", "middlebury"]),
        ("preview --config middlebury --set camera.widht_px=3", ["did you mean camera.width_px"]),
        ("generate --config middlebury --models nowhere", ["nowhere"]),
        ("generate --config middlebury --images nowhere/*.jpg", ["nowhere/*.jpg"]),
        ("generate --config middlebury --layout nuscenes", ["layout", "crestereo"]),
        ("generate --config middlebury --outputs visibility,normal", ["--outputs", "normals"]),
        ("generate --config middlebury --engine ray --workers 1", ["--workers"]),
        ("generate --config middlebury --shards 7-9", ["shards 0-7"]),
        ("generate --config middlebury --shards 5-3", ["--shards", "ascending order"]),
        ("generate --config middlebury --workers 1 --gpus 0,1", ["--gpus", "got 2 for 1 worker"]),
        ("generate --config middlebury --layout kitti --set files.disparity=png16", ["section files"]),
        ("generate --config middlebury --out nothing://x", ["nothing://x"]),
    ],
)
def test_wrong_input_is_refused_and_nothing_written(program, tmp_path, arguments, words):
    assert_refused(program(*arguments.split()), *words)
    assert list(tmp_path.iterdir()) == []


def test_hostile_images_are_named_and_counted(program, tmp_path, photographs):
    (photographs / "broken.jpg").write_bytes(b"\xff\xd8\xff\xe0 not really")
    (photographs / "cut.png").write_bytes((photographs / "noise.png").read_bytes()[:5000])
    done = program(*ETH3D, photographs, "--out", "o", "--pairs", 1)
    assert done.code == 0, done.err
    for words in ("broken.jpg", "cut.png", "2 not usable"):
        assert words in done.err
    (photographs / "noise.png").unlink()
    assert_refused(program(*ETH3D, photographs, "--out", "p"), "broken.jpg", "cut.png")
    assert not (tmp_path / "p").exists()


def test_broken_models_are_named_and_left_out(program, tmp_path, photographs):
    models = tmp_path / "models"
    models.mkdir()
    (models / "good.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    (models / "nan.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    command = (*ETH3D, photographs, "--models", models, "--pairs", 1)
    done = program(*command, "--out", "o")
    assert done.code == 0, done.err
    assert str(models / "nan.obj") in done.err
    assert "good.obj:" not in done.err
    (models / "good.obj").unlink()
    assert_refused(program(*command, "--out", "p"), "nan.obj")


def test_a_stopped_run_says_so_and_leaves_no_index(program, monkeypatch, tmp_path, photographs):
    monkeypatch.setattr(Progress, "on_pair", lambda _: signal.raise_signal(signal.SIGTERM))
    assert_refused(program(*ETH3D, photographs, "--out", "o", "--pairs", 9, "--engine", "serial"), "Stopped")
    assert not (tmp_path / "o/index.json").exists()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "the memory is full"),
        (OSError(28, "No space left on device", "x.png"), "x.png: No space left on device. Free"),
        (KeyboardInterrupt(), "Stopped."),
        (click.UsageError("no such option"), "no such option"),
    ],
)
def test_errors_of_the_process_are_one_line(program, monkeypatch, error, said):
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(cli.semisynth_gl, "main", fail)
    done = program()
    assert_refused(done, said)
    assert len(done.err.splitlines()) == 1


def test_a_pipe_that_nobody_reads_is_no_error():
    command = f"{sys.executable} -m semisynth_gl configs | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode in (0, 1), done.stderr) == (True, "")


def test_configs_are_listed_and_printed_in_full(program, tmp_path):
    listed = program("configs")
    assert listed.code == 0
    assert [line.split()[0] for line in listed.out.splitlines()] == packaged_configs()
    (tmp_path / "lab.yaml").write_text(program("configs", "kitti").out)
    assert load_config(tmp_path / "lab.yaml").digest() == load_config("kitti").digest()
    assert_refused(program("configs", "kiti"), "did you mean kitti?")


def test_verify_takes_a_number_of_pairs_or_all(program):
    assert_refused(program("verify", "pairs", "--rays", 2, "--oracle"), "--rays or --oracle")


def test_an_interrupt_ends_a_command_with_a_line(monkeypatch, program):
    monkeypatch.setattr("semisynth_gl.cli.configs.summaries", lambda: signal.raise_signal(signal.SIGINT))
    assert_refused(program("configs"), "Stopped.")
