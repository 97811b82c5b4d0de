"""Imperfections of real cameras, applied to rendered images; the truth stays unchanged.

The order is a camera's: motion blur (`semisynth_gl.pairs.cameras`), lens blur, vignetting, exposure and white balance,
sensor noise, tone curve, sharpening, JPEG. Noise comes after the white balance, so that its amount is in levels of the
image. All change 8-bit values directly, since the tone curves of the photographs are unknown. Values are rounded to
whole levels after the lens blur, the tone curve, sharpening and JPEG.
"""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from semisynth_gl.config.rig_sections import ImperfectionsSection

# Number of values in a block, which stays in the processor's cache.
_BLOCK = 1 << 17
# Weights of red, green and blue in the luminance, from ITU-R BT.601, as in JPEG.
LUMINANCE = np.array([0.299, 0.587, 0.114], np.float32)
# The unsharp mask blurs columns and rows with the weights 1 4 6 4 1, nearly a Gaussian of 1 px. Here, the weights and
# their sum are divided by the middle weight.
_NEXT, _OUTER, _SUM = np.float32(4 / 6), np.float32(1 / 6), np.float32(16 / 6)


@dataclass(frozen=True, slots=True)
class ImageImperfections:
    """The imperfections of a view, except motion blur. The default leaves the image as it is.

    Attributes:
        blur_px: standard deviation of the lens blur, px.
        exposure_stops: exposure; values are multiplied by 2 to this power.
        noise: standard deviation of the sensor's noise, 8-bit levels.
        gamma: exponent of the tone curve on [0, 1].
        white_balance: stops of red and of blue, which are multiplied by 2 to these powers; ignored for grey images.
        vignetting: share of the light, below 1, that is lost at half the image's diagonal from the principal point.
        sharpening: amount of the unsharp mask.
        jpeg_quality: quality of the JPEG, 1 to 100; None for no JPEG.
    """

    blur_px: float = 0.0
    exposure_stops: float = 0.0
    noise: float = 0.0
    gamma: float = 1.0
    white_balance: Sequence[float] = (0.0, 0.0)
    vignetting: float = 0.0
    sharpening: float = 0.0
    jpeg_quality: int | None = None


def apply_imperfections(
    image: NDArray[np.uint8],
    sampled: ImageImperfections,
    rng: np.random.Generator,
    principal_point_px: tuple[float, float] | None = None,
) -> NDArray[np.uint8]:
    """Return an image with imperfections; without any, the same image.

    Args:
        image: (H, W, 3) uint8, or (H, W) for an image of one channel.
        sampled: the imperfections.
        rng: source of the noise.
        principal_point_px: x and y of the centre of vignetting; by default the image's centre.
    """
    if sampled == ImageImperfections():
        return image
    if sampled.blur_px > 0:
        image = np.asarray(Image.fromarray(image).filter(ImageFilter.GaussianBlur(sampled.blur_px)))
    image = _pixel_by_pixel(image, sampled, rng, principal_point_px)
    if sampled.sharpening > 0:
        image = _sharpened(image, sampled.sharpening)
    if sampled.jpeg_quality is not None:
        image = _through_jpeg(image, sampled.jpeg_quality)
    return image


