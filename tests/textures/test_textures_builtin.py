"""Patches without the user's photographs: procedural ones, and the photographs that scikit-image ships."""

from importlib.machinery import ModuleSpec
from pathlib import Path

import numpy as np
import pytest

from semisynth_gl.inputs.errors import InputError
from semisynth_gl.textures import image_files
from semisynth_gl.textures.crops import texture_measure
from semisynth_gl.textures.image_files import builtin_photographs
from semisynth_gl.textures.images import read_image
from semisynth_gl.textures.procedural import procedural_atlas


@pytest.mark.parametrize("side_px", [16, 33, 128])
def test_procedural_patches_have_texture_and_come_from_the_generator_alone(side_px: int) -> None:
    first, again, other = (procedural_atlas(np.random.default_rng(seed), 20, side_px).layers for seed in (1, 1, 2))
    assert (first.shape, first.dtype) == ((20, side_px, side_px, 4), np.uint8)
    assert min(texture_measure(layer[..., :3]) for layer in first) > 3.0
    np.testing.assert_array_equal(first, again)
    assert len({layer.tobytes() for layer in (*first, *other)}) == 40


def test_builtin_photographs_are_there_and_none_is_an_evaluation_image() -> None:
    paths = builtin_photographs()
    assert len(paths) >= 8
    assert not any("motorcycle" in path.name for path in paths)
    for path in paths:
        assert min(read_image(path).shape[:2]) >= 300


@pytest.mark.parametrize("is_installed", [False, True])
def test_photographs_that_are_not_there_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *, is_installed: bool
) -> None:
    spec = ModuleSpec("skimage", None, is_package=True)
    spec.submodule_search_locations = [str(tmp_path)]
    monkeypatch.setattr(image_files, "find_spec", lambda _: spec if is_installed else None)
    with pytest.raises(InputError, match="astronaut" if is_installed else "scikit-image") as caught:
        builtin_photographs()
    assert "textures.images" in str(caught.value)
