"""Makes the pattern of a rig's projector, which all scenes share, and samples its pose and light for a sequence."""

import math

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.rig_sections import ProjectorSection
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.scene.rig import local_from_parent
from semisynth_gl.scene.scene import Projector
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.textures.atlas import to_grey
from semisynth_gl.textures.images import ImageError, read_image


def sample_projector(section: ProjectorSection, rng: np.random.Generator) -> Projector | None:
    """Sample the projector of a sequence; return None for a sequence in which it is off."""
    if rng.random() >= section.share:
        return None
    width_rad = math.radians(section.field_of_view_deg.sample(rng))
    position_m = np.array([each.sample(rng) for each in section.position_m])
    turn_rad = np.deg2rad([each.sample(rng) for each in section.turn_deg])
    power, ambient = section.power.sample(rng), section.ambient.sample(rng)
    return Projector(
        local_from_parent(position_m, turn_rad), section.pattern_width_px / 2 / math.tan(width_rad / 2), power, ambient
    )


def find_pattern(section: ProjectorSection) -> NDArray[np.uint8]:
    """Paint or read the pattern, (H, W) uint8. It depends only on the section, so all pairs and datasets share it.

    Raises InputError where its file cannot be read, or has a different size than the section says.
    """
    height, width = section.pattern_height_px, section.pattern_width_px
    if section.painted:
        return _paint(section, height, width)
    try:
        pattern = to_grey(read_image(expanded(section.pattern)))
    except ImageError as error:
        raise InputError(f"projector.pattern: {error}") from None
    if pattern.shape != (height, width):
        sizes = f"expected {width} x {height} px, got {pattern.shape[1]} x {pattern.shape[0]} px in {section.pattern}"
        raise InputError(f"projector.pattern: {sizes}: set pattern_width_px and pattern_height_px")
    return pattern


def _paint(section: ProjectorSection, height: int, width: int) -> NDArray[np.uint8]:
    rng = generator(0, Purpose.PROJECTOR)
    light = np.zeros((height, width))
    if section.pattern == "stripes":
        step = section.size_px / section.density
        starts = (np.arange(math.ceil(width / step)) + rng.random(math.ceil(width / step))) * step
        away = np.abs(np.arange(width) - starts[:, None]).min(axis=0)
        light[:] = np.clip(section.size_px / 2 + 0.5 - away, 0, 1)
    else:
        # Each square of a grid has one dot, at a random position, so that dots do not crowd anywhere.
        reach = math.ceil(section.size_px / 2 + 1)
        step = section.size_px * math.sqrt(math.pi / 4 / section.density)
        rows, columns = (np.arange(math.ceil(side / step)) for side in (height, width))
        squares = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        y, x = ((squares + rng.random(squares.shape)) * step - 0.5).T
        for down in range(-reach, reach + 1):
            for right in range(-reach, reach + 1):
                row, column = np.rint(y).astype(int) + down, np.rint(x).astype(int) + right
                inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
                away = np.hypot(row - y, column - x)[inside]
                np.maximum.at(light, (row[inside], column[inside]), np.clip(section.size_px / 2 + 0.5 - away, 0, 1))
    pattern: NDArray[np.uint8] = np.rint(255 * light).astype(np.uint8)
    return pattern
