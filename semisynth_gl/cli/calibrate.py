"""``semisynth-gl calibrate``."""

import re
import shlex
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import click

from semisynth_gl.calibration.calibrate import (
    PROPOSED_PAIRS,
    ConfigFacts,
    config_facts,
    config_name,
    config_text,
    suited_layout,
)
from semisynth_gl.calibration.disparity_range import DisparitySource
from semisynth_gl.calibration.matching import given_pairs, open_matcher, pairs_among
from semisynth_gl.calibration.photographs import impossible_splits
from semisynth_gl.calibration.rectification import fitting_pairs
from semisynth_gl.calibration.rig import Rig, Size, plain_rig
from semisynth_gl.calibration.rig_files import LONGEST_M, read_rigs
from semisynth_gl.calibration.style import Style, untried_style
from semisynth_gl.cli.options import NATURAL, FilesType, Number, above_0, images_option, map_options, option
from semisynth_gl.cli.outputs import CONFIG, Output, output_option
from semisynth_gl.cli.progress import Progress
from semisynth_gl.cli.streams import say
from semisynth_gl.codecs.png16 import KITTI_DISPARITY
from semisynth_gl.comparison.maps import map_files, one_of_each_scene
from semisynth_gl.comparison.measured_view import working_width
from semisynth_gl.comparison.place import find_place, left_out
from semisynth_gl.comparison.sides import MeasuredPlace, measure_place
from semisynth_gl.config import Config
from semisynth_gl.config.fields import LARGEST
from semisynth_gl.config.load import parse_config
from semisynth_gl.histogram import total_variation
from semisynth_gl.inputs.errors import BackendError, InputError, counted
from semisynth_gl.textures.crop_report import TextureReport
from semisynth_gl.textures.image_files import find_files, find_images
from semisynth_gl.textures.images import image_extensions
from semisynth_gl.textures.prepare import prepare_atlas

_ANY_NUMBER = Number(min=-LARGEST, max=LARGEST)
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# A shorter baseline, as a longer one than `LONGEST_M`, may be in another unit than it is taken for.
_SHORTEST_M = 0.002


@click.command()
@images_option(required=True)
@option(
    "--calib",
    type=FilesType(),
    multiple=True,
    metavar="FILE_OR_GLOB",
    help="Calibration of the rectified rig: Middlebury's or ETH3D's calib.txt, KITTI's calib_cam_to_cam.txt, stereo "
    "YAML of OpenCV or ROS. May be repeated: ROS's left and right, or several rigs.",
)
@option("--focal-px", type=above_0(LARGEST), help="Instead of --calib, with the next two.")
@option("--baseline-m", type=_ANY_NUMBER, help="Distance of the cameras.")
@option("--size", metavar="WIDTHxHEIGHT", help="Size of the images, for a calibration without one: 1280x720.")
@option(
    "--scale",
    type=above_0(16),
    help="Scale of the images against the calibrated size; 0.25 for quarter size.",
)
@option("--unit", type=click.Choice(list(_UNITS)), help="Unit of the translation in an OpenCV file, else metres.")
@map_options(
    "to measure the histogram",
    "Where one has another size than the rig's images, its disparities are scaled by the ratio of the widths.",
)
@option(
    "--pairs",
    type=(FilesType(), FilesType()),
    multiple=True,
    metavar="LEFT RIGHT",
    help="Left and right photographs of pairs of the rig, two files, folders or globs, to measure how far they are off "
    "rectified; needs OpenCV, the extra matching. May be repeated. By default the pairs among --images that are named "
    "as Middlebury's, ETH3D's or KITTI's.",
)
@option("--range-px", type=(_ANY_NUMBER, _ANY_NUMBER), help="Least and largest disparity, where there are no maps.")
@option("--other-camera", is_flag=True, help="The photographs are not the rig's: they may have any size.")
@option(
    "--trials",
    type=NATURAL,
    default=3,
    help="How many pairs to render and measure of each recipe with each of two texture scales and two shares of flat "
    "surfaces; 0 for none: then all recipes have one weight, and textures are as in the packaged configs.",
)
@output_option("--out", CONFIG, ".yaml", ".yml", required=True, help="YAML to write.")
def calibrate(
    images: tuple[str, ...],
    calib: tuple[str, ...],
    focal_px: float | None,
    baseline_m: float | None,
    size: str | None,
    scale: float | None,
    unit: str | None,
    maps: tuple[str, ...],
    png_scale: float,
    pairs: tuple[tuple[str, str], ...],
    range_px: tuple[float, float] | None,
    other_camera: bool,
    trials: int,
    output: Output,
) -> None:
    """Write a config for a rig: its camera, the disparities that it sees, and the photographs to cut patches from."""
    output.check((*calib, *maps, *images, *chain.from_iterable(pairs)))
    out = output.file
    if maps and range_px is not None:
        raise InputError("--range-px says what --disparity measures: give one of them")
    rigs = _rigs(calib, focal_px, baseline_m, _size(size), None if unit is None else _UNITS[unit])
    found = map_files(maps)
    disparity = DisparitySource(one_of_each_scene(found), png_scale, range_px)
    matched = _pairs(pairs, images, rigs if scale is None else [rig.scaled(scale) for rig in rigs], other_camera)
    facts = config_facts(rigs, images, disparity, scale=scale, other_camera=other_camera, pairs=matched)
    name, style = config_name(out.stem), untried_style(facts.recipes)
    text = config_text(name, facts, style)
    try:
        config = parse_config(text, str(out))
    except InputError as error:
        raise InputError(f"--out {out}: not written, since the numbers make no valid config:\n{error}") from None
    facts = replace(facts, layout=suited_layout(config, rigs))
    text = config_text(name, facts, style)
    # The patches of the dataset to come: unusable photographs are reported now, and the cache keeps the patches.
    report = prepare_atlas(config.textures, 0).report
    place, expected = None, []
    if trials:
        width_px = working_width(facts.size.width_px)
        place = measure_place(find_place(find_images(images), found, png_scale), width_px)
        style = _tried(facts, place, trials)
        text = config_text(name, facts, style)
        expected = [_expectation(parse_config(text, str(out)))]
    output.write(text.encode())
    for line in (*_summary(facts, report), *_style_summary(style, place), *expected):
        say(line)
    if note := _baseline_note(facts.ranges["baseline_m"]):
        click.echo(f"note: {note}", err=True)
    if passed_over := left_out(find_files(images, image_extensions()), found):
        click.echo(f"note: {passed_over}", err=True)
    for line in _next_steps(config.name, out, images, maps, png_scale):
        say(line)


