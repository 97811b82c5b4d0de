"""Files and datasets that commands write: where they may be, and what an empty name means."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault
from PIL import Image
from tiny_datasets import cheap

from semisynth_gl.cli import main
from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.dataset.apart import check_apart
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.plan import make_plan
from semisynth_gl.dataset.root import open_root
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
    "compare set --images photos --out": ".png",
    f"preview --config sceneflow --images photos --pairs 1 {SMALL} --out": ".png",
    f"preview --config sceneflow --images photos --pairs 1 {SMALL} --ply": ".ply",
    f"preview --patches --config sceneflow --images photos {SMALL} --out": ".png",
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


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_is_replaced_and_what_cannot_be_one_is_refused_first(call, tmp_path, command):
    ending, option = COMMANDS[command], command.split()[-1]
    (tmp_path / f"folder{ending}").mkdir()
    assert refused(call(command, tmp_path / f"no/x{ending}"), option, tmp_path / "no", "does not exist")
    assert refused(call(command, f"photos/0.png/x{ending}"), option, "photos/0.png does not exist")
    assert refused(call(command, tmp_path / f"folder{ending}"), option, "is a folder")
    assert refused(call(command, ""), option, "expected a name")
    if ending != ".json":
        assert refused(call(command, tmp_path / "x.txt"), option, f"ends in {ending}")
    path = tmp_path / f"x{ending}"
    path.write_bytes(b"mine")
    if command.startswith("calibrate"):  # somebody may have changed a config
        assert refused(call(command, path), option, path, "exists already", "--overwrite")
        assert path.read_bytes() == b"mine"
        command = f"calibrate --overwrite{command.removeprefix('calibrate')}"
    assert call(command, path)[0] == 0
    assert path.read_bytes() != b"mine"
    assert {each.name for each in tmp_path.iterdir()} == {path.name, f"folder{ending}"}


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
        check_apart(open_root(out), plan)
        return
    with pytest.raises(InputError) as fault:
        check_apart(open_root(out), plan)
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
            check_apart(open_root(out), plan)
        else:
            with pytest.raises(InputError, match=f"(?s){out}: .*{models}"):
                check_apart(open_root(out), plan)


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
    assert open_root("~/set") == tmp_path / "set"
    assert call("verify ~/set --json ~/v.json")[0] == 0
    assert call("evaluate --pred ~/pred --gt ~/gt --json ~/e.json --maps ~/maps")[0] == 0
    assert call("report ~/set --pairs 1 --sample 1 --out ~/r.html")[0] == 0
    assert {"v.json", "e.json", "maps", "r.html"} <= {path.name for path in tmp_path.iterdir()}
    assert not (home / "~").exists()
