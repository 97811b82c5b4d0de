"""The particle system: an emission plane above each depth layer releases models that fall, drift and spin.

All positions are in closed form, so any moment can be computed directly. A slot is one stream of models: it keeps its
layer, depth, size and speed, and releases one model after another. Model number g of a slot (generation g) leaves the
emission plane when model g - 1 has fallen out of the view, so the number of particles per layer stays constant. A
resting slot shows only its first model, which does not move.

No model appears or disappears in view: a path begins and ends just outside both views. The drift in depth is limited so
that models stay beyond the near plane. A slot whose models would reach the near plane even without drift shows nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from semisynth_gl.config import Range
from semisynth_gl.config.scene_sections import ParticleLayerSection, ParticlesSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.relief import sample_scales
from semisynth_gl.geometry.rotations import rotations_about, rotations_from_quaternions
from semisynth_gl.scene import Bools, Floats, Ints
from semisynth_gl.scene.rig import SequenceRig
from semisynth_gl.scene.view_volume import VerticalViewLimits, least_sphere_depth_m, vertical_view_limits

_QUANTILES = (np.arange(64) + 0.5) / 64


@dataclass(frozen=True, slots=True, eq=False)
class ParticleSlots:
    """The S slots of a sequence, which are streams of falling models."""

    depth_m: Floats  # (S,) planar depth of the path's middle
    disparity_px: Floats  # (S,) disparity of the path's middle
    radius_px: Floats  # (S,) radius of the bounding sphere in the image, at the depth of the path's middle
    flatness: Floats  # (S,) factor, up to 1, by which models are flattened along the viewing axis
    period_s: Floats  # (S,) time from the emission plane to the end of the view
    phase: Floats  # (S,) age at time 0, in periods, in [0, 1)
    path_m: Floats  # (S,) length of the path of a model without drift
    nearer_m: Floats  # (S,) how much nearer than the path's middle a model may come; 0 or less: the slot shows nothing
    limits: VerticalViewLimits  # where both views end above and below
    resting: Mapping[int, Floats] = field(default_factory=dict)  # by slot, the pose (4, 4) of a model at rest

    def __len__(self) -> int:
        return len(self.depth_m)

    def radius_m(self, camera: StereoCamera) -> Floats:
        """Return the radii (S,) of the bounding spheres before models are flattened."""
        return self.radius_px * (self.depth_m / camera.focal_px)

    @property
    def shown(self) -> Bools:
        """(S,) bool, whether a slot shows its models: they rest, or they stay beyond the near plane."""
        shown = self.nearer_m > 0
        shown[list(self.resting)] = True
        return shown

    def generation(self, time_s: float) -> Ints:
        """Return the generation that each slot shows at a time, (S,): 0 at time 0; earlier ones are negative."""
        generation = np.floor(time_s / self.period_s + self.phase).astype(np.int64)
        generation[list(self.resting)] = 0
        return generation


class ParticleGeneration(NamedTuple):
    """The random values of one generation of models, for each slot."""

    middle_px: Floats  # (S,) image x of the path's middle, left view
    quaternion: Floats  # (S, 4) rotation on leaving the emission plane, x y z w
    axis: Floats  # (S, 3) unit axis of the spin
    spin_rad_s: Floats  # (S,) speed of the spin
    drift: Floats  # (S, 2) speed in x and z relative to the speed downwards
    scale: Floats  # (S, 3) scales along the model's axes, relative to its radius; the largest is 1


class ParticleSizes(NamedTuple):
    """Diameters of models' bounding spheres, sampled uniformly in their logarithm."""

    low: float
    high: float
    metric: bool = False  # whether diameters are in metres; otherwise in pixels of the image, whatever the depth

    def radius_px(self, camera: StereoCamera, disparity_px: Floats, quantile: Floats) -> Floats:
        """Return the radii, px, of quantiles (0 to 1) of the sizes at disparities; both arrays are broadcast."""
        radius = self.low / 2 * (self.high / self.low) ** quantile
        if self.metric:
            radius = radius * camera.focal_px / camera.depth_m(disparity_px)
        return np.broadcast_to(radius, np.broadcast_shapes(radius.shape, disparity_px.shape))

    def scaled(self, factor: float) -> "ParticleSizes":
        """Return these sizes times a factor."""
        return ParticleSizes(self.low * factor, self.high * factor, self.metric)