def _pairs(
    pairs: Sequence[tuple[str, str]], images: Sequence[str], rigs: Sequence[Rig], other_camera: bool
) -> list[tuple[Path, Path]]:
    """Return the pairs to match: those that were given, or those among the photographs where they can be matched."""
    if pairs:
        if other_camera:
            raise InputError("--pairs are the rig's, but --other-camera says that another one took the photographs")
        open_matcher()
        return [pair for left, right in pairs for pair in given_pairs(left, right)]
    found = [] if other_camera else fitting_pairs(pairs_among(find_images(images)), rigs)
    if found:
        try:
            open_matcher()
        except InputError as error:
            pairs_there = counted(len(found), "pair")
            click.echo(f"note: not measured in {pairs_there} how far rows are off rectified: {error}", err=True)
            return []
    return found


def _tried(facts: ConfigFacts, place: MeasuredPlace, trials: int) -> Style:
    """Render and measure trial pairs for a style."""
    # Imported here: OpenGL and models take longer to load than a config to write without them.
    from semisynth_gl.calibration.trial import tried_style  # noqa: PLC0415

    try:
        with Progress() as progress:
            return tried_style(facts, place.side, trials, progress)
    except BackendError as error:
        advice = "Without OpenGL, --trials 0 writes a config that no pairs were tried for"
        raise BackendError(f"{error}\n{advice}") from None


def _expectation(config: Config) -> str:
    """Return how near a config's mix is expected to come to the wanted disparities."""
    # Imported here: models take longer to load than a config to write without them.
    from semisynth_gl.scene.mix import MixSampler  # noqa: PLC0415
    from semisynth_gl.scene.sources import prepare_sources  # noqa: PLC0415

    sources = prepare_sources(config, 0)
    mix = MixSampler(config, 0, sources.libraries, sources.atlas.patches)
    variation = total_variation(mix.expected(), config.shown_histogram())
    return f"                 disparities expected at a total variation of {variation:.3f} from the wanted ones"


def _style_summary(style: Style, place: MeasuredPlace | None) -> list[str]:
    parts = zip(style.weights, style.recipes, strict=True)
    lines = [f"recipes          {', '.join(f'{weight:.0%} {recipe.name}' for weight, recipe in parts)}"]
    if place is None:
        return lines
    low, high = style.texels_per_pixel
    look = f"{low:g} to {high:g} texels per pixel, {style.flat_share:.0%} flat, blurred by {style.blur_px:g} px"
    if style.exposure_stops:
        look += f", exposed by {style.exposure_stops:g} stops"
    near, compared = style.near(place.side)
    lines.append(f"textures         {look}")
    # A single picture has no deviation.
    if compared:
        lines.append(
            f"place            {near} of {counted(compared, 'measure')} expected within one standard deviation of its "
            "pictures"
        )
    return lines


