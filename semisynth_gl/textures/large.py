"""Large patches: the largest square of an image, for surfaces on which a small patch would repeat."""

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.config.scene_sections import TexturesSection
from semisynth_gl.textures.atlas import Atlas, Patch, opaque_layers
from semisynth_gl.textures.borders import inside_borders
from semisynth_gl.textures.crops import CropBox, cut_crop, texture_measure
from semisynth_gl.textures.pictures import TextureImage, pixels_of

MOST_LARGE = 24
"""Largest number of large patches of an atlas; with sides of 1024 pixels they take 100 MB."""


def with_large_patches(
    atlas: Atlas,
    find: Callable[[Collection[str]], Mapping[str, TextureImage]],
    section: TexturesSection,
    rng: np.random.Generator,
) -> Atlas:
    """Return an atlas with large patches added: one for each subject that its patches show, up to `MOST_LARGE`.

    Subjects are taken in random order; where a subject has several images, one is chosen at random. A patch is the
    largest square of its image, inside black borders and at a random place, with its pixels averaged. An image smaller
    than the patch is enlarged: near walls are blurred in photographs too.

    Args:
        atlas: the atlas, with no large patches yet.
        find: returns the images with the given names; called once.
        section: the config's section.
        rng: source of the choices.
    """
    subjects = {patch.source: patch.subject for patch in atlas.patches}
    sources: dict[str, list[str]] = defaultdict(list)
    for source in sorted(subjects):
        sources[subjects[source] or source].append(source)
    drawn = [sorted(sources)[int(number)] for number in rng.permutation(len(sources))[:MOST_LARGE]]
    order = [
        of_one[0] if len(of_one) == 1 else of_one[int(rng.integers(len(of_one)))]
        for of_one in (sources[subject] for subject in drawn)
    ]
    images = find(order)
    stacks, patches = list[NDArray[np.uint8]](), list(atlas.patches)
    for name in order:
        pixels = pixels_of(images[name])
        inside = inside_borders(pixels)
        side = min(inside.height_px, inside.width_px)
        left, top = (int(rng.integers(free + 1)) for free in (inside.width_px - side, inside.height_px - side))
        box = CropBox(inside.left_px + left, inside.top_px + top, side)
        layer = _resized(pixels, box, section.large_px)
        number = len(atlas.layers) + len(stacks)
        patches.append(Patch(name, *box, number, 1, texture_measure(layer), large=True, subject=subjects[name]))
        stacks.append(layer[np.newaxis])
    return replace(atlas, patches=tuple(patches), large_layers=opaque_layers(stacks))


def _resized(image: NDArray[np.uint8], box: CropBox, side_px: int) -> NDArray[np.uint8]:
    if box.side_px >= side_px:
        return cut_crop(image, box, side_px)
    square = image[box.top_px : box.top_px + box.side_px, box.left_px : box.left_px + box.side_px]
    return np.asarray(Image.fromarray(square).resize((side_px, side_px), Image.Resampling.BICUBIC))
