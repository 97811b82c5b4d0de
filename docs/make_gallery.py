"""Make the pictures of the site's gallery and its page, gallery.md.

`make docs` runs it as ``python docs/make_gallery.py build/gallery``.
"""

import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

import matplotlib as mpl
import numpy as np
from make_picture import flow_colours
from matplotlib.colors import hsv_to_rgb
from numpy.typing import NDArray
from PIL import Image
from skimage.data import data_dir

from semisynth_gl import PairRenderer, Renderer, StereoCamera, ViewArrays, load_config, make_scene, render_pair
from semisynth_gl.config.load import summaries
from semisynth_gl.config.rig_sections import ImperfectionsSection
from semisynth_gl.frame.channels import CHANNELS, OUTPUTS, Channel
from semisynth_gl.frame.frame import as_rgb
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS

Floats = NDArray[np.floating]
PaintedPicture = NDArray[np.uint8]

# Photographs for the config that needs some: a Middlebury scene from scikit-image.
TARGET = [f"textures.images=[{Path(data_dir) / 'motorcycle_left.png'}, {Path(data_dir) / 'motorcycle_right.png'}]"]

# The values that are shown of each imperfection; a key that is missing here is an error.
IMPERFECTIONS = {
    "exposure_stops": (-1, 1),
    "gamma": (0.5, 2),
    "noise": (6, 15),
    "blur_px": (1, 2.5),
    "motion_blur": (0.5, 1),
    "sub_frames": (3,),
    "vignetting": (0.3, 0.6),
    "white_balance": (-0.4, 0.4),
    "sharpening": (1, 3),
    "jpeg_quality": (60, 15),
}
# Further keys for imperfections that would otherwise change nothing.
_SWAY = ("camera.sway_m=0.1", "camera.sway_deg=2")
BESIDE = {"motion_blur": _SWAY, "sub_frames": (*_SWAY, "imperfections.motion_blur=1")}

# A config whose outputs all show something: rig and things move in front of a sky, and the lens leaves a border.
_EYE = "{fx_px: 1120, distortion: [-0.3, 0.1, 0, 0], rotation_deg: [0, 0.5, 1]}"
MOVING = [
    *("scenes=[]", "camera.sway_m=0.05", "camera.sway_deg=1", "sequence.length=3", f"outputs=[{','.join(OUTPUTS)}]"),
    *("background.cuboid=0", "background.plane=1", "background.sky=1", "disparity.signed=true"),
    f"lens={{raw_width_px: 960, raw_height_px: 540, left: {_EYE}, right: {_EYE}}}",
]

MODEL_PX, SAMPLES, DISTANCE_M = 180, 3, 6.0


def save(picture: PaintedPicture | Floats, path: Path, width: int) -> None:
    """Write a picture, uint8 or floats from 0 to 1, at most ``width`` pixels wide."""
    if picture.dtype != np.uint8:
        picture = np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8)
    image = Image.fromarray(picture).convert("RGB")
    path.parent.mkdir(parents=True, exist_ok=True)
    image.thumbnail((width, width), Image.Resampling.BOX)
    image.save(path, quality=82, progressive=True)


def figure(name: str, meaning: str, path: str) -> str:
    """Return the Markdown of a picture with a caption."""
    return (
        f'<figure markdown="span">\n![{name}](gallery/{path}){{ loading=lazy }}\n'
        f'<figcaption markdown="span">{meaning}</figcaption>\n</figure>\n'
    )


def colours(values: Floats, name: str, low: float, high: float) -> Floats:
    """Colour finite values by matplotlib's colour map ``name``; all others are black."""
    shown = mpl.colormaps[name]((np.where(np.isfinite(values), values, low) - low) / (high - low))[..., :3]
    shown[~np.isfinite(values)] = 0
    return shown


