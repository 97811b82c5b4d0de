"""Masks by float64 rays: whether the other eye, or the same eye at another moment, sees the points of a view."""

import numpy as np

from semisynth_gl import oracle
from semisynth_gl.frame.camera import OTHER_EYE
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.scene.raycast import cast_rays

# Largest relative difference of the depths at which two rays meet the same point; it covers float64's rounding, and a
# surface in front of the point is nearer by more.
SAME_POINT = 1e-9


def visibility(scene, models, eye, x_px, y_px, hits, *, signed=False):
    """Return whether the other eye sees the hit points, (R,) uint8, by a second ray to each point from that eye."""
    camera, other = scene.camera, OTHER_EYE[eye]
    position_px = np.stack([x_px, y_px], axis=1) + oracle.correspondence_px(
        camera, eye, x_px, y_px, hits, signed=signed
    )
    # Each eye's depths are in its own camera frame.
    is_far = np.isinf(hits.depth_m)
    points = camera.rays(eye, x_px, y_px) * np.where(is_far, 1.0, hits.depth_m)[:, None]
    points[:, 0] += camera.offset_m(eye) - camera.offset_m(other)
    turn = camera.turn(other)
    depth_m = np.where(is_far, np.inf, points[:, 2] if turn is None else points @ turn[2])
    return seen(scene, models, other, position_px, depth_m)


def flow_visibility(motion, models, eye, x_px, y_px, hits, flow_px, depth_m):
    """Return whether an eye sees the hit points at the other moment, (R,) uint8; things that are gone are occluded."""
    mask = seen(motion.scene, models, eye, np.stack([x_px, y_px], axis=1) + flow_px, depth_m)
    visible = np.flatnonzero(mask == VISIBLE)
    mask[visible[motion.instance[hits.instance[visible]] < 0]] = OCCLUDED
    return mask


def seen(scene, models, eye, position_px, depth_m):
    """Return whether an eye sees points at positions (R, 2) and depths (R,), where nothing nearer hides them."""
    size = np.array([scene.camera.width_px, scene.camera.height_px])
    where = np.flatnonzero(((position_px >= -0.5) & (position_px < size - 0.5)).all(axis=1))
    nearest_m = cast_rays(scene, models, eye, *position_px[where].T).depth_m
    mask = np.full(len(position_px), OUTSIDE, np.uint8)
    mask[where] = np.where(nearest_m < depth_m[where] * (1 - SAME_POINT), OCCLUDED, VISIBLE)
    return mask
