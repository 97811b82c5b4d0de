"""Models from positions and triangles of other programs."""

import numpy as np
import pytest
from geometry_measures import stretch

from semisynth_gl import make_model
from semisynth_gl.geometry.mesh import Mesh, make_mesh
from semisynth_gl.inputs.errors import InputError


def test_a_model_is_scaled_and_gets_uv_in_its_units():
    # No triangle uses the last corner, and two triangles have no area.
    corners = np.array([[0, 0, 5], [30, 0, 5], [30, 40, 5], [0, 40, 5], [15, 0, 5], [9e8, 9e8, 9e8]])
    triangles = [[0, 1, 2], [0, 2, 3], [0, 0, 1], [0, 1, 4]]
    for uv in (None, corners[:, :2] / 7, np.zeros((6, 2))):
        mesh = make_model("sheet", corners, triangles, uv)
        assert isinstance(mesh, Mesh)
        assert mesh.radius == pytest.approx(1)
        assert (len(mesh.positions), len(mesh.triangles)) == (4, 2)
        assert stretch(mesh) == pytest.approx(1, abs=1e-5)
    for arguments, message in (
        ((corners, [[0, 1, 6]]), "triangle index 6 is out of range"),
        ((corners, [[0, 1, -1]]), r"triangles: must be an array of uint32"),
        ((corners[:, :2], triangles), r"positions must be \(V, 3\)"),
        ((corners * np.nan, triangles), "got nan"),
        ((corners, triangles, corners[:2, :2]), "6 positions but 2 uv"),
        ((corners, [[0, 0, 1]]), "has no triangle with an area"),
        ((corners, np.zeros((0, 3), int)), "has no triangles"),
        (("cube", triangles), "positions"),
    ):
        with pytest.raises(InputError, match=message):
            make_model("sheet", *arguments)


@pytest.mark.parametrize(("position", "uv", "fits"), [(100, 15e3, True), (150, 0, False), (0, 17e3, False)])
def test_a_mesh_lies_where_float32_holds_its_shape(position, uv, fits):
    corners = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]])
    given = corners + position, corners[:, :2] + uv, [[0, 1, 2]]
    if fits:
        np.testing.assert_allclose(make_mesh("target", *given).positions, given[0], atol=1e-5)
    else:
        with pytest.raises(InputError, match=r"mesh target: (positions|uv) are farther from 0 than 16384 times"):
            make_mesh("target", *given)
