"""``semisynth-gl compare``."""

from pathlib import Path

import click

from semisynth_gl.cli.options import COUNT, Command, FilesType, images_option, map_options, option
from semisynth_gl.cli.outputs import OutputFile, write_json
from semisynth_gl.cli.progress import Progress
from semisynth_gl.comparison.compare import Comparison, comparison_json, comparison_table
from semisynth_gl.comparison.compare import compare as compare_dataset
from semisynth_gl.comparison.maps import map_files
from semisynth_gl.comparison.measured_view import WORKING_WIDTH
from semisynth_gl.comparison.place import left_out
from semisynth_gl.comparison.sides import FEWEST, SAMPLE, MeasuredPlace
from semisynth_gl.inputs.errors import counted
from semisynth_gl.seeds.splits import SPLITS, SplitName
from semisynth_gl.textures.image_files import find_files
from semisynth_gl.textures.images import image_extensions
from semisynth_gl.textures.subjects import of_subjects


@click.command(cls=Command)
@click.argument("directory", type=FilesType(), metavar="DIR_OR_ADDRESS")
@images_option(
    required=True,
    help="Photographs of the place that the dataset is made for: a file, folder or glob. May be repeated.",
)
@map_options("of the place")
@option(
    "--width",
    "width_px",
    type=click.IntRange(min=32, max=4096),
    help=f"Width in px to which all images and maps are scaled before they are measured. By default {WORKING_WIDTH}, "
    "or the width of the pairs where that is smaller.",
)
@option("--sample", type=COUNT, default=SAMPLE, help="How many pairs to measure, evenly spread over the dataset.")
@option("--split", type=click.Choice(SPLITS), help="Measure only this split.")
@option("--json", "json_file", type=OutputFile(), help="Also write all figures, unrounded, to this JSON file.")
@option("--out", type=OutputFile(".png"), help="Also draw all distributions into this PNG.")
def compare(
    directory: str,
    images: tuple[str, ...],
    disparity: tuple[str, ...],
    png_scale: float,
    width_px: int | None,
    sample: int,
    split: SplitName | None,
    json_file: Path | None,
    out: Path | None,
) -> None:
    """Compare a dataset's pairs with the place that it is made for, and say which keys of the config to change.

    Photographs are enough to compare textures and luminance; disparity maps add depth, occlusion and borders.
    """
    with Progress() as progress:
        comparison = compare_dataset(
            directory,
            images,
            disparity,
            png_scale=png_scale,
            width_px=width_px,
            sample=sample,
            split=split,
            listener=progress,
        )
    if json_file is not None:
        write_json(json_file, comparison_json(comparison))
    if out is not None:
        # Imported here: matplotlib takes longer to load than many pairs to measure.
        from semisynth_gl.comparison.plots import comparison_png  # noqa: PLC0415

        out.write_bytes(comparison_png(comparison, f"{directory}: {_counts(comparison)}"))
    for line in (_counts(comparison), "", *comparison_table(comparison), "", *_summary(comparison)):
        click.echo(line)
    passed_over = left_out(find_files(images, image_extensions()), map_files(disparity))
    for note in filter(None, (passed_over, *_notes(comparison))):
        click.echo(f"note: {note}", err=True)


def _counts(comparison: Comparison) -> str:
    place = comparison.place
    parts = [
        f"{comparison.pairs} of {counted(comparison.dataset_pairs, 'pair')}",
        _photographs(place),
        f"{counted(place.maps, 'disparity map')} ({place.maps_with_image} with their image)",
    ]
    return f"{', '.join(parts)}; all at a width of {comparison.width_px} px"


def _photographs(place: MeasuredPlace) -> str:
    return f"{counted(place.photographs, 'photograph')}{of_subjects(place.photographs, place.subjects)}"


def _summary(comparison: Comparison) -> list[str]:
    """Return lines on how many measures are near the place's, on too few pictures, and on each measure far from it."""
    near, compared = len(comparison.near()), len(comparison.compared())
    few, lines = len(comparison.too_few()), list[str]()
    if few:
        place = f"{_photographs(comparison.place)}, {counted(comparison.place.maps, 'map')}"
        lines.append(
            f"Too few pictures of the place to tell how far {counted(few, 'measure')} may be off: at least {FEWEST} "
            f"pictures are needed, better a few dozen; there are {place}"
        )
    if not compared:
        return lines or ["The pictures of the place are all alike, so there are no standard deviations to compare with"]
    lines += [f"{near} of {counted(compared, 'measure')} within one standard deviation (sd) of the place"]
    advice = comparison.advice()
    if advice:
        lines.append("The other measures, farthest first, with the config keys that move them:")
        lines += [f"  {measure.name}, {apart:.1f} sd apart: {change or 'no key'}" for measure, apart, change in advice]
    for measure, change in comparison.unlike():
        lines.append(f"  {measure.name}, the same in all pictures of the place, not here: {change or 'no key'}")
    return lines


def _notes(comparison: Comparison) -> list[str]:
    notes = [f"left out: {skipped}" for skipped in comparison.place.skipped]
    if comparison.place.narrow:
        notes.append(
            f"{counted(comparison.place.narrow, 'photograph')} narrower than {comparison.width_px} px, used for "
            "luminance only; a smaller --width uses them for all measures"
        )
    if comparison.place.sparse_maps:
        notes.append(
            f"{counted(comparison.place.sparse_maps, 'map')} with disparities in fewer than half of the pixels, used "
            "for disparity only"
        )
    return notes
