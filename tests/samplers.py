"""Scene samplers with a config's models, and patches without pixels."""

from functools import cache

from semisynth_gl.config import Config, load_config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.scene.catalogue import ModelCatalogue, make_catalogue
from semisynth_gl.scene.rig import SequenceRig
from semisynth_gl.scene.sampler import SceneSampler
from semisynth_gl.scene.static_scene import StaticScene, sample_static_scene
from semisynth_gl.seeds.seeds import generator
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures.atlas import Patch


def patches(count: int = 5, frames: int = 1) -> tuple[Patch, ...]:
    """Make patches, each of another photograph, or of another image sequence if ``frames`` > 1."""
    return tuple(Patch(f"{i}.png", 0, 0, 256, i * frames, frames, 9.0) for i in range(count))


def sampler_of(config: Config, seed: int = 0, atlas_patches: tuple[Patch, ...] = patches(1)) -> SceneSampler:
    """Make the sampler of a config without recipes."""
    return SceneSampler(config, seed, build_library(config.models, config.particles, Split(seed)), atlas_patches)


@cache
def catalogue() -> ModelCatalogue:
    """Build one model of each kind."""
    config = load_config("middlebury", ["models.variants=1"])
    return make_catalogue(build_library(config.models, config.particles, Split(0)))


def still_rig(camera: StereoCamera, max_px: float) -> SequenceRig:
    """Return a rig that does not sway, with its near plane at the disparity ``max_px``."""
    return SequenceRig((camera,), float(camera.depth_m(max_px)))


def static_scene_of(config: Config, seed: int) -> StaticScene:
    """Sample a static scene of the catalogue's models."""
    return sample_static_scene(config, catalogue(), lambda purpose: generator(seed, purpose))
