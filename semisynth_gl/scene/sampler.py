"""The scene of pair i of a dataset, from only the config, the seed and i."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from semisynth_gl.config.model import Config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.histogram import Histogram
from semisynth_gl.scene import Floats, Ints
from semisynth_gl.scene.disparity_solver import DisparitySolver
from semisynth_gl.scene.instances import Instances, new_instances, to_scene
from semisynth_gl.scene.mapping import CHANCE, PatchMapping, choose
from semisynth_gl.scene.particles import Particles, Release, Slots, particles_at, sample_release, sample_slots
from semisynth_gl.scene.projector import projector_record, sample_projector
from semisynth_gl.scene.resting import come_to_rest, triangles_of
from semisynth_gl.scene.rig import relief_px
from semisynth_gl.scene.scene import Motion, Projector, Scene
from semisynth_gl.scene.structures import SURFACE_MODELS, StaticScene, sample_static_scene, take_stock
from semisynth_gl.scene.view_volume import clear_depth_m
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Patch

# Mark before the attempt's number in the keys of generators; no generation's number reaches it.
_REDRAWN = 2**31
# First key of generations that were released before time 0; no later generation's number reaches it.
_BEFORE = 2**30


@dataclass(frozen=True, slots=True, eq=False)
class SampledScene:
    """A scene with one right view's camera, and the table of its instances, of which the static ones come first."""

    scene: Scene
    static: StaticScene
    instances: Instances  # (N,) in the order of the scene's arrays
    view: int  # number of the right view whose camera the scene has
    recipe: str | None  # name of the scene's recipe; None where the config has no recipes
    sequence: int  # number of the sequence
    frame: int  # number of the frame within the sequence
    attempt: int  # number of earlier attempts at the sequence, which failed

    @property
    def views(self) -> tuple[StereoCamera, ...]:
        """The camera of each right view; the cameras differ only in the right eye."""
        return self.static.views

    def seen_by(self, view: int) -> "SampledScene":
        """Return the same scene with the camera of another right view."""
        return replace(self, scene=replace(self.scene, camera=self.views[view]), view=view)


@dataclass(frozen=True, slots=True)
class _Generators:
    """The source of one sequence's random numbers."""

    seed: int
    sequence: int
    attempt: int

    def generator(self, purpose: Purpose, *numbers: int) -> np.random.Generator:
        redrawn = (_REDRAWN, self.attempt) if self.attempt else ()
        return generator(self.seed, purpose, self.sequence, *numbers, *redrawn)

    def per_slot(self, purpose: Purpose, generation: Ints, slot: Ints, width: int, first_key: int = 0) -> Floats:
        """Return uniform random numbers (N, width) for slots and generations, (N,) each, whatever other slots exist.

        The keys of the generations' generators count from ``first_key``.
        """
        result = np.empty((len(slot), width))
        for number in np.unique(generation):
            rows = generation == number
            rng = self.generator(purpose, first_key + _generation_key(int(number)))
            result[rows] = rng.random((int(slot[rows].max()) + 1, width))[slot[rows]]
        return result


def _generation_key(generation: int) -> int:
    """Return the key of a generation's generator; keys must not be negative."""
    return generation if generation >= 0 else _BEFORE - generation


class _Sequence(NamedTuple):
    """The state that all frames of a sequence share."""

    generators: _Generators
    static: StaticScene
    slots: Slots
    projector: Projector | None


