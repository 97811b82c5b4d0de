"""Compares each channel of the scenes of scene_table.py with float64 rays, and crops with whole images."""

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import pytest
from scene_table import CASES, scene_of
from scenes import assert_equal

from semisynth_gl import oracle
from semisynth_gl.frame.camera import EYES, OTHER_EYE, Crop
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, RENDERED_OUTPUTS, SKY, VISIBLE
from semisynth_gl.render import work_list_shader
from semisynth_gl.render.renderer import Renderer
from semisynth_gl.scene.raycast import RayHits, cast_rays
from semisynth_gl.scene.scene import move

EXACT_PX = 1e-3
# Rasterisers round vertices to a grid, so a pixel within this distance of an edge may show either surface.
EDGE_PX = 1 / 16
# Two float32 steps at 1500 px.
STEP_PX = 2.5e-4
# Compare at most this number of pixels: the left view's first rows and the right view's last rows.
MOST_PIXELS = 4000
SIDE = 256
# Largest relative difference of depth at which two rays hit the same point; more than float64's rounding.
SAME_POINT = 1e-9


def ramps():
    """Make patches whose colours encode u in red, v in green, and the patch's number in blue."""
    layers = np.zeros((4, SIDE, SIDE, 4), np.uint8)
    layers[..., 0], layers[..., 1], layers[..., 3] = np.arange(SIDE), np.arange(SIDE)[:, None], 255
    layers[..., 2] = 60 * np.arange(4)[:, None, None]
    return layers


@cache
def renderer(backend, own, rectified, signed):
    """Share one renderer among scenes with the same models and options."""
    outputs = [name for name in RENDERED_OUTPUTS if rectified or name != "disparity_change"]
    return Renderer(own, ramps(), outputs=outputs, rectified=rectified, signed=signed, backend=backend)


def render(case, backend, crop=None):
    own = renderer(backend, tuple(case.models), case.scene.camera.rectified, case.signed)
    return own.render(case.scene, crop, future=case.future, past=case.past)


