"""A dataset in the layout of Middlebury's evaluation set, scene by scene."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.encodings import DISPARITY_ENCODINGS, IMAGE_ENCODINGS, Encodings
from semisynth_gl.errors import InputError
from semisynth_gl.read.calib import Calibration, read_calib
from semisynth_gl.read.encodings import DISPARITY_DECODERS, IMAGE_DECODERS, read_with
from semisynth_gl.read.error import ReadError, read_bytes
from semisynth_gl.read.pfm import read_pfm
from semisynth_gl.read.png import read_grey, read_grey16

INDEX = "dataset.json"
SCENES = "MiddEval3/trainingF"
SCENE_LIST = "MiddEval3/official_train.txt"


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that holds one object.

    Raises:
        ReadError: where it is missing or holds something else.
    """
    try:
        values = json.loads(read_bytes(path))
    except ValueError as error:
        raise ReadError(path, f"is not JSON: {error}") from None
    if not isinstance(values, dict):
        raise ReadError(path, f"expected a JSON object, got {type(values).__name__}")
    return values


Readers = dict[str, Callable[[Path], Any]]

DEFAULT = Encodings()

OPTIONAL: dict[str, Readers] = {
    "visibility": {"mask0nocc.png": read_grey, "mask1nocc.png": read_grey},
    "instances": {"inst0.png": read_grey16, "inst1.png": read_grey16},
    "depth": {"depth0.pfm": read_pfm, "depth1.pfm": read_pfm},
}
"""Files that a scene has where the config's ``outputs`` name them."""


def required(encodings: Encodings) -> Readers:
    """Name the files that every scene has, and what reads them."""
    return {
        **dict.fromkeys(encodings.image_names, read_with(IMAGE_DECODERS[encodings.image])),
        encodings.disparity_names[0]: read_with(DISPARITY_DECODERS[encodings.disparity].decode),
        "calib.txt": read_calib,
        "pair.json": read_json,
    }


def of_right_view(encodings: Encodings) -> Readers:
    """Name the files that a scene lacks where the config's ``truth`` is of the left view alone."""
    return {
        encodings.disparity_names[1]: read_with(DISPARITY_DECODERS[encodings.disparity].decode),
        **{name: reader for files in OPTIONAL.values() for name, reader in files.items() if "1" in name},
    }


@dataclass(frozen=True, slots=True)
class Index:
    """A dataset's folder and what its dataset.json says.

    Attributes:
        path: the folder.
        values: the whole of dataset.json; empty where it could not be read.
        scenes: names of the scenes, from dataset.json, else from the folders that are there.
        fault: why dataset.json could not be read, or None.
        encodings: of images and disparities, as the config has them.
    """

    path: Path
    values: dict[str, Any]
    scenes: tuple[str, ...]
    fault: str | None = None
    encodings: Encodings = DEFAULT

    @property
    def config(self) -> dict[str, Any]:
        """The config's values, as JSON has them; empty where the index has none."""
        values = self.values.get("config_values")
        return values if isinstance(values, dict) else {}

    @property
    def outputs(self) -> tuple[str, ...] | None:
        """What the config names in ``outputs``; None for datasets older than that key."""
        outputs = self.config.get("outputs")
        return tuple(str(output) for output in outputs) if isinstance(outputs, list) else None

    @property
    def left_alone(self) -> bool:
        """Whether the config asks for the left view's truth alone."""
        return self.config.get("truth") == "left"

    @property
    def imperfect(self) -> bool:
        """Whether the config puts imperfections of a rig on the images, differently in each view."""
        section = self.config.get("imperfections")
        neutral = {"gamma": 1.0}
        return isinstance(section, dict) and any(
            end != neutral.get(key, 0.0)
            for key, ends in section.items()
            for end in (ends if isinstance(ends, list) else [ends])
        )

    def number(self, section: str, key: str) -> float | None:
        """Return a number of the config, or None where it has none there."""
        keys = self.config.get(section)
        value = keys.get(key) if isinstance(keys, dict) else None
        return value if isinstance(value, int | float) else None

    def scene_path(self, scene: str) -> Path:
        """Return the folder of a scene."""
        return self.path / SCENES / scene