class SceneSampler:
    """Samples the scenes of one recipe.

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
        self._config = config
        self.recipe = recipe
        self._seed = seed
        self._model_library = library
        self._catalogue = take_stock(library)
        # The models that `Scene.model` refers to: the surface models, then the library.
        self.models = self._catalogue.models
        self.disparity_solver = DisparitySolver(config, seed, library.silhouette, self._catalogue, wanted)
        self._patches = patches
        self._mapping = PatchMapping(config.textures, patches)
        self._ends = np.cumsum(library.chances)
        # The lowest and the highest UV of each model, (M, 2, 2).
        self._uv = np.array([(mesh.uv.min(axis=0), mesh.uv.max(axis=0)) for mesh in library.models], np.float64)
        self._latest: _Sequence | None = None

    def sample(self, index: int, attempt: int = 0) -> SampledScene:
        """Sample the scene of pair ``index``, 0 or more; each ``attempt`` samples the pair's whole sequence anew.

        Raises:
            InputError: where the config's disparities cannot be met, see `sample_static_scene` and
                `DisparitySolver.sample`.
        """
        scene, view = divmod(index, self._config.views)
        number, frame = divmod(scene, self._config.sequence.length)
        return self._sample_frame(self._sequence(number, attempt), frame, view)

    def motion(self, sampled: SampledScene, frames: int) -> Motion:
        """Return the motion of a scene's instances to the frame that is ``frames`` later, or earlier if it is negative.

        That frame may lie before the first or after the last frame of the sequence.
        """
        sequence = self._sequence(sampled.sequence, sampled.attempt)
        target = self._sample_frame(sequence, sampled.frame + frames, sampled.view)
        static = len(sequence.static.instances)
        now, then = sampled.instances[static:], target.instances[static:]
        # A slot shows one model at a time.
        row_of_slot = np.full(len(sequence.slots), -1)
        row_of_slot[then["slot"]] = np.arange(len(then))
        row = row_of_slot[now["slot"]]
        stays = row >= 0
        stays[stays] = then["generation"][row[stays]] == now["generation"][stays]
        instance = np.concatenate([np.arange(static), np.where(stays, static + row, -1)])
        return Motion(target.scene, self._moved(sequence, sampled, target.frame), instance)

    def moment(self, sampled: SampledScene, frames: float) -> Scene:
        """Return the scene with its own instances and their textures, where they and the camera are at another moment.

        The other moment is ``frames`` frame times later, or earlier if that is negative; it need not be a whole number.
        """
        sequence = self._sequence(sampled.sequence, sampled.attempt)
        frame = sampled.frame + frames
        return replace(
            sampled.scene,
            camera_from_world=sequence.static.sway.camera_from_world(frame * self._config.sequence.frame_s),
            world_from_model=self._moved(sequence, sampled, frame),
        )

    def provenance(self, sampled: SampledScene) -> dict[str, Any]:
        """Return the origin of a pair's scene, in JSON's types.

        ``models`` and ``images`` hold the number of instances by name; ``patches`` are indices into the dataset's
        patches.
        """
        models = Counter(self.models[index].name for index in sampled.scene.model.tolist())
        images = Counter(self._patches[index].source for index in sampled.instances["patch"].tolist())
        return {
            "sequence": sampled.sequence,
            "frame": sampled.frame,
            **({"view": sampled.view} if len(sampled.views) > 1 else {}),
            **({} if sampled.recipe is None else {"recipe": sampled.recipe}),
            "background": sampled.static.background,
            **({"sky": True} if sampled.scene.sky.any() else {}),
            **({} if sampled.scene.projector is None else {"projector": projector_record(sampled.scene.projector)}),
            "near_m": sampled.scene.near_m,
            "camera": sampled.scene.camera.values(deviation=not self._config.rig.none()),
            "camera_from_world": sampled.scene.camera_from_world[:3].tolist(),
            "models": dict(sorted(models.items())),
            "images": dict(sorted(images.items())),
            "patches": np.unique(sampled.instances["patch"]).tolist(),
        }

    def instance_table(self, sampled: SampledScene) -> list[dict[str, Any]]:
        """Return a row for each instance, in JSON's types; row k describes id k + 1 of the output ``instances``."""
        return [
            {
                "model": self.models[row["model"]].name,
                "patch": int(row["patch"]),
                # In a dataset's files, "still" tells walls, grounds and panels from furniture and particles.
                "still": bool(row["model"] < len(SURFACE_MODELS)),
                **({"resting": True} if row["resting"] else {}),
                **({"sky": True} if row["sky"] else {}),
                "world_from_model": row["pose"][:3].tolist(),
            }
            for row in sampled.instances
        ]

    def _sequence(self, number: int, attempt: int) -> _Sequence:
        """Sample the state that all frames of a sequence share; the latest sequence is kept for the next call."""
        generators = _Generators(self._seed, number, attempt)
        if self._latest is None or self._latest.generators != generators:
            config = self._config
            static = sample_static_scene(config, self._catalogue, generators.generator)
            camera, near_m = static.camera, static.near_m
            rng = generators.generator(Purpose.PARTICLES, 0)
            # A sequence that is sampled again gets a number that no other sequence has.
            batches = self.disparity_solver.sample(number + _REDRAWN * attempt, camera, static.bare_px, rng)
            most_px = relief_px(camera, config.disparity.min_px, near_m)
            slots = sample_slots(camera, config.particles, batches, rng, near_m, static.sway, most_px)
            section = config.projector
            projector = None if section is None else sample_projector(section, generators.generator(Purpose.PROJECTOR))
            falling = _Sequence(generators, static, slots, projector)
            self._latest = falling._replace(slots=replace(slots, resting=self._resting(falling)))
        return self._latest

    def _resting(self, sequence: _Sequence) -> dict[int, Floats]:
        """Lower the models of some slots onto the surfaces below them; return their poses (4, 4) by slot."""
        generators, static, slots, _ = sequence
        chance = generators.generator(Purpose.RESTING).random(len(slots))
        chosen = np.flatnonzero(chance < self._config.particles.resting)
        if not len(chosen):
            return {}
        first, camera = np.zeros(len(slots), np.int64), static.camera
        particles = self._particles(sequence, 0.0, first)
        meshes = [
            self._model_library.models[number] for number in self._sampled_models(generators, first[chosen], chosen)
        ]
        ground = static.instances[~static.instances["sky"]]
        corners = triangles_of(self.models, ground["model"], ground["pose"])
        rested = come_to_rest(particles.world_from_model[chosen], meshes, corners, static.up)
        resting = {}
        for number, pose in rested.items():
            slot = int(chosen[number])
            x, y, z = pose[:3, 3]
            row = camera.cy_px + camera.focal_y_px * y / z
            radius_m = particles.radius_m[slot] * slots.flatness[slot]
            clear_m = clear_depth_m(static.near_m, radius_m, np.hypot(x, y), static.sway)
            if z > clear_m and -0.5 < row < camera.height_px - 0.5:
                resting[slot] = pose
        return resting

    def _sample_frame(self, sequence: _Sequence, frame: int, view: int) -> SampledScene:
        """Sample the scene of any frame of a sequence, as the right view of a number sees it."""
        generators, static, _, projector = sequence
        table = np.concatenate([static.instances, self._falling(sequence, frame)])
        # Particles wear textures of their own.
        count = len(static.instances)
        table["texture"][count:] = np.arange(count, len(table))
        slot, generation = table["slot"][count:], table["generation"][count:]
        of_static = generators.generator(Purpose.TEXTURE, 0).random((count, 4))
        of_slots = generators.per_slot(Purpose.TEXTURE, generation, slot, 4, first_key=1)
        self._mapping.apply(table, np.concatenate([of_static, of_slots]).view(CHANCE)[:, 0], static.camera)
        pose = static.sway.camera_from_world(frame * self._config.sequence.frame_s)
        layer = self._mapping.layers(table["patch"], generators.sequence, frame)
        return SampledScene(
            scene=to_scene(table, static.views[view], static.near_m, pose, layer, projector),
            static=static,
            instances=table,
            view=view,
            recipe=self.recipe,
            sequence=generators.sequence,
            frame=frame,
            attempt=generators.attempt,
        )

    def _falling(self, sequence: _Sequence, frame: int) -> Instances:
        """Return the table of the particles that a frame shows."""
        slots, particles = sequence.slots, self._particles(sequence, frame)
        # The near plane is in front of both cameras, so no model can swallow a camera.
        slot = np.flatnonzero(slots.shown)
        generation, pose = particles.generation[slot], particles.world_from_model[slot]
        model = self._sampled_models(sequence.generators, generation, slot)
        return new_instances(
            len(slot),
            model=len(SURFACE_MODELS) + model,
            pose=pose,
            # Length of one UV unit: a particle's model unit times the mean of its scales.
            unit_m=np.linalg.norm(pose[:, :3, :3], axis=1).mean(axis=1)[:, None],
            # Use the depth of the path's middle, not the model's: a texture must not slide over its model.
            depth_m=slots.depth_m[slot],
            uv_low=self._uv[model, 0],
            uv_high=self._uv[model, 1],
            slot=slot,
            generation=generation,
            resting=np.isin(slot, list(slots.resting)),
        )

    def _moved(self, sequence: _Sequence, sampled: SampledScene, frame: float) -> Floats:
        """Return the poses (N, 4, 4) of a scene's instances at another frame, in which they need not be visible."""
        moved, falling = sampled.instances["pose"].copy(), sampled.instances["slot"] >= 0
        slots, generation = sampled.instances["slot"][falling], np.zeros(len(sequence.slots), np.int64)
        generation[slots] = sampled.instances["generation"][falling]
        moved[falling] = self._particles(sequence, frame, generation).world_from_model[slots]
        return moved

    def _particles(self, sequence: _Sequence, frame: float, generation: Ints | None = None) -> Particles:
        """Pose the models of all slots at a frame: of given generations (S,), or of those that the frame shows."""
        camera, slots = sequence.static.camera, sequence.slots

        def release(number: int) -> Release:
            rng = sequence.generators.generator(Purpose.PARTICLES, 1 + _generation_key(number))
            return sample_release(camera, self._config.particles, slots, rng)

        return particles_at(camera, slots, release, frame * self._config.sequence.frame_s, generation)

    def _sampled_models(self, generators: _Generators, generation: Ints, slot: Ints) -> Ints:
        """Return the number, (N,), of the library's model that each of N slots shows in its generation."""
        chance = generators.per_slot(Purpose.SHAPE, generation, slot, 1)[:, 0]
        return self._model_library.drawn[choose(self._ends, chance)]