def beside(*pictures: PaintedPicture | Floats) -> Floats:
    """Join pictures of one height from left to right, with white gaps."""
    parts = [picture / 255 if picture.dtype == np.uint8 else picture for picture in pictures]
    gap = np.ones((parts[0].shape[0], parts[0].shape[1] // 60, 3))
    return np.concatenate([each for part in parts for each in (part, gap)][:-1], axis=1)


def draw_configs(folder: Path) -> Iterator[str]:
    """Make a picture of each packaged config: a left image and its disparity."""
    for name, summary in summaries().items():
        frame = render_pair(load_config(name, TARGET if name.endswith("-target") else []), index=3)
        disparity = frame.left.disparity
        shown = colours(disparity, "inferno", 0, float(np.quantile(disparity[np.isfinite(disparity)], 0.995)))
        save(beside(as_rgb(frame.left.image), shown), folder / "configs" / f"{name}.jpg", 1200)
        yield figure(name, f"`{name}`: {summary}", f"configs/{name}.jpg")


def seen_from_above() -> NDArray[np.float64]:
    """Return the pose of a model in front of the camera: upright (z upwards), turned, and seen from above."""
    yaw, tilt = np.deg2rad(35), np.deg2rad(24)
    upright = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    turned = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    tilted = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    pose = np.eye(4)
    pose[:3, :3] = tilted @ turned @ upright
    pose[2, 3] = DISTANCE_M
    return pose


def draw_model(renderer: Renderer, model: int, layer: int) -> Floats:
    """Return a picture of a model with a patch, lit from the top left, on white; (H, W, 3), 0 to 1."""
    side = MODEL_PX * SAMPLES
    camera = StereoCamera.centred(side, side, focal_px=side / 2 * DISTANCE_M / 1.02, baseline_m=0.1)
    scene = make_scene(camera, model=[model], world_from_model=[seen_from_above()], layer=[layer], uv_scale=(0.7, 0.7))
    view = renderer.render(scene).left
    light = np.array([-0.45, -0.75, -0.5]) / np.linalg.norm([-0.45, -0.75, -0.5])
    shade = 0.45 + 0.75 * np.clip(view.normals @ light, 0, 1)
    lit = np.clip(view.image / 255 * shade[..., None], 0, 1)
    lit[~np.isfinite(view.disparity)] = 1
    return lit.reshape(MODEL_PX, SAMPLES, MODEL_PX, SAMPLES, 3).mean(axis=(1, 3))


def draw_models(folder: Path, kinds: Iterable[str]) -> Iterator[str]:
    """Make a picture of the variants of each of these kinds."""
    with PairRenderer(load_config("sceneflow"), seed=0) as pairs:
        models, layers = pairs.sampler.models, pairs.sources.atlas.layers
    numbers = {name: [number for number, model in enumerate(models) if model.name == name] for name in kinds}
    with Renderer(models, layers, outputs=("normals",), truth="left") as renderer:
        for number, (name, variants) in enumerate(numbers.items()):
            patches = (np.arange(len(variants)) + 7 * number) % len(layers)
            tiles = [draw_model(renderer, *pair) for pair in zip(variants, patches, strict=True)]
            save(np.concatenate(tiles, axis=1), folder / "models" / f"{name}.jpg", len(tiles) * MODEL_PX)
            yield figure(name, f"`{name}`", f"models/{name}.jpg")


def draw_imperfections(folder: Path) -> Iterator[str]:
    """Make pictures of a part of one image without imperfections, and with each single imperfection."""
    settings = [(key, value) for key in ImperfectionsSection.model_fields for value in IMPERFECTIONS[key]]
    for number, (key, value) in enumerate([("", 0.0), *settings]):
        config = load_config("sceneflow", [f"imperfections.{key}={value}", *BESIDE.get(key, ())] if key else [])
        picture = render_pair(config, index=7).left.image[100:400, 200:650]
        path = f"imperfections/{number}-{key or 'none'}.jpg"
        save(picture, folder / path, 450)
        yield figure(key or "none", f"`{key}: {value}`" if key else "none", path)


def show_ids(ids: NDArray[np.uint16]) -> Floats:
    """Return a random colour for each id; 0 is black."""
    table = hsv_to_rgb(np.random.default_rng(5).uniform((0, 0.35, 0.55), (1, 0.9, 1), (int(ids.max()) + 1, 3)))
    table[0] = 0
    return table[ids]


def quantile_colours(name: str) -> Callable[[Floats], Floats]:
    """Return a function that colours values from their 1 % to their 99 % quantile."""
    return lambda values: colours(values, name, *np.quantile(values[np.isfinite(values)], (0.01, 0.99)))


# The picture of each channel; a channel that is missing here is an error.
SHOWN: dict[str, Callable[[NDArray[np.generic]], Floats | PaintedPicture]] = {
    "image": lambda image: image,
    "disparity": quantile_colours("inferno"),
    "visibility": as_rgb,
    "correspondence": lambda way: quantile_colours("inferno")(np.hypot(*np.moveaxis(way, 2, 0))),
    "instances": show_ids,
    "depth": quantile_colours("viridis_r"),
    "sky": as_rgb,
    "valid": as_rgb,
    "raw": lambda image: image,
    "raw_map": lambda position: np.dstack([position / position.max(axis=(0, 1)), np.full(position.shape[:2], 0.4)]),
    "normals": lambda normals: (1 - normals) / 2,
    "flow": flow_colours,
    "flow_visibility": as_rgb,
    "flow_backward": flow_colours,
    "flow_backward_visibility": as_rgb,
    "disparity_change": lambda change: colours(change, "coolwarm", -1.5, 1.5),
}


def draw_outputs(folder: Path) -> Iterator[str]:
    """Make a picture of each channel of a left view."""
    with PairRenderer(load_config("sceneflow", MOVING), seed=0) as pairs:
        view: ViewArrays = pairs.render(13).frame.left
    for name, channel in CHANNELS.items():
        save(SHOWN[name](view[name]), folder / "outputs" / f"{name}.jpg", 480)
        yield figure(name, caption(channel), f"outputs/{name}.jpg")


def caption(channel: Channel[np.generic]) -> str:
    """Return a channel's name, its output if that has a different name, and its meaning."""
    output = "" if channel.output in (None, channel.name) else f" (output `{channel.output}`)"
    return f"`{channel.name}`{output}: {channel.meaning.format(view='left', other='right')}"


# Functions that make a section's pictures and yield their Markdown, by the section's name in PAGE.
SECTIONS: dict[str, Callable[[Path], Iterator[str]]] = {
    "configs": draw_configs,
    "complex-models": partial(draw_models, kinds=COMPLEX_KINDS),
    "simple-models": partial(draw_models, kinds=SIMPLE_KINDS),
    "imperfections": draw_imperfections,
    "outputs": draw_outputs,
}

PAGE = """# Gallery

## Configs

A pair of each packaged config: left image and disparity, bright where near.

{configs}

## Models

All built-in kinds, three variants each, shaded only here. `models.kinds` sets their weights, and `models.folders` adds
yours ([keys](config.md#keys)).

### Complex

{complex-models}

### Simple

{simple-models}

## Imperfections

A detail of an image, without and with each key of [`imperfections`](rigs.md#imperfections).

{imperfections}

## Outputs

The left view of a pair, and all that `--outputs` adds to it; [output](output.md) defines the files.

{outputs}
"""


def main(folder: Path) -> None:
    """Make all pictures and the page."""
    drawn = {name: "\n".join(draw(folder)) for name, draw in SECTIONS.items()}
    pictures = {name: f'<div class="pictures {name}" markdown>\n\n{text}\n</div>' for name, text in drawn.items()}
    (folder / "gallery.md").write_text(PAGE.format(**pictures), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