def stated_sizes(section: ParticlesSection, layer: ParticleLayerSection | None = None) -> ParticleSizes:
    """Return the sizes that a config states for all particles, or for a depth layer."""
    if layer is not None and layer.size_px is not None:
        return ParticleSizes(layer.size_px.low, layer.size_px.high)
    if section.size_m is not None:
        return ParticleSizes(section.size_m.low, section.size_m.high, metric=True)
    return ParticleSizes(section.size_px.low, section.size_px.high)


class ParticleLayer(NamedTuple):
    """A number of particles in one range of disparities."""

    disparity_px: Range  # disparities of the paths' middles
    number: int
    sizes: ParticleSizes


def expected_cover(camera: StereoCamera, sizes: ParticleSizes, disparity_px: Floats, fill: float) -> Floats:
    """Return the coverage (K,) of one particle at disparities (K,): the probability that it covers a given pixel.

    The pixel is in the left view. ``fill`` is `MeanModelRelief.fill`.
    """
    radius = sizes.radius_px(camera, disparity_px[:, None], _QUANTILES)
    area = fill * np.pi * radius**2 * _mean_secant(camera)
    released = _release_width_px(camera, disparity_px[:, None], radius) * path_px(camera, radius)
    return np.asarray((area / released).mean(axis=1))


def expected_in_view(camera: StereoCamera, sizes: ParticleSizes, disparity_px: Floats) -> Floats:
    """Return the share of the particles at disparities (K,) whose bounding sphere touches the left view, (K,)."""
    radius = sizes.radius_px(camera, disparity_px[:, None], _QUANTILES)
    width = _release_width_px(camera, disparity_px[:, None], radius)
    return np.asarray(((camera.width_px + 2 * radius) / width).mean(axis=1))


def _mean_secant(camera: StereoCamera) -> float:
    """Return the mean area, over the left image, of a small sphere's image, relative to that on the optical axis.

    At an angle t to the axis and at depth Z, a sphere with a disc of area a covers the solid angle a cos(t)^2 / Z^2.
    The image maps a solid angle to f^2 / cos(t)^3 times its size. So the relative area is 1 / cos(t).
    """
    x = ((np.arange(16) + 0.5) / 16 * camera.width_px - 0.5 - camera.cx_left_px) / camera.focal_px
    y = ((np.arange(16) + 0.5) / 16 * camera.height_px - 0.5 - camera.cy_px) / camera.focal_y_px
    return float(np.sqrt(1 + x**2 + y[:, None] ** 2).mean())


def _release_width_px(camera: StereoCamera, disparity_px: Floats, radius_px: Floats) -> Floats:
    """Return the width, px of the left image, of the region in which particles fall.

    It spans both views, and one radius on each side.
    """
    return camera.width_px + np.abs(disparity_px) + 2 * radius_px


def path_px(camera: StereoCamera, radius_px: Floats) -> Floats:
    """Return the lengths, px, of the paths of particles through both views of a rig without sway; any shape."""
    limits = vertical_view_limits(SequenceRig((camera,)))
    return np.asarray((limits.bottom - limits.top) * camera.focal_px + sum(limits.secants) * radius_px)


def sample_slots(
    rig: SequenceRig, section: ParticlesSection, layers: Sequence[ParticleLayer], rng: np.random.Generator
) -> ParticleSlots:
    """Sample the slots of one sequence, one for each particle of the layers.

    If all layers together have more than ``section.most`` particles, all are reduced in proportion. Models whose
    radius along the viewing axis would exceed ``rig.relief_px`` are flattened.
    """
    camera = rig.camera
    counts = np.array([layer.number for layer in layers], np.int64)
    if counts.sum() > section.most:
        counts = counts * section.most // counts.sum()
    low = np.repeat([layer.disparity_px.low for layer in layers], counts)
    high = np.repeat([layer.disparity_px.high for layer in layers], counts)
    total = len(low)
    disparity = low + (high - low) * rng.random(total)
    quantile = rng.random(total)
    radius = np.empty(total)
    for layer, count, end in zip(layers, counts, np.cumsum(counts), strict=True):
        rows = slice(end - count, end)
        radius[rows] = layer.sizes.radius_px(camera, disparity[rows], quantile[rows])
    speed = section.fall_m_s.sample_many(rng, total)
    phase = rng.random(total)
    depth = camera.depth_m(disparity)
    radius_m, limits = radius * depth / camera.focal_px, vertical_view_limits(rig)
    path = (limits.bottom - limits.top) * depth + sum(limits.secants) * (radius_m + limits.reach_m)
    width = _release_width_px(camera, disparity, radius)
    # Upper limit of a model's distance from the optical axis.
    aside = np.hypot(width * depth / camera.focal_px, path) * (1 + section.drift.high)
    flatness = np.minimum(rig.relief_px / radius, 1.0)
    nearer = depth - least_sphere_depth_m(rig, radius_m * flatness, aside)
    # In a narrow range of disparities, the drift in depth has the same limit as a model's relief.
    nearer = np.minimum(nearer, rig.relief_px * depth / camera.focal_px)
    return ParticleSlots(depth, disparity, radius, flatness, path / speed, phase, path, nearer, limits)