@dataclass
class Pixels:
    """Pixels of one eye's view, and the oracle's rays through their centres."""

    case: object
    view: object
    eye: str

    def __post_init__(self):
        height, width = self.view.disparity.shape
        rows = min(height, MOST_PIXELS // width)
        self.shape = rows, width
        self.at = np.divmod(np.arange(rows * width) + (0 if self.eye == "left" else (height - rows) * width), width)
        self.y, self.x = (index.astype(float) for index in self.at)
        self.scene, self.models, self.signed = self.case.scene, self.case.models, self.case.signed
        self.hits = self.cast(self.x, self.y)
        self.way = oracle.correspondence_px(self.scene.camera, self.eye, self.x, self.y, self.hits, signed=self.signed)
        self.disparity = oracle.disparity_of(self.eye, self.way)
        rendered = self.view.disparity[self.at].astype(float)
        with np.errstate(invalid="ignore"):
            self.error = np.where(np.isinf(rendered) & np.isinf(self.disparity), 0, np.abs(rendered - self.disparity))
        self.exact = self.error <= EXACT_PX
        # The rendered surface is the one that the ray hits.
        self.same = self.exact & (self.view.instances[self.at] == self.hits.instance + 1)

    def cast(self, x, y):
        return cast_rays(self.scene, self.models, self.eye, x, y)

    def disparity_on(self, hits, x, y):
        """Return the disparities at (x, y) of the planes through the triangles that other rays hit."""
        depth = oracle.depth_on_planes(self.scene, self.models, self.eye, x, y, hits)
        depth[np.isin(hits.instance, np.flatnonzero(self.scene.sky))] = np.inf
        on_surface = RayHits(depth, hits.instance, hits.triangle)
        way = oracle.correspondence_px(self.scene.camera, self.eye, x, y, on_surface, signed=self.signed)
        return oracle.disparity_of(self.eye, way)

    def displaced(self, wrong):
        """Tell whether wrong pixels show a surface within 1/16 px, or their disparity changes as much within a step."""
        x, y, rendered = self.x[wrong], self.y[wrong], self.view.disparity[self.at][wrong].astype(float)
        dx, dy = (each.ravel() for each in np.meshgrid(*[np.linspace(-EDGE_PX, EDGE_PX, 9)] * 2))
        beside = self.cast(np.add.outer(x, dx).ravel(), np.add.outer(y, dy).ravel())
        there = self.disparity_on(beside, x.repeat(len(dx)), y.repeat(len(dx))).reshape(len(x), len(dx))
        own = RayHits(*(getattr(self.hits, name)[wrong] for name in ("depth_m", "instance", "triangle")))
        with np.errstate(invalid="ignore"):
            off = np.abs(there - rendered[:, None])
            steps = [self.disparity_on(own, x + right, y + down) for right, down in ((STEP_PX, 0), (0, STEP_PX))]
            steep = np.hypot(*(step - self.disparity[wrong] for step in steps))
            found = (off <= EXACT_PX) | (np.isinf(there) & np.isinf(rendered)[:, None])
            return found.any(axis=1) | (self.error[wrong] <= steep)

    @cached_property
    def off_edges(self):
        """Mark pixels whose rays 1/16 px aside hit the same triangle."""
        same = np.ones(len(self.x), bool)
        for right, down in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            beside = self.cast(self.x + right * EDGE_PX, self.y + down * EDGE_PX)
            same &= (beside.instance == self.hits.instance) & (beside.triangle == self.hits.triangle)
        return same & self.same

    def __getitem__(self, name):
        return self.view[name][self.at]


def check_disparity(pixels):
    wrong = np.flatnonzero(~pixels.exact)[:300]
    assert pixels.exact.mean() >= (0.9 if pixels.case.steep else pixels.case.exact)
    # No disparity is a mix of two surfaces.
    assert (~pixels.displaced(wrong)).sum() <= 1
    known = pixels.off_edges & (np.abs(pixels.disparity + pixels.scene.camera.doffs_px) <= 256)
    if known.any() and not pixels.case.steep:
        assert np.median(pixels.error[known]) <= 1e-5
        assert np.quantile(pixels.error[known], 0.999) <= 1e-4


def check_instances(pixels):
    known = pixels.same | ~pixels.exact
    # Of surfaces at the same depth, the first one is visible.
    assert known.mean() >= 0.9995


def check_depth(pixels):
    np.testing.assert_allclose(pixels["depth"][pixels.off_edges], pixels.hits.depth_m[pixels.off_edges], rtol=1e-5)


def check_sky(pixels):
    is_sky = np.isin(pixels.hits.instance, np.flatnonzero(pixels.scene.sky))
    np.testing.assert_array_equal(pixels["sky"][pixels.same], np.where(is_sky, SKY, 0)[pixels.same])


def check_normals(pixels):
    sure = pixels.off_edges
    expected = oracle.normals(pixels.scene, pixels.models, pixels.eye, pixels.hits)[sure]
    found = pixels["normals"][sure].astype(float)
    seen = pixels.hits.instance[sure] >= 0
    # Use the chord, since the cosine of a tiny angle rounds to 1.
    degrees = np.rad2deg(2 * np.arcsin(np.linalg.norm(found - expected, axis=1) / 2))
    assert degrees.max(initial=0) < 0.01
    assert np.abs(np.linalg.norm(found[seen], axis=1) - 1).max(initial=0) < 1e-6
    assert not found[~seen].any()


def visibility(scene, models, eye, x_px, y_px, hits, *, signed=False):
    """Return the visibility of hit points in the other eye, (R,) uint8, by a ray from that eye to each point."""
    camera, other = scene.camera, OTHER_EYE[eye]
    position_px = np.stack([x_px, y_px], axis=1) + oracle.correspondence_px(
        camera, eye, x_px, y_px, hits, signed=signed
    )
    # Depths are in the frame of the eye's camera.
    is_far = np.isinf(hits.depth_m)
    points = camera.rays(eye, x_px, y_px) * np.where(is_far, 1.0, hits.depth_m)[:, None]
    points[:, 0] += camera.offset_m(eye) - camera.offset_m(other)
    turn = camera.turn(other)
    depth_m = np.where(is_far, np.inf, points[:, 2] if turn is None else points @ turn[2])
    return seen(scene, models, other, position_px, depth_m)


def flow_visibility(motion, models, eye, x_px, y_px, hits, flow_px, depth_m):
    """Return the visibility of hit points at the other moment, (R,) uint8; points of missing instances are occluded."""
    mask = seen(motion.scene, models, eye, np.stack([x_px, y_px], axis=1) + flow_px, depth_m)
    visible = np.flatnonzero(mask == VISIBLE)
    mask[visible[motion.instance[hits.instance[visible]] < 0]] = OCCLUDED
    return mask


def seen(scene, models, eye, position_px, depth_m):
    """Return the visibility of points at positions (R, 2) and depths (R,) in an eye's view, (R,) uint8."""
    size = np.array([scene.camera.width_px, scene.camera.height_px])
    where = np.flatnonzero(((position_px >= -0.5) & (position_px < size - 0.5)).all(axis=1))
    nearest_m = cast_rays(scene, models, eye, *position_px[where].T).depth_m
    mask = np.full(len(position_px), OUTSIDE, np.uint8)
    mask[where] = np.where(nearest_m < depth_m[where] * (1 - SAME_POINT), OCCLUDED, VISIBLE)
    return mask


def check_mask(pixels, name, expected):
    alike = (pixels[name] == expected)[pixels.same]
    assert alike.mean() >= pixels.case.seen
    around = np.lib.stride_tricks.sliding_window_view(np.pad(expected.reshape(pixels.shape), 1, mode="edge"), (3, 3))
    inside = (around.max((2, 3)) == around.min((2, 3))).ravel()[pixels.same]
    assert pixels.case.thin or (inside & ~alike).mean() <= 5e-3


def check_visibility(pixels):
    args = pixels.scene, pixels.models, pixels.eye, pixels.x, pixels.y, pixels.hits
    check_mask(pixels, "visibility", visibility(*args, signed=pixels.signed))


def check_correspondence(pixels):
    found, expected = pixels["correspondence"], pixels.way
    assert np.array_equal(np.isfinite(found)[pixels.same], np.isfinite(expected)[pixels.same])
    both = pixels.off_edges & np.isfinite(expected[:, 0])
    if both.any():
        assert np.quantile(np.abs(found[both] - expected[both]), 0.999) < (EXACT_PX if pixels.case.steep else 2e-4)


def check_flow(pixels):
    args = pixels.eye, pixels.x, pixels.y, pixels.hits
    motions = {"flow": pixels.case.future, "flow_backward": pixels.case.past}
    for name, motion in motions.items():
        flow_px, change_px, depth_m = oracle.flow(pixels.scene, pixels.models, motion, *args, signed=pixels.signed)
        assert np.array_equal(np.isfinite(pixels[name])[pixels.same], np.isfinite(flow_px)[pixels.same])
        both = pixels.off_edges & np.isfinite(flow_px).all(axis=1)
        if both.any():
            assert np.quantile(np.abs(pixels[name][both] - flow_px[both]), 0.999) < 2e-4
        check_mask(pixels, f"{name}_visibility", flow_visibility(motion, pixels.models, *args, flow_px, depth_m))
        if name == "flow" and "disparity_change" in pixels.view:
            change = pixels["disparity_change"]
            has = np.isfinite(change_px)
            assert np.array_equal(np.isfinite(change)[pixels.same], has[pixels.same])
            off = np.abs(change[both & has] - change_px[both & has])
            assert np.quantile(off, 0.999) < 2e-4 if len(off) else True


def check_image(pixels):
    """Compare colours with the ramps at the rays' UV."""
    hits, scene = pixels.hits, pixels.scene
    shown = np.flatnonzero(pixels.off_edges & (hits.instance >= 0))
    place = np.empty((len(shown), 2))
    rays = scene.camera.rays_of_eye(pixels.eye, pixels.x[shown], pixels.y[shown])
    chosen = RayHits(np.ones(len(shown)), hits.instance[shown], hits.triangle[shown])
    depth = oracle.depth_on_planes(scene, pixels.models, pixels.eye, pixels.x[shown], pixels.y[shown], chosen)
    turn = scene.camera.turn(pixels.eye)
    points = rays * depth[:, None] @ (np.eye(3) if turn is None else turn)
    for number in np.unique(chosen.instance):
        own = chosen.instance == number
        mesh, pose = pixels.models[scene.model[number]], scene.view_from_model(number)
        corner = mesh.positions[mesh.triangles].astype(float) @ pose[:3, :3].T + pose[:3, 3]
        corner[..., 0] -= scene.offset_m(pixels.eye, number)
        a, b, c = np.moveaxis(corner[chosen.triangle[own]], 1, 0)
        weights = np.einsum("nij,nj->ni", np.linalg.pinv(np.stack([b - a, c - a], axis=2)), points[own] - a)
        uv = mesh.uv[mesh.triangles][chosen.triangle[own]].astype(float)
        uv = uv[:, 0] + weights[:, :1] * (uv[:, 1] - uv[:, 0]) + weights[:, 1:] * (uv[:, 2] - uv[:, 0])
        place[own] = uv * scene.uv_scale[number] + scene.uv_offset[number]
    # Patches repeat mirrored. Colours are means near their borders, and where a patch is much smaller than a pixel.
    folded = 1 - np.abs(place % 2 - 1)
    image = pixels["image"][shown].astype(float)
    assert np.abs(image[:, 2] - 60 * scene.layer[chosen.instance]).max(initial=0) <= 1
    off = np.abs(image[:, :2] - np.clip(SIDE * folded - 0.5, 0, SIDE - 1)).max(axis=1)
    inner = (np.abs(folded - 0.5) < 0.4).all(axis=1)
    if inner.sum() > 500 and not pixels.case.steep:
        assert np.quantile(off[inner], 0.5) <= 1
        assert np.quantile(off[inner], 0.8) <= 1.5


CHECKS = (
    *(check_disparity, check_instances, check_depth, check_sky, check_normals, check_visibility),
    *(check_correspondence, check_flow, check_image),
)


@pytest.mark.one_backend
@pytest.mark.parametrize("name", CASES)
def test_every_channel_is_what_rays_say(backend, name):
    case = CASES[name]()
    frame = render(case, backend)
    for eye in EYES:
        pixels = Pixels(case, frame.view(eye), eye)
        for array in frame.view(eye).values():
            assert not np.isnan(array).any()
        for check in CHECKS:
            check(pixels)


@pytest.mark.one_backend
@pytest.mark.parametrize("name", ["clutter 0", "sky, signed", "far wall, signed", "deviating", "fence"])
def test_bands_and_crops_are_parts_of_the_whole(backend, name, monkeypatch):
    """The order of renderings and the capacity of work lists do not change the result."""
    case = CASES[name]()
    empty = scene_of(case.scene.camera, [])
    nothing = replace(case, scene=empty, future=move(empty), past=move(empty))
    whole = render(case, backend)
    for most_pixels, crop in ((1 << 21, Crop(23, 31, 50, 4)), (900, None), (900, Crop(61, 3, 59, 87))):
        # Render an empty scene to clear the earlier image.
        assert not render(nothing, backend).left.image.any()
        monkeypatch.setattr(work_list_shader, "_MOST_PIXELS", most_pixels)
        assert_equal(render(case, backend, crop), whole, crop)
