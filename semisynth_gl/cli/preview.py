"""``semisynth-gl preview``."""

import io
from collections import Counter
from pathlib import Path

import click
import numpy as np

from semisynth_gl.cli.options import SceneOptions, UserPath, option, scene_options
from semisynth_gl.cli.outputs import Output, ending_check, marked_ply, marked_png, output_option
from semisynth_gl.cli.progress import Progress
from semisynth_gl.cli.streams import say
from semisynth_gl.codecs.ply import encode_points
from semisynth_gl.errors import counted
from semisynth_gl.frame import as_rgb
from semisynth_gl.histogram import total_variation, wasserstein_px
from semisynth_gl.interrupts import interrupts_end

_PLY = marked_ply("semisynth-gl preview")


@click.command()
@scene_options
@output_option("--out", marked_png("semisynth-gl preview"), ".png", default="preview.png", help="PNG to write.")
@option(
    "--ply",
    "ply_path",
    type=UserPath(),
    callback=ending_check("--ply", ".ply"),
    metavar="FILE",
    help="Also write the first pair's left view as a point cloud, in metres and with colours, to this PLY.",
)
@option("--pairs", type=click.IntRange(min=1, max=64), default=4, help="How many pairs to show.")
def preview(scene: SceneOptions, output: Output, ply_path: Path | None, pairs: int) -> None:
    """Draw a contact sheet: the first pairs of a dataset, and their histogram against the config's."""
    # Imported here: help and completion need no renderer, and matplotlib takes longer to load than a pair to render.
    with interrupts_end():
        from semisynth_gl.pairs.pipeline import PairRenderer  # noqa: PLC0415
        from semisynth_gl.report.contact_sheet import draw_sheet  # noqa: PLC0415

    config = scene.config()
    cloud = Output("--ply", _PLY, ply_path, output.overwrite)
    for file in (output, cloud):
        file.check_beside(scene.config_name, config)
    with PairRenderer(config, scene.seed, scene.backend) as renderer, Progress() as progress:
        progress.on_total(pairs)
        shown = []
        for index in range(pairs):
            shown.append(renderer.render(index))
            progress.advance()
        expected, in_view = renderer.expected_histogram(), renderer.sampler.in_view_text()
        title = f"{config.name}, seed {scene.seed}, pairs 0 to {pairs - 1}, {renderer.renderer_name}"
    first = shown[0].frame
    png = io.BytesIO()
    target = config.shown_histogram()
    recipes = [recipe.name for recipe in config.recipes() if recipe.name is not None]
    names = []
    if recipes:
        shown.sort(key=lambda pair: recipes.index(pair.provenance["recipe"]))
        names = [f"{pair.provenance['recipe']}, pair {pair.index}" for pair in shown]
    draw_sheet([pair.frame for pair in shown], target, title, names).savefig(png, format="png")
    output.write(png.getvalue())
    say(f"{counted(pairs, 'pair')} in {output.file}")
    if cloud.path is not None:
        points = first.points()
        seen = np.isfinite(points[..., 2])
        cloud.write(encode_points(points[seen], as_rgb(first.left.image)[seen]))
        say(f"the points of pair 0 in {cloud.path}")
    if recipes:
        counts = Counter(pair.provenance["recipe"] for pair in shown)
        say("of each recipe: " + ", ".join(f"{name} {counts[name]}" for name in recipes))
    say(in_view)
    say(
        f"over many pairs, disparities are expected to come to a total variation of "
        f"{total_variation(expected, target):.3f} from the target, {wasserstein_px(target, expected):.2g} px "
        "(Wasserstein-1)"
    )
