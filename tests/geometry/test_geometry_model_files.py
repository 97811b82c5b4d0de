"""Model files: those that load, those that are skipped with a reason, and what untrusted files cannot read."""

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from geometry_measures import STRETCH_BOUND, areas, jacobians, stretch, volume
from gltf_files import DATA, TRIANGLE, document, glb, gltf
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shared_material import SHARED, needs_shared
from trimesh.exchange import load as trimesh_load

from semisynth_gl.geometry import model_files
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_files import load_models, read_surfaces
from semisynth_gl.geometry.surfaces import box
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import LFS_POINTER

MODELS = SHARED / "models"

SQUARE = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\n"
OBJ = SQUARE + "f 1 2 3\n"
PLY_HEAD = (
    "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
)
PLY = "ply\nformat ascii 1.0\n" + PLY_HEAD + "0 0 0\n1 0 0\n0 1 0\n"
PLY_BINARY = f"ply\nformat binary_little_endian 1.0\n{PLY_HEAD}".encode() + TRIANGLE + struct.pack("<B3i", 3, 0, 1, 2)
STL_BINARY = bytes(80) + struct.pack("<I12fH", 1, *[0] * 3, *struct.unpack("<9f", TRIANGLE), 0)


def write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def reason(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_surfaces(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def zipped(**members: str | bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name.replace("_", "."), content)
    return buffer.getvalue()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Write one good model, so that broken ones beside it are skipped instead of being an error."""
    write(tmp_path, "good.obj", SQUARE + "f 1 2 3\nf 1 3 4\n")
    return tmp_path


def one(path: Path) -> Mesh:
    (mesh,), skipped = load_models([path])
    assert skipped == []
    return mesh


def test_other_formats_have_the_surface(tmp_path: Path) -> None:
    files = {"a.ply": PLY + "3 0 1 2\n", "b.ply": PLY_BINARY, "c.stl": STL_BINARY, "d.glb": glb(), "e.gltf": gltf(DATA)}
    for name, content in files.items():
        ((positions, triangles, _),) = read_surfaces(write(tmp_path, name, content))
        np.testing.assert_array_equal(positions[triangles[0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]], err_msg=name)
    ((positions, triangles, _),) = read_surfaces(
        write(tmp_path, "windows.obj", b"\xef\xbb\xbf" + OBJ.encode() + b"# caf\xe9\n")
    )
    np.testing.assert_array_equal(positions[triangles[0]], [[0, 0, 0], [2, 0, 0], [2, 2, 0]])
    assert len(read_surfaces(write(tmp_path, "two.zip", zipped(a_obj=OBJ, b_ply=PLY_BINARY, c_txt="no model")))) == 2
    mesh = trimesh.creation.box()
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.random.default_rng(0).random((8, 2)))
    mesh.export(tmp_path / "textured.glb")
    ((*_, uv),) = read_surfaces(tmp_path / "textured.glb")
    assert uv is not None
    assert uv.shape == (8, 2)


@pytest.mark.parametrize(
    ("name", "content", "clause"),
    [
        ("nothing.obj", "", "no triangles"),
        ("nan.obj", "v nan 0 0\nv 1 inf 0\nv 0 1 0\nf 1 2 3\n", "2 vertices that are not finite"),
        ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "out of bounds"),
        ("negative.ply", PLY + "3 0 1 -1\n", "index out of range"),
        ("flat.obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "cannot be read"),
        ("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no triangle with an area"),
        ("point.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "no extent"),
        ("prose.obj", "Dear reader,\nthis is no model.\nface it: v is for victory\n", "no triangles"),
        ("prose.gltf", "{", "cannot be read"),
        ("cut.zip", b"PK", "cannot be read"),
        ("cut.glb", trimesh.creation.icosphere().export(file_type="glb")[:9000], "cannot be read"),
        ("cut.ply", trimesh.creation.icosphere().export(file_type="ply")[:9000], "cannot be read"),
        ("cut.stl", trimesh.creation.icosphere().export(file_type="stl")[:9000], "no triangles"),
        ("x.USDZ", "PK", "save it as .glb"),
        ("x.ply", LFS_POINTER + b"v1", "Git LFS pointer"),
        ("x.glb", glb(extensionsRequired=["EXT_meshopt_compression"]), "meshopt"),
    ],
)
def test_broken_models_are_skipped_with_a_reason(
    folder: Path, capfd: pytest.CaptureFixture[str], name: str, content: str | bytes, clause: str
) -> None:
    path = write(folder, name, content)
    meshes, skipped = load_models([folder])
    assert [mesh.name for mesh in meshes] == ["good.obj"]
    assert [broken.path for broken in skipped] == [path]
    assert clause in skipped[0].reason
    assert "\n" not in skipped[0].reason
    assert capfd.readouterr() == ("", "")


def test_a_folder_without_a_usable_model_is_an_input_error_with_reasons(tmp_path: Path) -> None:
    (tmp_path / "broken.obj").write_text("v 0 0 0\n")
    for name, found in (("nowhere", "does not exist"), ("broken.obj", "is a file")):
        with pytest.raises(InputError, match=f"expected a folder, but .*{name} {found}"):
            load_models([tmp_path / name])
    with pytest.raises(InputError, match=r"broken.obj: has no triangles"):
        load_models([tmp_path])


def test_models_of_a_folder_are_found_in_the_order_of_their_paths(tmp_path: Path) -> None:
    for name in ("b.obj", "a/z.obj", "a/b.OBJ", "c.obj", "a.png", "a.txt", "obj", ".hidden"):
        write(tmp_path, name, OBJ)
    assert [mesh.name for mesh in load_models([tmp_path])[0]] == ["a/b.OBJ", "a/z.obj", "b.obj", "c.obj"]
    write(tmp_path, "b/c.obj", OBJ)
    (tmp_path / "b/linked").symlink_to(tmp_path / "a")
    (tmp_path / "b/loop").symlink_to(tmp_path / "b")
    found = [mesh.name for mesh in load_models([tmp_path / "b", tmp_path / "a"])[0]]
    assert found == ["c.obj", "linked/b.OBJ", "linked/z.obj", "b.OBJ", "z.obj"]


def test_uv_map_is_kept_in_model_units_with_v_downwards(folder: Path) -> None:
    (folder / "good.obj").write_text(SQUARE + "vt 0 0\nvt .5 0\nvt .5 .5\nvt 0 .5\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    mesh = one(folder)
    assert stretch(mesh).max() == pytest.approx(1, abs=1e-5)
    order = np.lexsort((mesh.positions[:, 0], mesh.positions[:, 1]))
    side = np.sqrt(2)
    uv = (mesh.uv - mesh.uv.min(axis=0))[order]
    assert uv == pytest.approx(np.array([[0, side], [side, side], [0, 0], [side, 0]]), abs=1e-5)


FACES = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
WIDER = "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 0 3 0\nv 4 0 0\nv 4 1 0\nv 3 1 0\n"
EYE = "vt 0 0\nvt .3 0\nvt .3 .3\nvt 0 .3\nvt 0 0\nvt 1 0\nvt 1 1\n"


@pytest.mark.parametrize(
    ("content", "drawn_out"),
    [
        (WIDER + EYE + FACES + "f 2/5 5/6 6/7\n", [1, 1, 10]),  # a small area does not set the scale
        (SQUARE + "vt 0 0\nvt 1 0\nvt 1 0\nvt 0 0\n" + FACES, [1, 1]),  # collapsed
        (SQUARE + "vt nan 0\nvt inf 0\nvt 1 1\nvt 0 1\n" + FACES, [1, 1]),
        # One triangle has no UV.
        (WIDER + "vt 0 0\nvt 9 0\nvt 9 9\nvt 0 9\nvt 5 5\n" + FACES + "f 2/5 5/5 3/5\n", [1, 1, 1]),
    ],
)
def test_uv_maps_are_scaled_by_area_and_replaced_where_unusable(
    folder: Path, content: str, drawn_out: list[float]
) -> None:
    (folder / "good.obj").write_text(content)
    assert np.sort(stretch(one(folder))) == pytest.approx(drawn_out, rel=1e-4)


@pytest.mark.parametrize(("offset", "scale"), [(1e9, 1.0), (0.0, 1e-200), (0.0, 1e200)])
def test_place_and_size_do_not_matter(folder: Path, offset: float, scale: float) -> None:
    cube = box((1, 2, 3))
    corners = cube.positions.astype(float) * scale + offset
    lines = ["v " + " ".join(f"{value:.17g}" for value in corner) for corner in corners]
    lines += ["f " + " ".join(str(index + 1) for index in triangle) for triangle in cube.triangles]
    (folder / "good.obj").write_text("\n".join(lines))
    mesh = one(folder)
    half = np.sqrt(1 + 4 + 9) / 2
    # In float64, 1e9 + 1 keeps 7 decimals.
    assert volume(mesh) == pytest.approx(6 / half**3, rel=1e-5)
    assert areas(mesh).min() > 0.1


def write_nodes(path: Path, nodes: list[dict[str, object]], roots: list[int]) -> None:
    """Write a file of one triangle that nodes place."""
    path.write_bytes(gltf(DATA, nodes=nodes, scene=0, scenes=[{"nodes": roots}]))


def test_nested_nodes_place_their_parts(tmp_path: Path) -> None:
    nodes = [
        {"children": [1], "translation": [4, 0, 0]},
        {"children": [2], "scale": [2, 2, 2]},
        {"mesh": 0, "translation": [0, 3, 0]},
        {"mesh": 0},
    ]
    write_nodes(tmp_path / "nested.gltf", nodes, [0, 3])
    mesh = one(tmp_path)
    found = np.unique(np.round(mesh.positions * 5 + (3, 4, 0), 4), axis=0)
    # One triangle is at the origin; one is doubled about (0, 3, 0) and moved by 4. Their box is 6 x 8, with radius 5.
    assert found.tolist() == [[0, 0, 0], [0, 1, 0], [1, 0, 0], [4, 6, 0], [4, 8, 0], [6, 6, 0]]


def test_mirrored_nodes_keep_their_outside(tmp_path: Path) -> None:
    write_nodes(tmp_path / "mirrored.gltf", [{"mesh": 0, "scale": [-1, 1, 1]}], [0])
    mesh = one(tmp_path)
    corners = mesh.positions[mesh.triangles[0]]
    assert np.cross(corners[1] - corners[0], corners[2] - corners[0])[2] > 0
    assert np.linalg.det(jacobians(mesh))[0] < 0


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """Make a folder of models, with files inside and outside that models may or may not refer to."""
    for name in ("outside/secret.bin", "secret.bin", "home/own.bin"):
        write(tmp_path, name, TRIANGLE)
    write(tmp_path / "home", "below/own.bin", TRIANGLE)
    (tmp_path / "home/link.bin").symlink_to(tmp_path / "secret.bin")
    (tmp_path / "home/folder").symlink_to(tmp_path / "outside")
    return tmp_path / "home"


def test_nothing_outside_a_models_folder_is_opened(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.socket.connect", lambda *_: pytest.fail("a model file opened a connection"))
    opened = []
    real = model_files._read  # noqa: SLF001
    monkeypatch.setattr(model_files, "_read", lambda path, most: opened.append(path.name) or real(path, most))
    for uri in (
        "/etc/passwd",
        "/x/own.bin",
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
    for uri in ("own.bin", "./below/own.bin", "below/../own.bin", DATA):
        assert len(read_surfaces(write(home, "a.gltf", gltf(uri)))) == 1
    write(home, "own.mtl", "newmtl a\nmap_Kd /etc/passwd\n")
    for name, content in {
        "a.obj": "mtllib /etc/passwd\n" + OBJ,
        "b.obj": "mtllib own.mtl\nusemtl a\n" + OBJ,
        "a.ply": PLY.replace("1.0", "1.0\ncomment TextureFile /etc/passwd") + "3 0 1 2\n",
        "a.gltf": gltf("own.bin", images=[{"uri": "/etc/passwd"}, {"uri": "../secret.bin"}]),
    }.items():
        assert len(read_surfaces(write(home, name, content))) == 1, name
    assert set(opened) == {"a.gltf", "a.glb", "own.bin", "a.obj", "b.obj", "a.ply"}


def test_sizes_are_limited_before_memory_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = 20_000
    monkeypatch.setattr(model_files, "MAX_BYTES", room)
    bomb = OBJ.encode() + b"\n" * room
    for name, content in {
        "a.zip": zipped(a_obj=bomb),
        "two.zip": zipped(a_obj=bomb[:15_000], b_obj=bomb[:15_000]),
        "large.stl": bytes(room + 1),
    }.items():
        assert "bytes" in reason(write(tmp_path, name, content)), name
    write(tmp_path, "a.bin", TRIANGLE + bytes(room // 3))
    buffers = [{"uri": "a.bin", "byteLength": 36}]
    assert read_surfaces(write(tmp_path, "a.gltf", gltf(buffers=buffers * 2)))
    assert "bytes" in reason(write(tmp_path, "a.gltf", gltf(buffers=buffers * 3)))
    monkeypatch.setattr(model_files, "MAX_VERTICES", 8)
    monkeypatch.setattr(trimesh, "load_scene", lambda *_args, **_options: pytest.fail("trimesh read the file"))
    absent = {"accessors": [{"componentType": 5126, "count": 10**9, "type": "VEC3"}]}
    primitive = {"attributes": {"POSITION": 0}}
    shared = {"meshes": [{"primitives": [primitive] * 2}, {"primitives": [primitive]}]}
    for parts, count in ((absent, "1,000,000,000"), (shared, "9")):
        assert f"{count} vertices" in reason(write(tmp_path, "a.glb", glb(**parts)))


def test_triangles_and_vertices_are_counted_as_often_as_they_are_placed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path, "a.glb", glb(nodes=[{"mesh": 0}] * 8, scenes=[{"nodes": list(range(8))}]))
    assert len(read_surfaces(path)) == 8
    for name, count, word in (("MAX_TRIANGLES", 8, "triangles"), ("MAX_VERTICES", 24, "vertices")):
        with monkeypatch.context() as patch:
            patch.setattr(model_files, name, count)
            assert len(read_surfaces(path)) == 8
            patch.setattr(model_files, name, count - 1)
            assert f"{count} {word}" in reason(path)


WHOLE = {
    "a.obj": OBJ.encode(),
    "a.ply": (PLY + "3 0 1 2\n").encode(),
    "b.ply": PLY_BINARY,
    "b.stl": STL_BINARY,
    "a.gltf": json.dumps(document(DATA)).encode(),
    "a.glb": glb(),
    "a.zip": zipped(a_obj=OBJ),
}


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(sorted(WHOLE)),
    edits=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=5),
    end=st.floats(0.3, 1),
)
def test_damaged_bytes_give_surfaces_or_a_reason(
    tmp_path: Path, name: str, edits: list[tuple[float, int]], end: float
) -> None:
    damaged = bytearray(WHOLE[name][: max(1, int(len(WHOLE[name]) * end))])
    for at, value in edits:
        damaged[int(at * len(damaged))] = value
    try:
        surfaces = read_surfaces(write(tmp_path, name, bytes(damaged)))
    except InputError:
        return
    for positions, triangles, _ in surfaces:
        assert positions.shape[1:] == triangles.shape[1:] == (3,)
        assert np.isfinite(positions).all()
        assert {*triangles.flat} <= {*range(len(positions))}


@pytest.mark.parametrize("error", [RecursionError("too deep"), ValueError("two\nlines")])
def test_whatever_a_reader_raises_leaves_the_other_models(
    folder: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def raising(*_args: object, **_options: object) -> None:
        raise error

    monkeypatch.setitem(trimesh_load.mesh_loaders, "off", raising)
    broken = write(folder, "a.off", "OFF")
    meshes, skipped = load_models([folder])
    assert [mesh.name for mesh in meshes] == ["good.obj"]
    assert [each.path for each in skipped] == [broken]
    assert f"cannot be read ({type(error).__name__}" in skipped[0].reason


@needs_shared
def test_real_models(capfd: pytest.CaptureFixture[str]) -> None:
    meshes, skipped = load_models([MODELS])
    assert {broken.path.name: broken.reason for broken in skipped} == {
        "BoxWithInfinites.glb": "has 24 vertices that are not finite",
        "empty.obj": "has no triangles",
    }
    assert capfd.readouterr() == ("", "")
    found = {mesh.name: mesh for mesh in meshes}
    assert len(found) == len(meshes) == 15
    for mesh in meshes:
        assert mesh.radius == pytest.approx(1, abs=1e-6)
        assert areas(mesh).min() > 0
        # the median scale of the texture over the surface is 1
        scale = np.sqrt(np.abs(np.linalg.det(jacobians(mesh))))
        order = np.argsort(scale)
        share = np.cumsum(areas(mesh)[order])
        assert scale[order][np.searchsorted(share, share[-1] / 2)] == pytest.approx(1, abs=0.15)
    for name in ("cycloidal.ply", "busted.STL", "teapot.obj", "alligator.obj", "large_block_obb.STL", "nancolor.obj"):
        assert stretch(found[name]).max() < 1.01 * STRETCH_BOUND
    # its 12 triangles survive although it is 22,700 units from the origin
    assert len(found["large_block_obb.STL"].triangles) == 12
    # its parts with and without UV have 3644 triangles, some without area
    assert 3600 < len(found["CesiumMilkTruck.glb"].triangles) <= 1744 + 56 + 2 * 288 + 768 + 768
    assert len(found["Duck.glb"].positions) < 1.2 * 2399
