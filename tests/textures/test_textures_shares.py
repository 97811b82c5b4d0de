"""Surfaces show all images equally often."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from samplers import sampler_of
from tiny_datasets import cheap

from semisynth_gl.textures.atlas import Patch
from semisynth_gl.textures.subjects import MOST_TIMES, equal_shares, patch_chances


@given(st.lists(st.integers(1, 300), min_size=1, max_size=40))
def test_images_have_an_equal_say_but_for_those_with_too_few_patches(counts):
    by_name = {str(number): count for number, count in enumerate(counts)}
    shares = equal_shares(by_name)
    assert sum(shares.values()) == pytest.approx(1)
    most = {name: MOST_TIMES * count / sum(counts) for name, count in by_name.items()}
    assert all(shares[name] <= most[name] + 1e-12 for name in shares)
    free = [shares[name] for name in shares if shares[name] < most[name] - 1e-9]
    assert free == pytest.approx([max(shares.values())] * len(free))


def test_patches_share_the_chance_of_their_subject():
    sources = [*("a",) * 20, "b", "b", "a", "b"]
    # a has 21 patches; the limit MOST_TIMES applies to b's three.
    expected = np.where(np.array(sources) == "b", MOST_TIMES / 24, (1 - 3 * MOST_TIMES / 24) / 21)
    assert patch_chances(sources) == pytest.approx(expected)
    assert patch_chances([]).size == 0


def numbers_of_patches(config, patches, scenes):
    """Return the patch numbers of many surfaces: with small patches, and with large ones."""
    sampler = sampler_of(config, atlas_patches=patches)
    sampled = [sampler.sample(number) for number in range(scenes)]
    patch = np.concatenate([each.instances["patch"] for each in sampled])
    large = np.array([each.large for each in patches])[patch]
    return patch[~large], patch[large]


def test_surfaces_wear_subjects_equally_often():
    counts = {"huge": 60, "middling": 20, "little": 9}
    # The first subject has three photographs.
    sources = {"huge": "abc", "middling": ["middling"], "little": ["little"]}
    small = [
        Patch(sources[name][number % len(sources[name])], 0, 0, 64, 0, 1, 9.0, subject=name)
        for name, count in counts.items()
        for number in range(count)
    ]
    large = [Patch(name, 0, 0, 64, 0, 1, 9.0, large=True) for name in counts]
    patches = tuple(replace(patch, first_layer=layer) for layer, patch in enumerate([*small, *large]))
    particles = {"layers": [{"disparity_px": [2, 12], "count": 150}]}
    config = cheap(textures={"large_px": 64}, particles=particles, structures={"panels": 8, "ground": 0})
    for seen in numbers_of_patches(config, patches, 12):
        assert len(seen) > 100
        tolerance = 4 * np.sqrt(0.25 / len(seen))  # 4 standard deviations
        names = Counter(patches[number].subject_name for number in seen)
        assert [names[name] / len(seen) for name in counts] == pytest.approx([1 / 3] * 3, abs=tolerance)
