"""The code blocks of README and docs run unchanged, and every block is marked."""

import os
import re
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from backends import backend_fault
from click.testing import CliRunner
from config_texts import parse_config
from heavy import heavy
from PIL import Image
from processes import without_announcements
from snippets import PAGES, blocks
from tiny_datasets import cheap

from semisynth_gl.cli import semisynth_gl
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.config import load_config, packaged_configs
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.plan import make_plan

RUN = {"python", "sh", "bash"}
PROGRAM = "semisynth-gl"
ALL_BLOCKS = [block for page in PAGES for block in blocks(page)]

# --- files that pages assume: photographs, calibration, predictions, datasets ---

# The smallest photographs that calibrate accepts.
WIDTH, HEIGHT = 320, 256
CALIBRATION = f"""cam0=[420 0 150; 0 420 120; 0 0 1]
cam1=[420 0 155; 0 420 120; 0 0 1]
doffs=5
baseline=120
width={WIDTH}
height={HEIGHT}
"""
# Few models and patches, to be fast.
FEW = "extends: sceneflow\nmodels: {variants: 1, complex: 0}\ntextures: {max_patches: 16}\n"


def photographs(folder, path):
    """Write three photographs of noise."""
    (folder / path).mkdir(parents=True)
    for number in range(3):
        pixels = np.random.default_rng(number).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / path / f"{number}.png")


def disparity_map(path, left, right):
    """Write a disparity map of two walls."""
    path.parent.mkdir(exist_ok=True)
    disparity = np.where(np.arange(WIDTH) < WIDTH / 2, left, right).astype(np.float32)
    path.write_bytes(PFM.encode(np.tile(disparity, (HEIGHT, 1))))


def rig(folder):
    """Write the rig's calibration, disparity maps, and a network's disparities of four pairs."""
    (folder / "calib.txt").write_text(CALIBRATION)
    for number in range(2):
        disparity_map(folder / "gt" / f"{number}.pfm", 30, 32)
    predictions(folder, "lab", (HEIGHT, WIDTH))


def predictions(folder, name, shape):
    (folder / "guesses").mkdir()
    for pair in range(4):
        np.save(folder / "guesses" / f"{name}-{pair:06d}.npy", np.full(shape, 20, np.float32))


def dataset(folder, path, pairs=2, layout="middlebury", shard_pairs=None, **sections):
    generate(cheap(**sections), folder / path, pairs, 0, layout=layout, shard_pairs=shard_pairs)


def scene(folder, path):
    """Write an image and its disparity as in Middlebury."""
    photographs(folder, path)
    (folder / path / "0.png").rename(folder / path / "im0.png")
    disparity_map(folder / path / "disp0GT.pfm", 10, 30)


PRESUMED = {
    "verify": lambda folder: (
        photographs(folder, "rooms"),
        scene(folder, "scenes/chair"),
        scene(folder, "scenes/table"),
        dataset(folder, "data/rooms"),
    ),
    "README": lambda folder: (
        photographs(folder, "home/photos/lab"),
        rig(folder),
        dataset(folder, "out/middlebury"),
    ),
    "index": lambda folder: (photographs(folder, "photos"), rig(folder)),
    "evaluate": lambda folder: (
        predictions(folder, "middlebury", (48, 64)),
        dataset(folder, "out/middlebury", name="middlebury"),
    ),
    "training": lambda folder: dataset(folder, "out/rooms", 8, camera={"width_px": 400, "height_px": 200}),
    "output": lambda folder: dataset(folder, "data/lab", 8, "webdataset", 1, name="lab"),
}


@pytest.fixture
def make_folder(tmp_path, monkeypatch):
    """Change to a folder with the files that a page assumes, and a home folder."""
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])))

    def make(page):
        PRESUMED.get(page, lambda _: None)(tmp_path)
        return tmp_path

    return make


def pages_with(mark):
    return [page for page in PAGES if any(block.mark == mark for block in blocks(page))]


def run_shell(block):
    """Run a block; if it only calls the program, run it in this process, which is faster."""
    if all(words[0] == PROGRAM and not {">", "|", "&&"} & {*words} for words in block.commands):
        for _, *words in block.commands:
            calibrates = words[0] == "calibrate"
            done = CliRunner().invoke(semisynth_gl, [*words, *["--trials=0"] * calibrates])
            assert done.exit_code == 0, (block.place, words, done.output, done.exception)
            if calibrates:
                with Path(words[words.index("--out") + 1]).open("a") as config:
                    config.write("models: {variants: 1, complex: 0}\n")
        return
    shell = ["bash" if block.language == "bash" else "sh", "-e", "-c", block.text]
    done = subprocess.run(shell, capture_output=True, text=True, check=False)
    assert (done.returncode, without_announcements(done.stderr)) == (0, ""), (block.place, done.stdout)


@pytest.mark.parametrize("page", pages_with("runnable"))
def test_the_blocks_of_a_page_run_in_order(page, make_folder):
    make_folder(page)
    names = {"__name__": "__main__"}  # later Python blocks use the names of earlier ones
    for block in blocks(page):
        if block.mark == "runnable" and block.language == "python":
            exec(compile(block.text, block.place, "exec"), names)  # noqa: S102 - the project's own documentation
        elif block.mark == "runnable":
            run_shell(block)


# Spawned workers import the main script, so the blocks must be a file.
@pytest.mark.heavy
@pytest.mark.parametrize("page", pages_with("runnable: heavy"))
def test_the_heavy_blocks_of_a_page_run_in_order(page, make_folder):
    heavy("torch")
    folder = make_folder(page)
    (folder / "few.yaml").write_text(FEW)
    script = folder / "snippets.py"
    text = "".join(block.text for block in blocks(page) if block.mark == "runnable: heavy")
    script.write_text(text.replace('"sceneflow"', '"few.yaml"'))
    offline = {"HF_HUB_OFFLINE": "1", "HF_HOME": str(folder / "hub")}
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, check=False, env=os.environ | offline
    )
    assert done.returncode == 0, done.stderr


# --- blocks that do not run ---


def test_every_block_that_could_run_runs_or_says_why_not():
    assert [block.place for block in ALL_BLOCKS if block.language in RUN and not block.mark] == []
    comments = [
        re.findall(r"^<!-- (?:runnable|not run).*$", path.read_text("utf-8"), re.MULTILINE) for path in PAGES.values()
    ]
    # If not, a mark is misspelt or not directly before its block.
    assert sum(map(len, comments)) == sum(bool(block.mark) for block in ALL_BLOCKS) > 5


def test_blocks_of_yaml_are_configs_that_generate_takes():
    for block in ALL_BLOCKS:
        if block.language == "yaml" and not block.mark:
            config = parse_config(block.text)
            make_plan(config, 0, config.layout or "middlebury", {"train": 1})


def test_commands_that_are_not_run_have_options_and_keys_that_exist():
    commands = [
        (block.place, words)
        for block in ALL_BLOCKS
        if block.language in {"sh", "console"} and block.mark != "runnable"
        for words in block.commands
        if words[0] == PROGRAM
    ]
    assert len(commands) > 10
    for place, words in commands:
        group, arguments = semisynth_gl, words[1:]
        parent = click.Context(group, info_name=PROGRAM)
        while isinstance(group, click.Group):
            name, *arguments = arguments
            group = group.get_command(parent, name)
            assert group is not None, (place, name)
        with group.make_context(name, arguments, parent) as context:
            config_name = context.params.get("config_name")
            if config_name in packaged_configs():
                load_config(config_name, context.params["settings"])