def _pixel_by_pixel(
    image: NDArray[np.uint8],
    sampled: ImageImperfections,
    rng: np.random.Generator,
    principal_point_px: tuple[float, float] | None,
) -> NDArray[np.uint8]:
    """Apply vignetting, exposure, white balance, noise and tone curve to each pixel."""
    height, width, channels = (*image.shape, 1)[:3]
    red, blue = sampled.white_balance
    stops = (red, 0.0, blue) if channels == 3 else (0.0,)
    gains = np.tile(np.array([2.0 ** (sampled.exposure_stops + each) for each in stops], np.float32), width)
    falloff = None
    if sampled.vignetting > 0:
        x, y = ((width - 1) / 2, (height - 1) / 2) if principal_point_px is None else principal_point_px
        # Light falls off with cos^4 = 1 / (1 + tan^2)^2 of the angle from the optical axis.
        tan_per_px = np.sqrt((1 - sampled.vignetting) ** -0.5 - 1) / (np.hypot(width, height) / 2)
        across = np.repeat(1 + ((np.arange(width) - x) * tan_per_px) ** 2, channels).astype(np.float32)
        down = (((np.arange(height) - y) * tan_per_px) ** 2).astype(np.float32)[:, None]
        falloff = across, down
    result, rows = np.empty_like(image, order="C"), max(1, _BLOCK // len(gains))
    # The noise does not depend on the size of blocks: each block's random numbers follow those of the block before.
    for first in range(0, height, rows):
        block = image[first : first + rows]
        values = block.astype(np.float32).reshape(len(block), -1)
        values *= gains
        if falloff is not None:
            squared = falloff[0] + falloff[1][first : first + rows]
            squared *= squared
            values /= squared
        if sampled.noise > 0:
            noise = rng.standard_normal(values.shape, np.float32)
            noise *= np.float32(sampled.noise)
            values += noise
        levels = _to_levels(values, sampled.gamma).reshape(block.shape)
        np.copyto(result[first : first + rows], levels, casting="unsafe")
    return result


def _to_levels(values: NDArray[np.float32], gamma: float) -> NDArray[np.float32]:
    """Clip values to 0 to 255, apply the tone curve and round to whole levels, in place; return the values."""
    np.clip(values, 0, 255, out=values)
    if gamma != 1:
        values /= 255
        values **= np.float32(gamma)
        values *= 255
    return np.rint(values, out=values)


def _sharpened(image: NDArray[np.uint8], amount: float) -> NDArray[np.uint8]:
    """Add ``amount`` times the difference of luminance and blurred luminance to all channels, as cameras sharpen."""
    height, width, channels = (*image.shape, 1)[:3]
    result, rows = np.empty_like(image, order="C"), max(1, _BLOCK // (width * channels))
    for first in range(0, height, rows):
        last = min(first + rows, height)
        # Beyond the border, the outermost pixels are repeated.
        grey = image[np.arange(first - 2, last + 2).clip(0, height - 1)].astype(np.float32)
        if channels > 1:
            grey = grey @ LUMINANCE
        middle = grey[2:-2]
        down = (grey[1:-3] + grey[3:-1]) * _NEXT + (grey[:-4] + grey[4:]) * _OUTER + middle
        down = np.pad(down, ((0, 0), (2, 2)), "edge")
        blurred = (down[:, 1:-3] + down[:, 3:-1]) * _NEXT + (down[:, :-4] + down[:, 4:]) * _OUTER + down[:, 2:-2]
        detail = (middle - blurred / _SUM**2) * np.float32(amount)
        values = image[first:last].reshape(last - first, -1) + np.repeat(detail, channels, axis=1)
        levels = _to_levels(values, 1.0).reshape(image[first:last].shape)
        np.copyto(result[first:last], levels, casting="unsafe")
    return result


def _through_jpeg(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """Encode and decode an image as JPEG, with colour at half the width and height, as in most cameras."""
    data = io.BytesIO()
    Image.fromarray(image).save(data, "JPEG", quality=quality, subsampling="4:2:0")
    with Image.open(data, formats=["JPEG"]) as decoded:
        return np.array(decoded)


def sample_imperfections(
    section: ImperfectionsSection, rng: np.random.Generator, generator_of: Callable[[str], np.random.Generator]
) -> dict[str, Any]:
    """Sample arguments of `ImageImperfections` for one eye's view, in JSON's types.

    Lens blur, exposure, noise and gamma come from ``rng``. Every other key has its own generator,
    ``generator_of(key)``, so that setting one key does not change the values of the others.
    """
    values: dict[str, Any] = {
        key: getattr(section, key).sample(rng) for key in ("blur_px", "exposure_stops", "noise", "gamma")
    }
    given = section.model_dump(exclude_defaults=True)
    for key in ("white_balance", "vignetting", "sharpening", "jpeg_quality"):
        if key in given:
            span, key_rng = getattr(section, key), generator_of(key)
            values[key] = span.sample(key_rng)
            if key == "white_balance":
                values[key] = [values[key], span.sample(key_rng)]
            if key == "jpeg_quality":
                values[key] = round(values[key])
    return values
