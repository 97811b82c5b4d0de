"""The run that measures a GPU: its parts, its page, and its comparison of memory with files."""

import json
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from click.testing import CliRunner

from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.devices import ContextFacts

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

import gpu  # noqa: E402 - found by the line above
import memory_rates  # noqa: E402

PAIR = {"left": np.zeros((2, 3, 3), np.uint8), "disparity_left": np.full((2, 3), np.inf, np.float32)}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, []),
        ({"disparity_left": np.float32([[np.inf] * 3, [np.inf, 7, np.inf]])}, ["pair 5: disparity_left differs"]),
        ({"left": np.zeros((3, 2, 3), np.uint8)}, ["pair 5: left differs"]),
        ({"right": PAIR["left"]}, ["pair 5: right is only in memory"]),
        ({"left": None}, ["pair 5: left is only in the files"]),
    ],
)
def test_what_differs_from_the_files_is_named(change, expected):
    found = {role: array for role, array in (PAIR | change).items() if array is not None}
    assert memory_rates.differences({5: found}, {5: PAIR}) == expected


def test_a_pair_that_never_came_differs():
    assert len(memory_rates.differences({}, {0: PAIR})) == len(PAIR)


def test_every_kind_of_pair_is_a_config():
    for settings in memory_rates.KINDS.values():
        config = memory_rates.load_config("middlebury", (*settings, memory_rates.SHARP))
        assert config.imperfections.blur_px.high == 0
    assert config.outputs == ("visibility",)


def test_every_part_is_a_command(tmp_path):
    """Its script or module is there, and knows the options that are given."""
    for name, part in gpu.PARTS.items():
        first = part.command[0]
        assert first == "-m" or (ROOT / first).is_file(), name
    assert list(gpu.PARTS)[-1] == "training"  # it takes what time is left
    unknown = CliRunner().invoke(gpu.main, ["nothing", "--out", str(tmp_path)])
    assert unknown.exit_code == 2
    assert "'doctor'" in unknown.output


@pytest.fixture
def short_parts(monkeypatch):
    """Parts that end at once, fail, and take too long."""

    def text(code, **options):
        return gpu.Part("T", ("-c", code), **options)

    written = "import sys, json; json.dump({'n': 41}, open(sys.argv[-1], 'w'))"
    parts = {
        "doctor": text("print('a line')"),
        "reported": text(written, quick=("quickly",), report=(lambda _: "head", lambda report: f"n = {report['n']}")),
        "failing": text("print('why'); raise SystemExit(3)"),
        "timed": text("pass", minutes=True),
        "broken": text("print('because'); raise SystemExit(3)", report=(str, str)),
        "endless": text("import time; print('began', flush=True); time.sleep(60)"),
    }
    monkeypatch.setattr(gpu, "PARTS", parts)
    monkeypatch.setattr(gpu, "_LEAST_S", 0.0)


@pytest.mark.usefixtures("short_parts")
def test_parts_end_fail_and_are_cut_off(tmp_path):
    assert gpu.do_part("doctor", tmp_path, 60, [], quick=False).status == "done"
    reported = gpu.do_part("reported", tmp_path, 60, [], quick=True)
    assert reported.status == "done"
    assert "quickly --json" in reported.command
    assert gpu.do_part("failing", tmp_path, 60, [], quick=False).status == "failed (exit code 3)"
    timed = gpu.do_part("timed", tmp_path, 90, [], quick=False)
    assert (timed.status, timed.command[-14:]) == ("done", "--minutes 1.50")
    cut = gpu.do_part("endless", tmp_path, 2, [], quick=False)
    assert cut.status == "cut off after 2 s"
    assert 2 <= cut.seconds < 30
    assert (tmp_path / "endless.log").read_text() == "began\n"


@pytest.mark.usefixtures("short_parts")
def test_the_page_has_all_parts_that_ran(tmp_path):
    outcomes = {
        name: gpu.asdict(gpu.do_part(name, tmp_path, 60, [], quick=False))
        for name in ("doctor", "reported", "failing", "broken")
    }
    page = gpu.page(tmp_path, outcomes)
    for shown in ("n = 41", "\na line\n", "\nwhy\n", "\nbecause\n", "failed (exit code 3)"):
        assert shown in page
    # The report of an earlier run does not stand for one that fails now.
    (tmp_path / "reported.json").write_text("{}")
    assert gpu.do_part("reported", tmp_path, 1e-3, [], quick=False).status.startswith("cut off")
    assert not (tmp_path / "reported.json").exists()


