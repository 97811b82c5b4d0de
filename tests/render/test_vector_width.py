"""Vector widths of llvmpipe: ARM and x86 without AVX have 128 bits, other processors 256."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render.devices import context_facts
from semisynth_gl.render.vector_width import WIDTH, separate_compiled_shaders

TESTS = Path(__file__).parents[1]
NARROW = "128"
# What draws each channel, and each way to draw it, in the least time.
DRAWING = {
    "masks": ["render/test_masks.py", "pairs/test_crop.py::test_a_crop_has_the_pixels_of_the_whole_image"],
    "disparity": [
        "render/test_render_exactness.py::test_planes_have_their_analytic_disparity",
        "render/test_render_exactness.py::test_a_patch_at_one_texel_per_pixel_comes_out_bit_for_bit",
        "render/test_signed.py::test_crops_are_those_of_the_whole_image",
        "render/test_signed.py::test_the_sky_has_no_parallax_and_turns_with_the_camera",
        "render/test_baselines.py::test_a_rig_is_drawn_as_its_cameras_alone",
    ],
    "flow": [
        "render/test_flow.py::test_a_plane_that_moves_sideways_and_away_has_the_flow_of_the_formula",
        "render/test_flow.py::test_what_is_hidden_gone_or_outside_then_is_marked",
        "render/test_flow.py::test_crops_and_bands_of_flow_are_those_of_the_whole_image",
    ],
    "correspondence": [
        "render/test_rig.py::test_planes_have_their_analytic_correspondence",
        "render/test_rig.py::test_a_crop_is_a_part_of_the_whole_image_and_points_are_where_they_stand",
    ],
    "images": [
        "render/test_antialias_edges.py::test_outlines_come_near_to_many_samples",
        "pairs/test_grey.py::test_grey_images_are_the_luminance_of_coloured_ones_and_truth_is_the_same",
        "render/test_occlusion.py",
    ],
}

# A torus has enough vertices that their number matters, and hides parts of the wall.
PROGRAM = """
import sys
from hashlib import sha256
import numpy as np
from semisynth_gl import Renderer, StereoCamera, make_scene
from semisynth_gl.geometry.kinds import SIMPLE_KINDS
from semisynth_gl.scene.background import FACE

torus, wall = np.eye(4), np.diag([8.0, 8.0, 1.0, 1.0])
torus[2, 3], wall[:3, 3] = 2, (-4, -4, 4)
scene = make_scene(
    StereoCamera.centred(320, 240, 300.0, 0.2), model=[0, 1], world_from_model=[torus, wall], layer=[0, 0]
)
torus = SIMPLE_KINDS["torus"](np.random.default_rng(0))
with Renderer([torus, FACE], np.full((1, 8, 8, 4), 255, np.uint8), backend=sys.argv[1]) as renderer:
    frame = renderer.render(scene)
    print(renderer.facts["renderer"])
    print(sha256(frame.left.disparity.tobytes() + frame.left.visibility.tobytes()).hexdigest())
"""


@pytest.fixture
def width(backend, monkeypatch):
    """Start programs with a vector width."""
    if "llvmpipe" not in context_facts(backend).renderer:
        pytest.skip(f"{backend} does not draw with llvmpipe here")
    # What pytest tells its own workers is not for a run of its own.
    for name in [name for name in os.environ if name.startswith("PYTEST_")]:
        monkeypatch.delenv(name)

    def start(bits, *command):
        environment = {name: value for name, value in os.environ.items() if name != WIDTH}
        environment |= {} if bits is None else {WIDTH: bits}
        return subprocess.run(
            [sys.executable, *command], cwd=TESTS, env=environment, capture_output=True, text=True, check=False
        )

    return start


def test_code_compiled_for_wider_vectors_is_not_run(width, backend, tmp_path, monkeypatch):
    """What one width has compiled lies in Mesa's cache when the other draws; both draw the same."""
    monkeypatch.setenv("MESA_SHADER_CACHE_DIR", str(tmp_path))
    drawn = []
    for bits in (None, NARROW, None):
        done = width(bits, "-c", PROGRAM, backend)
        assert done.returncode == 0, f"{bits or 'default'} bits: exit code {done.returncode}\n{done.stderr}"
        drawn.append(done.stdout.splitlines())
    assert f", {NARROW} bits)" in drawn[1][0]
    assert drawn[0][1] == drawn[1][1]
    assert drawn[0] == drawn[2]


@pytest.mark.one_backend
@pytest.mark.parametrize("group", DRAWING)
def test_drawing_passes_its_tests_on_narrow_vectors(width, backend, group, tmp_path):
    command = "-m", "pytest", "--quiet", "-p", "no:cacheprovider", "--basetemp", str(tmp_path / "run"), "-k", backend
    done = width(NARROW, *command, *DRAWING[group])
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"


@pytest.mark.parametrize("bits", ["512", "64", "wide"])
def test_other_widths_are_refused(monkeypatch, bits):
    monkeypatch.setenv(WIDTH, bits)
    with pytest.raises(BackendError, match=rf"{WIDTH}={bits}: expected 128 or 256 \(bits\)"):
        separate_compiled_shaders.__wrapped__()


def test_each_width_has_a_folder_which_programs_inherit(monkeypatch, tmp_path):
    monkeypatch.delenv("MESA_GLSL_CACHE_DIR", raising=False)
    monkeypatch.setenv("MESA_SHADER_CACHE_DIR", str(tmp_path))
    folders = []
    for bits in ("", "128", "128", "256"):
        monkeypatch.setenv(WIDTH, bits)
        separate_compiled_shaders.__wrapped__()
        folders.append(Path(os.environ["MESA_SHADER_CACHE_DIR"]))
    assert folders[0] == tmp_path
    assert folders[1] == folders[2] == tmp_path / "llvmpipe-128-bits"
    assert folders[3] != folders[1]
