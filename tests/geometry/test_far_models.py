"""Models whose vertices lie far from their origin, as those of maps and sites, are drawn as where they lie near."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import facing, noise_layers

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.channels import DRAWN_OUTPUTS, FLOW_OUTPUTS
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS
from semisynth_gl.geometry.mesh import centred, make_mesh
from semisynth_gl.geometry.model_files import load_models
from semisynth_gl.geometry.topology import is_solid, marked_solid, neighbours
from semisynth_gl.scene.background import FACE
from semisynth_gl.scene.scene import make_scene, move

AWAY_M = np.array([6e6, -4.9e6, 5.3e6])
PERIODS = np.float64(2e6)


CAMERA = StereoCamera(200, 150, 220.0, 0.2, 95.0, 103.0, 70.0)
SHOWN = ("torus", "mug", "sphere", "chair", "cube", "table", "potted_plant", "cone")


def cluttered(seed):
    """A wall, and models of several kinds in front of it."""
    rng = np.random.default_rng(seed)
    kinds = SIMPLE_KINDS | COMPLEX_KINDS
    models = [FACE, *(kinds[name](rng) for name in SHOWN)]
    poses = [facing(CAMERA, -300, -300, 900, 900, 4.0)]
    for _ in models[1:]:
        pose, depth_m = np.eye(4), rng.uniform(1.2, 3.0)
        pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        pose[:3, :3] *= np.sign(np.linalg.det(pose[:3, :3])) * 0.13 * depth_m * rng.uniform(0.5, 1, 3)
        pose[:3, 3] = rng.uniform(-0.35, 0.35) * depth_m, rng.uniform(-0.25, 0.25) * depth_m, depth_m
        poses.append(pose)
    count = len(models)
    return make_scene(CAMERA, model=range(count), world_from_model=poses, layer=[0] * count, uv_scale=3), models


def far_away(mesh):
    """Return a mesh in coordinates of a map, and with UV of one; as solid as it was."""
    far = make_mesh(mesh.name, mesh.positions + AWAY_M, mesh.uv + PERIODS, mesh.triangles)
    return replace(far, solid=mesh.solid)


def brought_back(world_from_model):
    back = np.eye(4)
    back[:3, 3] = -AWAY_M
    return world_from_model @ back


def moved(scene, *, far):
    """A motion of all instances and of the camera."""
    rng = np.random.default_rng(0)
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.qr(np.eye(3) + 0.03 * rng.normal(size=(3, 3)))[0] * [1, 1, 1]
    turn[:3, :3] *= np.sign(np.diag(turn[:3, :3]))
    poses = scene.world_from_model @ turn
    poses[:, :3, 3] += rng.normal(size=(len(scene), 3)) * 0.03
    camera = np.eye(4)
    camera[:3, 3] = 0.02, 0.01, -0.03
    return move(scene, world_from_model=brought_back(poses) if far else poses, camera_from_world=camera)


@pytest.mark.one_backend
@pytest.mark.parametrize("antialias", ["none", "edges"])
def test_every_output_of_far_models_is_that_of_near_ones(open_renderer, antialias):
    scene, models = cluttered(1)
    mirrored = scene.world_from_model.copy()
    mirrored[3, :3, 0] *= -1
    scene = replace(scene, world_from_model=mirrored)
    models = [marked_solid(mesh) for mesh in models]
    assert any(mesh.solid for mesh in models)
    there = replace(scene, world_from_model=brought_back(scene.world_from_model))
    near, far = (
        open_renderer(meshes, noise_layers(1, 32), outputs=DRAWN_OUTPUTS, antialias=antialias).render(
            shown, future=moved(scene, far=shown is there), past=moved(scene, far=shown is there)
        )
        for meshes, shown in ((models, scene), ([far_away(mesh) for mesh in models], there))
    )
    assert set(DRAWN_OUTPUTS) >= FLOW_OUTPUTS
    for eye in EYES:
        for name, expected in near.view(eye).items():
            found = far.view(eye)[name]
            if found.dtype.kind == "u" and name != "image":
                assert (found != expected).mean() <= 1e-3, name
            elif name == "image":
                assert (np.abs(found.astype(int) - expected) > 3).mean() <= 1e-3
            else:
                known = np.isfinite(expected) & np.isfinite(found)
                assert (np.isfinite(found) != np.isfinite(expected)).mean() <= 1e-3, name
                error = np.abs(found[known] - expected[known]) / np.maximum(1, np.abs(expected[known]))
                assert np.quantile(error, 0.995) <= 1e-4, name


def test_far_meshes_keep_their_shape_and_what_follows_from_it():
    ball = SIMPLE_KINDS["sphere"](np.random.default_rng(0))
    far = make_mesh("far", ball.positions + AWAY_M, ball.uv + PERIODS, ball.triangles)
    assert far.positions.dtype == far.uv.dtype == np.float64
    drawn = centred(far)
    assert drawn.mesh.positions.dtype == drawn.mesh.uv.dtype == np.float32
    np.testing.assert_allclose(drawn.mesh.positions + drawn.origin - AWAY_M, ball.positions, atol=1e-7)
    np.testing.assert_allclose(drawn.mesh.uv + drawn.uv_origin - PERIODS, ball.uv, atol=1e-6)
    assert is_solid(ball)
    assert is_solid(far)
    np.testing.assert_array_equal(neighbours(far), neighbours(ball))
    assert make_mesh("near", ball.positions + 5, ball.uv, ball.triangles).positions.dtype == np.float32


def test_models_of_files_lose_nothing_far_from_their_origin(tmp_path):
    ball = SIMPLE_KINDS["sphere"](np.random.default_rng(0))
    for name, away, uv_away in (("near", 0, 0), ("far", AWAY_M, PERIODS)):
        lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in ball.positions.astype(float) + away]
        lines += [f"vt {u:.9f} {v:.9f}" for u, v in ball.uv.astype(float) + uv_away]
        lines += ["f " + " ".join(f"{k + 1}/{k + 1}" for k in triangle) for triangle in ball.triangles]
        (tmp_path / f"{name}.obj").write_text("\n".join(lines))
    (far, near), skipped = load_models([tmp_path])
    assert not skipped
    assert far.positions.dtype == far.uv.dtype == np.float32
    np.testing.assert_allclose(far.positions, near.positions, atol=1e-6)
    # A patch lies elsewhere on it, all of a piece.
    shift = (far.uv - near.uv).astype(float)
    np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-6)
