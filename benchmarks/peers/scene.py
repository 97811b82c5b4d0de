"""The scene that every renderer renders: a textured cuboid with instances of six models, in new poses in each frame.

The camera's frame is x right, y down, z forward, metres, with the left eye at the origin. v points up (v = 0 is the
patch's bottom row), as in most renderers, and patches repeat. The scene's folder has everything that is rendered;
reading it needs only numpy.
"""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

# scikit-image's photographs, from which patches are cropped.
PHOTOGRAPHS = (
    "astronaut.png",
    "coffee.png",
    "chelsea.png",
    "rocket.jpg",
    "motorcycle_left.png",
    "hubble_deep_field.jpg",
    "retina.jpg",
    "ihc.png",
    "brick.png",
    "grass.png",
    "gravel.png",
    "color.png",
)
# Six of the project's models, simple and complex, with about 600 triangles on average.
LIBRARY_KINDS = ("cone", "cylinder", "chair", "stairs", "gear", "lamp")
# Half the width and half the height of the cuboid, and z of its back and front walls, m.
_HALF_WIDTH_M, _HALF_HEIGHT_M, _BACK_M, _FRONT_M = 4.0, 3.0, 15.0, -1.0
# Disparities of the nearest and farthest instances, px at full size.
_DISPARITIES_PX = 24.0, 170.0
_FULL_SIZE_FB = 300.0

