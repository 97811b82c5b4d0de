"""Photographs as raw cameras take them: rectified by the rig's calibration, and written for `generate` to cut."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from semisynth_gl.calibration.kinds import Size
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.codecs.png import RGB8
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.lens.chain import LensChain
from semisynth_gl.textures.image_files import find_files, find_images, reaching_source
from semisynth_gl.textures.images import image_extensions, read_image, stored_size
from semisynth_gl.textures.subjects import is_right


def lens_chains(rig: Rig) -> dict[Eye, LensChain]:
    """Return each eye's way through its lens, with black borders, for a rig with cameras before rectification.

    Raises:
        InputError: where OpenCV is missing, or a lens bends two directions of the rectified image to one pixel.
    """
    raw = rig.raw or {}
    try:
        return {eye: LensChain(raw[eye], rig.camera, eye, "black") for eye in EYES}
    except InputError as error:
        raise InputError(f"{rig.source}: {error}") from None


def rectify_photographs(sources: Sequence[str], rig: Rig, folder: Path) -> list[str]:
    """Rectify photographs as OpenCV does, and write them as PNG.

    The right camera took the photographs that `is_right` knows by name, the left one all others. A photograph keeps its
    path below the folder that all share.

    Args:
        sources: files, folders and globs of photographs as they were taken.
        rig: with cameras before rectification.
        folder: where they are written; it may hold the same photographs already, and no other images.

    Returns:
        Notes, which say for which eye each photograph was taken, and name the photographs that were left out.

    Raises:
        InputError: where no photograph has the size of its raw camera, one is turned by its EXIF orientation, a
            rectified one is there with other pixels, or the folder holds other images or is one of the ``sources``.
        ImageError: where a photograph cannot be read.
    """
    folder = expanded(folder)
    if (source := reaching_source(folder, sources)) is not None:
        raise InputError(f"{folder} lies among the photographs ({source}): name another", argument="rectify_to")
    taken = find_images(sources)
    # resolve() would follow links, whose names may tell sides.
    top = os.path.commonpath([os.path.abspath(path.parent) for path in taken])  # noqa: PTH100
    names = {path: Path(os.path.relpath(path, top)) for path in taken}
    chains = lens_chains(rig)
    raw = chains["left"].raw
    expected, sizes = Size(raw.width_px, raw.height_px), {path: Size(*stored_size(path)[::-1]) for path in taken}
    fitting = [path for path, size in sizes.items() if size == expected]
    if not fitting:
        raise InputError(
            f"{rig.source}: the raw images have {expected}, but of {counted(len(taken), 'photograph')} none has that "
            f"size, the first one has {sizes[taken[0]]}: give photographs as the cameras take them, or the scale if "
            "they are reduced"
        )
    written = {folder / names[path].with_suffix(".png"): path for path in fitting}
    if len(written) < len(fitting):
        raise InputError("two photographs differ only in the endings of their names: both would be rectified to one")
    others = [file for file in find_files([folder], image_extensions()) if file not in written]
    if others or folder.is_file():
        raise InputError(f"{folder} holds other images: name a new folder", argument="rectify_to")
    counts: dict[Eye, int] = dict.fromkeys(EYES, 0)
    for file, path in written.items():
        image, eye = read_image(path), EYES[is_right(names[path])]
        if image.shape[:2] != (raw.height_px, raw.width_px):
            raise InputError(f"{path}: is turned by its EXIF orientation: expected the image as the sensor sees it")
        rectified = chains[eye].rectify(image)
        # Configs cut their patches from these files, and others' photographs may have the same names.
        if file.exists() and not np.array_equal(read_image(file), rectified):
            raise InputError(f"{folder} has a {file.name} with other pixels: name a new folder", argument="rectify_to")
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(RGB8.encode(rectified))
        counts[eye] += 1
    notes = [f"photographs rectified: {counts['left']} of the left camera, {counts['right']} of the right one"]
    if left_out := len(taken) - len(fitting):
        notes.append(f"{counted(left_out, 'photograph')} left out, of another size than the raw images' {expected}")
    return notes
