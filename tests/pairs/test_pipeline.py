"""The pipeline from a config to files: determinism, real photographs and models, constant memory."""

import weakref
from importlib.metadata import version
from mmap import PAGESIZE
from pathlib import Path

import numpy as np
import pytest
from photograph_like import octaves, save
from scenes import assert_equal
from shared_material import SHARED, needs_shared
from tiny_datasets import cheap, lean, tiny

import semisynth_gl
from semisynth_gl.config import packaged_configs
from semisynth_gl.frame.channels import OCCLUDED, OUTSIDE, VISIBLE
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.pairs.pipeline import PairRenderer


@pytest.mark.one_backend
@pytest.mark.parametrize("name", packaged_configs())
def test_packaged_configs_render_dense_valid_truth(tmp_path, name, backend):
    save(tmp_path, one=octaves(0), other=octaves(1))
    config = tiny(name, textures={"images": [str(tmp_path)]} if name == "ablation-textures-target" else {})
    with PairRenderer(config, 0, backend) as pairs:
        for index in range(2):
            frame = pairs.render(index).frame
            for disparity in (frame.left.disparity, frame.right.disparity):
                assert np.isfinite(disparity).all()
                assert disparity.min() > 0
                assert disparity.max() <= config.disparity.max_px * (1 + 1e-6)
            assert (frame.left.visibility == VISIBLE).mean() > 0.3
            assert set(np.unique(frame.left.visibility)) <= {OUTSIDE, OCCLUDED, VISIBLE}
            assert frame.left.image.std() > 10


@needs_shared
@pytest.mark.one_backend
def test_real_photographs_and_models_go_through(backend):
    images = [str(SHARED / "textures"), str(SHARED / "hostile")]
    config = tiny(
        textures={"source": "images", "images": images, "max_patches": 512},  # enough to open every image
        models={"simple": 0.0, "complex": 0.0, "folders": [str(SHARED / "models")]},
    )
    with PairRenderer(config, 0, backend) as pairs:
        reasons = {skipped.path.name: skipped.reason for skipped in pairs.sources.atlas.report.images_skipped}
        assert set(reasons) == {"png_bomb_65536.png", "truncated.jpg"}
        skipped = {each.path.name for each in pairs.sources.skipped_models}
        assert skipped == {"empty.obj", "BoxWithInfinites.glb"}
        assert len(pairs.sources.models) == 15
        assert "Duck.glb" in {mesh.name for mesh in pairs.sources.models}
        assert any(".png" in name or ".jpg" in name for name in pairs.render(0).provenance["images"])


def test_pixels_that_the_driver_has_may_be_forgotten(backend):
    textures = {"source": "procedural", "max_patches": 16}
    with PairRenderer(cheap(textures=textures), 0, backend) as pairs:
        before, digests = pairs.render(0), pairs.sources.digests()
        layers = weakref.ref(pairs.sources.atlas.layers)
        assert len(layers()) == 16
        pairs.forget_pixels()
        assert layers() is None
        after = pairs.render(0)
        assert pairs.sources.digests()["models"] == digests["models"]
    assert after.provenance == before.provenance
    assert_equal(after.frame, before.frame)


def resident_pages():
    """Return the resident memory in pages; getrusage's peak may come from an earlier test."""
    return int(Path("/proc/self/statm").read_text().split()[1])


@pytest.mark.one_backend
def test_memory_stays_flat_over_many_pairs(backend):
    config = lean(models={"complex": 0.0}, particles={"layers": [{"disparity_px": [2, 30], "count": 15}]})
    with PairRenderer(config, 0, backend) as pairs:
        for index in range(40):
            pairs.render(index)
        before = resident_pages()
        for index in range(40, 160):
            pairs.render(index)
        after = resident_pages()
    # A leak of each pair's images and truth would add 120 * 0.4 MB.
    assert (after - before) * PAGESIZE < 8_000_000


def test_user_models_alone(tmp_path, backend):
    config = tiny(models={"simple": 0.0, "complex": 0.0})
    with pytest.raises(InputError, match="no models to sample"):
        PairRenderer(config, 0, backend)
    (tmp_path / "tetra.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    config = tiny(models={"simple": 0.0, "complex": 0.0, "folders": [str(tmp_path)]})
    with PairRenderer(config, 0, backend) as pairs:
        assert set(pairs.render(0).provenance["models"]) <= {"face", "tetra.obj"}


def test_the_package_offers_its_public_names():
    assert dir(semisynth_gl) == semisynth_gl.__all__
    assert semisynth_gl.__version__ == version("semisynth-gl")
    for name in semisynth_gl.__all__:
        assert getattr(semisynth_gl, name).__name__ == name
    with pytest.raises(AttributeError, match="nonsense"):
        _ = semisynth_gl.nonsense
