"""Samples the scene of pair i of a dataset from only the config, the seed and i."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from semisynth_gl.config import Config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.histogram import Histogram
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.catalogue import SURFACE_MODELS, make_catalogue
from semisynth_gl.scene.disparity_solver import DisparitySolver
from semisynth_gl.scene.instances import INSTANCE, Instances, PatchAssignment, choose, new_instances, to_scene
from semisynth_gl.scene.particles import ParticleGeneration, particle_poses, sample_generation, sample_slots
from semisynth_gl.scene.projector import sample_projector
from semisynth_gl.scene.resting import come_to_rest, triangles_of
from semisynth_gl.scene.scene import Scene, SceneMotion
from semisynth_gl.scene.static_scene import sample_static_scene
from semisynth_gl.scene.view_volume import least_sphere_depth_m
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Patch

# Separates a generation's number from an attempt's number in the keys of random generators; no generation has it.
_REDONE = 2**31
# The keys of negative generations lie above this, those of the other generations below.
_BEFORE = 2**30


class SceneSampler:
    """Samples the scenes of one recipe of a dataset.

    Args:
        config: the recipe's config; recipes in it are ignored.
        seed: the dataset's seed.
        library: the models, from the same config and seed.
        patches: the atlas's patches, from the same config and seed, with small patches before large ones.
        recipe: the recipe's name; None where the dataset has no recipes.
        wanted: the distribution of disparity that the scenes aim for; by default the config's.
    """

    def __init__(
        self,
        config: Config,
        seed: int,
        library: ModelLibrary,
        patches: tuple[Patch, ...],
        recipe: str | None = None,
        wanted: Histogram | None = None,
    ) -> None:
        self.config, self.seed, self.patches, self.recipe = config, seed, patches, recipe
        self.catalogue = make_catalogue(library)
        self.models = self.catalogue.models  # `Scene.model` indexes them: the surface models, then the library's
        self.disparity_solver = DisparitySolver(config, seed, library.relief, self.catalogue, wanted)
        self.patch_assignment = PatchAssignment(config.textures, patches)
        self.particle_models = len(SURFACE_MODELS) + library.sampled
        self.chances = np.cumsum(library.chances)
        self._latest: SequenceSampler | None = None

    def sample(self, index: int, attempt: int = 0) -> "SampledScene":
        """Sample the scene of pair ``index``, 0 or more; each ``attempt`` samples the pair's whole sequence anew.

        Raises:
            InputError: where the config's disparities cannot be met, see `sample_static_scene` and
                `DisparitySolver.sample`.
        """
        scene, view = divmod(index, self.config.views)
        number, frame = divmod(scene, self.config.sequence.length)
        if self._latest is None or (self._latest.number, self._latest.attempt) != (number, attempt):
            self._latest = SequenceSampler(self, number, attempt)
        return self._latest.sample(frame, view)


class SequenceSampler:
    """The part of the scenes of one sequence that all its frames share; frames can be sampled in any order.

    ``attempt`` is the number of failed attempts at this sequence so far.
    """

    def __init__(self, sampler: SceneSampler, number: int, attempt: int) -> None:
        self.sampler, self.number, self.attempt = sampler, number, attempt
        config = sampler.config
        self.static = static = sample_static_scene(config, sampler.catalogue, self._generator)
        rig, rng = static.rig, self._generator(Purpose.PARTICLES, 0)
        # The sequence's number determines the numbers of particles; see step 5 of the solver. A repeated attempt uses a
        # number that no dataset reaches, so that they differ.
        layers = sampler.disparity_solver.sample(number + _REDONE * attempt, rig.camera, static.bare_px, rng)
        self.slots = sample_slots(rig, config.particles, layers, rng)
        section = config.projector
        self.projector = None if section is None else sample_projector(section, self._generator(Purpose.PROJECTOR))
        self.slots = replace(self.slots, resting=self._resting_poses())

    def sample(self, frame: int, view: int) -> "SampledScene":
        """Sample the scene of a frame with the camera of a right view; the frame may be outside of the sequence."""
        static, rig, patch_assignment = self.static, self.static.rig, self.sampler.patch_assignment
        table = np.concatenate([static.instances, self._particles(frame)], dtype=INSTANCE)
        # No two particles share a texture.
        count = len(static.instances)
        table["texture"][count:] = np.arange(count, len(table))
        slot, generation = table["slot"][count:], table["generation"][count:]
        static_uniform = self._generator(Purpose.TEXTURE, 0).random((count, 4))
        slot_uniform = self._per_slot(Purpose.TEXTURE, generation, slot, 4)
        patch_assignment.apply(table, np.concatenate([static_uniform, slot_uniform]), rig.camera)
        layer, pose = patch_assignment.layers(table["patch"], self.number, frame), self.camera_from_world(frame)
        scene = to_scene(table, rig.views[view], rig.near_m, pose, layer, self.projector)
        return SampledScene(scene, table, self, frame, view)

    def camera_from_world(self, frame: float) -> Floats:
        """Return the left camera's pose, (4, 4), at a frame or between frames."""
        return self.static.rig.sway.camera_from_world(frame * self.sampler.config.sequence.frame_s)

    def particle_poses(self, frame: float, generation: Ints) -> Floats:
        """Return the poses (S, 4, 4) at a frame of all slots' models of given generations (S,)."""
        config, camera = self.sampler.config, self.static.rig.camera

        def generation_values(number: int) -> ParticleGeneration:
            return sample_generation(
                camera, config.particles, self.slots, self._of_generation(Purpose.PARTICLES, number)
            )

        return particle_poses(camera, self.slots, generation_values, frame * config.sequence.frame_s, generation)

    def _particles(self, frame: int) -> Instances:
        """Return the table of a frame's particles, falling and resting."""
        slots, shown = self.slots, self.slots.generation(frame * self.sampler.config.sequence.frame_s)
        # All these models are beyond the near plane, so no camera is inside a model.
        slot = np.flatnonzero(slots.shown)
        generation, pose = shown[slot], self.particle_poses(frame, shown)[slot]
        model = self._models(generation, slot)
        return new_instances(
            len(slot),
            model=model,
            pose=pose,
            # Length of one UV unit: the model's unit times the mean of its scales along the axes.
            unit_m=np.linalg.norm(pose[:, :3, :3], axis=1).mean(axis=1)[:, None],
            # The depth of the path's middle does not change, so a texture does not slide over its model.
            depth_m=slots.depth_m[slot],
            uv_low=self.sampler.catalogue.uv_low[model],
            uv_high=self.sampler.catalogue.uv_high[model],
            slot=slot,
            generation=generation,
            resting=np.isin(slot, list(slots.resting)),
        )

    def _resting_poses(self) -> dict[int, Floats]:
        """Choose slots, and lower their first models onto the surfaces below; return the poses (4, 4) by slot."""
        static, slots, models, camera = self.static, self.slots, self.sampler.models, self.static.rig.camera
        chance = self._generator(Purpose.RESTING).random(len(slots))
        chosen = np.flatnonzero(chance < self.sampler.config.particles.resting)
        if not len(chosen):
            return {}
        generation = np.zeros(len(slots), np.int64)
        poses, radius_m = self.particle_poses(0.0, generation), slots.radius_m(camera)
        meshes = [models[number] for number in self._models(generation[chosen], chosen)]
        ground = static.instances[~static.instances["sky"]]
        corners = triangles_of(models, ground["model"], ground["pose"])
        resting = {}
        for number, pose in come_to_rest(poses[chosen], meshes, corners, static.up).items():
            slot = int(chosen[number])
            x, y, z = pose[:3, 3]
            row = camera.cy_px + camera.focal_y_px * y / z
            least_m = least_sphere_depth_m(static.rig, radius_m[slot] * slots.flatness[slot], np.hypot(x, y))
            if z > least_m and -0.5 < row < camera.height_px - 0.5:
                resting[slot] = pose
        return resting

    def _models(self, generation: Ints, slot: Ints) -> Ints:
        """Return, for N slots and generations, the index of the model into the sampler's models: (N,)."""
        sampler, chance = self.sampler, self._per_slot(Purpose.SHAPE, generation, slot, 1)[:, 0]
        return sampler.particle_models[choose(sampler.chances, chance)]

    def _generator(self, purpose: Purpose, *numbers: int) -> np.random.Generator:
        redone = (_REDONE, self.attempt) if self.attempt else ()
        return generator(self.sampler.seed, purpose, self.number, *numbers, *redone)

    def _of_generation(self, purpose: Purpose, generation: int) -> np.random.Generator:
        """Return the generator of one generation. Key 0 of PARTICLES and TEXTURE is for what all generations share."""
        key = generation if generation >= 0 else _BEFORE - generation
        return self._generator(purpose, key + (purpose is not Purpose.SHAPE))

    def _per_slot(self, purpose: Purpose, generation: Ints, slot: Ints, width: int) -> Floats:
        """Return uniform random numbers (N, width) for N slots and generations; they do not depend on other slots."""
        result = np.empty((len(slot), width))
        for number in np.unique(generation):
            rows = generation == number
            rng = self._of_generation(purpose, int(number))
            result[rows] = rng.random((int(slot[rows].max()) + 1, width))[slot[rows]]
        return result


