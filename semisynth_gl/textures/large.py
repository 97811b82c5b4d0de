"""Large patches: the largest square of an image, whole, for walls, grounds and whatever else is large."""

from collections.abc import Callable, Collection, Mapping

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.textures.atlas import Atlas, Patch, opaque_layers
from semisynth_gl.textures.crops import CropBox, cut_crop, texture_measure
from semisynth_gl.textures.pictures import TextureImage, pixels_of

MOST_LARGE = 24
"""Large patches of an atlas at most: of 1024 pixels they take 100 MB."""


def with_large_patches(
    atlas: Atlas,
    find: Callable[[Collection[str]], Mapping[str, TextureImage]],
    side_px: int,
    rng: np.random.Generator,
) -> Atlas:
    """Add large patches to an atlas, one of each image that its patches come from, until there are enough.

    Each image has an equal say however large it is. The square is as high or as wide as its image; it is averaged, or
    enlarged where the image is smaller: near walls are blurred in photographs too.

    Args:
        atlas: patches of one size.
        find: returns the images of the given names.
        side_px: side of a large patch.
        rng: draws the images and the places of the squares.
    """
    sources = sorted({patch.source for patch in atlas.patches})
    names = [sources[int(number)] for number in rng.permutation(len(sources))[:MOST_LARGE]]
    images = find(names)
    stacks, patches = list[NDArray[np.uint8]](), list(atlas.patches)
    for name in names:
        pixels = pixels_of(images[name])
        height, width = pixels.shape[:2]
        side = min(height, width)
        left, top = (int(rng.integers(free + 1)) for free in (width - side, height - side))
        patch = _resized(pixels, CropBox(left, top, side), side_px)
        first = len(atlas.layers) + len(stacks)
        patches.append(Patch(name, left, top, side, first, 1, texture_measure(patch), large=True))
        stacks.append(patch[np.newaxis])
    return Atlas(atlas.layers, tuple(patches), atlas.report, atlas.pictures, opaque_layers(stacks))


def _resized(image: NDArray[np.uint8], box: CropBox, side_px: int) -> NDArray[np.uint8]:
    if box.side_px >= side_px:
        return cut_crop(image, box, side_px)
    square = image[box.top_px : box.top_px + box.side_px, box.left_px : box.left_px + box.side_px]
    enlarged = Image.fromarray(square).resize((side_px, side_px), Image.Resampling.BICUBIC)
    return np.asarray(enlarged, np.uint8)
