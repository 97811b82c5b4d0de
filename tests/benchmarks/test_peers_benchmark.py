"""The benchmark of renderers side by side, as far as it can be run in seconds: its scene, loop, accuracy and table."""

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks" / "peers"))

from accuracy import cast_truth, errors_px
from exr import read_exr
from loop import write_arrays
from run import (
    CANDIDATES,
    ENCODER_PACKAGES,
    OURS,
    REFERENCE,
    SOME_LEFT_OUT,
    SYSTEM_BLENDER,
    Candidate,
    Measured,
    Parallel,
    PeerError,
    as_json,
    main,
    measure,
    missing,
    run_together,
    table,
)
from scene import PeerScene, library_meshes, make_scene

from semisynth_gl.codecs.pfm import PFM
from semisynth_gl.codecs.png import RGB8


def small_scene(folder: Path, frames: int) -> PeerScene:
    return make_scene(folder, library_meshes(), frames, size_px=(150, 100), instances=12, patches=4, patch_px=32)


def test_a_scene_depends_on_its_arguments_alone_and_longer_ones_start_alike(tmp_path):
    short, again, longer = (small_scene(tmp_path / name, n) for name, n in (("a", 2), ("b", 2), ("c", 3)))
    assert (tmp_path / "a" / "scene.npz").read_bytes() == (tmp_path / "b" / "scene.npz").read_bytes()
    for name in ("model", "patch", "camera_from_model", "wall_patch"):
        np.testing.assert_array_equal(getattr(short, name), getattr(longer, name)[:2])
    assert [path.read_bytes() for path in short.patches] == [path.read_bytes() for path in longer.patches]
    assert len(again.patches) == 4
    assert len(again.models) == 6


