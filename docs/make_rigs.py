"""Make the pictures of docs/rigs.md.

Run it as ``python docs/make_rigs.py docs/images``.
"""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from make_picture import coloured, strip
from matplotlib.colors import TwoSlopeNorm
from PIL import Image, ImageDraw, ImageFont

from semisynth_gl import load_config, render_pair
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.pairs.pipeline import PairRenderer

_OPEN = ("scenes=[]", "background.cuboid=0", "background.room=0")


def draw_baselines(path: Path) -> None:
    """Show a left image and depth, and three right images, each above the left disparity of its pair."""
    rig = {"width_px": 640, "baselines": [0.25, 0.5, 1.0], "baseline_m": None}
    with PairRenderer(load_config("sceneflow", {"camera": rig, "outputs": ["depth"]}), 0) as renderer:
        frames = [renderer.render(3 + view).frame for view in range(3)]
    left = frames[0].left
    largest = float(frames[-1].left.disparity.max())
    # Inverse depth, so that near things are bright, as in the disparities.
    above = [left.image, *(frame.right.image for frame in frames)]
    below = [coloured(1 / left.depth, largest / frames[-1].camera.focal_baseline)]
    below += [coloured(frame.left.disparity, largest) for frame in frames]
    gap = np.full((12, left.image.shape[1], 3), 255, np.uint8)
    columns = [np.concatenate([one, gap, two]) for one, two in zip(above, below, strict=True)]
    strip(columns, path)


def draw_signed(path: Path) -> None:
    """Show left and right image, and signed disparity in a colour map that changes its hue at 0."""
    rig = ("camera.doffs_px=40", "disparity.signed=true", "disparity.min_px=-35", "disparity.max_px=60")
    keys = ("background.street=1", "background.plane_disparity_px=-38", "disparity.target={form: uniform}")
    with PairRenderer(load_config("sceneflow", [*_OPEN, *rig, *keys]), 1) as renderer:
        frame = renderer.render(2).frame
    shown = mpl.colormaps["RdBu_r"](TwoSlopeNorm(0, -40, 60)(frame.left.disparity))[..., :3]
    strip([frame.left.image, frame.right.image, (255 * shown).astype(np.uint8)], path)


def draw_sky(path: Path) -> None:
    """Show left image, disparity and the mask of the sky."""
    keys = ("disparity.signed=true", "background.street=1", "background.sky=1", "outputs=[sky]")
    few = "particles.layers=[{count: 4, disparity_px: [20, 60]}]"
    with PairRenderer(load_config("sceneflow", [*_OPEN, *keys, few]), 1) as renderer:
        frame = renderer.render(4).frame
    shown = coloured(frame.left.disparity, float(np.quantile(frame.left.disparity, 0.99)))
    strip([frame.left.image, shown, as_rgb(frame.left.sky)], path)


# A large value of each imperfection, in the order in which cameras cause them.
CAMERA: Mapping[str, str] = {
    "": "as rendered",
    "motion_blur": "0.8",
    "blur_px": "1.5",
    "vignetting": "0.7",
    "exposure_stops": "-1",
    "white_balance": "0.4",
    "noise": "14",
    "gamma": "0.6",
    "sharpening": "2.5",
    "jpeg_quality": "12",
}
ALL = (
    "imperfections={motion_blur: 0.3, blur_px: 0.6, vignetting: 0.4, exposure_stops: [-0.4, 0], noise: 4, "
    "white_balance: [-0.2, 0.2], sharpening: 1, jpeg_quality: 40}"
)
COLUMNS, GAP_PX = 4, 6


def draw_rectification(path: Path) -> None:
    """Show both images of a pair whose right camera deviates, and the vertical displacement."""
    config = load_config(
        "sceneflow", ["rig.right_roll_deg=2", "rig.right_y_px=6", "disparity.signed=true", "outputs=[correspondence]"]
    )
    frame = render_pair(config, index=1)
    off = mpl.colormaps["coolwarm"](frame.left.correspondence[..., 1] / 40 + 0.5)[..., :3]
    strip([frame.left.image, frame.right.image, (255 * off).astype(np.uint8)], path)