def test_a_software_renderer_is_not_taken_for_a_gpu(tmp_path, monkeypatch):
    monkeypatch.setattr(gpu, "PARTS", {"doctor": gpu.Part("T", ("-c", "pass"))})
    for renderer, code in (("llvmpipe (LLVM 15.0.6, 256 bits)", 1), ("NVIDIA H200/PCIe/SSE2", 0)):
        facts = ContextFacts("egl", renderer, "4.6", {})
        monkeypatch.setattr(gpu, "context_facts", lambda _, facts=facts: facts)
        done = CliRunner().invoke(gpu.main, ["doctor", "--out", str(tmp_path)])
        assert done.exit_code == code, done.output
        assert ("OpenGL draws with llvmpipe" in done.output) == bool(code)
    monkeypatch.setattr(gpu, "context_facts", Mock(side_effect=BackendError("no OpenGL context could be opened")))
    monkeypatch.setattr(gpu, "nvidia_fault", lambda _: "no file tells EGL of it")
    done = CliRunner().invoke(gpu.main, ["doctor", "--out", str(tmp_path)])
    assert (done.exit_code, "no OpenGL context could be opened Of NVIDIA's: no file" in done.output) == (1, True)


def test_nvidias_driver_is_named_to_egl_where_no_file_does(tmp_path, monkeypatch):
    monkeypatch.setattr(gpu, "NVIDIA_CONTROL", tmp_path / "nvidiactl")
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", str(tmp_path / "none.json"))
    gpu.name_nvidia(tmp_path)
    assert not gpu.nvidia_is_named()
    (tmp_path / "nvidiactl").touch()
    gpu.name_nvidia(tmp_path)
    assert gpu.nvidia_is_named()
    assert json.loads((tmp_path / "10_nvidia.json").read_text())["ICD"]["library_path"] == "libEGL_nvidia.so.0"


def test_the_processes_of_a_part_end_with_it(tmp_path, monkeypatch):
    code = "import subprocess, sys; p = subprocess.Popen(['sleep', '60']); print(p.pid, flush=True); p.wait()"
    monkeypatch.setattr(gpu, "PARTS", {"parent": gpu.Part("T", ("-c", code))})
    assert gpu.do_part("parent", tmp_path, 2, [], quick=False).status == "cut off after 2 s"
    child = Path("/proc", (tmp_path / "parent.log").read_text().strip(), "stat")
    until = time.monotonic() + 30
    # A process that nobody waits for stays as a zombie.
    while child.exists() and child.read_text().rsplit(")", 1)[1].split()[0] != "Z":
        assert time.monotonic() < until
        time.sleep(0.05)


def test_parts_take_their_turns_and_their_shares_of_the_time(tmp_path, monkeypatch):
    done = []

    def do_part(name, _out, seconds, arguments, **_):
        done.append((name, seconds, list(arguments)))
        (tmp_path / f"{name}.log").touch()
        return gpu.Outcome("done", 0.0, "", "2000-01-01")

    monkeypatch.setattr(gpu, "do_part", do_part)
    given = ["training", "doctor", "--images", "A", "--real", "B", "--out", str(tmp_path), "--software"]
    assert CliRunner().invoke(gpu.main, [*given, "--minutes", "10"], catch_exceptions=False).exit_code == 0
    (first, seconds, none), (last, left, words) = done
    assert (first, none, last, words) == ("doctor", [], "training", ["--images", "A", "--real", "B"])
    assert seconds <= 60
    assert 300 < left <= 600
    late = CliRunner().invoke(gpu.main, [*given, "--minutes", "0.01"], catch_exceptions=False)
    assert (late.exit_code, len(done)) == (1, 2)
    assert "no time was left" in (tmp_path / "README.md").read_text()


@pytest.mark.usefixtures("short_parts")
@pytest.mark.parametrize(("failing", "code"), [(False, 0), (True, 1)])
def test_the_exit_code_tells_and_parts_of_before_are_kept(tmp_path, monkeypatch, failing, code):
    kept = {"status": "done", "seconds": 1.0, "command": "python before", "date": "2000-01-01"}
    (tmp_path / "parts.json").write_text(json.dumps({"reported": kept}))
    if failing:
        monkeypatch.setitem(gpu.PARTS, "doctor", gpu.PARTS["failing"])
    given = ["doctor", "--software", "--out", str(tmp_path), "--minutes", "1"]
    done = CliRunner().invoke(gpu.main, given, catch_exceptions=False)
    assert done.exit_code == code
    page = (tmp_path / "README.md").read_text()
    assert "python before" in page
    assert "## T" in page
