"""``semisynth-gl calibrate``."""

import re
import shlex
from pathlib import Path
from typing import Any

import click

from semisynth_gl.calibration.calibrate import calibrate as calibrate_rig
from semisynth_gl.calibration.finder import UNITS
from semisynth_gl.cli.options import NATURAL, Command, images_option, map_options, option, split
from semisynth_gl.cli.outputs import OutputFileType
from semisynth_gl.cli.progress import Progress
from semisynth_gl.inputs.errors import InputError

_PROPOSED_PAIRS = 1000


def _size(_: click.Context, __: click.Parameter, text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    sides = re.fullmatch(r"([1-9][0-9]{0,4})\s*[xX]\s*([1-9][0-9]{0,4})", text.strip())
    if sides is None:
        raise InputError(f"--size {text}: expected width x height in pixels, such as 1280x720")
    return int(sides[1]), int(sides[2])


def _calib_keys(_: click.Context, __: click.Parameter, text: str | None) -> dict[str, str]:
    pairs = [part.partition("=") for part in (text or "").split(",") if part.strip()]
    if not all(equals and name.strip() for _, equals, name in pairs):
        raise InputError(f"--calib-keys {text}: expected names such as K1=left.K,K2=right.K")
    return {key.strip(): name.strip() for key, _, name in pairs}


@click.command(cls=Command)
@images_option(required=True)
@option(
    "--calib",
    multiple=True,
    metavar="FILE_OR_GLOB",
    help="Calibration file of most tools: YAML, JSON, XML, .npz, .npy, .conf, .ini or text. May be repeated, for the "
    "files of both cameras.",
)
@option(
    "--calib-keys",
    callback=_calib_keys,
    metavar="K1=NAME,...",
    help="Where --calib has values whose names are not recognised: K1=left.camera_matrix,D1=left.dist,... for K1, D1, "
    "R1, P1, K2, D2, R2, P2, R, T, Q and size.",
)
@option(
    "--pair",
    "cameras",
    callback=split(click.STRING),
    metavar="LEFT,RIGHT",
    help="Names of the left and the right camera, such as cam1,cam2, if the calibration has more than two.",
)
@option("--focal-px", type=float, help="Focal length in pixels. With --baseline-m and --size, it replaces --calib.")
@option("--baseline-m", type=float, help="Distance between the cameras in metres, with --focal-px.")
@option(
    "--size",
    callback=_size,
    metavar="WIDTHxHEIGHT",
    help="Size of the images, such as 1280x720, if --calib does not have it.  [default: the size of most photographs, "
    "unless there is --other-camera or --focal-px]",
)
@option("--scale", type=float, help="Size of the images relative to the calibrated size, such as 0.25.")
@option("--unit", type=click.Choice(tuple(UNITS)), help="Unit of the translation in --calib.  [default: the likeliest]")
@option(
    "--alpha",
    type=float,
    help="alpha of OpenCV's stereoRectify, for a calibration without P1 and P2: 0 crops all borders, 1 keeps all raw "
    "pixels.  [default: stereoRectify's, and at most 100 degrees of a fisheye's view]",
)
@map_options
@option("--range-px", type=(float, float), help="Smallest and largest disparity in pixels, instead of --disparity.")
@option("--range-m", type=(float, float), help="Smallest and largest distance in metres, instead of --range-px.")
@option("--other-camera", is_flag=True, help="A different camera took the photographs; they may have any size.")
@option(
    "--trials",
    type=NATURAL,
    default=6,
    help="Number of pairs to render and measure for each recipe, with each of two texture scales. 0 needs no OpenGL: "
    "all recipes get the same weight, and textures are as in the packaged configs.",
)
@option("--out", type=OutputFileType(".yaml", ".yml"), required=True, help="YAML file to write.")
@option("--overwrite", is_flag=True, help="Replace --out if it exists; changes that you made in it are lost.")
def calibrate(
    out: Path,
    overwrite: bool,
    **others: Any,  # noqa: ANN401 - arguments of the function that calibrates
) -> None:
    """Write a config for a rig: its camera and disparities, and photographs to cut patches from."""
    if out.is_file() and not overwrite:
        raise InputError(f"--out {out}: exists already; choose another name, or replace it with --overwrite")
    with Progress() as progress:
        made = calibrate_rig(name=out.stem, listener=progress, **others)
    out.write_text(made.text, "utf-8")
    for line in made.summary:
        click.echo(line)
    for note in made.notes:
        click.echo(f"note: {note}", err=True)
    config = shlex.quote(str(out))
    click.echo(f"wrote {out}; next:")
    click.echo(f"  semisynth-gl preview --config {config}")
    click.echo(f"  semisynth-gl generate --config {config} --out data/{made.config.name} --pairs {_PROPOSED_PAIRS}")
