"""The rig of one sequence: its stereo cameras, their near plane and their sway.

The sway is a bounded function of time. So frames can be rendered in any order, and walls can be kept out of its reach.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from semisynth_gl.config import Config, Range
from semisynth_gl.config.disparity_section import DisparitySection
from semisynth_gl.config.rig_sections import CameraSection
from semisynth_gl.frame.camera import RECTIFIED, CameraDeviation, StereoCamera
from semisynth_gl.geometry.rotations import rotations_about
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.scene import Floats
from semisynth_gl.seeds.seeds import Purpose

# Number of points along each border of the image at which disparities are measured.
_ALONG_BORDER = 129
# Number of steps in the search for the near plane of a camera that deviates.
_STEPS = 8

# In a narrow range of disparities, a model's radius along the viewing axis is at most about this share of the range's
# depth. A larger model would spread over many of the range's disparities.
_RELIEF = 0.1

BEYOND_NEAR = 1.01
"""Ratio of `SequenceRig.clear_m` to the depth of the near plane."""


def sample_cameras(section: CameraSection, rng: np.random.Generator) -> tuple[StereoCamera, ...]:
    """Sample the camera of each right view of a scene; the cameras differ only in the right eye.

    The sampled doffs belongs to the longest baseline. Unless the config states the right principal point, doffs is
    proportional to the baseline. Disparities are then proportional to the baseline, so a surface with a valid disparity
    in one view has a valid disparity in all views.
    """

    def sample(key: Range | None, default: float) -> float:
        return (key or Range(default, default)).sample(rng)

    # Every range is sampled once, always in the same order.
    if section.focal_px is not None:
        focal_px = section.focal_px.sample(rng)
    else:
        assert section.focal_mm is not None and section.sensor_width_mm is not None  # noqa: S101, PT018 - CameraSection
        focal_px = section.focal_mm.sample(rng) / section.sensor_width_mm * section.width_px
    baselines_m = [section.baseline_ranges_m[0].sample(rng)]
    doffs_px = sample(section.doffs_px, 0.0)
    cx_left_px = sample(section.cx_left_px, (section.width_px - 1) / 2 - doffs_px / 2)
    cx_right_px = sample(section.cx_right_px, cx_left_px + doffs_px)
    cy_px = sample(section.cy_px, (section.height_px - 1) / 2)
    baselines_m += [range_m.sample(rng) for range_m in section.baseline_ranges_m[1:]]
    intrinsics = focal_px, baselines_m[0], cx_left_px, cx_right_px, cy_px
    camera = StereoCamera(section.width_px, section.height_px, *intrinsics, fy_over_fx=section.fy_over_fx)

    def cx_of(baseline_m: float) -> float:
        if baseline_m == max(baselines_m) or section.cx_right_px is not None:
            return cx_right_px
        return cx_left_px + baseline_m / max(baselines_m) * camera.doffs_px

    return tuple(replace(camera, baseline_m=each_m, cx_right_px=cx_of(each_m)) for each_m in baselines_m)


@dataclass(frozen=True, slots=True, eq=False)
class CameraSway:
    """The sway of the left camera: six independent oscillations, three along the world's axes and three about them."""

    shift_m: Floats  # (3,) amplitude of the position along x, y and z
    turn_rad: Floats  # (3,) amplitude of the rotation vector's x, y and z
    period_s: Floats  # (6,) periods of the three shifts and the three turns
    phase_rad: Floats  # (6,) phases at time 0

    @property
    def reach_m(self) -> float:
        """Largest distance of the left camera from the origin."""
        return float(np.linalg.norm(self.shift_m))

    @property
    def angle_rad(self) -> float:
        """Largest angle of the rotation, about any axis."""
        return float(np.linalg.norm(self.turn_rad))

    @property
    def moves(self) -> bool:
        """Whether the camera moves at all."""
        return self.reach_m > 0 or self.angle_rad > 0

    def camera_from_world(self, time_s: float) -> Floats:
        """Return camera_from_world of the left camera at a time, (4, 4) float64; the identity without sway."""
        if not self.moves:
            return np.eye(4)
        swing = np.sin(2 * np.pi * time_s / self.period_s + self.phase_rad)
        return local_from_parent(self.shift_m * swing[:3], self.turn_rad * swing[3:])


NO_SWAY = CameraSway(np.zeros(3), np.zeros(3), np.ones(6), np.zeros(6))
"""The sway of a camera at rest."""


