"""The disparity solver: histograms, target forms, the Boolean model, and the disparities of scenes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samplers import sampler_of
from tiny_datasets import tiny

from semisynth_gl.config import Range, load_config
from semisynth_gl.config.scene_sections import ParticlesSection
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry import model_files
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.geometry.model_units import make_model
from semisynth_gl.geometry.relief import mean_relief
from semisynth_gl.histogram import Histogram, count_pixels, total_variation, wasserstein_px
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.scene.depth_layers import DepthLayers, expected_shares, solve_coverage
from semisynth_gl.scene.disparity_solver import poisson_counts
from semisynth_gl.scene.particles import ParticleSizes, expected_cover
from semisynth_gl.scene.rig import SequenceRig
from semisynth_gl.seeds.splits import Split

CAMERA = StereoCamera.centred(600, 400, 700.0, 0.2)
RIGID = ParticlesSection(stretch=Range(1.0, 1.0))
HUMPS = [0, 5, 16, 17, 12, 6, 3, 1, 0, 1, 2, 3, 5, 6, 7, 6, 5, 3, 1, 1]
TWO_HUMPS = {"form": "histogram", "bin_px": 1.2, "first_px": 1.2, "shares": HUMPS}


# Histograms


def test_distances_of_shifted_blocks_are_known():
    one = Histogram.from_counts([0, 10, 20, 30], [1, 0, 0])
    other = Histogram.from_counts([0, 10, 20, 30], [0, 0, 1])
    assert total_variation(one, other) == 1
    assert wasserstein_px(one, other) == pytest.approx(20)
    # Uniform over 0 to 4 px and over 0 to 2 px: quantiles differ by 1 px on average.
    assert wasserstein_px(Histogram.from_counts([0, 4], [1]), Histogram.from_counts([0, 2], [1])) == pytest.approx(1)


def test_pixels_beyond_the_edges_count_in_the_outer_bins():
    assert count_pixels(np.array([[-1, 3, np.inf], [15, 99, np.nan]]), [0, 10, 20]).tolist() == [2, 2]


# Forms


def target(form, **camera):
    config = load_config("sceneflow", {"disparity.target": form, **camera})
    return config.wanted_histogram()


def test_uniform_in_depth_is_what_thrown_depths_show():
    made = target({"form": "uniform-depth"}, **{"camera.doffs_px": 10.0})
    depth = np.random.default_rng(0).uniform(1050 / (300 + 10), 1050 / (4 + 10), 400_000)
    thrown = Histogram.from_counts(made.edges_px, count_pixels(1050 / depth - 10, made.edges_px))
    assert total_variation(made, thrown) < 0.003


@pytest.mark.parametrize("origin_px", [0, 20])
def test_a_gamma_has_its_mean_and_spread(origin_px):
    made = target({"form": "gamma", "mean_px": 90.0, "spread_px": 30.0, "origin_px": origin_px})
    middle = (made.edges_px[1:] + made.edges_px[:-1]) / 2
    assert made.mean_px == pytest.approx(90, rel=0.005)
    assert math.sqrt(made.shares @ (middle - made.mean_px) ** 2) == pytest.approx(30, rel=0.03)


@pytest.mark.parametrize(
    ("form", "message"),
    [
        ({"form": "uniform", "low_px": 200, "high_px": 500}, r"66\.7% above"),
        (
            {"form": "histogram", "bin_px": 1, "first_px": -2, "shares": [1, 1, 1, 1, 1, 1, 8]},
            "42.9% of the pixels below disparity.min_px and 0.0%",
        ),
        ({"form": "histogram", "bin_px": 10, "shares": [0, 0]}, "above 0"),
    ],
)
def test_targets_that_no_scene_can_show_are_refused(form, message):
    with pytest.raises(InputError, match=message):
        target(form)


def off_by(sampler):
    return total_variation(sampler.disparity_solver.target, sampler.disparity_solver.expected())


def particles_of(sampler, scenes):
    return [(sampler.sample(index).instances["slot"] >= 0).sum() for index in range(scenes)]


def test_narrow_bins_are_merged_for_layers():
    config = tiny(disparity={"target": {"form": "histogram", "bin_px": 0.1, "shares": [0.0] * 20 + [1.0] * 340}})
    assert len(sampler_of(config).disparity_solver.target.shares) <= 48
    assert off_by(sampler_of(config)) < 0.06


def test_particles_grow_where_more_of_them_would_be_needed_than_allowed():
    config = tiny(particles={"size_px": [0.5, 1.0], "most": 300})
    sampler = sampler_of(config)
    assert 150 < np.mean(particles_of(sampler, 8)) <= 300
    assert off_by(sampler) < 0.06


@settings(max_examples=10)
@given(st.floats(-1, 2.3), st.floats(0.01, 0.97), st.floats(0, 1))
def test_narrow_ranges_meet_their_target(magnitude, width, doffs):
    most = 10**magnitude
    least = most * (1 - width)
    config = tiny(
        camera={"doffs_px": doffs * least},
        disparity={"min_px": least, "max_px": most, "target": {"form": "uniform"}},
        background={"wall_disparity_px": least, "wall_turn_deg": 0},
    )
    sampler = sampler_of(config)
    assert off_by(sampler) < 0.1
    assert 0 < particles_of(sampler, 1)[0] <= config.particles.most


# The Boolean model


@settings(max_examples=60)
@given(st.integers(2, 24), st.integers(0, 2**31))
def test_solved_coverage_gives_the_wanted_shares(bins, seed):
    """Thin layers in front of a wall in the farthest bin."""
    wanted = np.random.default_rng(seed).random(bins) + 0.05
    wanted /= wanted.sum()
    bare, reached = np.ones(bins - 1), np.tri(bins, bins - 1, -1)
    solved = solve_coverage(wanted, bare, reached, np.zeros(bins), np.ones(bins, bool))
    np.testing.assert_allclose(expected_shares(solved, bare, reached), wanted, atol=0.01)
    assert (solved >= 0).all()


def test_counts_are_poisson():
    quantile = (np.arange(10_000) + 0.5) / 10_000
    for mean in (0.0, 0.1, 3.0, 60.0):
        counts = poisson_counts(np.full(10_000, mean), quantile)
        assert counts.mean() == pytest.approx(mean, rel=1e-3)
        assert counts.var() == pytest.approx(mean, rel=1e-2)


def test_reliefs_of_a_ball_and_a_cube():
    rng = np.random.default_rng(0)
    ball = mean_relief([SIMPLE_KINDS["sphere"](rng)], np.array([1.0]), RIGID, rng)
    assert ball.fill == pytest.approx(1, abs=0.02)
    # For uniform points of a disc, the squared height 1 - r^2 of the ball is uniform.
    np.testing.assert_allclose(ball.heights**2, (np.arange(16) + 0.5) / 16, atol=0.05)
    # The mean projected area of a convex body is a quarter of its surface (Cauchy): 6 a^2 / 4, a = 2 / sqrt(3).
    cube = mean_relief([SIMPLE_KINDS["cube"](rng)], np.array([1.0]), RIGID, rng)
    assert cube.fill == pytest.approx(2 / np.pi, rel=0.02)
    needle = make_model("needle", [[0, 0, 0], [1, 0, 0], [0.5, 1e-6, 0]], [[0, 1, 2]])
    with pytest.raises(InputError, match="too thin to be seen"):
        mean_relief([needle, SIMPLE_KINDS["cube"](rng)], np.array([1.0, 0.0]), RIGID, rng)


@pytest.mark.parametrize("fy_over_fx", [1.0, 0.6])
def test_expected_cover_grows_towards_the_sides_of_a_wide_view(fy_over_fx):
    """Measure the mean image area of small balls by the rays that pass within their radius."""
    camera, rng = StereoCamera.centred(600, 400, 350.0, 0.2), np.random.default_rng(2)
    camera = replace(camera, fy_over_fx=fy_over_fx)
    depth, radius_px = 5.0, 4.0
    radius_m = radius_px * depth / camera.focal_px
    x, y = rng.random(400) * 600 - 0.5, rng.random(400) * 400 - 0.5
    step = np.arange(-10, 10, 0.25)
    dx, dy = (each.ravel() for each in np.meshgrid(step, step))
    rays = camera.rays("left", np.add.outer(x, dx), np.add.outer(y, dy))
    centre = camera.rays("left", x, y)[:, None] * depth
    along = (rays * centre).sum(-1) / (rays**2).sum(-1)
    inside = np.linalg.norm(along[..., None] * rays - centre, axis=-1) < radius_m
    area = inside.sum(axis=1).mean() * 0.25**2
    assert area > 1.1 * np.pi * radius_px**2 * fy_over_fx
    # Centres are uniform over both views, 80 px apart, and up to a radius beside them.
    width_px, height_px = 600 + 80 + 2 * radius_px, 400 + 2 * radius_px * fy_over_fx
    sizes, disparity = ParticleSizes(2 * radius_px, 2 * radius_px), np.array([80.0, -80.0])
    np.testing.assert_allclose(expected_cover(camera, sizes, disparity, 1.0) * width_px * height_px, area, rtol=0.02)
    # Sizes are log-uniform. A long lens does not stretch balls, so the cover is the mean over the sizes.
    long, between = replace(camera, focal_px=70_000.0), 40 * 5 ** ((np.arange(500) + 0.5) / 500)
    single = [expected_cover(long, ParticleSizes(size, size), disparity, 1.0) for size in between]
    np.testing.assert_allclose(
        expected_cover(long, ParticleSizes(40.0, 200.0), disparity, 1.0), np.mean(single, 0), rtol=1e-3
    )


def test_particles_show_their_fronts():
    """The point of a ball that is h radii in front of its centre has disparity (d + doffs) / (1 - h r / f)."""
    still = Range(0.0, 0.0)
    heights = np.sqrt((np.arange(16) + 0.5) / 16)
    layers = DepthLayers(np.array([80.0]), np.array([80.0]))
    edges = np.array([79.0, 90.0, 100.0])
    sizes = ParticleSizes(280.0, 280.0)
    found = layers.exceedance(edges, SequenceRig((CAMERA,), 0.1), still, sizes, heights)[0]
    height = np.sqrt(np.random.default_rng(3).random(100_000))
    shown = 80 / (1 - height * 140 / CAMERA.focal_px)
    np.testing.assert_allclose(found, [(shown >= edge).mean() for edge in edges], atol=0.05)
    # Balls flattened to a relief of 70 px.
    found = layers.exceedance(edges, SequenceRig((CAMERA,), 0.1, relief_px=70.0), still, sizes, heights)[0]
    shown = 80 / (1 - height * 70 / CAMERA.focal_px)
    np.testing.assert_allclose(found, [(shown >= edge).mean() for edge in edges], atol=0.05)
    # A near plane at 1.6 m clips the balls' fronts, which are at 1.4 m.
    assert layers.exceedance(edges, SequenceRig((CAMERA,), 1.6), still, sizes, heights)[0].tolist() == [0, 0, 0]


@pytest.mark.parametrize(("density", "factor"), [("sparse", 1 / 3), ("dense", 3)])
def test_density_shares_the_area_out_to_more_or_fewer(density, factor):
    plain, sampler = sampler_of(tiny()), sampler_of(tiny(particles={"density": density}))
    number = np.mean(particles_of(sampler, 20))
    assert number == pytest.approx(factor * np.mean(particles_of(plain, 20)), rel=0.2)
    assert off_by(sampler) < 0.05


def test_stated_layers_have_numbers_from_their_range_and_by_default_the_middle_of_the_target():
    config = tiny(particles={"layers": [{"count": [0, 60]}]})
    sampler, own = sampler_of(config), config.wanted_histogram()
    px = [sampler.sample(index).sequence.slots.disparity_px for index in range(40)]
    numbers, both = [*map(len, px)], np.concatenate(px)
    assert min(numbers) < 10
    assert 50 < max(numbers) <= 60
    assert [both.min(), both.max()] == pytest.approx([own.quantile(0.1), own.quantile(0.9)], rel=0.02)
    of_mean = sampler_of(tiny(particles={"layers": [{"count": 30}]})).disparity_solver.expected()
    assert sampler.disparity_solver.expected().shares == pytest.approx(of_mean.shares)


def test_clutter_is_counted_in_what_the_target_asks_for():
    sampler = sampler_of(tiny(particles={"clutter": [{"disparity_px": [4, 6], "count": 60, "size_px": [6, 12]}]}))
    assert off_by(sampler) < 0.02
    assert particles_of(sampler, 1) > particles_of(sampler_of(tiny()), 1)


@pytest.mark.parametrize(
    ("name", "sections"),
    [
        ("kitti", {}),
        ("sceneflow", {"disparity": {"max_px": 25.0, "target": {"form": "uniform", "low_px": 0.0, "high_px": 24.0}}}),
        ("sceneflow", {"disparity": {"max_px": 27.5, "target": TWO_HUMPS}}),
    ],
    ids=["kitti", "uniform", "two-humps"],
)
def test_rendered_histograms_follow_their_targets(name, sections):
    """The limits are three times the distances over 200 pairs in benchmarks/results/targets.json."""
    config = tiny(name, **sections).model_copy(update={"truth": "left", "outputs": ()})
    wanted = config.wanted_histogram()
    counts, medians = 0, []
    with PairRenderer(config, 0) as pairs:
        for index in range(16):
            disparity = pairs.render(index).frame.left.disparity
            counts += count_pixels(disparity, wanted.edges_px)
            medians.append(np.median(disparity))
    shown = Histogram.from_counts(wanted.edges_px, counts)
    assert total_variation(wanted, shown) < 0.09
    assert wasserstein_px(wanted, shown) < 0.08 * wanted.mean_px
    assert np.std(medians) > 0.05 * wanted.mean_px


# Models


def test_kinds_have_weights_within_their_family():
    section = load_config("middlebury", {"models.kinds": {"cube": 0, "sphere": 7}, "models.variants": 1}).models
    library = build_library(section, ParticlesSection(), Split(0))
    chance = {mesh.name: c for mesh, c in zip(library.models, library.chances, strict=True)}
    assert "cube" not in chance
    assert chance["sphere"] == pytest.approx(7 * chance["cone"])


@pytest.mark.parametrize(
    ("count", "weights", "share"),
    [
        (2, {}, 2 / 25 / (2 + 2 / 25)),  # about the share of two of the 50 built-in kinds
        (30, {}, 1 / 3),
        (2, {"user": 25.0}, 1 / 2),
    ],
)
def test_a_few_models_of_the_users_are_a_few_of_all(monkeypatch, count, weights, share):
    cube = SIMPLE_KINDS["cube"](np.random.default_rng(0))
    own = [replace(cube, name=f"{number}.obj") for number in range(count)]
    monkeypatch.setattr(model_files, "load_models", lambda _: (own, []))
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", "off")
    few = dict.fromkeys([*SIMPLE_KINDS, *COMPLEX_KINDS], 0) | {"cube": 1, "table": 1}
    keys = {"variants": 1, "folders": ["absent"], "kinds": few} | weights
    section = load_config("middlebury", {f"models.{key}": value for key, value in keys.items()}).models
    library = build_library(section, ParticlesSection(), Split(0))
    assert library.user_count == count == sum(mesh.name.endswith(".obj") for mesh in library.models)
    assert library.chances[:count] == pytest.approx([share / count] * count)
