from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import trimesh
from geometry_measures import STRETCH_BOUND, areas, jacobians, stretch, volume
from gltf_files import DATA, glb, gltf
from shared_material import SHARED, needs_shared

from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_files import load_models
from semisynth_gl.geometry.surfaces import box
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import LFS_POINTER

MODELS = SHARED / "models"

SQUARE = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one good model, so that broken ones next to it are skipped and not the end."""
    (tmp_path / "good.obj").write_text(SQUARE + "f 1 2 3\nf 1 3 4\n")
    return tmp_path


def one(path: Path) -> Mesh:
    (mesh,), skipped = load_models([path])
    assert skipped == []
    return mesh


PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
)


@pytest.mark.parametrize(
    ("name", "content", "clause"),
    [
        ("nothing.obj", "", "no triangles"),
        ("nan.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "1 NaN vertices"),
        ("inf.obj", "v 0 0 0\nv 1 -inf 0\nv 0 1 inf\nf 1 2 3\n", "2 infinite vertices"),
        ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "out of bounds"),
        ("negative.ply", PLY + "3 0 1 -1\n", "index -1 out of range"),
        ("flat.obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "three columns"),
        ("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no triangle with an area"),
        ("point.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "no extent"),
        ("prose.obj", "Dear reader,\nthis is no model.\nface it: v is for victory\n", "no triangles"),
        ("prose.gltf", "{", "cannot be read"),
        ("cut.zip", b"PK", "cannot be read"),
        ("cut.glb", trimesh.creation.icosphere().export(file_type="glb")[:9000], "cannot be read"),
        ("cut.ply", trimesh.creation.icosphere().export(file_type="ply")[:9000], "cannot be read"),
        ("cut.stl", trimesh.creation.icosphere().export(file_type="stl")[:9000], "no triangles"),
        ("x.dae", "<x/>", "pip install pycollada"),
        ("x.USDZ", "PK", "save it as .glb"),
        ("x.ply", LFS_POINTER + b"v1", "Git LFS pointer"),
        ("x.gltf", gltf(extensionsRequired=["KHR_draco_mesh_compression"]), "Draco"),
        ("x.glb", glb(extensionsRequired=["EXT_meshopt_compression"]), "meshopt"),
    ],
)
def test_broken_models_are_skipped_with_a_reason(
    folder: Path, capfd: pytest.CaptureFixture[str], name: str, content: str | bytes, clause: str
) -> None:
    if ("pycollada" in clause and "dae" in trimesh.available_formats()) or ("Draco" in clause and find_spec("DracoPy")):
        pytest.skip("the reader of these files is installed here")
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    meshes, skipped = load_models([folder])
    assert [mesh.name for mesh in meshes] == ["good.obj"]
    assert [broken.path for broken in skipped] == [path]
    assert clause in skipped[0].reason
    assert "\n" not in skipped[0].reason
    assert capfd.readouterr() == ("", "")


def test_a_folder_without_a_usable_model_is_an_input_error_with_reasons(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere does not exist"):
        load_models([tmp_path / "nowhere"])
    (tmp_path / "broken.obj").write_text("v 0 0 0\n")
    with pytest.raises(InputError, match=r"broken.obj: has no triangles"):
        load_models([tmp_path])


def test_models_of_a_folder_are_found_in_the_order_of_their_paths(tmp_path: Path) -> None:
    for name in ("b.obj", "a/z.obj", "a/b.OBJ", "c.obj", "a.png", "a.txt", "obj", ".hidden"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(SQUARE + "f 1 2 3\n")
    assert [mesh.name for mesh in load_models([tmp_path])[0]] == ["a/b.OBJ", "a/z.obj", "b.obj", "c.obj"]
    assert [mesh.name for mesh in load_models([tmp_path / "c.obj", tmp_path / "a"])[0]] == ["c.obj", "b.OBJ", "z.obj"]


def test_uv_map_is_kept_in_model_units_with_v_downwards(folder: Path) -> None:
    (folder / "good.obj").write_text(SQUARE + "vt 0 0\nvt .5 0\nvt .5 .5\nvt 0 .5\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    mesh = one(folder)
    assert stretch(mesh).max() == pytest.approx(1, abs=1e-5)
    order = np.lexsort((mesh.positions[:, 0], mesh.positions[:, 1]))
    side = np.sqrt(2)
    uv = (mesh.uv - mesh.uv.min(axis=0))[order]
    assert uv == pytest.approx(np.array([[0, side], [side, side], [0, 0], [side, 0]]), abs=1e-5)


def test_few_triangles_with_a_large_share_of_the_map_do_not_set_the_scale(folder: Path) -> None:
    corners = "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 0 3 0\nv 4 0 0\nv 4 1 0\nv 3 1 0\n"
    body, eye = "vt 0 0\nvt .3 0\nvt .3 .3\nvt 0 .3\n", "vt 0 0\nvt 1 0\nvt 1 1\n"
    (folder / "good.obj").write_text(corners + body + eye + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 2/5 5/6 6/7\n")
    mesh = one(folder)
    assert np.sort(stretch(mesh)) == pytest.approx([1, 1, 10], rel=1e-4)


@pytest.mark.parametrize(
    "texture",
    ["vt 0 0\nvt 1 0\nvt 1 0\nvt 0 0\n", "vt nan 0\nvt inf 0\nvt 1 1\nvt 0 1\n"],
)
def test_collapsed_uv_is_replaced(folder: Path, texture: str) -> None:
    (folder / "good.obj").write_text(SQUARE + texture + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    mesh = one(folder)
    assert stretch(mesh).max() < STRETCH_BOUND + 1e-3
    assert len(mesh.triangles) == 2


def test_single_triangles_without_uv_are_projected(folder: Path) -> None:
    corners = "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 0 3 0\nv 4 0 0\n"
    texture = "vt 0 0\nvt 9 0\nvt 9 9\nvt 0 9\nvt 5 5\n"
    (folder / "good.obj").write_text(corners + texture + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 2/5 5/5 3/5\n")
    mesh = one(folder)
    assert len(mesh.triangles) == 3
    assert stretch(mesh) == pytest.approx(1, abs=1e-4)


def test_colours_that_are_not_finite_do_no_harm(folder: Path) -> None:
    (folder / "good.obj").write_text("v 0 0 0 nan nan nan\nv 1 0 0 inf 0 0\nv 0 1 0 0 0 0\nf 1 2 3\n")
    assert len(one(folder).triangles) == 1


def test_degenerate_triangles_and_loose_vertices_are_dropped(folder: Path) -> None:
    (folder / "good.obj").write_text(SQUARE + "v 1000 0 0\nv 1 0 0\nf 1 2 3\nf 1 1 2\nf 1 2 6\n")
    mesh = one(folder)
    assert len(mesh.triangles) == 1
    assert len(mesh.positions) == 3
    assert mesh.radius == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(("offset", "scale"), [(1e9, 1.0), (0.0, 1e-200), (0.0, 1e200)])
def test_place_and_size_do_not_matter(folder: Path, offset: float, scale: float) -> None:
    cube = box((1, 2, 3))
    corners = cube.positions.astype(float) * scale + offset
    lines = ["v " + " ".join(f"{value:.17g}" for value in corner) for corner in corners]
    lines += ["f " + " ".join(str(index + 1) for index in triangle) for triangle in cube.triangles]
    (folder / "good.obj").write_text("\n".join(lines))
    mesh = one(folder)
    half = np.sqrt(1 + 4 + 9) / 2
    # 1e9 + 1 has 7 decimals left in float64
    assert volume(mesh) == pytest.approx(6 / half**3, rel=1e-5)
    assert areas(mesh).min() > 0.1


def placed(path: Path, nodes: list[dict[str, object]], roots: list[int]) -> None:
    """One triangle, placed by nodes."""
    path.write_bytes(gltf(DATA, nodes=nodes, scene=0, scenes=[{"nodes": roots}]))


def test_nested_nodes_place_their_parts(tmp_path: Path) -> None:
    nodes = [
        {"children": [1], "translation": [4, 0, 0]},
        {"children": [2], "scale": [2, 2, 2]},
        {"mesh": 0, "translation": [0, 3, 0]},
        {"mesh": 0},
    ]
    placed(tmp_path / "nested.gltf", nodes, [0, 3])
    mesh = one(tmp_path)
    found = np.unique(np.round(mesh.positions * 5 + (3, 4, 0), 4), axis=0)
    # one triangle where it is, one doubled about (0, 3, 0) and moved by 4: the box is 6 x 8, its radius 5
    assert found.tolist() == [[0, 0, 0], [0, 1, 0], [1, 0, 0], [4, 6, 0], [4, 8, 0], [6, 6, 0]]


def test_mirrored_nodes_keep_their_outside(tmp_path: Path) -> None:
    placed(tmp_path / "mirrored.gltf", [{"mesh": 0, "scale": [-1, 1, 1]}], [0])
    mesh = one(tmp_path)
    corners = mesh.positions[mesh.triangles[0]]
    assert np.cross(corners[1] - corners[0], corners[2] - corners[0])[2] > 0
    assert np.linalg.det(jacobians(mesh))[0] < 0


def test_cyclic_nodes_are_no_endless_loop(folder: Path) -> None:
    placed(folder / "cycle.gltf", [{"children": [1]}, {"children": [0], "mesh": 0}], [0])
    meshes, skipped = load_models([folder])
    assert len(meshes) + len(skipped) == 2


@needs_shared
def test_real_models(capfd: pytest.CaptureFixture[str]) -> None:
    meshes, skipped = load_models([MODELS])
    assert {broken.path.name: broken.reason for broken in skipped} == {
        "BoxWithInfinites.glb": "has 24 infinite vertices",
        "empty.obj": "has no triangles",
    }
    assert capfd.readouterr() == ("", "")
    found = {mesh.name: mesh for mesh in meshes}
    assert len(found) == len(meshes) == 15
    for mesh in meshes:
        assert mesh.radius == pytest.approx(1, abs=1e-6)
        assert areas(mesh).min() > 0
        # half of the surface is textured finer than true, half coarser
        scale = np.sqrt(np.abs(np.linalg.det(jacobians(mesh))))
        order = np.argsort(scale)
        share = np.cumsum(areas(mesh)[order])
        assert scale[order][np.searchsorted(share, share[-1] / 2)] == pytest.approx(1, abs=0.15)
    for name in ("cycloidal.ply", "busted.STL", "teapot.obj", "alligator.obj", "large_block_obb.STL", "nancolor.obj"):
        assert stretch(found[name]).max() < 1.01 * STRETCH_BOUND
    # its 12 triangles survive although it stands 22,700 units off
    assert len(found["large_block_obb.STL"].triangles) == 12
    # its parts with and without UV: 3644 triangles less those without area
    assert 3600 < len(found["CesiumMilkTruck.glb"].triangles) <= 1744 + 56 + 2 * 288 + 768 + 768
    assert len(found["Duck.glb"].positions) < 1.2 * 2399
