"""Samples a pair's scene again, and compares some of its pixels with float64 rays: the strongest check."""

from collections.abc import Callable, Mapping
from functools import partial
from math import degrees, radians

import numpy as np
from numpy.typing import NDArray

from semisynth_gl import oracle
from semisynth_gl.dataset.rebuild import RebuiltScenes
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import SKY
from semisynth_gl.judge.findings import Verdict
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.scene import Motion, Scene

Values = NDArray[np.float64]
Ints = NDArray[np.int64]
RayValues = Mapping[str, Values]
"""The values of R rays for a view's channels, (R, C) each: px, except for unit normals and the sky's mask."""

# Bounds; docs/verify.md has them. Errors at a pixel's centre: px, normals in radians, and the sky exactly.
_ERRORS = {"disparity": 1e-3, "normals": radians(0.01), "sky": 0.0}
_VECTOR_PX, _VECTOR_SHARE = 1e-3, 1e-5
# Rays may miss triangles that are seen edge-on: normals of so many pixels may be another triangle's.
_NORMALS_SHARE = 0.005
# Rasterisers move vertices by up to half a step of a grid, whose steps are 1/256 px at best and 1/16 px at worst. So a
# pixel beside an edge may show the surface on the edge's other side.
_EDGE_PX = 1 / 32
_STEPS = (-_EDGE_PX, -_EDGE_PX / 8, 0.0, _EDGE_PX / 8, _EDGE_PX)
_AROUND_X, _AROUND_Y = (steps.ravel() for steps in np.meshgrid(_STEPS, _STEPS))
# For each motion, the number of frames that it leads on, and the channels that it is compared with.
_MOTIONS = {"flow": (+1, ("flow", "disparity_change")), "flow_backward": (-1, ("flow_backward",))}


def check_rays(frame: StoredFrame, scenes: RebuiltScenes, pixels: int, verdict: Verdict) -> None:
    """Compare a pair's truth with rays through random pixels, half of them in each view with a disparity."""
    sampled = scenes.sampled(frame)
    if sampled is None:
        verdict.add("oracle", "config and seed of the index give a scene that differs from the pair's provenance")
        return
    motions = {
        name: sampled.motion(frames)
        for name, (frames, channels) in _MOTIONS.items()
        if any(channel in frame.view(eye) for channel in channels for eye in EYES)
    }
    rng = np.random.default_rng((scenes.seed, frame.index))
    for eye in EYES:
        if "disparity" not in frame.view(eye):
            continue
        height, width = frame.view(eye)["disparity"].shape
        row, column = (rng.integers(0, side, -(-pixels // 2)) for side in (height, width))
        _check_view(frame, eye, partial(_cast, frame, eye, sampled.scene, scenes, motions), row, column, verdict)


def _check_view(
    frame: StoredFrame, eye: Eye, cast: Callable[[Values, Values], RayValues], row: Ints, column: Ints, verdict: Verdict
) -> None:
    """Compare a view's arrays with rays through R pixels; the measures are the largest errors of right pixels."""
    view = frame.view(eye)
    x, y = column.astype(np.float64), row.astype(np.float64)
    rays, border = cast(x, y), frame.left_out(eye)[row, column]
    stored = {name: view[name][row, column].reshape(len(x), -1).astype(np.float64) for name in rays if name in view}
    bounds = {name: _bounds(frame, name, values) for name, values in stored.items()}
    wrong = {}
    for name, values in stored.items():
        with np.errstate(invalid="ignore"):
            # inf agrees with inf.
            differences = np.where(values == rays[name], 0.0, np.abs(values - rays[name]))
        # The chord of a small angle is the angle in radians; its cosine would round to 1.
        error = np.linalg.norm(differences, axis=1) if name == "normals" else differences.max(axis=1)
        # Borders of a lens may lack values. A change of disparity may lie in a border at the next frame, too: there,
        # `single_view` judges what is missing.
        in_border = border | (name == "disparity_change" and not frame.border_disparity)
        lacking = in_border & np.isposinf(values).all(axis=1)
        wrong[name] = ~lacking & ~(error <= bounds[name])
        unit, scale = ("deg", degrees(1)) if name == "normals" else ("px", 1.0)
        largest = scale * float(error[~wrong[name] & ~lacking].max(initial=0.0))
        verdict.keep_largest(f"oracle_{name}_largest_{unit}", largest)
    suspect = np.flatnonzero(np.logical_or.reduce(list(wrong.values())))
    if not suspect.size:
        return
    around = cast(np.add.outer(x[suspect], _AROUND_X).ravel(), np.add.outer(y[suspect], _AROUND_Y).ravel())
    for name, values in stored.items():
        beside, bound = around[name].reshape(len(suspect), len(_AROUND_X), -1), bounds[name][suspect, None]
        low, high = beside.min(axis=1) - bound, beside.max(axis=1) + bound
        wrong[name][suspect] &= ~((low <= values[suspect]) & (values[suspect] <= high)).all(axis=1)
        number = int(wrong[name].sum())
        if number > (_NORMALS_SHARE * len(x) if name == "normals" else 0):
            first = np.argmax(wrong[name])
            where = f"the first at ({column[first]}, {row[first]})"
            verdict.add("oracle", f"{name}_{eye}: {number} of {len(x)} pixels differ from their rays, {where}")


def _cast(
    frame: StoredFrame,
    eye: Eye,
    scene: Scene,
    scenes: RebuiltScenes,
    motions: Mapping[str, Motion],
    x: Values,
    y: Values,
) -> RayValues:
    """Return the values of rays through R points (x, y); inf where the encoding cannot hold them."""
    view, encodings = frame.view(eye), frame.encodings
    hits = cast_rays(scene, scenes.models, eye, x, y)
    vectors = oracle.correspondence_px(scene.camera, eye, x, y, hits, signed=encodings.signed)
    disparity = oracle.disparity_of(eye, vectors)[:, None]
    disparity[np.abs(disparity) > encodings.disparity.limit_px] = np.inf
    values = {"disparity": disparity, "correspondence": vectors}
    if "normals" in view:
        values["normals"] = oracle.normals(scene, scenes.models, eye, hits)
    if "sky" in view:
        values["sky"] = np.where(np.isin(hits.instance, np.flatnonzero(scene.sky)), float(SKY), 0.0)[:, None]
    for name, motion in motions.items():
        flows = oracle.flow(scene, scenes.models, motion, eye, x, y, hits, signed=encodings.signed)
        beyond = (np.abs(flows.flow_px) > encodings.flow.limit_px).any(axis=1, keepdims=True)
        values[name] = np.where(beyond, np.inf, flows.flow_px)
        if name == "flow":
            change = flows.disparity_change_px[:, None]
            values["disparity_change"] = np.where(np.isinf(disparity), np.inf, change)
    return values


def _bounds(frame: StoredFrame, channel: str, stored: Values) -> Values:
    """Return the largest errors, (R,) px (for normals radians), that stored values (R, C) of a channel may have."""
    bound = np.full(len(stored), _ERRORS.get(channel, _VECTOR_PX))
    if channel == "disparity":
        bound += frame.rounding_px(stored[:, 0])
    elif channel not in _ERRORS:
        bound += _VECTOR_SHARE * np.linalg.norm(np.where(np.isfinite(stored), stored, 0.0), axis=1)
        bound += frame.encodings.flow.error_px if channel.startswith("flow") else 0.0
    return bound
