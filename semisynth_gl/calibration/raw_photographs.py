"""Photographs as raw cameras take them: rectified by the rig's calibration, and written for `generate` to cut."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from semisynth_gl.calibration.arrays import Size
from semisynth_gl.calibration.rig import Rig
from semisynth_gl.codecs.png import RGB8
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.inputs.errors import InputError, abbreviate, counted
from semisynth_gl.inputs.user_files import expanded
from semisynth_gl.lens.chain import LensChain
from semisynth_gl.textures.image_files import find_files, reaching_source
from semisynth_gl.textures.images import image_extensions, read_image, stored_size
from semisynth_gl.textures.subjects import is_right

_NAMED = 3


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


def rectify_photographs(
    photographs: Sequence[Path], pairs: Sequence[tuple[Path, Path]], sources: Sequence[str], rig: Rig, folder: Path
) -> tuple[dict[Path, Path], list[str]]:
    """Rectify photographs as OpenCV does, and write them as PNG.

    The right camera took the right photographs of ``pairs`` and those that `is_right` knows; the left one took all
    others. A photograph keeps its path below the folder that all share.

    Args:
        photographs: as they were taken.
        pairs: left and right photographs, among them or beside them.
        sources: of the photographs, as the user gave them.
        rig: with cameras before rectification.
        folder: where they are written; it may hold the same photographs already, and no other images.

    Returns:
        The rectified photograph by the raw one, and notes: on the sides that photographs were taken for, and on those
        of another size, which are left out.

    Raises:
        InputError: where no photograph has the size of its raw camera, one is turned by its EXIF orientation or would
            be replaced, a rectified one is there with other pixels, or the folder holds other images or is one of the
            ``sources``.
        ImageError: where a photograph cannot be read.
    """
    folder = _whole(expanded(folder))
    given = {path: _whole(path) for path in (*photographs, *(path for pair in pairs for path in pair))}
    source = reaching_source(folder, sources)
    if source is not None:
        raise InputError(f"{folder} lies among the photographs ({source}): name another", argument="rectify_to")
    chains = lens_chains(rig)
    left, right = ({given[pair[side]] for pair in pairs} for side in (0, 1))
    taken = list(dict.fromkeys(given.values()))
    top = Path(os.path.commonpath([path.parent for path in taken]))
    eyes: dict[Path, Eye] = {
        path: "right" if path in right or (path not in left and is_right(path.relative_to(top))) else "left"
        for path in taken
    }
    raw = chains["left"].raw
    expected, sizes = Size(raw.width_px, raw.height_px), {path: Size(*stored_size(path)[::-1]) for path in taken}
    fitting = [path for path, size in sizes.items() if size == expected]
    if not fitting:
        others = ", ".join(map(str, sorted({*sizes.values()})[:_NAMED]))
        raise InputError(
            f"{rig.source}: the raw images have {expected}, but of {counted(len(taken), 'photograph')} none has that "
            f"size: they have {others}: give photographs as the cameras take them, or the scale if they are reduced"
        )
    written = {path: folder / path.relative_to(top).with_suffix(".png") for path in fitting}
    _check_files(written, folder)
    for path, file in written.items():
        image = read_image(path)
        if image.shape[:2] != (raw.height_px, raw.width_px):
            raise InputError(f"{path}: is turned by its EXIF orientation: expected the image as the sensor sees it")
        rectified = chains[eyes[path]].rectify(image)
        # Configs cut their patches from these files, and others' photographs may have the same names.
        if file.exists() and not np.array_equal(read_image(file), rectified):
            raise InputError(f"{folder} has a {file.name} with other pixels: name a new folder", argument="rectify_to")
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(RGB8.encode(rectified))
    rights = [path.relative_to(top).as_posix() for path in written if eyes[path] == "right"]
    named = f" ({abbreviate(rights, _NAMED)})" if rights else ""
    sides = f"{len(written) - len(rights)} of the left camera, {len(rights)} of the right one{named}"
    notes = [f"{counted(len(written), 'photograph')} rectified: {sides}"]
    missing = len(taken) - len(written)
    if missing:
        notes.append(f"{counted(missing, 'photograph')} left out, of another size than the raw images' {expected}")
    return {path: written[whole] for path, whole in given.items() if whole in written}, notes


def _whole(path: Path) -> Path:
    """Return a path from the root, without ``..``."""
    return Path(os.path.abspath(path))  # noqa: PTH100 - resolve() follows links, whose names may tell sides


def _check_files(written: Mapping[Path, Path], folder: Path) -> None:
    """Refuse two photographs for one file, and a folder with other images: they would become textures, too."""
    raw_by_file: dict[Path, Path] = {}
    for path, file in written.items():
        if raw_by_file.setdefault(file, path) != path:
            raise InputError(
                f"{path} and {raw_by_file[file]}: both would be rectified to {file}: expected names that differ in "
                "more than their endings"
            )
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: name a new folder", argument="rectify_to")
    found = find_files([folder], image_extensions()) if folder.exists() else []
    others = [path for path in found if path not in raw_by_file]
    if others:
        raise InputError(
            f"{folder} holds {counted(len(others), 'other image')}, such as {others[0].name}: name a new folder",
            argument="rectify_to",
        )
