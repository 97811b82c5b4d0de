"""``semisynth-gl preview``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from semisynth_gl.cli.options import Command, option, scene_config, scene_options
from semisynth_gl.cli.outputs import OutputFileType, table
from semisynth_gl.cli.progress import Progress
from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.frame.frame import Frame
from semisynth_gl.histogram import total_variation, wasserstein_px
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.render import Backend
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.crop_report import REJECTIONS, TextureReport, count_crops, make_texture_sheet
from semisynth_gl.textures.image_files import printable
from semisynth_gl.textures.prepare import prepare_atlas

_FEWEST = 4


@click.command(cls=Command)
@scene_options
@option("--out", type=OutputFileType(".png"), default="preview.png", help="PNG file to write.")
@option(
    "--patches",
    is_flag=True,
    help="Show patches instead of pairs. Count each image's patches, and its rejected crops by reason.",
)
@option(
    "--pairs",
    type=click.IntRange(min=1, max=64),
    help=f"Number of pairs.  [default: {_FEWEST}, or one for each recipe if there are more recipes]",
)
def preview(
    seed: int,
    backend: Backend,
    out: Path,
    patches: bool,
    pairs: int | None,
    **scene: Any,  # noqa: ANN401 - options of `scene_config`
) -> None:
    """Render a few pairs as a contact sheet.

    There is a pair of each recipe, if possible. A histogram compares the disparities, weighted by each recipe's share
    of the scenes, with the config's target.
    """
    if patches:
        if pairs is not None:
            raise InputError("--patches shows no pairs: leave --pairs out")
        _preview_patches(scene_config(**scene).textures, seed, out)
        return
    # Imported here: help and completion need no renderer, and loading matplotlib takes longer than rendering a pair.
    from semisynth_gl.judge.charts import plot_sheet  # noqa: PLC0415
    from semisynth_gl.pairs.pipeline import PairRenderer  # noqa: PLC0415

    config = scene_config(**scene)
    recipes, target = config.recipes(), config.shown_histogram()
    with PairRenderer(config, seed, backend) as renderer, Progress() as progress:
        indices = renderer.sampler.overview(pairs or max(_FEWEST, len(recipes)))
        progress.on_total(len(indices))
        shown = []
        for index in indices:
            shown.append(renderer.render(index))
            progress.on_pair()
        expected = renderer.sampler.expected()
        title = f"{config.name}, seed {seed}, {counted(len(shown), 'pair')}, {renderer.renderer_name}"
    frames, names, weights = list[Frame](), list[str](), list[float]()
    lines = [f"{counted(len(shown), 'pair')} in {out}"]
    for recipe in recipes:
        sampled = [pair for pair in shown if pair.provenance.get("recipe") == recipe.name]
        frames += [pair.frame for pair in sampled]
        names += [f"{'' if recipe.name is None else f'{recipe.name}, '}pair {pair.index}" for pair in sampled]
        weights += [recipe.share / len(sampled) for _ in sampled]
        if recipe.name is not None:
            numbers = ", ".join(str(pair.index) for pair in sampled)
            seen = f"shown as {'pair' if len(sampled) == 1 else 'pairs'} {numbers}" if sampled else "not shown"
            lines.append(f"{recipe.name}, {recipe.share:.0%} of the scenes: {seen}")
    lines.append(
        f"expected distance of a large dataset's disparities from the target: total variation "
        f"{total_variation(expected, target):.3f}, Wasserstein-1 {wasserstein_px(target, expected):.2g} px"
    )
    plot_sheet(frames, target, title, names, weights).savefig(out)
    click.echo("\n".join(lines))


def _preview_patches(section: TexturesSection, seed: int, out: Path) -> None:
    """Write a sheet of a dataset's patches, and print how many patches and rejected crops each image has."""
    atlas = prepare_atlas(section, Split(seed))
    report = atlas.report
    kept = counted(report.total("kept"), "patch")
    source = ", ".join(section.images) if section.source == "images" else section.source
    title = f"{kept} of {report.patch_px} x {report.patch_px} pixels: {source}"
    shown = [(each.source, atlas.pixels(each)[0, ..., :3]) for each in atlas.patches if not each.large]
    make_texture_sheet(report, shown, title).save(out)
    for line in (*table(_patch_rows(report)), report.summary(), f"{kept} in {out}"):
        click.echo(line)


def _patch_rows(report: TextureReport) -> Iterator[list[str]]:
    """Yield a row for each image: its patches by scale, its rejected crops by reason, its share of the surfaces."""
    sides = sorted({count.side_px for count in report.counts})
    scales = [f"at {side / report.patch_px:g}x" for side in sides]
    yield ["image", "patches", *scales, *REJECTIONS, "surfaces"]
    for name, counts in (*report.grouped_counts.items(), ("all", report.counts)):
        numbers = [count_crops(counts, "kept"), *(count_crops(counts, "kept", side) for side in sides)]
        numbers += [count_crops(counts, outcome) for outcome in REJECTIONS]
        share = sum(report.surface_shares.get(source, 0.0) for source in {count.source for count in counts})
        yield [printable(name), *map(str, numbers), f"{share:.1%}"]
