"""Digests of patches and models differ between sources, and are the same on all processors."""

from dataclasses import replace

import numpy as np
import pytest
from photograph_like import octaves, save
from tiny_datasets import cheap, tiny

from semisynth_gl.scene.sources import SceneSources, prepare_sources
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures import sources as texture_sources

# Functions whose last bit differs between processors.
FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "arctan2", "arcsin", "arccos")


@pytest.fixture(autouse=True)
def no_cache(monkeypatch):
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", "off")


def with_other_last_bits(function, rng):
    """Move a function's results up or down by their last bit, except for zeros and ones."""

    def moved(*arguments, **options):
        exact = np.asarray(function(*arguments, **options))
        upwards = np.where(rng.random(exact.shape) < 0.5, np.inf, -np.inf).astype(exact.dtype)
        return np.where((exact == 0) | (np.abs(exact) == 1), exact, np.nextafter(exact, upwards))[()]

    return moved


def test_checksums_are_the_same_where_the_last_bits_of_functions_differ(monkeypatch):
    monkeypatch.setattr(texture_sources, "KINDS", texture_sources.KINDS[:2])
    config = tiny(textures={"source": "builtin", "large_px": 128, "max_patches": 16})
    here = prepare_sources(config, Split(2))
    rng = np.random.default_rng(0)
    for name in FUNCTIONS:
        monkeypatch.setattr(np, name, with_other_last_bits(getattr(np, name), rng))
    there = prepare_sources(config, Split(2))
    pairs = list(zip(here.models, there.models, strict=True))
    assert sum(one.uv.tobytes() != other.uv.tobytes() for one, other in pairs) > 20
    assert max(np.abs(one.positions - other.positions).max() for one, other in pairs) < 1e-6
    assert max(np.abs(one.uv - other.uv).max() for one, other in pairs) < 1e-5
    assert here.digests() == there.digests()


@pytest.mark.parametrize(("source", "patches"), [("procedural", "a042c0c8"), ("images", "75b26116")])
def test_models_of_all_kinds_and_patches_have_the_recorded_checksums(tmp_path, source, patches):
    """After an intended change of models or patches, record the new digests here."""
    paths = save(tmp_path, **{f"{number}": octaves(number) for number in range(4)})
    textures = {"source": source, "images": list(map(str, paths)) if source == "images" else [], "large_px": 128}
    found = prepare_sources(cheap(textures=textures, models={"complex": 1}), Split(2)).digests()
    assert found == {"patches": patches, "models": "e5e1cf22"}


@pytest.fixture(scope="module")
def sources():
    return prepare_sources(cheap(textures={"large_px": 128}), Split(2))


def darkened(layers):
    layers, side = layers.copy(), layers.shape[1] // 4
    layers[-1, :side, -side:, 1] //= 2
    return layers


# Changes of an atlas's layers and last patch, and of a library's first model, relief and chances.
OF_LAYERS = dict.fromkeys(("layers", "large_layers"), darkened)
OF_PATCH = {"source": lambda _: "other.png", "left_px": lambda left: left + 1}
OF_MODEL = dict.fromkeys(("positions", "uv"), lambda array: array + np.float32(2e-5)) | {"triangles": np.flipud}
OF_RELIEF = dict.fromkeys(("fill", "heights"), lambda value: value + 2e-5)
OF_LIBRARY = {"chances": lambda chances: chances * np.linspace(0.99, 1.01, len(chances))}


def changed(whole, changes, part):
    return replace(whole, **{part: changes[part](getattr(whole, part))}) if part in changes else whole


@pytest.mark.parametrize("part", [*OF_LAYERS, *OF_PATCH, *OF_MODEL, *OF_RELIEF, *OF_LIBRARY])
def test_each_part_of_patches_and_models_counts_in_its_checksum(sources, part):
    atlas, library = changed(sources.atlas, OF_LAYERS, part), changed(sources.libraries[0], OF_LIBRARY, part)
    atlas = replace(atlas, patches=(*atlas.patches[:-1], changed(atlas.patches[-1], OF_PATCH, part)))
    models = changed(library.models[0], OF_MODEL, part), *library.models[1:]
    library = replace(library, models=models, relief=changed(library.relief, OF_RELIEF, part))
    before, after = sources.digests(), SceneSources(atlas, (library,)).digests()
    patches = part in OF_LAYERS or part in OF_PATCH
    assert [name for name in before if before[name] != after[name]] == ["patches" if patches else "models"]
