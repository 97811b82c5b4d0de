"""``semisynth-gl textures``."""

import io
from pathlib import Path

import click

from semisynth_gl.cli.options import read_config
from semisynth_gl.config import packaged_configs
from semisynth_gl.errors import InputError
from semisynth_gl.textures.crop_report import REJECTIONS, TextureReport, count_crops
from semisynth_gl.textures.image_files import printable, relative_names
from semisynth_gl.textures.prepare import prepare_atlas, split_images


@click.command()
@click.option(
    "--config",
    "config_name",
    default="middlebury",
    show_default=True,
    metavar="NAME_OR_PATH",
    help=f"Its section textures counts: a YAML file, or a packaged config: {', '.join(packaged_configs())}.",
)
@click.option(
    "--images",
    multiple=True,
    metavar="PATH_OR_GLOB",
    help="Photographs to cut patches from: a file, folder or glob. May be repeated.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="As of the dataset.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="dotted.key=value",
    help="Override a key of the config, for example textures.flat_share=0.1. May be repeated.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("textures.png"), show_default=True, help="PNG to write."
)
def textures(config_name: str, images: tuple[str, ...], seed: int, settings: tuple[str, ...], out: Path) -> None:
    """Draw the patches that a dataset shows, count them, and tell what was left out of the photographs and why."""
    # Imported here: no other command draws text.
    from semisynth_gl.textures.sheet import draw_texture_sheet  # noqa: PLC0415

    section = read_config(config_name, images, (), settings).textures
    if out.suffix.lower() != ".png":
        raise InputError(f"--out {out}: expected a name that ends in .png")
    if not out.absolute().parent.is_dir():
        raise InputError(f"--out {out}: the folder {out.absolute().parent} does not exist")
    atlas = prepare_atlas(section, seed)
    report = atlas.report
    kept = report.total("kept")
    shown = ", ".join(section.images) if section.source == "images" else section.source
    title = f"{kept} patches of {report.patch_px} x {report.patch_px} pixels: {shown}"
    files = {name: path for path, name in relative_names(split_images(section, seed)).items()}
    png = io.BytesIO()
    draw_texture_sheet(atlas, files, title).save(png, format="png")
    partial = out.with_name(f".{out.name}.partial")
    try:
        partial.write_bytes(png.getvalue())
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)
    for line in _table(report):
        click.echo(line)
    click.echo(report.summary())
    click.echo(f"{kept} patches in {out}")


def _table(report: TextureReport) -> list[str]:
    """Return a line for each image: the numbers of its patches by scale, and of its rejected crops by reason."""
    scales = report.scale_names
    groups = {printable(name): counts for name, counts in report.grouped_counts.items()}
    wide = max(len("image"), *map(len, groups)) if groups else len("image")
    heads = ["patches", *(f"at {name}" for name in scales.values()), *REJECTIONS]
    lines = [f"{'image':<{wide}}  " + "  ".join(f"{head:>9}" for head in heads)]
    for name, counts in (*groups.items(), ("all", report.counts)):
        numbers = [
            count_crops(counts, "kept"),
            *(count_crops(counts, "kept", side) for side in scales),
            *(count_crops(counts, outcome) for outcome in REJECTIONS),
        ]
        lines.append(f"{name:<{wide}}  " + "  ".join(f"{number:>9}" for number in numbers))
    return lines
