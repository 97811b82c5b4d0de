"""The command line as a script sees it: output, files, messages, exit codes."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import click
import cv2
import numpy as np
import pytest
import trimesh
from backends import backend_fault
from PIL import Image
from shared_material import SHARED, needs_shared
from tiny_datasets import CLUTTER_ALONE

from semisynth_gl import render_pair
from semisynth_gl.cli import main, semisynth_gl
from semisynth_gl.config import load_config, packaged_configs
from semisynth_gl.scene import sources

SMALL = (
    *(word for setting in CLUTTER_ALONE for word in ("--set", setting)),
    "--set",
    "camera.width_px=160",
    "--set",
    "camera.height_px=96",
    "--set",
    "models.variants=1",
    "--set",
    "models.complex=0",
)


@dataclass
class Done:
    returncode: int
    stdout: str
    stderr: str


def run(*arguments, cwd=None, **environment):
    """Run the program as a script does."""
    return subprocess.run(
        [sys.executable, "-m", "semisynth_gl", *map(str, arguments)],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.fixture
def call(monkeypatch, capsys):
    """Run the program in this process, which saves it the time to start."""

    def caller(*arguments, cwd):
        monkeypatch.chdir(cwd)
        monkeypatch.setattr(sys, "argv", ["semisynth-gl", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            main()
        return Done(stopped.value.code, *capsys.readouterr())

    return caller


def refused(done, *words):
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    for word in words:
        assert word in done.stderr


@pytest.fixture(autouse=True)
def _some_backend():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")


@pytest.fixture
def photographs(tmp_path):
    folder = tmp_path / "photographs"
    folder.mkdir()
    noise = np.random.default_rng(0).integers(0, 256, (300, 400, 3), dtype=np.uint8)
    Image.fromarray(noise).save(folder / "noise.png")
    return folder


def test_each_option_and_argument_that_is_needed_is_missed_by_name(call, tmp_path):
    needed = set()
    for name in semisynth_gl.list_commands(click.Context(semisynth_gl)):
        command = semisynth_gl.get_command(click.Context(semisynth_gl), name)
        for missing in (parameter for parameter in command.params if parameter.required):
            given = [name]
            for other in command.params:
                if other.required and other is not missing:
                    given += [other.opts[0], "x.yaml"] if isinstance(other, click.Option) else ["x.yaml"]
            shown = missing.opts[0] if isinstance(missing, click.Option) else missing.human_readable_name
            refused(call(*given, cwd=tmp_path), "Missing", shown)
            needed.add((name, missing.name))
    assert needed >= {("calibrate", "out"), ("evaluate", "predictions"), ("verify", "directory")}
    assert list(tmp_path.iterdir()) == []


def test_generate_writes_a_dataset_that_opencv_reads(call, tmp_path, photographs):
    done = run(
        "generate",
        "--config",
        "middlebury.yaml",
        "--images",
        photographs,
        "--out",
        "data/lab",
        "--pairs",
        2,
        *SMALL,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "2 pairs in data/lab\n"
    assert done.stderr.splitlines()[-1] == (
        "The images are in data/lab/MiddEval3/trainingF. To look at them: semisynth-gl report data/lab"
    )
    assert "2 of 2 pairs" in done.stderr
    scene = tmp_path / "data/lab/MiddEval3/trainingF/middlebury-000001"
    assert cv2.imread(str(scene / "im0.png")).shape == (96, 160, 3)
    assert np.isfinite(cv2.imread(str(scene / "disp0GT.pfm"), cv2.IMREAD_UNCHANGED)).all()
    assert cv2.imread(str(scene / "mask0nocc.png"), cv2.IMREAD_UNCHANGED).ndim == 2
    made_by = json.loads((scene / "pair.json").read_text())
    assert (made_by["pair"], made_by["seed"], made_by["images"].keys()) == (1, 0, {"noise.png"})
    index = json.loads((tmp_path / "data/lab/index.json").read_text())
    assert index["pairs"] == {"train": 2}
    assert index["config_values"]["camera"]["width_px"] == 160
    assert not (tmp_path / "data/lab/.partial").exists()
    again = ("generate", "--config", "middlebury.yaml", "--images", photographs, "--out", "data/lab", *SMALL)
    other = call(*again, "--seed", 4, "--pairs", 2, cwd=tmp_path)
    refused(other, "begun with other values: seed (0 there, 4 now)", "overwrite")
    refused(call(*again, "--pairs", 1, cwd=tmp_path), "2 there, 1 now")
    before = scene.stat().st_mtime_ns
    assert call(*again, "--pairs", 2, cwd=tmp_path).stdout == "2 pairs in data/lab\n"
    assert scene.stat().st_mtime_ns == before


def test_preview_draws_a_sheet(call, tmp_path, photographs):
    done = call(
        "preview",
        "--config",
        "kitti",
        "--images",
        photographs,
        "--out",
        "sheet.png",
        "--ply",
        "cloud.ply",
        "--pairs",
        2,
        *SMALL,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert "the points of pair 0 in cloud.ply\n" in done.stdout
    cloud = trimesh.load(tmp_path / "cloud.ply")
    values = ["textures.source=images", ("textures.images", [str(photographs)]), *SMALL[1::2]]
    frame = render_pair(load_config("kitti", values), 0)
    np.testing.assert_array_equal(np.float32(cloud.vertices), frame.points().reshape(-1, 3))
    np.testing.assert_array_equal(cloud.colors[:, :3], frame.left.image.reshape(-1, 3))
    assert re.search(
        r"total variation of 0\.0\d\d from the target, and a Wasserstein-1 distance of [\d.]+ px", done.stdout
    )
    assert re.search(r"^on average \d+ particles in view, covering \d+% of the image$", done.stdout, re.MULTILINE)
    sheet = np.asarray(Image.open(tmp_path / "sheet.png").convert("RGB"))
    assert sheet.shape[1] == 1600
    assert len(np.unique(sheet.reshape(-1, 3), axis=0)) > 1000
    assert [path.name for path in tmp_path.glob("*.png*")] == ["sheet.png"]


def test_patches_are_announced_before_they_are_made_and_not_when_they_are_found(
    tmp_path, photographs, call, monkeypatch
):
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", str(tmp_path / "cache"))
    arguments = ["preview", "--patches", "--config", "middlebury", "--images", photographs]
    announced = f"making patches of photographs (images: {len(list(photographs.iterdir()))}); later runs find them in "
    assert call(*arguments, cwd=tmp_path).stderr.startswith(announced)
    assert "making" not in call(*arguments, cwd=tmp_path).stderr


def test_doctor_renders_its_test_pair():
    done = run("doctor")
    assert done.returncode == 0, done.stdout
    assert "largest error of the disparity" in done.stdout
    assert "good" in done.stdout
    assert "Ready:" in done.stdout
    assert f"Cache: {os.environ['SEMISYNTH_GL_CACHE']}, " in done.stdout


def test_doctor_names_the_command_where_nothing_works():
    # A broken driver name makes Mesa's EGL fail; OSMesa is kept from loading by hiding the backend's library path.
    done = run("doctor", MESA_GL_VERSION_OVERRIDE="3.1")
    assert done.returncode == 1
    assert "No backend works" in done.stdout
    assert "apt-get install -y libegl1" in done.stdout


def test_quotes_are_advised_where_patterns_are_taken(call, tmp_path):
    for command, advised in ((["preview", "--config", "eth3d", "--images"], True), (["report"], False)):
        done = call(*command, "a.jpg", "b.jpg", "c.jpg", cwd=tmp_path)
        assert "unexpected extra argument" in done.stderr
        assert ("into quotes" in done.stderr) == advised


def test_a_command_that_may_be_meant_is_named(call, tmp_path):
    done = call("generat", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "Error: No such command 'generat'; did you mean generate?"


@pytest.mark.parametrize("command", ["generate", "preview", "doctor"])
def test_help_is_there(call, command, tmp_path):
    done = call(command, "--help", cwd=tmp_path)
    assert done.returncode == 0
    assert "Usage:" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--layout", "nuscenes"], ["layout: expected one of crestereo", "got 'nuscenes'"]),
        (["--outputs", "visibility,normal"], ["--outputs: unknown output 'normal'; did you mean normals?"]),
        (["photos/b.jpg"], ["unexpected extra argument", "Put a pattern such as 'photos/*.jpg' into quotes"]),
        (["--engine", "slurm"], ["--engine: expected one of serial, local, ray, got slurm"]),
        (["--engine", "serial", "--workers", "3"], ["leave --workers out, or use --engine local"]),
        (["--engine", "ray", "--workers", "1"], ["--workers is for --engine local"]),
        (["--ray-address", "x:1"], ["--engine ray"]),
        (["--gpus", "a"], ["--gpus: expected numbers such as 0,1,3, got 'a'"]),
        (["--shards", "5-x"], ["--shards: expected one number, or two such as 100-199"]),
        (["--shards", "7-9"], ["7-9: the dataset has the shards 0-7"]),
        (["--shards", "3-2"], ["must not be smaller"]),
        (["--pairs", "0"], ["at least one pair"]),
        (["--layout", "kitti", "--set", "files.disparity=png16"], ["encodings of its own"]),
        (["--out", "nothing://x"], ["nothing://x"]),
    ],
)
def test_wrong_ways_to_generate_are_refused_and_nothing_written(call, tmp_path, arguments, words):
    refused(call("generate", "--config", "middlebury", *arguments, cwd=tmp_path), *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["generate", "preview"])
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--config", "nope"], ["no such config: nope", "middlebury"]),
        (
            ["--config", "middlebury", "--set", "camera.widht_px=3"],
            ["override camera.widht_px: unknown key; did you mean camera.width_px?"],
        ),
        (["--config", "middlebury", "--models", "nowhere"], ["nowhere"]),
        (["--config", "middlebury", "--seed", "-1"], ["--seed"]),
        (["--config", "middlebury", "--backend", "vulkan"], ["--backend", "egl"]),
        ([], ["--config"]),
    ],
)
def test_wrong_input_is_refused_and_nothing_written(call, tmp_path, command, arguments, words):
    refused(call(command, *arguments, *SMALL, cwd=tmp_path), *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["generate", "preview"])
@pytest.mark.parametrize("images", ["nowhere", "nowhere/*.jpg"])
def test_missing_photographs_are_refused_before_models_are_built(call, monkeypatch, tmp_path, command, images):
    monkeypatch.setattr(sources, "build_libraries", lambda *_: pytest.fail("models were built"))
    done = call(command, "--config", "middlebury", "--images", images, cwd=tmp_path)
    refused(done, f"no image matches {images!r}")
    assert list(tmp_path.iterdir()) == []


def test_hostile_images_are_named_and_counted(call, tmp_path, photographs):
    (photographs / "broken.jpg").write_bytes(b"\xff\xd8\xff\xe0 not really")
    (photographs / "cut.png").write_bytes((photographs / "noise.png").read_bytes()[:5000])
    done = call(
        "generate", "--config", "eth3d", "--images", photographs, "--out", "o", "--pairs", 1, *SMALL, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "broken.jpg" in done.stderr
    assert "cut.png" in done.stderr
    assert "2 not readable" in done.stderr
    (photographs / "noise.png").unlink()
    refused(
        call("generate", "--config", "eth3d", "--images", photographs, "--out", "p", cwd=tmp_path),
        "broken.jpg",
        "cut.png",
    )
    assert not (tmp_path / "p").exists()


@needs_shared
def test_a_bomb_is_refused_by_its_header(call, tmp_path):
    bomb = SHARED / "hostile" / "png_bomb_65536.png"
    refused(call("generate", "--config", "eth3d", "--images", bomb, cwd=tmp_path), "png_bomb_65536.png", "65536")
    assert list(tmp_path.iterdir()) == []


def test_broken_models_are_named_and_left_out(call, tmp_path, photographs):
    models = tmp_path / "models"
    models.mkdir()
    (models / "good.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    (models / "nan.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (models / "index.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    (models / "empty.obj").write_text("# nothing\n")
    done = call(
        "generate",
        "--config",
        "eth3d",
        "--images",
        photographs,
        "--models",
        models,
        "--out",
        "o",
        "--pairs",
        1,
        *SMALL,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    for name in ("nan.obj", "index.obj", "empty.obj"):
        assert f"model left out: {models / name}" in done.stderr
    assert "good.obj:" not in done.stderr
    (models / "good.obj").unlink()
    refused(
        call("generate", "--config", "eth3d", "--images", photographs, "--models", models, "--out", "p", cwd=tmp_path),
        "nan.obj",
    )


def test_too_old_opengl_is_told(tmp_path, photographs):
    done = run(
        "generate",
        "--config",
        "eth3d",
        "--images",
        photographs,
        "--out",
        "o",
        *SMALL,
        cwd=tmp_path,
        MESA_GL_VERSION_OVERRIDE="3.1",
    )
    refused(done, "no OpenGL context could be opened", "semisynth-gl doctor")
    assert not (tmp_path / "o").exists()


def test_a_full_disk_is_told(tmp_path, photographs):
    """A limit on the size of files stands in for a full disk: writing fails in the middle of a file."""
    script = (
        "import errno, pathlib, semisynth_gl.cli\n"
        "whole = pathlib.Path.write_bytes\n"
        "def write_bytes(self, data, written=[0]):\n"
        "    written[0] += len(data)\n"
        "    if written[0] > 600_000:\n"
        "        whole(self, data[: len(data) // 2])\n"
        "        raise OSError(errno.ENOSPC, 'No space left on device', str(self))\n"
        "    return whole(self, data)\n"
        "pathlib.Path.write_bytes = write_bytes\n"
        "semisynth_gl.cli.main()\n"
    )
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            script,
            "generate",
            "--config",
            "eth3d",
            "--images",
            photographs,
            "--out",
            "o",
            "--layout",
            "middlebury",
            "--pairs",
            "9",
            *SMALL,
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    refused(done, "No space left on device", "Free some space")
    assert list((tmp_path / "o/shards").glob("*train*.json"))
    assert not (tmp_path / "o/index.json").exists()


def test_what_is_refused_while_drawing_costs_no_earlier_dataset(call, tmp_path, photographs):
    base = ("generate", "--config", "eth3d", "--images", photographs, "--out", "o", "--pairs", 1, *SMALL)
    assert call(*base, cwd=tmp_path).returncode == 0
    before = {path: path.read_bytes() for path in (tmp_path / "o").rglob("*") if path.is_file()}
    for setting in ("checks.min_brightness=255", "camera.width_px=200000", "antialias=msaa4"):
        refused(call(*base, "--overwrite", "--set", setting, cwd=tmp_path), "Error:")
        assert {path: path.read_bytes() for path in (tmp_path / "o").rglob("*") if path.is_file()} == before


def test_a_read_only_folder_is_told(call, tmp_path, photographs):
    if os.geteuid() == 0:
        done = call(
            "generate", "--config", "eth3d", "--images", photographs, "--out", "/proc/nothing", *SMALL, cwd=tmp_path
        )
    else:
        (tmp_path / "locked").mkdir(mode=0o500)
        done = call("generate", "--config", "eth3d", "--images", photographs, "--out", "locked/o", *SMALL, cwd=tmp_path)
    refused(done, "cannot be written to")


def test_ctrl_c_stops_without_traceback_or_half_pairs(tmp_path, photographs):
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "semisynth_gl",
            "generate",
            "--config",
            "eth3d",
            "--images",
            str(photographs),
            "--out",
            "o",
            "--pairs",
            "100000",
            "--layout",
            "middlebury",
            *SMALL,
        ],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    scenes = tmp_path / "o/MiddEval3/trainingF"
    while not (scenes.is_dir() and len(list(scenes.iterdir())) > 2):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    output, messages = process.communicate(timeout=120)
    assert process.returncode == 2
    assert output == ""
    assert "Traceback" not in messages
    assert "Stopped" in messages
    assert all(len(list(scene.iterdir())) == 8 for scene in scenes.iterdir())
    assert not (tmp_path / "o/index.json").exists()
    done = run(
        "generate",
        "--config",
        "eth3d",
        "--images",
        photographs,
        "--out",
        "o",
        "--pairs",
        1,
        "--layout",
        "middlebury",
        "--overwrite",
        *SMALL,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert len(list(scenes.iterdir())) == 1


def test_preview_refuses_other_formats_and_missing_folders(call, tmp_path, photographs):
    refused(
        call("preview", "--config", "eth3d", "--images", photographs, "--out", "a.jpg", cwd=tmp_path), "ends in .png"
    )
    refused(
        call("preview", "--config", "eth3d", "--images", photographs, "--out", "no/a.png", cwd=tmp_path),
        "does not exist",
    )


def test_quotes_in_paths_survive(call, tmp_path):
    folder = Path(tmp_path / "it's, [odd]")
    folder.mkdir()
    noise = np.random.default_rng(0).integers(0, 256, (300, 300, 3), dtype=np.uint8)
    Image.fromarray(noise).save(folder / "n.png")
    done = call("generate", "--config", "eth3d", "--images", folder, "--out", "o", "--pairs", 1, *SMALL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_configs_are_listed_and_printed_in_full(call, tmp_path):
    listed = call("configs", cwd=tmp_path)
    assert listed.returncode == 0
    assert [line.split()[0] for line in listed.stdout.splitlines()] == packaged_configs()
    (tmp_path / "lab.yaml").write_text(call("configs", "kitti", cwd=tmp_path).stdout)
    assert load_config(tmp_path / "lab.yaml").digest() == load_config("kitti").digest()
    refused(call("configs", "kiti", cwd=tmp_path), "did you mean kitti?")


def test_generate_without_a_config_says_which_there_are(call, tmp_path):
    refused(call("generate", cwd=tmp_path), "--config: name a YAML file", "middlebury  ", "configs NAME")