def read_index(path: Path) -> Index:
    """Open a dataset.

    A folder with scenes and without a readable dataset.json is opened all the same, with a `fault`.

    Raises:
        InputError: where there is no dataset at the path, or one in another layout or encoding.
    """
    if not path.is_dir():
        raise InputError(f"{path}: {'expected a folder, got a file' if path.exists() else 'there is no such folder'}")
    held = sorted(entry.name for entry in (path / SCENES).iterdir()) if (path / SCENES).is_dir() else []
    if not (path / INDEX).exists() and not held:
        raise InputError(f"{path}: not a dataset: neither {INDEX} nor scenes in {SCENES}")
    try:
        values = read_json(path / INDEX)
    except ReadError as error:
        return Index(path, {}, tuple(held), f"{INDEX} {error.reason}")
    if values.get("layout") != "middlebury":
        raise InputError(f"{path}: expected the layout middlebury, got {values.get('layout')!r} in {INDEX}")
    encodings = _encodings(path, values.get("config_values"))
    scenes = values.get("scenes")
    if not (isinstance(scenes, list) and all(isinstance(scene, str) and "/" not in scene for scene in scenes)):
        return Index(path, values, tuple(held), f"{INDEX} has no list of scenes", encodings)
    return Index(path, values, tuple(scenes), encodings=encodings)


def _encodings(path: Path, config: object) -> Encodings:
    """Take the encodings from the config's values; the default for datasets older than that section."""
    files = config.get("files") if isinstance(config, dict) else None
    if not isinstance(files, dict):
        return DEFAULT
    image, disparity = files.get("image", DEFAULT.image), files.get("disparity", DEFAULT.disparity)
    if image not in IMAGE_ENCODINGS or disparity not in DISPARITY_ENCODINGS:
        raise InputError(
            f"{path}: expected images in {', '.join(IMAGE_ENCODINGS)} and disparities in "
            f"{', '.join(DISPARITY_ENCODINGS)}, {INDEX} names {image} and {disparity}"
        )
    return Encodings(image, disparity)


@dataclass(frozen=True, slots=True, eq=False)
class SceneFiles:
    """One scene as arrays, H x W as its files have them (nothing here says that they agree).

    Attributes:
        calibration: calib.txt.
        pair: pair.json.
        left: (H, W, 3) uint8.
        right: (H, W, 3) uint8.
        disparity_left: (H, W) float32, px; inf where invalid.
        disparity_right: (H, W) float32, px, in the right view's pixels, or None.
        optional: arrays of the optional files that are there, by file name.
        encodings: of images and disparities.
    """

    calibration: Calibration
    pair: dict[str, Any]
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    disparity_left: NDArray[np.float32]
    disparity_right: NDArray[np.float32] | None
    optional: dict[str, NDArray[Any]] = field(default_factory=dict)
    encodings: Encodings = DEFAULT

    def rounding_px(self, disparity: NDArray[np.floating[Any]] | float) -> NDArray[np.float64]:
        """Return the most that the encoding puts disparities off by: 0 for those that are lossless."""
        error = DISPARITY_DECODERS[self.encodings.disparity].error_px
        # What would round to 0, which says that there is none, is raised to the smallest step.
        return np.where(np.asarray(disparity) <= 2 * error, 2 * error, error)

    @property
    def disparity_largest_px(self) -> float:
        """The largest disparity that the encoding can say."""
        return DISPARITY_DECODERS[self.encodings.disparity].largest_px


def read_scene_files(folder: Path, encodings: Encodings = DEFAULT) -> tuple[SceneFiles | None, list[ReadError]]:
    """Read what can be read of a scene.

    Args:
        folder: the scene's.
        encodings: `Index.encodings`.

    Returns:
        The scene, or None where a file that every scene has cannot be read; and a fault for each such file.

    Raises:
        InputError: where an encoding needs what is not installed.
    """
    needed = required(encodings)
    optional = of_right_view(encodings) | {
        name: reader for files in OPTIONAL.values() for name, reader in files.items()
    }
    readers = needed | {name: reader for name, reader in optional.items() if (folder / name).exists()}
    values: dict[str, Any] = {}
    faults: list[ReadError] = []
    for name, reader in readers.items():
        try:
            values[name] = reader(folder / name)
        except ReadError as error:
            faults.append(error)
    if not needed.keys() <= values.keys():
        return None, faults
    (left, right), (disparity_left, disparity_right) = encodings.image_names, encodings.disparity_names
    scene = SceneFiles(
        calibration=values["calib.txt"],
        pair=values["pair.json"],
        left=values[left],
        right=values[right],
        disparity_left=values[disparity_left],
        disparity_right=values.pop(disparity_right, None),
        optional={name: value for name, value in values.items() if name not in needed},
        encodings=encodings,
    )
    return scene, faults


def read_scene(folder: Path, encodings: Encodings = DEFAULT) -> SceneFiles:
    """Read one scene; see `read_scene_files`.

    Raises:
        ReadError: where a file is missing or cannot be read.
        InputError: where an encoding needs what is not installed.
    """
    scene, faults = read_scene_files(folder, encodings)
    if faults or scene is None:
        raise faults[0]
    return scene
