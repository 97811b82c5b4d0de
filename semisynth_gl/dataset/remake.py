"""The scenes of a finished dataset, made again from its index: config, seed and patches."""

from pydantic import ValidationError

from semisynth_gl.config import Config
from semisynth_gl.dataset.reader import Index
from semisynth_gl.dataset.stored import StoredFrame
from semisynth_gl.errors import InputError
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.scene.sampler import SampledScene, SceneSampler
from semisynth_gl.scene.scene import Motion, Scene
from semisynth_gl.splits import SplitName
from semisynth_gl.textures.atlas import Patch


class RemadeScenes:
    """Makes the scenes of a split again. Photographs are not needed: patches colour a scene and do not shape it.

    Args:
        index: the dataset's.
        split: whose scenes.

    Attributes:
        config: the dataset's.
        seed: the dataset's.
        models: the meshes that `Scene.model` counts.

    Raises:
        InputError: where its config, seed or patches are not this version's, or its models are not there.
    """

    def __init__(self, index: Index, split: SplitName) -> None:
        values = index.values
        try:
            self.config = Config.model_validate(index.config)
            patches = tuple(
                Patch(**{name: patch[name] for name in Patch.__slots__}) for patch in values["splits"][split]["patches"]
            )
            self.seed = int(values["seed"])
            part = self.config.splits.split(split, tuple(index.pairs))
        except (ValidationError, KeyError, TypeError, ValueError) as error:
            reason = " ".join(str(error).splitlines()[:3]) if index.fault is None else index.fault
            raise InputError(
                f"{index.place.address}: the scenes cannot be made again from the index: {reason}"
            ) from None
        if not patches or self.seed < 0:
            raise InputError(
                f"{index.place.address}: the scenes cannot be made again from the index: expected patches and a "
                f"seed of 0 or more, got {len(patches)} and {self.seed}"
            )
        library = build_library(self.config.models, self.config.particles, self.seed, part)
        self._sampler = SceneSampler(self.config, part.seed(self.seed), library, patches)
        self.models: tuple[Mesh, ...] = self._sampler.models

    def sampled(self, frame: StoredFrame) -> SampledScene | None:
        """Make a pair's scene again, with what it was made of.

        Args:
            frame: the pair as it was read.

        Returns:
            The scene; None where config and seed give another camera than the pair's provenance has.
        """
        # A sequence whose first frame failed the config's checks was drawn again, once for each entry.
        redrawn = frame.provenance.get("redrawn")
        made = self._sampler.sample(frame.index, len(redrawn) if isinstance(redrawn, list) else 0)
        recorded, camera = frame.provenance.get("camera"), made.scene.camera
        if not isinstance(recorded, dict) or any(
            recorded.get(name) != getattr(camera, name) for name in camera.__slots__
        ):
            return None
        return made

    def scene(self, frame: StoredFrame) -> Scene | None:
        """Make a pair's scene again; see `sampled`."""
        made = self.sampled(frame)
        return None if made is None else made.scene

    def motion(self, made: SampledScene, frames: int) -> Motion:
        """Return how a scene that was made again gets to another frame; see `SceneSampler.motion`."""
        return self._sampler.motion(made, frames)
