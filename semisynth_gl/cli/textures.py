"""``semisynth-gl textures``."""

import io
from pathlib import Path

import click

from semisynth_gl.cli.options import IMAGES_OPTION, NATURAL, OutputFile, option, read_config, write_output
from semisynth_gl.config import packaged_configs
from semisynth_gl.textures.atlas import TextureReport
from semisynth_gl.textures.prepare import images_of, prepare_atlas
from semisynth_gl.textures.selection import names_of

_COLUMNS = ("flat", "blurred", "duplicate", "surplus")


@click.command()
@option(
    "--config",
    "config_name",
    default="middlebury",
    metavar="NAME_OR_PATH",
    help=f"Its section textures counts: a YAML file, or a packaged config: {', '.join(packaged_configs())}.",
)
@IMAGES_OPTION
@option("--seed", type=NATURAL, default=0, help="As of the dataset.")
@option(
    "--set",
    "settings",
    multiple=True,
    metavar="dotted.key=value",
    help="Override a key of the config, for example textures.flat_share=0.1. May be repeated.",
)
@option("--out", type=OutputFile(".png"), default=Path("textures.png"), help="PNG to write.")
def textures(config_name: str, images: tuple[str, ...], seed: int, settings: tuple[str, ...], out: Path) -> None:
    """Draw the patches that a dataset shows, count them, and tell what was left out of the photographs and why."""
    # Imported here: no other command draws text.
    from semisynth_gl.textures.sheet import draw_texture_sheet  # noqa: PLC0415

    section = read_config(config_name, images, (), settings).textures
    files = images_of(section, seed)
    atlas = prepare_atlas(section, seed)
    report = atlas.report
    shown = ", ".join(section.images) if section.source == "images" else section.source
    title = f"{report.crops_kept} patches of {report.patch_px} x {report.patch_px} pixels: {shown}"
    named = {name: path for path, name in names_of(files).items()} if files else {}
    png = io.BytesIO()
    draw_texture_sheet(atlas, named, title).save(png, format="png")
    write_output(out, png.getvalue())
    for line in _table(report):
        click.echo(line)
    click.echo(report.summary())
    click.echo(f"{report.crops_kept} patches in {out}")


def _table(report: TextureReport) -> list[str]:
    """A line for each image: how many of its crops became patches, by scale, and how many were left out and why."""
    from semisynth_gl.textures.sheet import grouped_counts, printable, scale_names  # noqa: PLC0415 - as above

    scales = scale_names(report)
    groups = {printable(name): counts for name, counts in grouped_counts(report).items()}
    wide = max(len("image"), *map(len, groups)) if groups else len("image")
    heads = ["patches", *(f"at {name}" for name in scales.values()), *_COLUMNS]
    lines = [f"{'image':<{wide}}  " + "  ".join(f"{head:>9}" for head in heads)]
    for name, counts in (*groups.items(), ("all", report.counts)):
        numbers = [
            sum(count.kept for count in counts),
            *(sum(count.kept for count in counts if count.side_px == side) for side in scales),
            *(sum(getattr(count, column) for count in counts) for column in _COLUMNS),
        ]
        lines.append(f"{name:<{wide}}  " + "  ".join(f"{number:>9}" for number in numbers))
    return lines
