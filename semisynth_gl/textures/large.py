"""Cuts large patches, for surfaces on which a small patch would repeat: the largest squares of images."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.textures.atlas import Atlas, Patch, opaque_layers
from semisynth_gl.textures.borders import inside_borders
from semisynth_gl.textures.canvas import PaintedPicture
from semisynth_gl.textures.crops import Square, cut_crop, texture_measure
from semisynth_gl.textures.images import read_image

MOST_LARGE = 24
"""Maximum number of large patches of an atlas; with sides of 1024 pixels they need 100 MB."""


def with_large_patches(
    atlas: Atlas, images: Mapping[str, Path | PaintedPicture], section: TexturesSection, rng: np.random.Generator
) -> Atlas:
    """Return an atlas with large patches added: one for each subject, up to `MOST_LARGE`.

    Subjects are chosen in random order, and one of their images at random. A patch is the largest square of its image,
    inside black borders and at a random position. Images smaller than the patch are enlarged: in photographs, near
    walls are blurred as well. ``images`` are given by name; the atlas's further images get no large patches.
    """
    subjects = {patch.source: patch.subject for patch in atlas.patches if patch.source in images}
    if not subjects:
        return atlas
    sources: dict[str, list[str]] = defaultdict(list)
    for source in sorted(subjects):
        sources[subjects[source] or source].append(source)
    some = [sources[sorted(sources)[int(number)]] for number in rng.permutation(len(sources))[:MOST_LARGE]]
    order = [of_one[int(rng.integers(len(of_one)))] for of_one in some]
    stacks, patches = list[NDArray[np.uint8]](), list(atlas.patches)
    for number, name in enumerate(order, start=len(atlas.layers)):
        image = images[name]
        pixels = image.pixels if isinstance(image, PaintedPicture) else read_image(image)
        inside = inside_borders(pixels)
        side = min(inside.height_px, inside.width_px)
        left, top = (int(rng.integers(free + 1)) for free in (inside.width_px - side, inside.height_px - side))
        square = Square(name, inside.left_px + left, inside.top_px + top, side)
        layer = cut_crop(pixels, square, section.large_px)
        patches.append(Patch(*square, number, 1, texture_measure(layer), large=True, subject=subjects[name]))
        stacks.append(layer[np.newaxis])
    return replace(atlas, patches=tuple(patches), large_layers=opaque_layers(stacks))
