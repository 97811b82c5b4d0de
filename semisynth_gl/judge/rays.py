"""Rebuilds a pair's scene, and compares random pixels with float64 rays, which is the strictest check."""

from collections.abc import Mapping
from math import degrees, radians

import numpy as np
from numpy.typing import NDArray

from semisynth_gl import oracle
from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.dataset.rebuild import RebuiltScenes
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import SKY
from semisynth_gl.judge.findings import CheckResults
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import Scene, SceneMotion

Values = NDArray[np.float64]

# Maximum errors at a pixel's centre, which docs/verify.md lists: px, radians for normals, mask levels for the sky.
_ERRORS = {"disparity": 1e-3, "normals": radians(0.01), "sky": 0.0}
# All other channels are vectors; their maximum error is a number of px plus a share of the vector's length.
_VECTOR_PX, _VECTOR_SHARE = 1e-3, 1e-5
# This share of the normals may be wrong: rays miss some triangles seen edge-on, and hit their neighbours.
_NORMALS_SHARE = 0.005
# Rasterisers round vertices to steps of 1/256 px at best and 1/16 px at worst, and so move edges by up to half a step.
# A pixel this near to an edge may show the surface on the other side.
_EDGE_PX = 1 / 32
_STEPS = (-_EDGE_PX, -_EDGE_PX / 8, 0.0, _EDGE_PX / 8, _EDGE_PX)
_AROUND_X, _AROUND_Y = (steps.ravel() for steps in np.meshgrid(_STEPS, _STEPS))
# For each motion: the number of frames to its target moment, and the channels that it checks.
_MOTIONS = {"flow": (+1, ("flow", "disparity_change")), "flow_backward": (-1, ("flow_backward",))}
# Unit of a channel's largest error in the results, and factor to this unit; all other channels have px.
_UNITS = {"normals": ("deg", degrees(1)), "sky": ("levels", 1.0)}


