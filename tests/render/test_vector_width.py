"""llvmpipe on ARM and on x86 without AVX, whose vectors have 128 bits; other processors have 256."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from semisynth_gl.render.devices import context_facts

TESTS = Path(__file__).parents[1]
# What draws each channel, and each way to draw it, in the least time.
DRAWING = [
    "render/test_masks.py",
    "render/test_render_exactness.py::test_planes_have_their_analytic_disparity",
    "render/test_render_exactness.py::test_a_patch_at_one_texel_per_pixel_comes_out_bit_for_bit",
    "render/test_signed.py::test_the_sky_has_no_parallax_and_turns_with_the_camera",
    "render/test_flow.py::test_a_plane_that_moves_sideways_and_away_has_the_flow_of_the_formula",
    "render/test_flow.py::test_what_is_hidden_gone_or_outside_then_is_marked",
    "render/test_rig.py::test_planes_have_their_analytic_correspondence",
    "render/test_antialias_edges.py::test_outlines_come_near_to_many_samples",
    "render/test_occlusion.py",
]


@pytest.mark.heavy
@pytest.mark.one_backend
def test_drawing_passes_its_tests_on_narrow_vectors(backend, tmp_path):
    if "llvmpipe" not in context_facts(backend).renderer:
        pytest.skip(f"{backend} does not draw with llvmpipe here")
    # What pytest tells its own workers is not for a run of its own, and Mesa's cache does not tell widths apart.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment |= {"LP_NATIVE_VECTOR_WIDTH": "128", "MESA_SHADER_CACHE_DIR": str(tmp_path / "shaders")}
    command = "-m", "pytest", "--quiet", "-p", "no:cacheprovider", "--basetemp", str(tmp_path / "run"), "-k", backend
    done = subprocess.run(
        [sys.executable, *command, *DRAWING], cwd=TESTS, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