@pytest.mark.skipif(all(backend_fault(backend) for backend in ("egl", "osmesa")), reason="no OpenGL here")
def test_our_peer_writes_exact_pairs_in_two_processes_as_in_one(tmp_path):
    scene = small_scene(tmp_path / "scene", 2)
    truth = cast_truth(scene, (0, 1), rays=300)
    candidate = Candidate(OURS, "all", "ours")
    files = {}
    for processes in (1, 2):
        seconds, details = run_together(candidate, Parallel(processes, "1"), scene.folder, [0, 1], tmp_path)
        assert seconds > 0
        assert [len(detail["frame_s"]) for detail in details] == [2 // processes] * processes
        out = tmp_path / "out" / candidate.name
        error = errors_px(out, truth)
        assert error["pixels"] > 200
        assert error["worst"] < 1e-3
        files[processes] = {path.relative_to(out).as_posix(): path.read_bytes() for path in out.glob("*/*")}
    assert files[1] == files[2]
    assert sorted(files[1])[:6] == [
        f"000000/{name}"
        for name in (
            "disp.pfm",
            "disp_right.pfm",
            "left.png",
            "right.png",
            "visibility_left.png",
            "visibility_right.png",
        )
    ]


@pytest.mark.parametrize("our_encoders", [False, True])
def test_arrays_are_written_without_loss_by_pillow_and_by_our_encoders(tmp_path, our_encoders):
    rng = np.random.default_rng(0)
    left, right = rng.integers(0, 256, (2, 5, 7, 3), np.uint8)
    disparity = rng.random((5, 7), np.float32)
    write_arrays(tmp_path, left, right, disparity, our_encoders=our_encoders)
    for name, image in (("left.png", left), ("right.png", right)):
        data = (tmp_path / name).read_bytes()
        assert (data == RGB8.encode(image)) == our_encoders
        np.testing.assert_array_equal(RGB8.decode(data, tmp_path / name), image)
    data = (tmp_path / "disp.pfm").read_bytes()
    np.testing.assert_array_equal(PFM.decode(data, tmp_path / "disp.pfm"), disparity)


def test_a_peers_environment_has_what_our_encoders_import():
    show = (
        "import sys, semisynth_gl.codecs.pfm, semisynth_gl.codecs.png; "
        "print(*{name.partition('.')[0] for name in sys.modules} - sys.stdlib_module_names)"
    )
    command = [sys.executable, "-S", "-c", f"import sys; sys.path[:] = {sys.path!r}; {show}"]
    imported = set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    assert imported - {"__main__"} == {"semisynth_gl", "numpy", "isal", "PIL"}
    assert set(ENCODER_PACKAGES) == {"isal", "Pillow"}


def test_a_peer_that_breaks_is_reported_and_ends_nothing(tmp_path, monkeypatch, capsys):
    def broken(*_):
        raise PeerError("ended without saying READY")

    monkeypatch.setattr("run.run_together", broken)
    measured = measure(CANDIDATES[:2], small_scene(tmp_path / "scene", 2), tmp_path, rounds=2)
    assert [result.fault for result in measured.values()] == ["ended without saying READY"] * 2
    assert capsys.readouterr().err.count("ended without saying READY") == 2


def test_the_table_takes_each_peers_best_use_of_the_cores_and_compares_medians():
    names = {"one": Parallel(1), "two": Parallel(2), "alone": Parallel(2, "1")}
    error = {"median": 1e-6, "p99_9": 2e-5, "worst": 3e-4}

    def measured(**seconds):
        runs = {names[name]: own for name, own in seconds.items()}
        return Measured(runs, {parallel: [[{"version": "7"}]] for parallel in runs}, error)

    ours, slow, fast, broken = CANDIDATES[0], *(Candidate("p", name, name) for name in ("slow", "fast", "broken"))
    given = Candidate("p", "fast", "fast", our_encoders=True)
    peers = {
        ours: measured(one=[0.3, 0.5, 0.4], two=[0.3], alone=[0.2, 0.9, 0.1]),
        slow: measured(one=[3.0], two=[2.0]),
        fast: measured(one=[0.9], two=[1.0]),
        given: measured(one=[0.8], two=[0.5]),
        broken: Measured(fault="died"),
    }
    text = table(
        {
            "peers": [as_json(candidate, result) for candidate, result in peers.items()],
            "machine": {"cores": 2},
        }
    )
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert rows[2] == ["semisynth-gl", "us", "0.400", "0.200", "1.00", "1.0e-06", "2.0e-05", "3.0e-04"]
    assert [row[1:5] for row in rows[3:6]] == [
        ["itself", "3.000", "2.000", "10.00"],
        ["itself", "0.900", "1.000", "4.50"],
        ["us", "0.800", "0.500", "2.50"],
    ]
    assert rows[6][2] == "could not be run"
    assert "as a user would run it: fast, 4.50 times our time." in text
    assert "given our encoders: fast, 2.50 times our time." in text
    assert text.endswith("Versions: semisynth-gl: 7.")


def test_missing_programs_are_named_with_their_packages(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "blender").write_text("#!/bin/sh\n")
    (tmp_path / "blender").chmod(0o755)
    assert missing(SYSTEM_BLENDER, tmp_path) == [
        "the program xvfb-run is not in PATH (Debian: apt-get install xvfb)",
        "the program xauth is not in PATH (Debian: apt-get install xauth)",
    ]
    assert missing(OURS, tmp_path) == []
    assert "--setup pyrender" in missing("pyrender", tmp_path)[-1]
    monkeypatch.setattr("run.LIBRARIES", {"pygfx": {"libnowhere.so.1": "a-package"}})
    assert missing("pygfx", tmp_path)[0] == (
        "the library libnowhere.so.1 cannot be loaded (Debian: apt-get install a-package)"
    )


def test_a_peer_without_xvfb_run_is_left_out_and_the_others_are_measured(tmp_path, monkeypatch, capsys):
    def measured(candidates, *_):
        runs = {Parallel(processes): [0.5] for processes in (1, os.cpu_count() or 1)}
        error = {"median": 1e-6, "p99_9": 2e-5, "worst": 3e-4}
        details = {parallel: [[{"version": "7"}]] for parallel in runs}
        return {candidate: Measured(dict(runs), details, error) for candidate in candidates}

    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("run.measure", measured)
    monkeypatch.setattr("run.make_scene", lambda folder, _, frames: small_scene(folder, frames))
    monkeypatch.setattr(sys, "argv", ["run.py", "--peers", SYSTEM_BLENDER, "--work", str(tmp_path), "--frames", "64"])
    with pytest.raises(SystemExit) as exit_:
        main()
    assert exit_.value.code == SOME_LEFT_OUT
    captured = capsys.readouterr()
    assert f"{SYSTEM_BLENDER} is left out: the program blender is not in PATH" in captured.err
    assert "the program xvfb-run is not in PATH (Debian: apt-get install xvfb)" in captured.err
    assert [line.split("|")[1].strip() for line in captured.out.splitlines()[2:3]] == [REFERENCE.label]
    assert "Blender" not in captured.out


def test_a_program_that_cannot_be_started_is_a_fault_of_its_peer(tmp_path, monkeypatch):
    monkeypatch.setattr("run._command", lambda *_: [str(tmp_path / "no-such-program")])
    with pytest.raises(PeerError, match=r"could not be started: .*no-such-program"):
        run_together(CANDIDATES[0], Parallel(2), tmp_path, [0, 1], tmp_path)


def exr_bytes(image: np.ndarray, compression: int, rows_of_a_block: int) -> bytes:
    """Encode a channel named V as OpenEXR's specification has it, ZIP with zlib."""
    height, width = image.shape
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channels = b"V\0" + struct.pack("<i4B2i", 2, 0, 0, 0, 0, 1, 1) + b"\0"
    attributes = {
        (b"channels", b"chlist"): channels,
        (b"compression", b"compression"): bytes([compression]),
        (b"dataWindow", b"box2i"): window,
        (b"lineOrder", b"lineOrder"): b"\0",
    }
    header = struct.pack("<2i", 20000630, 2)
    for (name, kind), value in attributes.items():
        header += name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value
    header += b"\0"
    blocks = []
    for first in range(0, height, rows_of_a_block):
        plain = image[first : first + rows_of_a_block].astype("<f4").tobytes()
        halves = np.frombuffer(plain[0::2] + plain[1::2], np.uint8)
        steps = np.concatenate([halves[:1], np.diff(halves) + np.uint8(128)])
        packed = zlib.compress(steps.tobytes()) if compression else plain
        packed = packed if len(packed) < len(plain) else plain
        blocks.append(struct.pack("<2i", first, len(packed)) + packed)
    start = len(header) + 8 * len(blocks)
    offsets = start + np.cumsum([0, *map(len, blocks[:-1])])
    return header + offsets.astype("<u8").tobytes() + b"".join(blocks)


@pytest.mark.parametrize(("compression", "rows_of_a_block"), [(0, 1), (3, 16)])
def test_exr_is_read_stored_and_zipped(tmp_path, compression, rows_of_a_block):
    # 37 rows end in a block that is not full; noise does not compress and is stored, the ramp is zipped.
    image = np.random.default_rng(0).integers(0, 2**31, (37, 50)).astype(np.uint32).view(np.float32)
    image[:20] = np.linspace(0, 200, 50, dtype=np.float32)
    path = tmp_path / "image.exr"
    path.write_bytes(exr_bytes(image, compression, rows_of_a_block))
    np.testing.assert_array_equal(read_exr(path), image)


def test_exr_of_another_compression_is_refused(tmp_path):
    path = tmp_path / "image.exr"
    path.write_bytes(exr_bytes(np.zeros((2, 2), np.float32), 4, 32))
    with pytest.raises(ValueError, match="compression 4 is neither none nor ZIP"):
        read_exr(path)
