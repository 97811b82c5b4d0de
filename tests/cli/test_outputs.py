"""Options that write a file: nothing is replaced without --overwrite, and no name means nothing."""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault
from PIL import Image
from tiny_datasets import cheap

from semisynth_gl.cli import main
from semisynth_gl.cli.outputs import Output
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.dataset.apart import check_apart
from semisynth_gl.dataset.places import open_place
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.generation.generate import generate
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures.image_files import find_files
from semisynth_gl.textures.reach import reaching_source

PLAIN = "--focal-px 700 --baseline-m 0.12 --size 64x48 --range-px 1 8 --other-camera --trials 0"
SMALL = "--set camera.width_px=64 --set camera.height_px=48 --set models.variants=1 --set models.complex=0"
# Each option that writes a file, behind the command that has it.
COMMANDS = {
    "verify set --json": ".json",
    "evaluate --pred pred --gt gt --json": ".json",
    "compare set --images photos --json": ".json",
    f"preview --config sceneflow --images photos --pairs 1 {SMALL} --out": ".png",
    f"textures --images photos {SMALL.partition(' --set models')[0]} --out": ".png",
    "report set --pairs 1 --out": ".html",
    f"calibrate --images photos {PLAIN} --out": ".yaml",
    "bench accuracy --config eth3d --json": ".json",
    "bench speed --config eth3d --json": ".json",
}


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A folder with photographs, a dataset, predictions and their truth."""
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    folder = tmp_path_factory.mktemp("home")
    noise = np.random.default_rng(0).integers(0, 256, (2, 300, 300, 3), dtype=np.uint8)
    (folder / "photos").mkdir()
    for number, pixels in enumerate(noise):
        Image.fromarray(pixels).save(folder / f"photos/{number}.png")
    generate(cheap(textures={"source": "procedural", "max_patches": 16}), folder / "set", 2, 0, layout="middlebury")
    for path in ("pred/a.pfm", "gt/a/disp0GT.pfm"):
        (folder / path).parent.mkdir(parents=True)
        (folder / path).write_bytes(PFM.encode(np.full((20, 30), 3, np.float32)))
    return folder


@pytest.fixture
def call(monkeypatch, capsys, home):
    def caller(command, *arguments, cwd=home):
        monkeypatch.chdir(cwd)
        monkeypatch.setattr(sys, "argv", ["semisynth-gl", *command.split(), *map(str, arguments)])
        for benchmark in ("accuracy", "speed"):
            report = {"config": "eth3d", "machine": {}}
            monkeypatch.setattr(f"semisynth_gl.bench.{benchmark}.measure", lambda *_, report=report: dict(report))
            monkeypatch.setattr(f"semisynth_gl.bench.{benchmark}.headline", lambda _: "")
            monkeypatch.setattr(f"semisynth_gl.bench.{benchmark}.table", lambda _: "")
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            main()
        return stopped.value.code, *capsys.readouterr()

    return caller


def files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(done, *words):
    code, out, err = done
    assert (code, out) == (2, ""), err
    assert "Traceback" not in err
    for word in words:
        assert str(word) in err
    return True


def test_every_option_that_writes_a_file_is_in_the_table():
    from semisynth_gl.cli import semisynth_gl

    found = []

    def search(command, name):
        if hasattr(command, "list_commands"):
            for each in command.list_commands(None):
                search(command.get_command(None, each), f"{name} {each}".strip())
        elif any(option.name == "overwrite" for option in command.params):
            found.extend((name, option.opts[0]) for option in command.params if option.name == "output")

    search(semisynth_gl, "")
    mine = {(" ".join(word for word in key.split()[:2] if word in ("bench", "accuracy", "speed")) or key.split()[0],
             key.split()[-1]) for key in COMMANDS}  # fmt: skip
    assert set(found) == mine


@pytest.mark.parametrize("command", COMMANDS)
def test_an_existing_file_is_replaced_only_where_it_is_forced(call, tmp_path, command):
    ending, option = COMMANDS[command], command.split()[-1]
    path = tmp_path / f"x{ending}"
    path.write_bytes(b"mine")
    assert refused(call(command, path), option, path, "exists already", "--overwrite")
    assert path.read_bytes() == b"mine"
    assert refused(call(command, tmp_path / f"no/x{ending}"), "does not exist")
    (tmp_path / f"folder{ending}").mkdir()
    assert refused(call(command, tmp_path / f"folder{ending}", "--overwrite"), "is a folder")
    assert refused(call(command, ""), option, "expected a name")
    assert call(command, path, "--overwrite")[0] == 0
    assert path.read_bytes() != b"mine"
    assert {each.name for each in tmp_path.iterdir()} == {path.name, f"folder{ending}"}


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("bench accuracy --config rig.yaml --json", "rig.yaml"),
        ("preview --config ./rig.yaml --images photos/0.png --out", "photos/0.png"),
        ("preview --config rig.yaml --images photos --out sheet.png --ply", "cloud.ply"),
        ("textures --images ~/photos/1.png --out", "photos/1.png"),
        ("compare set --images photos/0.png --out", "photos/0.png"),
        (f"calibrate --images photos {PLAIN} --calib rig.yaml --out", "rig.yaml"),
    ],
)
def test_a_file_that_the_command_reads_is_kept_whatever_is_forced(call, home, tmp_path, monkeypatch, command, name):
    monkeypatch.setenv("HOME", str(tmp_path))
    shutil.copytree(home / "photos", tmp_path / "photos")
    (tmp_path / "rig.yaml").write_text("extends: sceneflow\n")
    (tmp_path / "cloud.ply").symlink_to("rig.yaml")
    before = files(tmp_path)
    assert refused(call(command, name, "--overwrite", cwd=tmp_path), name, "is an input")
    assert files(tmp_path) == before


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("folder", ["/proc", "photos/0.png"])
def test_a_folder_that_takes_no_file_is_told_before_anything_is_computed(call, monkeypatch, command, folder):
    monkeypatch.setattr(Output, "write", lambda *_: pytest.fail("came to the end of its work"))
    assert refused(call(command, f"{folder}/a{COMMANDS[command]}"), f"{folder}/a{COMMANDS[command]}: ", "the folder")


def test_second_outputs_are_checked_as_the_first_is(call, tmp_path):
    command = f"preview --config sceneflow --images photos --pairs 1 {SMALL} --out"
    for path in ("a.ply", "maps/a.png"):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(b"mine")
    before = files(tmp_path)
    assert refused(call(command, tmp_path / "a.png", "--ply", tmp_path / "a.ply"), "--ply", "exists already")
    assert refused(call(command, tmp_path / "a.png", "--ply", tmp_path / "a.obj"), "--ply", "ends in .ply")
    evaluated = "evaluate --pred pred --gt gt --maps"
    assert refused(call(evaluated, tmp_path / "maps"), "maps/a.png", "exists already")
    assert files(tmp_path) == before
    assert call(evaluated, tmp_path / "maps", "--overwrite")[0] == 0
    assert (tmp_path / "maps/a.png").read_bytes() != b"mine"


def test_pipes_and_links_are_written_through(call, tmp_path):
    (tmp_path / "real.json").write_text("")
    (tmp_path / "link.json").symlink_to("real.json")
    assert call("verify set --overwrite --json", tmp_path / "link.json")[0] == 0
    assert (tmp_path / "link.json").is_symlink()
    assert json.loads((tmp_path / "real.json").read_text())["pairs"] == 2
    assert call("verify set --json", "/dev/null")[0] == 0
    assert Path("/dev/null").is_char_device()
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    assert call("evaluate --pred pred --gt gt --json", tmp_path / "pipe")[0] == 0
    assert json.loads(os.read(reader, 1 << 20))["pairs"] == 1
    os.close(reader)


# Where a dataset, its photographs and its models lie.

APART = [  # --images, --out, whether they lie apart
    ("photos", "photos/set", False),
    ("photos", "photos", False),
    ("photos/", "photos/../photos/x/y", False),
    ("link-to-photos", "photos/set", False),
    ("photos", "link-to-photos/set", False),
    ("with-link", "elsewhere/set", False),
    ("photos/0.png", "photos/set", True),
    ("photos/0.png", "photos", False),
    ("photos/*.png", "photos/set", True),
    ("photos/*", "photos/set", False),
    ("**/*.png", "set", False),
    ("photos/**/*.png", "photos/set", False),
    ("photos/**/*.png", "set", True),
    ("*.png", "set", True),
    ("*/*.png", "set", True),
    ("set/*/*/*/*.png", "set", False),
    ("s[ef]t/MiddEval3", "set", False),
    ("photos/.hidden", "photos/set", True),
    ("photos", "photos2", True),
    ("photos", "set", True),
    (".", "set", False),
    ("..", "set", False),
    ("inside/deep/0.png", "inside", False),
    ("inside", "inside/deep", False),
    ("to-inside", "inside", False),
]


@pytest.mark.parametrize(("images", "out", "apart"), APART)
def test_a_dataset_lies_apart_from_its_photographs(home, tmp_path, monkeypatch, images, out, apart):
    monkeypatch.chdir(tmp_path)
    for name in ("photos", "photos/.hidden", "with-link", "elsewhere/deep", "inside/deep", "photos2"):
        shutil.copytree(home / "photos", tmp_path / name, dirs_exist_ok=True)
    for link, target in (
        ("link-to-photos", "photos"),
        ("with-link/link", "../elsewhere"),
        ("to-inside", "inside/deep"),
    ):
        (tmp_path / link).symlink_to(target)
    config = cheap(textures={"source": "images", "images": [images]})
    plan = make_plan(config, 0, "middlebury", {"train": 1})
    if apart:
        check_apart(open_place(out), plan)
        return
    with pytest.raises(InputError) as fault:
        check_apart(open_place(out), plan)
    assert out in str(fault.value)
    assert images.strip("/") in str(fault.value) or "0.png" in str(fault.value)


def test_a_dataset_lies_apart_from_its_models(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models/a").mkdir(parents=True)
    (tmp_path / "link").symlink_to("models")
    for models, out, apart in (
        ("models", "models/set", False),
        ("link", "models/set", False),
        ("models", "link", False),
        ("models/a", "models", False),
        ("models", "models2", True),
        ("models/a", "models/b", True),
    ):
        config = cheap(textures={"source": "procedural"}, models={"folders": [models]})
        plan = make_plan(config, 0, "middlebury", {"train": 1})
        if apart:
            check_apart(open_place(out), plan)
        else:
            with pytest.raises(InputError, match=f"(?s){out}: .*{models}"):
                check_apart(open_place(out), plan)


def test_what_is_foreseen_is_what_is_found(tmp_path, monkeypatch):
    """A file of every name is written, and the search is asked."""
    monkeypatch.chdir(tmp_path)
    folders = (".", "a", "a/b", "a/.c", "ab", "ab/b/c")
    paths = [Path(folder) / name for folder in folders for name in ("x.png", ".y.png", "z.txt", "w.PNG")]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / "l").symlink_to("a")
    patterns = (
        "* a a/ ./a ** a/** **/*.png a*/* */b */b/*.png ?b/**/c l l/* [ab] a/x.png a/./*.png ab/../a/*.png .* a/.*"
    )
    patterns = (*patterns.split(), str(tmp_path / "a*"))
    for path in paths:
        foreseen = [pattern for pattern in patterns if reaching_source(path, [pattern], {".png"})]
        path.write_text("")
        real = path.resolve()
        found = [
            pattern for pattern in patterns if real in {each.resolve() for each in find_files([pattern], {".png"})}
        ]
        path.unlink()
        # A file that is named in full counts once it is there.
        assert set(found) - {"a/x.png"} <= set(foreseen), path
        # The current folder itself is not among the matches of a bare **, which is a matter of hidden files alone.
        assert set(foreseen) - set(found) <= ({"**"} if path.name.startswith(".") else set()), path


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("generate --config sceneflow --out", "--out"),
        ("generate --config sceneflow --images", "--images"),
        ("generate --config sceneflow --models", "--models"),
        ("generate --config", "--config"),
        ("preview --config sceneflow --images", "--images"),
        ("textures --images", "--images"),
        ("textures --config", "--config"),
        ("calibrate --out x.yaml --images", "--images"),
        ("calibrate --out x.yaml --images photos --calib", "--calib"),
        ("calibrate --out x.yaml --images photos --disparity", "--disparity"),
        ("evaluate --gt gt --pred", "--pred"),
        ("evaluate --pred pred --gt", "--gt"),
        ("evaluate --pred pred --gt gt --mask", "--mask"),
        ("evaluate --pred pred --gt gt --maps", "--maps"),
        ("compare set --images", "--images"),
        ("compare set --images photos --disparity", "--disparity"),
        ("compare set --images photos --out", "--out"),
        ("compare", "DIR_OR_ADDRESS"),
        ("verify", "DIR_OR_ADDRESS"),
        ("report", "DIR_OR_ADDRESS"),
    ],
)
def test_an_empty_name_is_not_the_current_folder(call, home, command, words):
    before = files(home)
    for name in ("", " ", "\n"):
        assert refused(call(command, name), words, "expected a name")
    assert files(home) == before


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("s3://", "with a bucket"),
        ("s3:///set", "with a bucket"),
        ("gs://", "with a bucket"),
        ("simplecache::s3://", "with a bucket"),
        ("memory://", "would be gone"),
        ("memory://set", "would be gone"),
        ("simplecache::memory://set", "would be gone"),
        ("s3:/bucket/set", "one slash after the colon"),
        ("file://", "expected a folder or an address"),
        ("nobody://set", "nobody"),
        ("http://localhost:1/set", "http://localhost:1/set"),
        ("~nosuchuser/set", "nosuchuser"),
    ],
)
def test_places_where_nobody_looks_are_refused(call, tmp_path, address, words):
    pytest.importorskip("fsspec")
    setting = ("--set", "textures.source=procedural")
    done = call(f"generate --config sceneflow --pairs 1 {SMALL} --out", address, *setting, cwd=tmp_path)
    assert refused(done, words)
    assert list(tmp_path.iterdir()) == []


def test_home_is_expanded_in_every_path(call, home, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("set", "pred", "gt"):
        shutil.copytree(home / name, tmp_path / name, symlinks=True)
    assert open_place("~/set").local == tmp_path / "set"
    assert call("verify ~/set --json ~/v.json")[0] == 0
    assert call("evaluate --pred ~/pred --gt ~/gt --json ~/e.json --maps ~/maps")[0] == 0
    assert call("report ~/set --pairs 1 --sample 1 --out ~/r.html")[0] == 0
    assert {"v.json", "e.json", "maps", "r.html"} <= {path.name for path in tmp_path.iterdir()}
    assert not (home / "~").exists()
