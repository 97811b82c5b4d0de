"""Checksums of patches and models: others for other sources, and the same on all processors."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from tiny_datasets import cheap, tiny

from semisynth_gl.scene.sources import Sources, prepare_sources
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures import drawn

# Libraries of these differ in the last bit from processor to processor.
FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "arctan2", "arcsin", "arccos")


@pytest.fixture(autouse=True)
def no_cache(monkeypatch):
    monkeypatch.setenv("SEMISYNTH_GL_CACHE", "off")


def with_other_last_bits(function, rng):
    """Move a function's results up or down by their last bit, but for zeros and ones."""

    def moved(*arguments, **options):
        exact = np.asarray(function(*arguments, **options))
        upwards = np.where(rng.random(exact.shape) < 0.5, np.inf, -np.inf).astype(exact.dtype)
        return np.where((exact == 0) | (np.abs(exact) == 1), exact, np.nextafter(exact, upwards))[()]

    return moved


def test_checksums_are_the_same_where_the_last_bits_of_functions_differ(monkeypatch):
    monkeypatch.setattr(drawn, "KINDS", drawn.KINDS[:4])
    config = tiny(textures={"source": "builtin", "large_px": 128})
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


def save_photographs(folder, **options):
    folder.mkdir(exist_ok=True)
    for number in range(2):
        coarse = np.random.default_rng(number).integers(0, 256, (40, 40, 3), dtype=np.uint8)
        picture = Image.fromarray(coarse).resize((256, 256), Image.Resampling.BICUBIC)
        picture.save(folder / f"{number}.jpg", **options)


def test_other_pixels_have_another_checksum(tmp_path):
    config = cheap(textures={"source": "images", "images": [str(tmp_path / "photographs")], "large_px": 128})

    def digests():
        return prepare_sources(config, Split(2)).digests()

    save_photographs(tmp_path / "photographs", quality=90)
    before = digests()
    assert digests() == before
    save_photographs(tmp_path / "photographs", quality=85)
    assert digests()["patches"] != before["patches"]
    assert digests()["models"] == before["models"]


@pytest.fixture(scope="module")
def sources():
    return prepare_sources(cheap(textures={"large_px": 128}), Split(2))


def changed(sources, place):
    atlas, library = sources.atlas, sources.libraries[0]
    first, *others = library.models
    if place in {"layers", "large_layers"}:
        layers = getattr(atlas, place).copy()
        side = layers.shape[1] // 4
        layers[-1, :side, -side:, 1] //= 2
        return Sources(replace(atlas, **{place: layers}), sources.libraries)
    if place in {"source", "left_px"}:
        *some, last = atlas.patches
        value = {"source": "other.png", "left_px": last.left_px + 1}[place]
        return Sources(replace(atlas, patches=(*some, replace(last, **{place: value}))), sources.libraries)
    if place in {"positions", "uv"}:
        array = getattr(first, place).copy()
        array[0, 0] += 2e-5
        first = replace(first, **{place: array})
    if place == "triangles":
        first = replace(first, triangles=first.triangles[::-1].copy())
    library = replace(library, models=(first, *others))
    if place == "chances":
        library = replace(library, chances=library.chances[::-1] * np.linspace(0.99, 1.01, len(library.chances)))
    if place == "fill":
        library = replace(library, silhouette=replace(library.silhouette, fill=library.silhouette.fill + 2e-5))
    if place == "heights":
        library = replace(library, silhouette=replace(library.silhouette, heights=library.silhouette.heights + 2e-5))
    return Sources(atlas, (library,))


@pytest.mark.parametrize("place", ["layers", "large_layers", "source", "left_px"])
def test_each_part_of_a_patch_counts(sources, place):
    other = changed(sources, place).digests()
    assert other["patches"] != sources.digests()["patches"]
    assert other["models"] == sources.digests()["models"]


@pytest.mark.parametrize("place", ["positions", "uv", "triangles", "chances", "fill", "heights"])
def test_each_part_of_the_models_counts(sources, place):
    other = changed(sources, place).digests()
    assert other["models"] != sources.digests()["models"]
    assert other["patches"] == sources.digests()["patches"]
