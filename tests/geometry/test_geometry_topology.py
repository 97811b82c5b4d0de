"""Which models are solid, and that drawing only their front faces loses nothing."""

from copy import deepcopy
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scenes import noise_layers

from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.geometry import outdoors, soft
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS
from semisynth_gl.geometry.mesh import make_mesh, merged
from semisynth_gl.geometry.topology import is_solid, marked_solid
from semisynth_gl.scene.scene import make_scene

KINDS = SIMPLE_KINDS | COMPLEX_KINDS
CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
OUTWARD = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
FAR = np.add(CORNERS, 5)
SPLIT = [CORNERS[vertex] for triangle in OUTWARD for vertex in triangle]  # with a vertex per corner, as UV needs it


@pytest.mark.parametrize(
    ("parts", "solid"),
    [
        ([(OUTWARD, CORNERS)], True),
        ([(np.arange(12).reshape(4, 3), SPLIT)], True),
        ([(OUTWARD, CORNERS), (OUTWARD, FAR)], True),
        ([(OUTWARD[1:], CORNERS)], False),  # a side is missing
        ([(np.flip(OUTWARD, axis=1), CORNERS)], False),  # inside out
        ([([OUTWARD[0][::-1], *OUTWARD[1:]], CORNERS)], False),  # one side flipped
        ([(OUTWARD, CORNERS), (np.flip(OUTWARD, axis=1), FAR)], False),
    ],
)
def test_surfaces_are_solid_whose_parts_are_all_closed_and_wound_outwards(parts, solid):
    meshes = [make_mesh("m", corners, np.zeros((len(corners), 2)), triangles) for triangles, corners in parts]
    assert is_solid(merged("m", meshes)) == solid


@pytest.fixture(scope="module", params=[(False, 11), (True, 13)], ids=["others", "soft and outdoors"])
def all_kinds(request):
    """Build a model of each kind of a group; also return the generator in its state afterwards."""
    are_later, seed = request.param
    rng = np.random.default_rng(seed)
    later = {kind for kind in COMPLEX_KINDS if hasattr(soft, kind) or hasattr(outdoors, kind)}
    return [marked_solid(build(rng)) for name, build in KINDS.items() if (name in later) == are_later], rng


# A near plane at 0.7 m cuts models open, so that their insides are visible.
@pytest.mark.parametrize(("mirrored", "near_m"), [(False, 0.01), (True, 0.01), (False, 0.7), (True, 0.7)])
def test_drawing_fronts_only_changes_no_pixel(open_renderer, all_kinds, mirrored, near_m):
    models, rng = deepcopy(all_kinds)
    count = len(models)
    matrices = np.tile(np.eye(4), (count, 1, 1))
    for matrix in matrices:
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix[:3, :3] = turn * np.sign(np.linalg.det(turn)) * rng.uniform(0.1, 0.5, 3) * (-1 if mirrored else 1)
    depth = rng.uniform(0.4, 4, count)
    matrices[:, :3, 3] = np.c_[rng.uniform(-0.5, 0.5, (count, 2)) * depth[:, None], depth]
    camera = StereoCamera.centred(240, 180, 200.0, 0.05)
    scene = make_scene(camera, model=range(count), world_from_model=matrices, layer=np.zeros(count), near_m=near_m)
    fronts = open_renderer(models, noise_layers(1, 16)).render(scene)
    both = open_renderer([replace(mesh, solid=False) for mesh in models], noise_layers(1, 16)).render(scene)
    for eye, name in product(EYES, ("image", "disparity", "visibility")):
        differs = fronts.view(eye)[name] != both.view(eye)[name]
        # Front and back faces meet at silhouettes, where float32 rounding decides which is nearer.
        assert differs.sum() <= 4, name
    for eye in EYES:
        np.testing.assert_allclose(fronts.view(eye).disparity, both.view(eye).disparity, atol=0.01, err_msg=eye)