def draw_grey(path: Path) -> None:
    """Show a left image in colour, and both images in grey."""
    coloured, grey = (
        render_pair(load_config("sceneflow", [f"camera.colour={colour}"]), index=1) for colour in ("rgb", "grey")
    )
    strip([coloured.left.image, as_rgb(grey.left.image), as_rgb(grey.right.image)], path)


def draw_cameras(path: Path) -> None:
    """Show a left image with each single imperfection, then both images of a pair with several imperfections."""
    moving = ["scale=0.32", "camera.sway_m=0.1", "camera.sway_deg=2", "sequence.frame_s=0.15", "antialias=ssaa2"]
    tiles = {}
    for key, value in CAMERA.items():
        given = [f"imperfections.{key}={value}"] if key else []
        frame = render_pair(load_config("sceneflow", [*moving, *given]), index=3)
        tiles[f"{key} {value}".strip()] = frame.left.image
    frame = render_pair(load_config("sceneflow", [*moving, ALL]), index=3)
    tiles |= {"several, left": frame.left.image, "several, right": frame.right.image}
    height, width = frame.left.image.shape[:2]
    rows = -(-len(tiles) // COLUMNS)
    size = COLUMNS * (width + GAP_PX) - GAP_PX, rows * (height + GAP_PX) - GAP_PX
    picture = Image.new("RGB", size, "white")
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(15)
    for number, (label, tile) in enumerate(tiles.items()):
        row, column = divmod(number, COLUMNS)
        corner = column * (width + GAP_PX), row * (height + GAP_PX)
        picture.paste(Image.fromarray(np.ascontiguousarray(tile)), corner)
        below = corner[0], corner[1] + height - 22
        draw.rectangle((*below, below[0] + draw.textlength(label, font) + 10, below[1] + 22), "white")
        draw.text((below[0] + 5, below[1] + 2), label, "black", font)
    picture.save(path, quality=55, optimize=True)


def draw_lenses(path: Path) -> None:
    """Show a raw image, the rectified image, and the mask of its pixels that both cameras saw."""
    eye = {"fx_px": 1150, "distortion": [-0.35, 0.12, 0, 0], "rotation_deg": [0.3, -1.5, 1.2]}
    lens = {"raw_width_px": 960, "raw_height_px": 540, "left": eye, "right": eye | {"rotation_deg": [0, 1, -0.8]}}
    config = load_config("sceneflow", {"lens": lens, "outputs": ["visibility", "valid", "raw"]})
    with PairRenderer(config, 0) as renderer:
        view = renderer.render(1).frame.left
    strip([view.raw, view.image, as_rgb(view.visibility)], path)


def draw_projector(path: Path) -> None:
    """Show a pair with projected dots, and its disparity."""
    with PairRenderer(load_config("active-infrared", {"projector": {"power": 14, "ambient": 0.5}}), 0) as renderer:
        frame = renderer.render(3).frame
    shown = coloured(frame.left.disparity, float(np.quantile(frame.left.disparity, 0.98)))
    strip([as_rgb(frame.left.image), as_rgb(frame.right.image), shown], path)


PICTURES: Mapping[str, Callable[[Path], None]] = {
    "rigs-baselines.jpg": draw_baselines,
    "rigs-signed.jpg": draw_signed,
    "rigs-sky.jpg": draw_sky,
    "rigs-rectification.jpg": draw_rectification,
    "rigs-cameras.jpg": draw_cameras,
    "rigs-grey.jpg": draw_grey,
    "rigs-lenses.jpg": draw_lenses,
    "rigs-projector.jpg": draw_projector,
}
"""The functions that make the pictures, by the pictures' names."""

if __name__ == "__main__":
    for name, draw in PICTURES.items():
        draw(Path(sys.argv[1]) / name)
