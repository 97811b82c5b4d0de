"""Errors of the hard cases in tests/render/test_hard_cases.py that are compared with the oracle.

    python benchmarks/hard_cases.py --json hard-cases.json

The tests run on one backend, in a process of their own, and hand their errors over as files.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.render.backends import is_software
from semisynth_gl.render.devices import context_facts

ROOT = Path(__file__).resolve().parents[1]
# Cases that are compared with an equation: what they are, the bound that a test asserts, and the test.
EQUATIONS = (
    ("surfaces at 0.05 m and 10,000 m in one frame", "1e-4 px at 220 px; relative 1e-6 at 1.1e-3 px",
     "test_near_and_far_in_one_frame"),
    ("two parallel surfaces a relative 1e-5 apart, either drawn first",
     "all pixels show the nearer one, in both eyes", "test_parallel_surfaces_a_relative_1e_5_apart"),
    ("a scene 10^6 m from its origin", "99.9 % within 1e-5 px of the same scene at the origin",
     "test_a_whole_scene_a_million_metres_away"),
    ("a wall of 2 to 1000 m, 1.5 m away at 200 px", "200 px times 2^-24 times (4 + half its size over its distance)",
     "test_the_error_grows_with_the_size_of_a_triangle_over_its_distance"),
    ("a plane whose vertices lie 40 m, 8 km, 1049 km and 10^7 m from their origin",
     "both images within 1e-3 px of the truth, disparity within 3e-5 px of the plane's near its origin",
     "test_images_lie_on_their_truth_however_far_a_model_stands_from_its_origin"),
    ("lengths, focal lengths and UV of any magnitude", "as the rays say, or refused; nothing is NaN",
     "test_numbers_of_any_magnitude_are_drawn_as_rays_say_or_refused"),
    ("a watertight ball of 100k triangles", "none of 100,000 pixels inside shows the wall behind",
     "test_no_pixel_inside_a_fine_mesh_shows_what_lies_behind"),
    ("balls of 100k triangles, 4.5 to 15 px in radius", "what they hide is hidden, but for one pixel at most",
     "test_fine_meshes_hide_what_is_behind_them"),
    ("rods thinner than a pixel", "every pixel at the depth of its rod or of the wall, within 1e-4 px",
     "test_rods_thinner_than_a_pixel_are_whole_or_absent_never_mixed"),
    ("models smaller than a pixel", "every pixel on one of the two depths within 1e-4 px",
     "test_models_smaller_than_a_pixel"),
    ("three coplanar faces", "the first one wins everywhere, in both eyes and every time",
     "test_coplanar_faces_have_one_winner_in_both_eyes"),
    ("disparity wider than the image", "150 px within 1e-4; all outside the other image",
     "test_disparity_wider_than_the_image"),
    ("zero and negative disparity through doffs", "invalid (inf), never clamped",
     "test_zero_and_negative_disparities_are_invalid_never_clamped"),
    ("baseline 0", "equal images, no valid disparity", "test_baseline_zero"),
    ("64x64, 941x489, 1x1, 3000x2000, 7680x4320", "a slanted plane within a relative 3e-6", "test_image_sizes"),
    ("200000x4", "refused, with the driver's limit", "test_an_image_beyond_the_drivers_limit_is_refused"),
    ("no instances", "no disparity, no ids", "test_no_instances"),
    ("100,000 instances", "drawn, the last one too", "test_instances_without_end_are_drawn"),
    ("65,536 instances with 16-bit ids", "refused", "test_more_instances_than_ids_are_refused"),
    ("patches of 1x1 and 8192x8192", "bit for bit at one texel per pixel",
     "test_patches_from_one_texel_to_8192"),
    ("a transform of rank 0", "draws nothing, harms nothing",
     "test_a_singular_transform_draws_nothing_and_harms_nothing"),
    ("the peers' scene, 1500x1000, 100 objects",
     "p99 within 3e-5 px, worst within 1e-3, ids as the oracle's in 99.95 %",
     "test_the_peers_scene_is_as_exact_as_asked"),
)  # fmt: skip


def measure(backend: str) -> list[dict[str, Any]]:
    """Run the tests and return a row of each case: errors of both eyes at all pixels that were compared."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:xdist",
            "-k",
            backend,
            "tests/render/test_hard_cases.py",
        ]
        environment = os.environ | {"HARD_CASES_FOLDER": folder}
        code = subprocess.run(command, cwd=ROOT, env=environment, stdout=sys.stderr, check=False).returncode
        if code:
            raise SystemExit(code)
        cases: dict[str, list[Mapping[str, np.ndarray]]] = defaultdict(list)
        for path in sorted(Path(folder).iterdir()):
            with np.load(path) as arrays:
                parts = dict(arrays)
            name = re.sub(rf".*::test_(\w+)\[{backend}-?(.*)\].*", r"\1 \2", str(parts["test"]))
            cases[name.replace("_", " ").strip()].append(parts)
    return [_row(name, parts) for name, parts in cases.items()]


def _row(name: str, parts: list[Mapping[str, np.ndarray]]) -> dict[str, Any]:
    error = np.concatenate([part["error"][part["smooth"] & ~part["displaced"]] for part in parts])
    return {
        "name": name,
        "pixels": len(error),
        "median_px": float(np.median(error)),
        "p999_px": float(np.quantile(error, 0.999)),
        "worst_px": float(error.max()),
        "elsewhere": float(np.mean(np.concatenate([part["displaced"] for part in parts]))),
        "visibility": float(np.mean(np.concatenate([part["seen_alike"] for part in parts]))),
    }


def headline(report: Mapping[str, Any]) -> str:
    """Name the machine of a report."""
    machine = report["machine"]
    return f"{machine['renderer']}, {machine['opengl']}; {machine['processor']}; {machine['date']}"


def table(report: Mapping[str, Any]) -> str:
    """Lay a report out in Markdown, and below it the cases that are compared with an equation."""
    errors = markdown(
        ("case", "pixels", "median, px", "99.9 %", "worst", "elsewhere", "visibility"),
        [
            (row["name"], str(row["pixels"]), *(f"{row[key]:.1e}" for key in ("median_px", "p999_px", "worst_px")),
             f"{100 * row['elsewhere']:.3f} %", f"{100 * row['visibility']:.2f} %")
            for row in report["rows"]
        ],
        text_last=False,
    )  # fmt: skip
    bounds = [(case, f"{bound} (`{test}`)") for case, bound, test in EQUATIONS]
    return f"{errors}\n\n{markdown(('case', 'bound, and the test that asserts it'), bounds)}"


@click.command()
@click.option("--backend", type=click.Choice(["egl", "osmesa"]), default="egl", show_default=True)
@click.option("--gpu", is_flag=True, help="Refuse a driver that draws on the processor.")
@click.option(
    "--json", "json_path", type=click.Path(dir_okay=False, path_type=Path), help="Also write everything here."
)
def main(backend: str, json_path: Path | None, *, gpu: bool) -> None:
    """Run the hard cases and print their errors."""
    driver = context_facts(backend)
    if gpu and is_software(driver.renderer):
        raise click.ClickException(f"--gpu: expected a GPU, but {driver.renderer} draws on the processor")
    report = {
        "command": shlex.join(["python", "benchmarks/hard_cases.py", *sys.argv[1:]]),
        "machine": machine_facts() | {"backend": driver.backend, "renderer": driver.renderer, "opengl": driver.version},
        "rows": measure(backend),
    }
    if json_path is not None:
        json_path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    click.echo(f"{headline(report)}\n\n{table(report)}")


if __name__ == "__main__":
    main()
