"""The strongest check: sample a pair's scene again, and compare some of its pixels with float64 rays."""

from collections.abc import Iterable, Mapping
from math import degrees

import numpy as np
from numpy.typing import NDArray

from semisynth_gl import oracle
from semisynth_gl.dataset.reader import StoredIndex
from semisynth_gl.dataset.rebuild import RebuiltScenes
from semisynth_gl.dataset.sample import StoredFrame
from semisynth_gl.frame.camera import EYES, Eye
from semisynth_gl.frame.channels import SKY
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.judge.findings import Verdict, format_vector
from semisynth_gl.judge.flow import OPPOSITE, flow_bound_px
from semisynth_gl.judge.lens import find_lost_change
from semisynth_gl.scene.raycast import cast_rays
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.scene import Motion
from semisynth_gl.seeds.splits import SplitName

Values = NDArray[np.float64]
RayValues = Mapping[str, Values]
"""The values of R rays for a view's channels, (R, C) each: px, except for unit normals and the sky's mask."""

# Largest error of disparity at a pixel's centre that the renderer promises.
_ERROR_PX = 1e-3
_NORMALS_DEG = 0.01
# Rasterisers move vertices to a grid of 1/256 px at best and 1/16 px at worst, so a pixel beside an edge may show the
# surface on the edge's other side.
_EDGE_PX = 1 / 32
# The 25 rays around a pixel's centre, as steps to the right and down.
_STEPS = (-_EDGE_PX, -_EDGE_PX / 8, 0.0, _EDGE_PX / 8, _EDGE_PX)
_AROUND = tuple(steps.ravel() for steps in np.meshgrid(_STEPS, _STEPS))
_MEASURES = {
    "disparity": "oracle_largest_px",
    "correspondence": "oracle_correspondence_largest_px",
    "normals": "oracle_normals_largest_deg",
    "flow": "oracle_flow_largest_px",
    "flow_backward": "oracle_flow_largest_px",
    "disparity_change": "oracle_change_largest_px",
}
# Channels that are not in px: the factor to the shown unit, the unit, and the text after a value.
_SCALES = {"normals": (degrees(1), "degrees", ""), "sky": (1.0, "", "")}
# For each motion, the number of frames that it leads on, and the channels that it is compared with.
_MOTIONS = {"flow": (+1, ("flow", "disparity_change")), "flow_backward": (-1, ("flow_backward",))}


