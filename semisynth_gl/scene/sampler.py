"""The scene of pair i of a dataset, from only the config, the seed and i."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.config.model import Config
from semisynth_gl.frame.camera import StereoCamera
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.histogram import Histogram
from semisynth_gl.scene import Bools, Floats, Ints
from semisynth_gl.scene.disparity_solver import DisparitySolver
from semisynth_gl.scene.mapping import Surfaces, map_patches, wears_large
from semisynth_gl.scene.particles import Particles, Release, Slots, particles_at, sample_release, sample_slots
from semisynth_gl.scene.projector import projector_record, sample_projector
from semisynth_gl.scene.resting import come_to_rest, triangles_of
from semisynth_gl.scene.rig import near_depth_m, relief_px
from semisynth_gl.scene.scene import Motion, Projector, Scene
from semisynth_gl.scene.structures import STILL_MODELS, StaticScene, sample_static_scene, take_stock
from semisynth_gl.scene.view_volume import clear_depth_m
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Patch
from semisynth_gl.textures.shares import patch_chances

# Mark before the attempt's number in the keys of generators; no generation's number reaches it.
_REDRAWN = 2**31
# Multiples of this number spread evenly over [0, 1).
_GOLDEN = (5**0.5 - 1) / 2
# First key of generations that were released before time 0; no later generation's number reaches it.
_BEFORE = 2**30


@dataclass(frozen=True, slots=True, eq=False)
class SampledScene:
    """A scene with one right view's camera, and what its N instances came from; the static scene's come first."""

    scene: Scene
    views: tuple[StereoCamera, ...]  # the camera of each right view; the cameras differ only in the right eye
    view: int  # number of the right view whose camera the scene has
    recipe: str | None  # name of the scene's recipe; None where the config has no recipes
    background: str  # kind of the background, such as "room"
    farthest_m: float  # depth that no view of a room exceeds; inf for other backgrounds
    sequence: int  # number of the sequence
    frame: int  # number of the frame within the sequence
    attempt: int  # number of earlier attempts at the sequence, which failed
    patch_px: Ints  # (N,) side of the patch that each instance wears
    patch: Ints  # (N,) the patch that each instance wears; a patch of video frames has an atlas layer per frame
    slot: Ints  # (N,) the particles' slot that each instance comes from; -1 for the static scene's things
    generation: Ints  # (N,) number of the model in its slot; -1 for the static scene's things
    resting: Bools  # (N,) whether each instance is a particle at rest

    @property
    def still(self) -> Bools:
        """(N,) bool, true for walls, grounds, panels and other surfaces; false for furniture and particles."""
        return self.scene.model < len(STILL_MODELS)

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

    def per_slot(
        self, purpose: Purpose, generation: Ints, slot: NDArray[np.intp], width: int, first_key: int = 0
    ) -> Floats:
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
    near_m: float  # depth of the near plane
    slots: Slots
    projector: Projector | None


def _chosen(ends: Floats, chance: Floats) -> Ints:
    """Return the items, (N,), that uniform numbers (N,) choose from K items with cumulative chances (K,)."""
    return np.minimum(np.searchsorted(ends, chance, side="right"), len(ends) - 1)


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
        # The models that `Scene.model` refers to: the models of still things, then the library.
        self.models = self._catalogue.models
        self.disparity_solver = DisparitySolver(config, seed, library.silhouette, self._catalogue, wanted)
        self._patches = patches
        self._small = sum(not patch.large for patch in patches)
        # Cumulative chances of the small patches, and of the large ones.
        self._ends = [
            np.cumsum(patch_chances([patch.shown for patch in those]))
            for those in (patches[: self._small], patches[self._small :])
        ]
        self._first_layer = np.array([patch.first_layer for patch in patches])
        self._layer_count = np.array([patch.layer_count for patch in patches])
        self._cumulative = np.cumsum(library.chances)
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
        still = len(sequence.static.still)
        # A slot shows one model at a time.
        instance_of_slot = np.full(len(sequence.slots), -1)
        instance_of_slot[target.slot[still:]] = np.arange(still, len(target.slot))
        instance = np.concatenate([np.arange(still), instance_of_slot[sampled.slot[still:]]])
        instance[still:][target.generation[instance[still:]] != sampled.generation[still:]] = -1
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
        images = Counter(self._patches[index].source for index in sampled.patch.tolist())
        return {
            "sequence": sampled.sequence,
            "frame": sampled.frame,
            **({"view": sampled.view} if len(sampled.views) > 1 else {}),
            **({} if sampled.recipe is None else {"recipe": sampled.recipe}),
            "background": sampled.background,
            **({"sky": True} if sampled.scene.sky.any() else {}),
            **({} if sampled.scene.projector is None else {"projector": projector_record(sampled.scene.projector)}),
            "near_m": sampled.scene.near_m,
            "camera": sampled.scene.camera.values(deviation=not self._config.rig.none()),
            "camera_from_world": sampled.scene.camera_from_world[:3].tolist(),
            "models": dict(sorted(models.items())),
            "images": dict(sorted(images.items())),
            "patches": np.unique(sampled.patch).tolist(),
        }

    def instance_table(self, sampled: SampledScene) -> list[dict[str, Any]]:
        """Return a row for each instance, in JSON's types; row k describes id k + 1 of the output ``instances``."""
        scene = sampled.scene
        return [
            {
                "model": self.models[scene.model[k]].name,
                "patch": int(sampled.patch[k]),
                "still": bool(sampled.still[k]),
                **({"resting": True} if sampled.resting[k] else {}),
                **({"sky": True} if scene.sky[k] else {}),
                "world_from_model": scene.world_from_model[k, :3].tolist(),
            }
            for k in range(len(scene))
        ]

    def _sequence(self, number: int, attempt: int) -> _Sequence:
        """Sample the state that all frames of a sequence share; the latest sequence is kept for the next call."""
        generators = _Generators(self._seed, number, attempt)
        if self._latest is None or self._latest.generators != generators:
            static = sample_static_scene(self._config, self._catalogue, generators.generator)
            rng = generators.generator(Purpose.PARTICLES, 0)
            # A sequence that is sampled again gets a number that no other sequence has.
            batches = self.disparity_solver.sample(
                number + _REDRAWN * attempt, static.camera, static.still.disparity_px, rng
            )
            near_m = near_depth_m(static.camera, self._config.disparity)
            most_px = relief_px(static.camera, self._config.disparity.min_px, near_m)
            slots = sample_slots(static.camera, self._config.particles, batches, rng, near_m, static.sway, most_px)
            section = self._config.projector
            projector = None if section is None else sample_projector(section, generators.generator(Purpose.PROJECTOR))
            falling = _Sequence(generators, static, near_m, slots, projector)
            self._latest = falling._replace(slots=replace(slots, resting=self._resting(falling)))
        return self._latest

    def _resting(self, sequence: _Sequence) -> dict[int, Floats]:
        """Lower the models of some slots onto the surfaces below them; return their poses (4, 4) by slot."""
        generators, static, near_m, slots, _ = sequence
        chance = generators.generator(Purpose.RESTING).random(len(slots))
        chosen = np.flatnonzero(chance < self._config.particles.resting)
        if not len(chosen):
            return {}
        first, camera, still = np.zeros(len(slots), np.int64), static.camera, static.still
        particles = self._particles(sequence, 0.0, first)
        meshes = [
            self._model_library.models[number] for number in self._sampled_models(generators, first[chosen], chosen)
        ]
        ground = ~still.sky
        corners = triangles_of(self.models, still.model[ground], still.world_from_model[ground])
        rested = come_to_rest(particles.world_from_model[chosen], meshes, corners, static.up)
        resting = {}
        for number, pose in rested.items():
            slot = int(chosen[number])
            x, y, z = pose[:3, 3]
            row = camera.cy_px + camera.focal_y_px * y / z
            radius_m = particles.radius_m[slot] * slots.flatness[slot]
            clear_m = clear_depth_m(near_m, radius_m, np.hypot(x, y), static.sway)
            if z > clear_m and -0.5 < row < camera.height_px - 0.5:
                resting[slot] = pose
        return resting

    def _sample_frame(self, sequence: _Sequence, frame: int, view: int) -> SampledScene:
        """Sample the scene of any frame of a sequence, as the right view of a number sees it."""
        generators, static, near_m, slots, projector = sequence
        config, still = self._config, static.still
        particles = self._particles(sequence, frame)
        # The near plane is in front of both cameras, so no model can swallow a camera.
        kept = np.flatnonzero(slots.shown)
        generations = particles.generation[kept]
        models = self._sampled_models(generators, generations, kept)
        patch, scale, offset = self._textures(sequence, particles, kept, models)
        # Instances start their videos at frames that depend on patch and sequence, and repeat them.
        count = self._layer_count[patch]
        scene = Scene(
            camera=static.views[view],
            near_m=near_m,
            camera_from_world=static.sway.camera_from_world(frame * config.sequence.frame_s),
            model=np.concatenate([still.model, len(STILL_MODELS) + models]),
            world_from_model=np.concatenate([still.world_from_model, particles.world_from_model[kept]]),
            layer=self._first_layer[patch] + ((patch * 7919 + generators.sequence) % count + frame) % count,
            uv_scale=scale,
            uv_offset=offset,
            sky=np.concatenate([still.sky, np.zeros(len(kept), bool)]),
            projector=projector,
        )
        slot, generation = (np.concatenate([np.full(len(still), -1), numbers]) for numbers in (kept, generations))
        return SampledScene(
            scene=scene,
            views=static.views,
            view=view,
            recipe=self.recipe,
            background=static.background,
            farthest_m=static.farthest_m,
            sequence=generators.sequence,
            frame=frame,
            attempt=generators.attempt,
            patch_px=np.where(patch >= self._small, config.textures.large_px, config.textures.patch_px),
            patch=patch,
            slot=slot,
            generation=generation,
            resting=np.isin(slot, list(slots.resting)),
        )

    def _moved(self, sequence: _Sequence, sampled: SampledScene, frame: float) -> Floats:
        """Return the poses (N, 4, 4) of a scene's instances at another frame, in which they need not be visible."""
        still = len(sequence.static.still)
        world_from_model = sampled.scene.world_from_model.copy()
        slots, generation = sampled.slot[still:], np.zeros(len(sequence.slots), np.int64)
        generation[slots] = sampled.generation[still:]
        world_from_model[still:] = self._particles(sequence, frame, generation).world_from_model[slots]
        return world_from_model

    def _particles(self, sequence: _Sequence, frame: float, generation: Ints | None = None) -> Particles:
        """Pose the models of all slots at a frame: of given generations (S,), or of those that the frame shows."""
        camera, slots = sequence.static.camera, sequence.slots

        def release(number: int) -> Release:
            rng = sequence.generators.generator(Purpose.PARTICLES, 1 + _generation_key(number))
            return sample_release(camera, self._config.particles, slots, rng)

        return particles_at(camera, slots, release, frame * self._config.sequence.frame_s, generation)

    def _sampled_models(self, generators: _Generators, generation: Ints, slot: NDArray[np.intp]) -> Ints:
        """Return the number, (N,), of the library's model that each of N slots shows in its generation."""
        chance = generators.per_slot(Purpose.SHAPE, generation, slot, 1)[:, 0]
        return self._model_library.drawn[_chosen(self._cumulative, chance)]

    def _textures(
        self, sequence: _Sequence, particles: Particles, slot: NDArray[np.intp], model: Ints
    ) -> tuple[Ints, Floats, Floats]:
        """Return each instance's patch (N,), patches per UV unit (N, 2), and UV offset in patches (N, 2)."""
        generators, static, _, slots, _ = sequence
        section, still = self._config.textures, static.still
        of_still = generators.generator(Purpose.TEXTURE, 0).random((len(still), 4))
        of_slots = generators.per_slot(Purpose.TEXTURE, particles.generation[slot], slot, 4, first_key=1)
        chances = np.concatenate([of_still[still.wears], of_slots])
        range_ = section.texels_per_pixel
        texels = range_.low * (range_.high / range_.low) ** chances[:, 3]
        # Length of one UV unit: a particle's model unit times the mean of its scales.
        scale = np.linalg.norm(particles.world_from_model[slot, :3, :3], axis=1).mean(axis=1)
        surfaces = still.surfaces + Surfaces(
            # Use the depth of the path's middle, not the model's: a texture must not slide over its model.
            slots.depth_m[slot],
            np.repeat(scale[:, None], 2, axis=1),
            self._uv[model, 0],
            self._uv[model, 1],
            np.zeros(len(slot), bool),
        )
        patch, large = _chosen(self._ends[0], chances[:, 0]), np.zeros(len(texels), bool)
        if self._small < len(self._patches):
            large = wears_large(surfaces, static.camera, section, texels)
            wearing = np.flatnonzero(large[: len(still)])
            # The large patches are spread over the still things, so that few things wear the same patch. Each side of a
            # box shows another part of its patch.
            order = np.unique(still.wears[wearing], return_inverse=True)[1]
            chances[wearing, 0] = (of_still[0, 0] + order * _GOLDEN) % 1.0
            chances[wearing, 1:3] = of_still[wearing, 1:3]
            patch[large] = self._small + _chosen(self._ends[1], chances[large, 0])
        return patch, *map_patches(surfaces, static.camera, section, texels, chances[:, 1:3], large)
