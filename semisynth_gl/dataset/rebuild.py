"""The scenes of a finished dataset, rebuilt from the config, the seed and the patches in its index."""

from semisynth_gl.dataset.pair_files import StoredFrame
from semisynth_gl.dataset.reader import StoredIndex
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.plugins import require_plugins
from semisynth_gl.scene.mix import RecipeMixSampler
from semisynth_gl.scene.sampler import SampledScene
from semisynth_gl.scene.sources import recipe_libraries
from semisynth_gl.seeds.splits import SplitName
from semisynth_gl.textures.atlas import Patch


class RebuiltScenes:
    """Rebuilds the scenes of a split. It needs no photographs: patches colour a scene and do not shape it.

    ``config`` and ``seed`` are the dataset's, and ``models`` are the meshes that `Scene.model` indexes.

    Raises:
        InputError: where the dataset is not finished, or models are missing, or a plug-in with models is not installed
            in the same version.
    """

    def __init__(self, index: StoredIndex, split: SplitName) -> None:
        plan = index.finished_index
        sources = plan and plan.split_sources.get(split)
        if plan is None or not sources or not sources.patches:
            raise InputError(f"{index.root}: the scenes cannot be rebuilt: {index.fault or 'its index has no patches'}")
        self.config, self.seed, part = plan.config, plan.seed, plan.split(split)
        # A different version of a plug-in may make different models. Recipes of plug-ins are part of the config.
        require_plugins(f"{index.root}: the scenes cannot be rebuilt", "models", plan.plugins.get("models", {}))
        patches = tuple(Patch(**patch.values()) for patch in sources.patches)
        self._sampler = RecipeMixSampler(self.config, part.seed, recipe_libraries(self.config, part), patches)
        self.models: tuple[Mesh, ...] = self._sampler.models

    def sampled(self, frame: StoredFrame) -> SampledScene | None:
        """Rebuild a pair's scene, with the slot and generation of each instance (see `scene.particles`).

        Return None if the rebuilt scene has a different recipe or camera than the pair's provenance.
        """
        redrawn = frame.provenance.get("redrawn")  # an entry for each earlier attempt that failed the config's checks
        rebuilt = self._sampler.sample(frame.index, len(redrawn) if isinstance(redrawn, list) else 0)
        recorded, camera = frame.provenance.get("camera"), rebuilt.scene.camera
        if rebuilt.recipe != frame.recipe or not isinstance(recorded, dict):
            return None
        return rebuilt if recorded == camera.values(deviation="deviation" in recorded) else None