@dataclass(frozen=True, slots=True, eq=False)
class SequenceRig:
    """The cameras of a sequence, the limits of depth that follow from its disparities, and the sway."""

    views: tuple[StereoCamera, ...]  # the camera of each right view; the cameras differ only in the right eye
    near_m: float = 0.0  # depth of the near plane
    sway: CameraSway = NO_SWAY
    relief_px: float = np.inf  # maximum radius of models along the viewing axis, px of the image at their own depth

    @classmethod
    def within(
        cls, section: DisparitySection, views: tuple[StereoCamera, ...], sway: CameraSway = NO_SWAY
    ) -> "SequenceRig":
        """Return a rig whose near plane and maximum relief follow from a range of disparities; see `near_depth_m`."""
        rig = cls(views, sway=sway)
        near_m = near_depth_m(rig.camera, section)
        # Depth of the range, in units of ``near_m``. From 1 on, the relief has no limit.
        extent = max(float(rig.camera.depth_m(section.min_px)) / near_m - 1, 0.0)
        relief_px = _RELIEF * rig.camera.focal_px * extent / (1 - extent) if extent < 1 else np.inf
        return replace(rig, near_m=near_m, relief_px=relief_px)

    @property
    def clear_m(self) -> float:
        """Minimum depth of walls and static models; at the near plane, rounding might take a disparity above max_px."""
        return BEYOND_NEAR * self.near_m

    @property
    def camera(self) -> StereoCamera:
        """The camera of the longest baseline, for which scenes are composed."""
        return max(self.views, key=lambda view: view.baseline_m)


def sample_rig(config: Config, generator_for: Callable[[Purpose], np.random.Generator]) -> SequenceRig:
    """Sample the rig of a sequence; the config may ask for a rectified twin after each deviating camera.

    ``generator_for`` returns the generators for CAMERA, RIG and SWAY. Raises InputError as `near_depth_m` does.
    """
    views = sample_cameras(config.camera, generator_for(Purpose.CAMERA))
    section = config.rig
    if not section.is_rectified():
        rng = generator_for(Purpose.RIG)
        roll, pitch = (np.deg2rad(deg.sample(rng)).item() for deg in (section.right_roll_deg, section.right_pitch_deg))
        deviation = CameraDeviation(roll, pitch, section.right_y_px.sample(rng), section.focal_ratio.sample(rng))
        twins = (deviation, RECTIFIED) if section.twin else (deviation,)
        views = tuple(replace(view, deviation=each) for view in views for each in twins)
    return SequenceRig.within(config.disparity, views, sample_sway(config.camera, generator_for(Purpose.SWAY)))


def near_depth_m(camera: StereoCamera, section: DisparitySection) -> float:
    """Return the depth of the near plane, at which the largest disparity of the image is ``max_px``.

    For a right camera that deviates, the plane is far enough away for its rectified twin, too. Raises InputError where
    the deviation alone causes disparities of ``max_px`` + doffs or more. `Config` checks that ``min_px`` + doffs is
    positive.
    """
    depth_m = plane_m = float(camera.depth_m(section.max_px))
    for _ in range(0 if camera.rectified else _STEPS):
        # Assume that the deviation's part of the disparity does not depend on the depth, which is nearly true.
        deviation_px = _largest_disparity_px(camera, plane_m) - float(camera.disparity_px(plane_m))
        if not section.max_px - deviation_px + camera.doffs_px > 0:  # True for nan, too: a point lies behind an eye.
            raise InputError(
                f"disparity.max_px: {section.max_px:g} px leaves no depth in front of a camera that deviates by "
                f"{camera.deviation}, which alone moves pixels by up to {deviation_px:g} px: raise disparity.max_px, "
                "or narrow the ranges of rig"
            )
        plane_m = float(camera.depth_m(section.max_px - deviation_px))
    return max(depth_m, plane_m)


def _largest_disparity_px(camera: StereoCamera, depth_m: float) -> float:
    """Return the largest disparity, in both images, of a plane of constant planar depth in the left view."""
    # The maximum is on the image's border: disparity is a quotient of two linear functions of the pixel's position, and
    # the Hessian of such a quotient has a negative determinant.
    along, ends = np.tile(np.linspace(0, 1, _ALONG_BORDER), 2), np.repeat((0.0, 1.0), _ALONG_BORDER)
    x_px = np.concatenate([along, ends]) * camera.width_px - 0.5
    y_px = np.concatenate([ends, along]) * camera.height_px - 0.5
    left = -camera.correspondence("left", x_px, y_px, np.full_like(x_px, depth_m))[..., 0]
    right_depth_m = depth_m / camera.rays("right", x_px, y_px)[..., 2]
    right = camera.correspondence("right", x_px, y_px, right_depth_m)[..., 0]
    return float(max(left.max(), right.max()))


def sample_sway(section: CameraSection, rng: np.random.Generator) -> CameraSway:
    """Sample a sway."""
    return CameraSway(
        section.sway_m.sample_many(rng, 3),
        np.deg2rad(section.sway_deg.sample_many(rng, 3)),
        section.sway_s.sample_many(rng, 6),
        rng.uniform(0, 2 * np.pi, 6),
    )


def local_from_parent(position_m: Floats, turn_rad: Floats) -> Floats:
    """Return local_from_parent, (4, 4), of a body whose position and rotation vector, (3,), are in the parent frame."""
    pose = np.eye(4)
    angle = float(np.linalg.norm(turn_rad))
    if angle > 0:
        pose[:3, :3] = rotations_about(turn_rad[None] / angle, np.array([-angle]))[0]
    pose[:3, 3] = -pose[:3, :3] @ position_m
    return pose