@dataclass(frozen=True, slots=True, eq=False)
class SampledScene:
    """The scene of one pair, with the table of its instances and its place in the dataset."""

    scene: Scene
    instances: Instances  # (N,) in the order of the scene's arrays; the static instances come first
    sequence: SequenceSampler
    frame: int  # number of the frame within the sequence
    view: int  # number of the right view whose camera the scene has

    @property
    def recipe(self) -> str | None:
        """Name of the scene's recipe; None where the config has no recipes."""
        return self.sequence.sampler.recipe

    @property
    def views(self) -> tuple[StereoCamera, ...]:
        """The camera of each right view; the cameras differ only in the right eye."""
        return self.sequence.static.rig.views

    def seen_by(self, view: int) -> "SampledScene":
        """Return the same scene with the camera of the right view ``view``."""
        return replace(self, scene=replace(self.scene, camera=self.views[view]), view=view)

    def motion(self, frames: int) -> SceneMotion:
        """Return the motion of the instances over ``frames`` frames, even beyond the ends of the sequence."""
        target = self.sequence.sample(self.frame + frames, self.view)
        static = len(self.sequence.static.instances)
        now, then = self.instances[static:], target.instances[static:]
        # A model is gone if its slot shows no model at the target moment, or a model of a different generation.
        row_of_slot = np.full(len(self.sequence.slots), -1)
        row_of_slot[then["slot"]] = np.arange(len(then))
        row = row_of_slot[now["slot"]]
        stays = row >= 0
        stays[stays] = then["generation"][row[stays]] == now["generation"][stays]
        instance = np.concatenate([np.arange(static), np.where(stays, static + row, -1)])
        return SceneMotion(target.scene, self._poses(target.frame), instance)

    def moment(self, frames: float) -> Scene:
        """Return the scene with the same instances, ``frames`` frames or fractions of a frame later."""
        pose = self.sequence.camera_from_world(self.frame + frames)
        return replace(self.scene, camera_from_world=pose, world_from_model=self._poses(self.frame + frames))

    def _poses(self, frame: float) -> Floats:
        """Return the poses (N, 4, 4) of these instances at any frame, even one that does not show them."""
        poses, moving = self.instances["pose"].copy(), self.instances["slot"] >= 0
        slots, generation = self.instances["slot"][moving], np.zeros(len(self.sequence.slots), np.int64)
        generation[slots] = self.instances["generation"][moving]
        poses[moving] = self.sequence.particle_poses(frame, generation)[slots]
        return poses

    def provenance(self) -> dict[str, Any]:
        """Return the origin of the pair's scene, in JSON's types.

        ``models`` and ``images`` hold the number of instances by name; ``patches`` are indices into the dataset's
        patches.
        """
        scene, sampler, patches = self.scene, self.sequence.sampler, self.instances["patch"].tolist()
        models = Counter(sampler.models[index].name for index in scene.model.tolist())
        images = Counter(sampler.patches[index].source for index in patches)
        return {
            "sequence": self.sequence.number,
            "frame": self.frame,
            **({"view": self.view} if len(self.views) > 1 else {}),
            **({} if self.recipe is None else {"recipe": self.recipe}),
            "background": self.sequence.static.background,
            **({"sky": True} if scene.sky.any() else {}),
            **({} if scene.projector is None else {"projector": scene.projector.record()}),
            "near_m": scene.near_m,
            "camera": scene.camera.values(deviation=not sampler.config.rig.is_rectified()),
            "camera_from_world": scene.camera_from_world[:3].tolist(),
            "models": dict(sorted(models.items())),
            "images": dict(sorted(images.items())),
            "patches": sorted(set(patches)),
        }

    def instance_table(self) -> list[dict[str, Any]]:
        """Return a row for each instance, in JSON's types; row k describes id k + 1 of the output ``instances``."""
        models = self.sequence.sampler.models
        return [
            {
                "model": models[row["model"]].name,
                "patch": int(row["patch"]),
                # True for surface models: walls, grounds, panels, and boxes such as pillars, rugs and houses. False for
                # all other models, even for furniture, which does not move either.
                "still": bool(row["model"] < len(SURFACE_MODELS)),
                **({"resting": True} if row["resting"] else {}),
                **({"sky": True} if row["sky"] else {}),
                "world_from_model": row["pose"][:3].tolist(),
            }
            for row in self.instances
        ]
