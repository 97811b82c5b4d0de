"""``semisynth-gl textures``."""

from pathlib import Path

import click

from semisynth_gl.cli.options import SEED, ConfigName, images_option, option, read_config, set_option
from semisynth_gl.cli.outputs import OutputFile
from semisynth_gl.cli.streams import say
from semisynth_gl.cli.wording import Command
from semisynth_gl.config import packaged_configs
from semisynth_gl.inputs.errors import counted
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.crop_report import REJECTIONS, TextureReport, count_crops
from semisynth_gl.textures.image_files import printable
from semisynth_gl.textures.prepare import named_images, prepare_atlas, split_images


@click.command(cls=Command)
@option(
    "--config",
    "config_name",
    type=ConfigName(),
    default="middlebury",
    metavar="NAME_OR_PATH",
    help=f"Config whose patches to draw: a YAML file, or a packaged config: {', '.join(packaged_configs())}.",
)
@images_option()
@option("--seed", type=SEED, default=0, help="Seed of the dataset whose patches to draw.")
@set_option(help="Override a key of the config, for example textures.patch_px=512. May be repeated.")
@option("--out", type=OutputFile(".png"), default="textures.png", help="PNG file to write.")
def textures(config_name: str, images: tuple[str, ...], seed: int, settings: tuple[str, ...], out: Path) -> None:
    """Draw the patches that a dataset shows, count them, and say how many crops were rejected and why."""
    # Imported here: other commands need no fonts.
    from semisynth_gl.textures.sheet import draw_texture_sheet  # noqa: PLC0415

    section = read_config(config_name, images, (), settings).textures
    split = Split(seed)
    photographs = split_images(section, split)
    atlas = prepare_atlas(section, split, photographs)
    report = atlas.report
    kept = report.total("kept")
    shown = ", ".join(section.images) if section.source == "images" else section.source
    title = f"{counted(kept, 'patch')} of {report.patch_px} x {report.patch_px} pixels: {shown}"
    images_of_sheet = named_images(section, report.named_images, split, photographs)
    draw_texture_sheet(atlas, images_of_sheet, title).save(out)
    for line in _table(report):
        say(line)
    say(report.summary())
    say(f"{counted(kept, 'patch')} in {out}")


def _table(report: TextureReport) -> list[str]:
    """Return a line for each image: its patches by scale, its rejected crops by reason, its share of the surfaces."""
    scales = report.scale_names
    groups = {printable(name): counts for name, counts in report.grouped_counts.items()}
    wide = max(len("image"), *map(len, groups)) if groups else len("image")
    heads = ["patches", *(f"at {name}" for name in scales.values()), *REJECTIONS, "surfaces"]
    shares = report.surface_shares
    lines = [f"{'image':<{wide}}  " + "  ".join(f"{head:>9}" for head in heads)]
    for name, counts in (*groups.items(), ("all", report.counts)):
        numbers = [
            count_crops(counts, "kept"),
            *(count_crops(counts, "kept", side) for side in scales),
            *(count_crops(counts, outcome) for outcome in REJECTIONS),
        ]
        worn = sum(shares.get(source, 0.0) for source in {count.source for count in counts})
        cells = [*map(str, numbers), f"{worn:.1%}"]
        lines.append(f"{name:<{wide}}  " + "  ".join(f"{cell:>9}" for cell in cells))
    return lines