def _rigs(
    calib: tuple[str, ...], focal_px: float | None, baseline_m: float | None, size: Size | None, unit_m: float | None
) -> list[Rig]:
    plain = {"--focal-px": focal_px, "--baseline-m": baseline_m}
    given = [name for name, value in plain.items() if value is not None]
    if calib:
        if given:
            raise InputError(f"{' and '.join(given)}: --calib says that already: give one or the other")
        return read_rigs(calib, size=size, unit_m=unit_m)
    if focal_px is None or baseline_m is None or size is None:
        missing = [name for name, value in (plain | {"--size": size}).items() if value is None]
        raise InputError(f"{', '.join(missing)} missing: give --calib, or --focal-px, --baseline-m and --size")
    return [plain_rig(focal_px, baseline_m, size)]


def _baseline_note(ends_m: tuple[float, float]) -> str | None:
    """Return what to look at where a baseline is as no rig's: most files do not say in which unit it is."""
    if ends_m[0] >= _SHORTEST_M and ends_m[1] <= LONGEST_M:
        return None
    return (
        f"the baseline is {_shown_range(ends_m, 'm')}: ROS and KITTI state it in metres, Middlebury and ETH3D in "
        "millimetres; is it so in your files?"
    )


def _size(text: str | None) -> Size | None:
    if text is None:
        return None
    sides = re.fullmatch(r"([1-9][0-9]{0,4})\s*[xX]\s*([1-9][0-9]{0,4})", text.strip())
    if sides is None:
        raise InputError(f"--size {text}: expected width x height in pixels, such as 1280x720")
    return Size(int(sides[1]), int(sides[2]))


def _summary(facts: ConfigFacts, report: TextureReport) -> list[str]:
    ranges, disparity, count = facts.ranges, facts.disparity, facts.photograph_count
    patches = counted(report.total("kept"), "patch")
    lines = [
        f"layout           {facts.layout or 'middlebury, and webdataset from 10,000 pairs on'}",
        f"image size       {facts.size}",
        f"focal length     {_shown_range(ranges['focal_px'], 'px')}",
        f"baseline         {_shown_range(ranges['baseline_m'], 'm')}",
        f"doffs            {_shown_range(ranges['doffs_px'], 'px')}",
        f"disparity        {disparity.min_px:g} to {disparity.max_px:g} px, mean {disparity.target.mean_px:.2f} px",
        f"                 {disparity.origin}",
        f"scenes           {' and '.join(facts.scenes)} ({facts.far_share:.1%} of the pixels beyond 20 m)",
        f"photographs      {facts.photographs}{', all grey' * facts.grey}, which give {patches}",
    ]
    if facts.rectification is not None:
        lines.append(f"rectification    {facts.rectification.summary()}")
    if 0 < facts.fitting_count < count:
        lines.append(f"                 {count - facts.fitting_count} have another size than the rig's images")
    splits = impossible_splits(facts.subject_count)
    if splits:
        lines.append(f"                 too few to hold some out for {' or '.join(splits)}")
    return lines


def _next_steps(name: str, out: Path, images: Sequence[str], maps: Sequence[str], png_scale: float) -> list[str]:
    config, data = shlex.quote(str(out)), shlex.quote(f"data/{name}")
    sources = [f"--images {shlex.quote(source)}" for source in images]
    sources += [f"--disparity {shlex.quote(source)}" for source in maps]
    if maps and png_scale != KITTI_DISPARITY.steps:
        sources.append(f"--png-scale {png_scale:g}")
    return [
        f"wrote {out}; next:",
        f"  semisynth-gl preview --config {config}",
        f"  semisynth-gl generate --config {config} --out {data} --pairs {PROPOSED_PAIRS}",
        f"  semisynth-gl compare {data} {' '.join(sources)}",
    ]


def _shown_range(ends: tuple[float, float], unit: str) -> str:
    """Return a range as a person reads it, such as ``994.978 px`` or ``0.16 to 0.38 m``."""
    low, high = ends
    return f"{low:.6g} {unit}" if f"{low:.6g}" == f"{high:.6g}" else f"{low:.6g} to {high:.6g} {unit}"
