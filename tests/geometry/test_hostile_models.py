"""Models made to take files, memory or time that are not theirs are refused with a reason, and the others read."""

import bz2
import io
import json
import struct
import sys
import tarfile
import zipfile

import numpy as np
import pytest
import trimesh
from gltf_files import DATA, TRIANGLE, document, glb, gltf
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from trimesh.exchange import load as trimesh_load

from semisynth_gl.geometry import model_reader
from semisynth_gl.geometry.model_files import OUT_OF_MEMORY, load_models
from semisynth_gl.geometry.model_reader import read_surfaces
from semisynth_gl.geometry.model_units import BrokenModelError

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def reason(path):
    with pytest.raises(BrokenModelError) as caught:
        read_surfaces(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture
def home(tmp_path):
    """A folder of models, with what a file there may refer to and what it may not."""
    home = tmp_path / "home"
    (home / "below").mkdir(parents=True)
    (tmp_path / "outside").mkdir()
    for path in ("outside/secret.bin", "secret.bin", "home/own.bin", "home/below/own.bin"):
        (tmp_path / path).write_bytes(TRIANGLE)
    (home / "link.bin").symlink_to(tmp_path / "secret.bin")
    (home / "folder").symlink_to(tmp_path / "outside")
    return home


def test_nothing_outside_a_models_folder_is_opened(home, monkeypatch):
    monkeypatch.setattr("socket.socket.connect", lambda *_: pytest.fail("a model file opened a connection"))
    for uri in (
        "/etc/passwd",
        f"file://{home.parent}/secret.bin",
        "../secret.bin",
        "below/../../secret.bin",
        "%2e%2e/secret.bin",
        "..\\secret.bin",
        "link.bin",
        "folder/secret.bin",
        "/dev/zero",
        "http://localhost:9/secret.bin",
        "",
        "own.bin\0",
        "x" * 5000,
        "\udcff.bin",
    ):
        for name, content in (("a.gltf", gltf(uri)), ("a.glb", glb(uri))):
            why = reason(write(home, name, content))
            assert "cannot be read" in why or "refers to" in why, uri
    for uri in ("own.bin", "./below/own.bin", "below/../own.bin", "/x/own.bin", DATA):
        assert len(read_surfaces(write(home, "a.gltf", gltf(uri)))) == 1


def test_textures_and_materials_elsewhere_do_no_harm_and_are_not_opened(home, monkeypatch):
    opened = []
    real = model_reader._read  # noqa: SLF001
    monkeypatch.setattr(model_reader, "_read", lambda path, room: opened.append(path.name) or real(path, room))
    (home / "own.mtl").write_text("newmtl a\nmap_Kd /etc/passwd\n")
    for name, content in {
        "a.obj": "mtllib /etc/passwd\n" + OBJ,
        "b.obj": "mtllib own.mtl\nusemtl a\n" + OBJ,
        "a.ply": "ply\nformat ascii 1.0\ncomment TextureFile /etc/passwd\n" + PLY_BODY,
        "a.gltf": gltf("own.bin", images=[{"uri": "/etc/passwd"}, {"uri": "../secret.bin"}]),
    }.items():
        assert len(read_surfaces(write(home, name, content))) == 1, name
    assert opened == ["a.obj", "b.obj", "a.ply", "a.gltf", "own.bin"]


PLY_BODY = (
    "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)
PLY_BINARY = (
    (
        "ply\nformat binary_little_endian 1.0\ncomment Größe\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode("latin-1")
    + TRIANGLE
    + struct.pack("<B3i", 3, 0, 1, 2)
)
STL_BINARY = "solid Größe".encode("latin-1").ljust(80) + struct.pack(
    "<I12fH", 1, *[0] * 3, *struct.unpack("<9f", TRIANGLE), 0
)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8"])
def test_text_needs_no_further_package_in_another_encoding(tmp_path, monkeypatch, encoding):
    for package in ("charset_normalizer", "chardet", "cchardet"):
        monkeypatch.setitem(sys.modules, package, None)
    texts = {
        "a.obj": "# Größe ÿ\no Tür\nusemtl größe\n" + OBJ,
        "a.ply": "ply\nformat ascii 1.0\ncomment Größe\n" + PLY_BODY,
        "a.gltf": json.dumps(document(DATA) | {"nodes": [{"mesh": 0, "name": "Tür"}]}, ensure_ascii=False),
    }
    for name, text in texts.items():
        surfaces = read_surfaces(write(tmp_path, name, text.encode(encoding)))
        assert [len(triangles) for _, triangles, _ in surfaces] == [1], name
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("a.obj", texts["a.obj"].encode(encoding))
    for name, content in {"a.zip": (tmp_path / "a.zip").read_bytes(), "b.ply": PLY_BINARY, "b.stl": STL_BINARY}.items():
        ((positions, _, _),) = read_surfaces(write(tmp_path, name, content))
        np.testing.assert_array_equal(positions, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


ROOM = 20_000


def zipped(**members):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name.replace("_", "."), content)
    return buffer.getvalue()


def tarred(*members, mode="w"):
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode=mode) as archive:
        for name, content in members:
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return buffer.getvalue()


def sparse_tar():
    """A GNU sparse file of 4 GiB in a tar of a few blocks."""
    header = bytearray(tarred(("a.obj", b""))[:512])
    header[156:157] = b"S"
    header[257:265] = b"ustar  \0"
    header[386:482] = b"0" * 96
    header[483:495] = b"%011o\0" % (1 << 32)
    header[148:156] = b" " * 8
    header[148:156] = b"%06o\0 " % sum(header)
    return bytes(header) + bytes(1024)


def test_what_is_unpacked_is_counted_before_it_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(model_reader, "MAX_BYTES", ROOM)
    bomb = OBJ.encode() + b"\n" * ROOM
    half = OBJ.encode() + b"#" * (ROOM // 2)
    declared = bytearray(zipped(a_obj=OBJ))
    entry = declared.rindex(b"PK\x01\x02")
    declared[entry + 24 : entry + 28] = struct.pack("<I", 4_000_000_000)
    files = {
        "a.zip": zipped(a_obj=bomb),
        "two.zip": zipped(a_obj=half, b_obj=half),
        "declared.zip": bytes(declared),
        "inside.zip": zipped(a_obj=OBJ, b_zip=zipped(c_obj=bomb) + bomb),
        "a.tar.gz": tarred(("a.obj", bomb), mode="w:gz"),
        "a.obj.bz2": bz2.compress(bomb),
        "sparse.tar.bz2": bz2.compress(sparse_tar()),
        "large.stl": bytes(ROOM + 1),
    }
    for name, content in files.items():
        assert "bytes" in reason(write(tmp_path, name, content)), name
    for name, content in {
        "b.zip": zipped(a_obj=OBJ),
        "b.tar.gz": tarred(("a.obj", OBJ.encode()), mode="w:gz"),
        "b.obj.bz2": bz2.compress(OBJ.encode()),
        "part.zip": zipped(a_obj=OBJ, b_ply="no model"),
    }.items():
        assert len(read_surfaces(write(tmp_path, name, content))) == 1, name


def test_buffers_count_together(tmp_path, monkeypatch):
    monkeypatch.setattr(model_reader, "MAX_BYTES", ROOM)
    write(tmp_path, "a.bin", TRIANGLE + bytes(ROOM // 3))
    buffers = [{"uri": "a.bin", "byteLength": 36}]
    assert read_surfaces(write(tmp_path, "a.gltf", gltf(buffers=buffers * 2)))
    assert "too large" in reason(write(tmp_path, "a.gltf", gltf(buffers=buffers * 3)))


def test_triangles_vertices_and_parts_are_counted_as_often_as_they_are_placed(tmp_path, monkeypatch):
    nodes = {"nodes": [{"mesh": 0}] * 8, "scenes": [{"nodes": list(range(8))}]}
    path = write(tmp_path, "a.glb", glb(**nodes))
    assert len(read_surfaces(path)) == 8
    for name, limit, word in (
        ("MAX_PARTS", 7, "parts"),
        ("MAX_TRIANGLES", 7, "triangles"),
        ("MAX_VERTICES", 23, "vertices"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(model_reader, name, limit + 1)
            assert len(read_surfaces(path)) == 8
            patch.setattr(model_reader, name, limit)
            assert f"{limit + 1} {word}" in reason(path)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(["a.obj", "a.ply", "b.ply", "b.stl", "a.gltf", "a.glb", "a.zip"]),
    edits=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=5),
    end=st.floats(0.3, 1),
)
def test_damaged_bytes_give_surfaces_or_a_reason(tmp_path, name, edits, end):
    whole = {
        "a.obj": OBJ.encode(),
        "a.ply": ("ply\nformat ascii 1.0\n" + PLY_BODY).encode(),
        "b.ply": PLY_BINARY,
        "b.stl": STL_BINARY,
        "a.gltf": gltf(DATA),
        "a.glb": glb(),
        "a.zip": zipped(a_obj=OBJ),
    }[name]
    damaged = bytearray(whole[: max(1, int(len(whole) * end))])
    for at, value in edits:
        damaged[int(at * len(damaged))] = value
    try:
        surfaces = read_surfaces(write(tmp_path, name, bytes(damaged)))
    except (BrokenModelError, MemoryError):
        return
    for positions, triangles, _ in surfaces:
        assert positions.shape[1:] == triangles.shape[1:] == (3,)
        assert np.isfinite(positions).all()
        assert {*triangles.flat} == {*range(len(positions))}


@pytest.mark.parametrize("error", [MemoryError(), RecursionError("too deep"), ValueError("two\nlines")])
def test_whatever_a_reader_raises_leaves_the_other_models(tmp_path, monkeypatch, error):
    def raising(*_args, **_options):
        raise error

    monkeypatch.setitem(trimesh_load.mesh_loaders, "off", raising)
    broken = [write(tmp_path, "a.off", "OFF"), write(tmp_path, "b.zip", zipped(a_off="OFF"))]
    write(tmp_path, "c.obj", OBJ)
    write(tmp_path, "d.zip", zipped(a_obj=OBJ))
    meshes, skipped = load_models([tmp_path])
    assert [mesh.name for mesh in meshes] == ["c.obj", "d.zip"]
    assert [each.path for each in skipped] == broken
    assert {each.reason == OUT_OF_MEMORY for each in skipped} == {isinstance(error, MemoryError)}


def test_what_a_gltf_declares_is_counted_before_it_is_allocated(tmp_path, monkeypatch):
    monkeypatch.setattr(model_reader, "MAX_VERTICES", 8)
    monkeypatch.setattr(trimesh, "load_scene", lambda *_args, **_options: pytest.fail("trimesh read the file"))
    absent = {"accessors": [{"componentType": 5126, "count": 10**9, "type": "VEC3"}]}
    primitive = {"attributes": {"POSITION": 0}}
    shared = {"meshes": [{"primitives": [primitive] * 2}, {"primitives": [primitive]}]}
    for parts, count in ((absent, "1,000,000,000"), (shared, "9")):
        for name, content in (("a.glb", glb(**parts)), ("a.zip", zipped(a_glb=glb(**parts)))):
            assert f"{count} vertices" in reason(write(tmp_path, name, content))


def test_a_model_in_an_archive_is_the_model_of_its_file(tmp_path):
    mesh = trimesh.creation.box()
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.random.default_rng(0).random((8, 2)))
    with zipfile.ZipFile(tmp_path / "model.zip", "w") as archive:
        for name, content in mesh.scene().export(file_type="gltf").items():
            write(tmp_path, name, content)
            archive.writestr(name, content)
    ((*_, uv),) = alone = read_surfaces(tmp_path / "model.gltf")
    assert uv.shape == (8, 2)
    np.testing.assert_equal(read_surfaces(tmp_path / "model.zip"), alone)