# OpenGL's cameras look along -z, with y up.
OPENGL_FROM_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])
NEAR_M, FAR_M = 0.1, 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A triangle mesh.

    Attributes:
        positions: (V, 3) float32.
        uv: (V, 2) float32, v upwards.
        triangles: (T, 3) int32.
    """

    positions: np.ndarray
    uv: np.ndarray
    triangles: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class PeerScene:
    """F frames of one camera.

    Attributes:
        folder: the scene's folder.
        width_px: image width.
        height_px: image height; the principal point is the image's centre.
        focal_px: focal length.
        baseline_m: distance of the right eye.
        models: the models.
        walls: the six walls of the cuboid.
        model: (F, N) int32, indices of `models`.
        patch: (F, N) int32, the patch of each instance.
        camera_from_model: (F, N, 4, 4) float64.
        wall_patch: (F, 6) int32.
    """

    folder: Path
    width_px: int
    height_px: int
    focal_px: float
    baseline_m: float
    models: list[Model]
    walls: list[Model]
    model: np.ndarray
    patch: np.ndarray
    camera_from_model: np.ndarray
    wall_patch: np.ndarray

    @property
    def patches(self) -> list[Path]:
        """PNG files of the patches, square and RGB; `patch` has indices of this list."""
        return sorted((self.folder / "patches").iterdir())

    @property
    def focal_baseline(self) -> float:
        """Focal length times baseline, px m."""
        return self.focal_px * self.baseline_m


def library_meshes() -> dict[str, Model]:
    """Build `LIBRARY_KINDS`."""
    from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS  # noqa: PLC0415 - peers read scenes without the project

    meshes = {name: (SIMPLE_KINDS | COMPLEX_KINDS)[name](np.random.default_rng(0)) for name in LIBRARY_KINDS}
    return {name: Model(mesh.positions, mesh.uv, mesh.triangles.astype(np.int32)) for name, mesh in meshes.items()}


def make_scene(
    folder: Path,
    meshes: Mapping[str, Model],
    frames: int,
    *,
    size_px: tuple[int, int] = (1500, 1000),
    instances: int = 100,
    patches: int = 32,
    patch_px: int = 512,
) -> PeerScene:
    """Write the scene's folder; the same arguments give the same scene.

    Args:
        folder: the scene's folder, which is replaced.
        meshes: the models by name.
        frames: number of frames; a frame does not depend on it.
        size_px: width and height; the horizontal field of view is constant.
        instances: number of instances in each frame.
        patches: number of patches.
        patch_px: side of the patches.
    """
    rng = np.random.default_rng(7)
    shutil.rmtree(folder, ignore_errors=True)
    _make_patches(folder / "patches", patches, patch_px, rng)
    names = sorted(meshes)
    model, patch = np.zeros((2, frames, instances), np.int32)
    camera_from_model = np.tile(np.eye(4), (frames, instances, 1, 1))
    wall_patch = np.zeros((frames, 6), np.int32)
    for frame in range(frames):
        wall_patch[frame] = rng.integers(0, patches, 6)
        for number in range(instances):
            model[frame, number] = rng.integers(len(names))
            patch[frame, number] = rng.integers(patches)
            camera_from_model[frame, number] = _pose(rng)
    arrays = {"model": model, "patch": patch, "camera_from_model": camera_from_model, "wall_patch": wall_patch}
    for number, name in enumerate(names):
        mesh = meshes[name]
        arrays |= {
            f"positions_{number}": mesh.positions,
            f"uv_{number}": mesh.uv,
            f"triangles_{number}": mesh.triangles,
        }
    np.savez(folder / "scene.npz", camera=np.array([*size_px, size_px[0], 0.2]), models=len(names), **arrays)
    return load_scene(folder)


def load_scene(folder: Path) -> PeerScene:
    """Read the scene that `make_scene` made."""
    with np.load(folder / "scene.npz") as arrays:
        width_px, height_px, focal_px, baseline_m = arrays["camera"].tolist()
        return PeerScene(
            folder=folder,
            width_px=int(width_px),
            height_px=int(height_px),
            focal_px=focal_px,
            baseline_m=baseline_m,
            models=[
                Model(arrays[f"positions_{n}"], arrays[f"uv_{n}"], arrays[f"triangles_{n}"])
                for n in range(int(arrays["models"]))
            ],
            walls=_walls(),
            model=arrays["model"],
            patch=arrays["patch"],
            camera_from_model=arrays["camera_from_model"],
            wall_patch=arrays["wall_patch"],
        )


def _make_patches(folder: Path, count: int, side_px: int, rng: np.random.Generator) -> None:
    """Crop squares of random size out of the photographs, and resize them."""
    from PIL import Image  # noqa: PLC0415 - not every peer has it

    spec = find_spec("skimage")
    if spec is None or not spec.submodule_search_locations:
        raise SystemExit("the patches are cut from scikit-image's photographs: pip install scikit-image")
    data = Path(spec.submodule_search_locations[0]) / "data"
    folder.mkdir(parents=True)
    for number in range(count):
        with Image.open(data / PHOTOGRAPHS[number % len(PHOTOGRAPHS)]) as file:
            photograph = file.convert("RGB")
        side = int(min(photograph.size) * rng.uniform(0.6, 1))
        top, left = (int(rng.integers(0, length - side + 1)) for length in (photograph.height, photograph.width))
        crop = photograph.crop((left, top, left + side, top + side))
        crop.resize((side_px, side_px), Image.Resampling.LANCZOS).save(folder / f"{number:02d}.png")


def _pose(rng: np.random.Generator) -> np.ndarray:
    """Sample a pose (4, 4) in view of the left eye, with a different scale along each axis."""
    depth = _FULL_SIZE_FB / rng.uniform(*_DISPARITIES_PX)
    scale = depth * np.exp(rng.uniform(np.log(0.025), np.log(0.10)))
    depth = min(depth, _BACK_M - 0.7)
    pose = np.eye(4)
    x = np.clip(rng.uniform(-0.5, 0.5) * depth * 1.05, 0.6 - _HALF_WIDTH_M, _HALF_WIDTH_M - 0.6)
    y = np.clip(rng.uniform(-1 / 3, 1 / 3) * depth * 1.05, 0.6 - _HALF_HEIGHT_M, _HALF_HEIGHT_M - 0.6)
    pose[:3, 3] = x, y, depth
    q = rng.normal(size=4)
    w, i, j, k = q / np.linalg.norm(q)
    rotation = np.array(
        [
            [1 - 2 * (j * j + k * k), 2 * (i * j - k * w), 2 * (i * k + j * w)],
            [2 * (i * j + k * w), 1 - 2 * (i * i + k * k), 2 * (j * k - i * w)],
            [2 * (i * k - j * w), 2 * (j * k + i * w), 1 - 2 * (i * i + j * j)],
        ]
    )
    pose[:3, :3] = rotation * scale * rng.uniform(0.7, 1, 3)
    return pose


def _walls() -> list[Model]:
    """Make the walls of the cuboid; a patch repeats twice along each side."""
    w, h, back, front = _HALF_WIDTH_M, _HALF_HEIGHT_M, _BACK_M, _FRONT_M
    sides = (
        [(-w, -h, back), (w, -h, back), (w, h, back), (-w, h, back)],
        [(-w, -h, front), (w, -h, front), (w, h, front), (-w, h, front)],
        [(-w, -h, front), (-w, -h, back), (-w, h, back), (-w, h, front)],
        [(w, -h, front), (w, -h, back), (w, h, back), (w, h, front)],
        [(-w, -h, front), (w, -h, front), (w, -h, back), (-w, -h, back)],
        [(-w, h, front), (w, h, front), (w, h, back), (-w, h, back)],
    )
    uv = np.array([[0, 0], [2, 0], [2, 2], [0, 2]], np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return [Model(np.array(side, np.float32), uv, triangles) for side in sides]
