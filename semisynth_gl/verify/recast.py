"""The strongest check: make a pair's scene again, and cast float64 rays at some of its pixels."""

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from semisynth_gl import oracle
from semisynth_gl.camera import EYES, Eye
from semisynth_gl.config import Config
from semisynth_gl.errors import InputError
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.read.middlebury import Index, SceneFiles
from semisynth_gl.scene.sampler import SceneSampler
from semisynth_gl.scene.scene import Scene
from semisynth_gl.textures.atlas import Patch
from semisynth_gl.verify.finding import Verdict

# What the renderer promises for disparity at a pixel's centre.
_ERROR_PX = 1e-3
# Rasterisers move vertices to a grid of 1/256 px at best, of 1/16 px at worst: beside an edge they may see the
# surface on its other side.
_EDGE_PX = 1 / 32


class Recaster:
    """Makes the scenes of a dataset again. Photographs are not needed: patches colour a scene and do not shape it.

    Args:
        index: the dataset.

    Raises:
        InputError: where its config, seed or patches are not this version's, or its models are not there.
    """

    def __init__(self, index: Index) -> None:
        values = index.values
        try:
            config = Config.model_validate(index.config)
            patches = tuple(Patch(**patch) for patch in values["patches"])
            self._seed = int(values["seed"])
        except (ValidationError, KeyError, TypeError, ValueError) as error:
            reason = str(error).splitlines()[0] if values else "it is missing or empty"
            raise InputError(
                f"{index.path}: for --oracle the scenes cannot be made again from dataset.json: {reason}. "
                "Verify without --oracle to see what is wrong with the dataset"
            ) from None
        if not patches or self._seed < 0:
            raise InputError(
                f"{index.path}: the scenes cannot be made again from dataset.json: expected patches and a seed of 0 or "
                f"more, got {len(patches)} and {self._seed}"
            )
        self._sampler = SceneSampler(config, self._seed, build_library(config.models, self._seed), patches)

    def check(self, scene: SceneFiles, pair: int, pixels: int, verdict: Verdict) -> None:
        """Compare both disparities with rays through randomly chosen pixels.

        Args:
            scene: the files.
            pair: the pair's number.
            pixels: how many, half of them in each view.
            verdict: takes findings and measures.
        """
        # A sequence whose first frame failed the config's checks was drawn again, once for each entry.
        redrawn = scene.pair.get("redrawn")
        made = self._sampler.sample(pair, len(redrawn) if isinstance(redrawn, list) else 0).scene
        recorded = scene.pair.get("camera")
        names = made.camera.__slots__
        if not isinstance(recorded, dict) or any(recorded.get(name) != getattr(made.camera, name) for name in names):
            verdict.add("oracle", "config and seed of dataset.json give another camera than pair.json has")
            return
        rng = np.random.default_rng((self._seed, pair))
        errors = []
        for eye, disparity in zip(EYES, (scene.disparity_left, scene.disparity_right), strict=True):
            if disparity is None:
                continue
            height, width = disparity.shape
            x = rng.integers(0, width, -(-pixels // 2)).astype(np.float64)
            y = rng.integers(0, height, -(-pixels // 2)).astype(np.float64)
            came = disparity[y.astype(np.int64), x.astype(np.int64)].astype(np.float64)
            bound = _ERROR_PX + scene.rounding_px(came)
            expected = _as_said(self._cast(made, eye, x, y), came, scene.disparity_largest_px)
            error = _difference(came, expected)
            off = np.flatnonzero(~(error <= bound))
            errors.append(error[error <= bound])
            if off.size:
                off = off[~self._is_edge(made, eye, x[off], y[off], came[off], scene)]
            if off.size:
                first = off[0]
                verdict.add(
                    "oracle",
                    f"{eye}: {off.size} of {len(x)} pixels are off by more than {bound[first]:.3g} px; at "
                    f"({x[first]:.0f}, {y[first]:.0f}) the ray finds {expected[first]:.6g} px, "
                    f"the file has {came[first]:.6g} px",
                )
        verdict.measures["oracle_largest_px"] = float(np.concatenate(errors).max(initial=0.0))

    def _cast(self, scene: Scene, eye: Eye, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return oracle.disparity_px(scene.camera, oracle.cast(scene, self._sampler.models, eye, x, y))

    def _is_edge(
        self,
        scene: Scene,
        eye: Eye,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        came: NDArray[np.float64],
        files: SceneFiles,
    ) -> NDArray[np.bool_]:
        """Whether rays within `_EDGE_PX` of each pixel's centre find disparities about what the file has there."""
        steps = np.array([-_EDGE_PX, -_EDGE_PX / 8, 0.0, _EDGE_PX / 8, _EDGE_PX])
        dx, dy = np.meshgrid(steps, steps)
        # All rays in one call: its cost is the number of instances more than the number of rays.
        near = self._cast(scene, eye, np.add.outer(x, dx.ravel()).ravel(), np.add.outer(y, dy.ravel()).ravel())
        near = _as_said(near.reshape(len(x), -1), came[:, None], files.disparity_largest_px)
        bound = _ERROR_PX + files.rounding_px(came)
        return np.asarray((near.min(axis=1) - bound <= came) & (came <= near.max(axis=1) + bound))


def _as_said(expected: NDArray[np.float64], came: NDArray[np.float64], largest_px: float) -> NDArray[np.float64]:
    """Make inf what a file's encoding cannot say, where the file has inf."""
    return np.where((expected > largest_px) & np.isinf(came), np.inf, expected)


def _difference(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Absolute difference; 0 where both are inf, inf where one is."""
    with np.errstate(invalid="ignore"):
        difference: NDArray[np.float64] = np.where(one == other, 0.0, np.abs(one - other))
    return difference