def sample_generation(
    camera: StereoCamera, section: ParticlesSection, slots: ParticleSlots, rng: np.random.Generator
) -> ParticleGeneration:
    """Sample the random values of one generation."""
    total = len(slots)
    width = _release_width_px(camera, slots.disparity_px, slots.radius_px)
    # With a negative disparity, the right view shows particles to the left of the left view.
    middle = rng.random(total) * width - slots.radius_px - 0.5 + np.minimum(slots.disparity_px, 0)
    quaternion = rng.normal(size=(total, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    axis = rng.normal(size=(total, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    spin = np.deg2rad(section.spin_deg_s.sample_many(rng, total))
    heading = rng.uniform(0, 2 * np.pi, total)
    drift = section.drift.sample_many(rng, total)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    scale = sample_scales(section, total, rng)
    return ParticleGeneration(middle, quaternion, axis, spin, drift, scale)


def particle_poses(
    camera: StereoCamera,
    slots: ParticleSlots,
    generations: Callable[[int], ParticleGeneration],
    time_s: float,
    generation: Ints,
) -> Floats:
    """Pose one model of every slot at any time.

    ``generation`` (S,) has the number of each slot's model. ``generations`` returns the random values of a
    generation. Before and after the time in which its slot shows a model, the model is on the extension of its path.

    Returns:
        world_from_model (S, 4, 4) of models of radius 1; the world is the left camera's frame without its sway.
    """
    # Periods since the model left the emission plane: 0 to 1 while the slot shows it.
    age = time_s / slots.period_s + slots.phase - generation
    m_per_px = slots.depth_m / camera.focal_px
    matrix = np.tile(np.eye(4), (len(slots), 1, 1))
    centre = matrix[:, :3, 3]
    radius_m = slots.radius_m(camera)
    (top_secant, bottom_secant), margin_m = slots.limits.secants, radius_m + slots.limits.reach_m
    nearer_m = np.maximum(slots.nearer_m, 0.0)
    for number in np.unique(generation):
        k = np.flatnonzero(generation == number)
        values = generations(int(number))
        drift_m = values.drift[k] * slots.path_m[k, None]
        recedes_m = np.clip(drift_m[:, 1], -2 * nearer_m[k], 2 * nearer_m[k])
        first_m, last_m = slots.depth_m[k] - recedes_m / 2, slots.depth_m[k] + recedes_m / 2
        begin = slots.limits.top * first_m - top_secant * margin_m[k]
        end = slots.limits.bottom * last_m + bottom_secant * margin_m[k]
        centre[k, 0] = (values.middle_px[k] - camera.cx_left_px) * m_per_px[k] + (age[k] - 0.5) * drift_m[:, 0]
        centre[k, 1] = begin + age[k] * (end - begin)
        centre[k, 2] = slots.depth_m[k] + (age[k] - 0.5) * recedes_m
        angle = values.spin_rad_s[k] * age[k] * slots.period_s[k]
        rotation = rotations_about(values.axis[k], angle) @ rotations_from_quaternions(values.quaternion[k])
        matrix[k, :3, :3] = rotation * (values.scale[k] * radius_m[k, None])[:, None, :]
    # Flatten along the optical axis without sway, so that a model keeps its shape as the camera moves.
    matrix[:, 2, :3] *= slots.flatness[:, None]
    for slot, pose in slots.resting.items():
        matrix[slot] = pose
    return matrix