class RayJudge:
    """Judges the pairs of a split by float64 rays through ``pixels`` pixels of each.

    The constructor raises InputError where the scenes cannot be sampled again.
    """

    def __init__(self, index: StoredIndex, split: SplitName, pixels: int) -> None:
        self._pixels = pixels
        try:
            self._scenes = RebuiltScenes(index, split)
        except InputError as error:
            raise InputError(
                f"{error}. Rays need the scenes; verify without them to see what else is wrong with the dataset"
            ) from None

    def check(self, frame: StoredFrame, verdict: Verdict) -> None:
        """Compare a pair's truth with rays through random pixels, half of them in each view with a disparity."""
        sampled = self._scenes.sampled(frame)
        if sampled is None:
            verdict.add("oracle", "config and seed of the index give a scene that differs from the pair's provenance")
            return
        motions = {
            name: sampled.motion(frames)
            for name, (frames, channels) in _MOTIONS.items()
            if any(channel in frame.view(eye) for channel in channels for eye in EYES)
        }
        rng = np.random.default_rng((self._scenes.seed, frame.index))
        for eye in EYES:
            if "disparity" not in frame.view(eye):
                continue
            height, width = frame.view(eye)["disparity"].shape
            x = rng.integers(0, width, -(-self._pixels // 2)).astype(np.float64)
            y = rng.integers(0, height, -(-self._pixels // 2)).astype(np.float64)
            self._check_view(sampled, frame, eye, motions, x, y, verdict)

    def _check_view(
        self,
        sampled: SampledScene,
        frame: StoredFrame,
        eye: Eye,
        motions: Mapping[str, Motion],
        x: Values,
        y: Values,
        verdict: Verdict,
    ) -> None:
        """Compare a view's arrays with rays through pixels (x, y); the measures are the largest allowed errors."""
        rays = self._cast(sampled, eye, frame, motions, x, y)
        at = y.astype(np.int64), x.astype(np.int64)
        left_out, lost_change = frame.left_out(eye), find_lost_change(frame, eye)[1]
        for channel, expected in rays.items():
            array = frame.view(eye).get(channel)
            if array is None:
                continue
            stored = array[at].reshape(len(x), -1).astype(np.float64)
            bound = _bound(frame, channel, stored)
            encodable = _encodable(frame, channel, rays, stored)
            with np.errstate(invalid="ignore"):
                # inf agrees with inf.
                errors = np.where(stored == encodable, 0.0, np.abs(stored - encodable))
            # The chord of a small angle is the angle in radians; its cosine would round to 1.
            error = np.linalg.norm(errors, axis=1) if channel == "normals" else errors.max(axis=1)
            may_lack = (lost_change if channel == "disparity_change" else left_out)[at]
            error[may_lack & np.isposinf(stored).all(axis=1)] = 0
            scale, unit, suffix = _SCALES.get(channel, (1.0, "px", " px"))
            if channel in _MEASURES:
                measure, largest = _MEASURES[channel], float(error[error <= bound].max(initial=0.0))
                verdict.measures[measure] = max(verdict.measures.get(measure, 0.0), scale * largest)
            wrong = np.flatnonzero(~(error <= bound))
            if wrong.size:
                needed = {name: motion for name, motion in motions.items() if channel in _MOTIONS[name][1]}
                around = (
                    np.add.outer(centre[wrong], step).ravel() for centre, step in zip((x, y), _AROUND, strict=True)
                )
                cast = self._cast(sampled, eye, frame, needed, *around)
                wrong = wrong[~_is_edge(frame, channel, cast, stored[wrong], bound[wrong])]
            if wrong.size and channel == "normals":
                beside = oracle.normals_beside(sampled.scene, self._scenes.models, eye, x[wrong], y[wrong], _EDGE_PX)
                wrong = wrong[~_is_beside(beside, stored[wrong], bound[wrong])]
            if wrong.size:
                first = wrong[0]
                off = (
                    f"off by more than {scale * bound[first]:.3g} {unit}" if bound[first] else "not what the rays meet"
                )
                verdict.add(
                    "oracle",
                    f"{channel}_{eye}: {wrong.size} of {len(x)} pixels are {off}; "
                    f"at ({x[first]:.0f}, {y[first]:.0f}) the ray gives {format_vector(expected[first])}{suffix}, "
                    f"the file has {format_vector(stored[first])}{suffix}",
                )

    def _cast(
        self, sampled: SampledScene, eye: Eye, frame: StoredFrame, motions: Mapping[str, Motion], x: Values, y: Values
    ) -> dict[str, Values]:
        """Return the values of rays through points (x, y), with flow for the given motions."""
        scene, models = sampled.scene, self._scenes.models
        view, signed = frame.view(eye), frame.encodings.signed
        hits = cast_rays(scene, models, eye, x, y)
        way = oracle.correspondence_px(scene.camera, eye, x, y, hits, signed=signed)
        values = {"disparity": oracle.disparity_of(eye, way)[:, None]}
        if "correspondence" in view:
            values["correspondence"] = way
        if "normals" in view:
            values["normals"] = oracle.normals(scene, models, eye, hits)
        if "sky" in view:
            values["sky"] = np.where(np.isin(hits.instance, np.flatnonzero(scene.sky)), float(SKY), 0.0)[:, None]
        for name, motion in motions.items():
            flows = oracle.flow(scene, models, motion, eye, x, y, hits, signed=signed)
            values[name] = flows.flow_px
            if name == "flow":
                values["disparity_change"] = flows.disparity_change_px[:, None]
        return values


def _bound(frame: StoredFrame, channel: str, stored: Values) -> Values:
    """Return the largest errors, (R,) px (for normals radians), that stored values (R, C) of a channel may have."""
    if channel == "sky":
        return np.zeros(len(stored))
    if channel == "normals":
        return np.full(len(stored), np.deg2rad(_NORMALS_DEG))
    if channel == "disparity":
        return _ERROR_PX + frame.rounding_px(stored[:, 0])
    known = np.where(np.isfinite(stored), stored, 0.0)
    return flow_bound_px(known, 0.0 if channel == "disparity_change" else frame.encodings.flow.error_px)


def _is_edge(frame: StoredFrame, channel: str, around: RayValues, stored: Values, bound: Values) -> NDArray[np.bool_]:
    """Return where stored values (R, C) lie in the range of the rays around their pixel's centre, (R,) bool."""
    repeated = np.repeat(stored, len(_AROUND[0]), axis=0)
    values = _encodable(frame, channel, around, repeated).reshape(len(stored), -1, stored.shape[1])
    low, high = values.min(axis=1) - bound[:, None], values.max(axis=1) + bound[:, None]
    return np.asarray(((low <= stored) & (stored <= high)).all(axis=1))


def _is_beside(beside: Iterable[tuple[NDArray[np.intp], Values]], stored: Values, bound: Values) -> NDArray[np.bool_]:
    """Return where stored normals (R, 3) are those of triangles beside their pixel, which rays may miss, (R,) bool."""
    found = np.zeros(len(stored), bool)
    for place, normals in beside:
        # Rounding decides which side of a triangle seen edge-on faces the eye.
        errors = [np.linalg.norm(stored[place] - side, axis=1) for side in (normals, -normals)]
        found[place[np.minimum(*errors) <= bound[place]]] = True
    return found


def _encodable(frame: StoredFrame, channel: str, rays: RayValues, stored: Values) -> Values:
    """Return the rays' values (R, C), but inf where they are beyond the encoding and the stored value is inf too."""
    # Where the disparity is beyond the encoding, its change is not stored either.
    source, largest_px = np.abs(rays["disparity"]), frame.encodings.disparity.limit_px
    if channel == "correspondence":
        return rays[channel]
    if channel in OPPOSITE:
        source, largest_px = np.abs(rays[channel]).max(axis=1, keepdims=True), frame.encodings.flow.limit_px
    beyond = np.isinf(stored).all(axis=1, keepdims=True) & (source > largest_px)
    return np.where(beyond, np.inf, rays[channel])