def check_rays(frame: StoredFrame, scenes: RebuiltScenes, pixels: int, results: CheckResults) -> None:
    """Compare a pair's truth with rays through random pixels, ``pixels`` / 2 in each view that has a disparity."""
    sampled = scenes.sampled(frame)
    if sampled is None:
        results.add("oracle", "config and seed of the index give a scene that differs from the pair's provenance")
        return
    motions = {
        name: sampled.motion(frames)
        for name, (frames, channels) in _MOTIONS.items()
        if any(channel in frame.view(eye) for channel in channels for eye in EYES)
    }
    rng = np.random.default_rng((scenes.seed, frame.index))
    for eye in EYES:
        if "disparity" in frame.view(eye):
            height, width = frame.view(eye)["disparity"].shape
            row, column = (rng.integers(0, side, -(-pixels // 2)) for side in (height, width))
            _RayCheck(frame, eye, sampled.scene, scenes, motions).check(row, column, results)


class _RayCheck:
    """Compares one view of a pair with rays through its rebuilt scene.

    Flow is compared with the paths of the points that the rays hit; ``motions`` move these points.
    """

    def __init__(
        self, frame: StoredFrame, eye: Eye, scene: Scene, scenes: RebuiltScenes, motions: Mapping[str, SceneMotion]
    ) -> None:
        self.frame, self.eye, self.scene, self.models, self.motions = frame, eye, scene, scenes.models, motions

    def check(self, row: NDArray[np.int64], column: NDArray[np.int64], results: CheckResults) -> None:
        """Compare the view with rays through R pixels, and record the largest error of the pixels that agree."""
        view = self.frame.view(self.eye)
        x, y = column.astype(np.float64), row.astype(np.float64)
        rays, border = self.cast(x, y), self.frame.cut_border(self.eye)[row, column]
        stored = {name: view[name][row, column].reshape(len(x), -1).astype(np.float64) for name in rays if name in view}
        bounds = {name: self.bounds(name, values) for name, values in stored.items()}
        wrong = {}
        for name, values in stored.items():
            with np.errstate(invalid="ignore"):
                # Where both are inf, they agree.
                differences = np.where(values == rays[name], 0.0, np.abs(values - rays[name]))
            # The distance of two unit vectors is their small angle in radians; the cosine would round to 1.
            error = np.linalg.norm(differences, axis=1) if name == "normals" else differences.max(axis=1)
            # Rectification leaves a border that the sensor did not see: pixels there may lack a value. Any pixel may
            # lack a disparity change, since its point may be in the border at the next frame.
            may_lack = border | (name == "disparity_change" and not self.frame.border_disparity)
            lacks = may_lack & np.isposinf(values).all(axis=1)
            wrong[name] = ~lacks & ~(error <= bounds[name])
            unit, scale = _UNITS.get(name, ("px", 1.0))
            largest = scale * float(error[~wrong[name] & ~lacks].max(initial=0.0))
            measure = f"oracle_{name}_largest_{unit}"
            results.measures[measure] = max(largest, results.measures.get(measure, 0.0))
        suspect = np.flatnonzero(np.logical_or.reduce(list(wrong.values())))
        if not suspect.size:
            return
        # A suspect pixel is right if its value lies in the range of the 25 rays around its centre.
        around = self.cast(np.add.outer(x[suspect], _AROUND_X).ravel(), np.add.outer(y[suspect], _AROUND_Y).ravel())
        for name, values in stored.items():
            values_around = around[name].reshape(len(suspect), len(_AROUND_X), -1)
            bound = bounds[name][suspect, None]
            low, high = values_around.min(axis=1) - bound, values_around.max(axis=1) + bound
            in_range = ((low <= values[suspect]) & (values[suspect] <= high)).all(axis=1)
            wrong[name][suspect] &= ~in_range
            number = int(wrong[name].sum())
            allowed = _NORMALS_SHARE * len(x) if name == "normals" else 0
            if number > allowed:
                first = np.argmax(wrong[name])
                where = f"the first at ({column[first]}, {row[first]})"
                results.add("oracle", f"{name}_{self.eye}: {number} of {len(x)} pixels differ from their rays, {where}")

    def cast(self, x: Values, y: Values) -> dict[str, Values]:
        """Return each channel's values (R, C) at R points (x, y) by rays: px, unit normals, the sky's mask.

        As in stored arrays, inf means no value: the ray hits nothing, the disparity or the flow is not valid, or the
        encoding cannot hold it.
        """
        scene, eye, encodings = self.scene, self.eye, self.frame.encodings
        hits = cast_rays(scene, self.models, eye, x, y)
        vectors = oracle.correspondence_px(scene.camera, eye, x, y, hits, signed=encodings.signed)
        disparity = oracle.disparity_of(eye, vectors)[:, None]
        disparity[np.abs(disparity) > encodings.disparity.limit_px] = np.inf
        sky = np.where(np.isin(hits.instance, np.flatnonzero(scene.sky)), float(SKY), 0.0)[:, None]
        values = {"disparity": disparity, "correspondence": vectors, "sky": sky}
        if "normals" in self.frame.view(eye):
            values["normals"] = oracle.normals(scene, self.models, eye, hits)
        for name, motion in self.motions.items():
            flow, change, _ = oracle.flow(scene, self.models, motion, eye, x, y, hits, signed=encodings.signed)
            beyond = (np.abs(flow) > encodings.flow.limit_px).any(axis=1, keepdims=True)
            values[name] = np.where(beyond, np.inf, flow)
            if name == "flow":
                values["disparity_change"] = np.where(np.isinf(disparity), np.inf, change[:, None])
        return values

    def bounds(self, channel: str, stored: Values) -> Values:
        """Return the largest errors (R,) that stored values (R, C) may have: px, radians for normals, mask levels."""
        bound = np.full(len(stored), _ERRORS.get(channel, _VECTOR_PX))
        if channel == "disparity":
            bound += self.frame.rounding_px(stored[:, 0])
        elif channel not in _ERRORS:
            bound += _VECTOR_SHARE * np.linalg.norm(np.where(np.isfinite(stored), stored, 0.0), axis=1)
            bound += self.frame.encodings.flow.error_px if channel.startswith("flow") else 0.0
        return bound
