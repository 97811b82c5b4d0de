"""Pair i of a dataset as a scene, from (config, seed, i) and nothing else."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.camera import StereoCamera
from semisynth_gl.config.model import Config
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_library import ModelLibrary
from semisynth_gl.scene.background import Background, draw_background
from semisynth_gl.scene.particles import Particles, Release, Slots, draw_release, draw_slots, particles_at
from semisynth_gl.scene.population import Population
from semisynth_gl.scene.rig import Sway, draw_camera, draw_sway, near_depth_m
from semisynth_gl.scene.scene import Motion, Scene
from semisynth_gl.scene.structures import STILL_MODELS, Surroundings, draw_surroundings
from semisynth_gl.seeds import Purpose, generator
from semisynth_gl.textures.atlas import Patch

# Stands before the attempt in the keys of generators; no generation reaches it.
_REDRAWN = 2**31
# Generations released before time 0 count from here in the keys of generators; no later one reaches it.
_BEFORE = 2**30


@dataclass(frozen=True, slots=True, eq=False)
class SampledScene:
    """A scene and what it was made of.

    Attributes:
        scene: what the renderer draws; the first models are those that stand still.
        background: "cuboid" or "plane".
        sequence: number of the sequence.
        frame: number of the frame within it.
        attempt: how often the sequence was drawn anew before.
        patch: (N,) int64, the patch that each instance wears; the layer of an image sequence changes with the frame.
        slot: (N,) int64, the slot of the particles that each instance comes from; -1 for what stands still.
        generation: (N,) int64, which of its slot's models it is; likewise.
    """

    scene: Scene
    background: str
    sequence: int
    frame: int
    attempt: int
    patch: NDArray[np.int64]
    slot: NDArray[np.int64]
    generation: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class _Sequence:
    """What all frames of a sequence share."""

    camera: StereoCamera
    sway: Sway
    background: Background
    surroundings: Surroundings
    slots: Slots


@dataclass(frozen=True, slots=True)
class _Draw:
    """Where the randomness of a sequence comes from."""

    seed: int
    sequence: int
    attempt: int

    def generator(self, purpose: Purpose, *numbers: int) -> np.random.Generator:
        redrawn = (_REDRAWN, self.attempt) if self.attempt else ()
        return generator(self.seed, purpose, self.sequence, *numbers, *redrawn)


class SceneSampler:
    """Samples the scenes of one dataset.

    Args:
        config: the configuration.
        seed: 0 or more.
        library: the models, from the same config and seed.
        patches: the atlas's patches, likewise.

    Attributes:
        population: how many particles scenes have, and what disparities they come to.
    """

    def __init__(self, config: Config, seed: int, library: ModelLibrary, patches: tuple[Patch, ...]) -> None:
        self._config = config
        self._seed = seed
        self._model_library = library
        self.population = Population(config, seed, library.silhouette)
        self._patches = patches
        self._first_layer = np.array([patch.first_layer for patch in patches])
        self._layer_count = np.array([patch.layer_count for patch in patches])
        self._cumulative = np.cumsum(library.chances)
        self._latest: tuple[_Draw, _Sequence] | None = None

    @property
    def models(self) -> tuple[Mesh, ...]:
        """The models that `Scene.model` counts: those that stand still, then the library."""
        return (*STILL_MODELS, *self._model_library.models)

    def sample(self, index: int, attempt: int = 0) -> SampledScene:
        """Sample the scene of pair ``index``, 0 or more; each ``attempt`` draws its whole sequence anew."""
        number, frame = divmod(index, self._config.sequence.length)
        return self._at(_Draw(self._seed, number, attempt), frame)

    def motion(self, sampled: SampledScene, frames: int) -> Motion:
        """Return how a scene's instances get to the frame so many later, or earlier where it is below 0.

        That frame need not be one of the dataset's: motion goes on beyond both ends of a sequence.
        """
        draw = _Draw(self._seed, sampled.sequence, sampled.attempt)
        then = self._at(draw, sampled.frame + frames)
        sequence = self._sequence(draw)
        still = len(sequence.surroundings)
        world_from_model = sampled.scene.world_from_model.copy()
        slots, generation = sampled.slot[still:], np.zeros(len(sequence.slots), np.int64)
        generation[slots] = sampled.generation[still:]
        moved = self._particles(draw, sequence, then.frame, generation)
        world_from_model[still:] = moved.world_from_model[slots]
        # A slot shows one model at a time.
        there = np.full(len(sequence.slots), -1)
        there[then.slot[still:]] = np.arange(still, len(then.slot))
        instance = np.concatenate([np.arange(still), there[slots]])
        instance[still:][then.generation[instance[still:]] != sampled.generation[still:]] = -1
        return Motion(then.scene, world_from_model, instance)

    def _at(self, draw: _Draw, frame: int) -> SampledScene:
        """The scene of any frame of a sequence."""
        config, sequence = self._config, self._sequence(draw)
        camera, slots = sequence.camera, sequence.slots
        particles = self._particles(draw, sequence, frame)
        camera_from_world = sequence.sway.camera_from_world(frame * config.sequence.frame_s)
        near_m = near_depth_m(camera, config.disparity)
        # A model that crosses the near plane is not there; the near plane is in front of both cameras, so neither can
        # be swallowed.
        depth_m = particles.centre_m @ camera_from_world[2, :3] + camera_from_world[2, 3]
        kept = np.flatnonzero(depth_m - particles.radius_m > near_m)

        generations = particles.generation[kept]
        still = sequence.surroundings
        model = np.concatenate([still.model, len(STILL_MODELS) + self._models(draw, generations, kept)])
        patch, offset, texels = self._textures(draw, len(still), generations, kept)
        # A patch at its own resolution covers this part of a ray's slope X / Z, inverted.
        patches_per_slope = camera.focal_px / config.textures.patch_px
        # The middle of a path, not where the model is: texture must not slide over it from frame to frame.
        depth = np.concatenate([still.depth_m, slots.depth_m[kept]])
        # Lengths of one UV unit: of a model its unit under its mean scale.
        scale = np.linalg.norm(particles.world_from_model[kept, :3, :3], axis=1).mean(axis=1)
        unit_m = np.concatenate([still.unit_m, np.repeat(scale[:, None], 2, axis=1)])
        scene = Scene(
            camera=camera,
            near_m=near_m,
            camera_from_world=camera_from_world,
            model=model,
            world_from_model=np.concatenate([still.world_from_model, particles.world_from_model[kept]]),
            layer=self._layers(draw.sequence, patch, frame),
            uv_scale=unit_m * (patches_per_slope * texels / depth)[:, None],
            uv_offset=offset,
        )
        none = np.full(len(still), -1)
        return SampledScene(
            scene,
            sequence.background.kind,
            draw.sequence,
            frame,
            draw.attempt,
            patch,
            np.concatenate([none, kept]),
            np.concatenate([none, generations]),
        )

    def _particles(
        self, draw: _Draw, sequence: _Sequence, frame: int, generation: NDArray[np.int64] | None = None
    ) -> Particles:
        """Where the models of all slots are at a frame, those shown then or those of the generations named."""

        def release(generation: int) -> Release:
            rng = draw.generator(Purpose.PARTICLES, 1 + _released(generation))
            return draw_release(sequence.camera, self._config.particles, sequence.slots, rng)

        time_s = frame * self._config.sequence.frame_s
        return particles_at(sequence.camera, sequence.slots, release, time_s, generation)

    def provenance(self, sampled: SampledScene) -> dict[str, Any]:
        """What a pair's scene was made of, in JSON's types.

        ``models`` and ``images`` count the instances of each; ``patches`` are indices into the dataset's patches.
        """
        camera = sampled.scene.camera
        models = Counter(self.models[index].name for index in sampled.scene.model)
        images = Counter(self._patches[index].source for index in sampled.patch)
        return {
            "sequence": sampled.sequence,
            "frame": sampled.frame,
            "background": sampled.background,
            "near_m": sampled.scene.near_m,
            "camera": {name: getattr(camera, name) for name in camera.__slots__} | {"doffs_px": camera.doffs_px},
            "camera_from_world": sampled.scene.camera_from_world[:3].tolist(),
            "models": dict(sorted(models.items())),
            "images": dict(sorted(images.items())),
            "patches": np.unique(sampled.patch).tolist(),
        }

    def instance_table(self, sampled: SampledScene) -> list[dict[str, Any]]:
        """What each instance is, in JSON's types; row k describes id k + 1 of the output ``instances``."""
        scene = sampled.scene
        return [
            {
                "model": self.models[scene.model[k]].name,
                "patch": int(sampled.patch[k]),
                "world_from_model": scene.world_from_model[k, :3].tolist(),
            }
            for k in range(len(scene))
        ]

    def _sequence(self, draw: _Draw) -> _Sequence:
        """What all frames share; that of the latest sequence is kept."""
        if self._latest is None or self._latest[0] != draw:
            self._latest = draw, self._drawn(draw)
        return self._latest[1]

    def _drawn(self, draw: _Draw) -> _Sequence:
        config = self._config
        camera = draw_camera(config.camera, draw.generator(Purpose.CAMERA))
        sway = draw_sway(config.camera, draw.generator(Purpose.SWAY))
        background = draw_background(
            config.background, config.disparity, camera, draw.generator(Purpose.BACKGROUND), sway
        )
        surroundings = draw_surroundings(
            config.structures, config.disparity, camera, background, draw.generator(Purpose.STRUCTURES), sway
        )
        rng = draw.generator(Purpose.PARTICLES, 0)
        # A scene that is drawn again takes a number that no other scene has.
        number = draw.sequence + _REDRAWN * draw.attempt
        batches = self.population.draw(number, camera, surroundings.disparity_px, rng)
        return _Sequence(camera, sway, background, surroundings, draw_slots(camera, config.particles, batches, rng))

    def _models(self, draw: _Draw, generation: NDArray[np.int64], slot: NDArray[np.intp]) -> NDArray[np.int64]:
        """Library index of the model in each slot."""
        chance = _per_slot(draw, Purpose.SHAPE, generation, slot, 1)[:, 0]
        return np.minimum(np.searchsorted(self._cumulative, chance, side="right"), len(self._cumulative) - 1)

    def _textures(
        self, draw: _Draw, faces: int, generation: NDArray[np.int64], slot: NDArray[np.intp]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Patch (N,), UV offset (N, 2) in patches and texels per pixel (N,) of faces and models."""
        of_faces = draw.generator(Purpose.TEXTURE, 0).random((faces, 4))
        of_models = _per_slot(draw, Purpose.TEXTURE, generation, slot, 4, after=1)
        drawn = np.concatenate([of_faces, of_models])
        patch = (drawn[:, 0] * len(self._first_layer)).astype(np.int64)
        texels = self._config.textures.texels_per_pixel
        return patch, drawn[:, 1:3], texels.low * (texels.high / texels.low) ** drawn[:, 3]

    def _layers(self, number: int, patch: NDArray[np.int64], frame: int) -> NDArray[np.int64]:
        """Atlas layer of each patch at a frame: image sequences start at a phase of their own and go round."""
        count = self._layer_count[patch]
        phase = (patch * 7919 + number) % count
        layer: NDArray[np.int64] = self._first_layer[patch] + (phase + frame) % count
        return layer


def _per_slot(
    draw: _Draw,
    purpose: Purpose,
    generation: NDArray[np.int64],
    slot: NDArray[np.intp],
    width: int,
    after: int = 0,
) -> NDArray[np.float64]:
    """Uniform numbers (N, width) that belong to a slot's generation, whatever other slots exist.

    The keys of the purpose's generators begin ``after`` those that it has for something else.
    """
    result = np.empty((len(slot), width))
    for value in np.unique(generation):
        of = generation == value
        rng = draw.generator(purpose, after + _released(int(value)))
        result[of] = rng.random((int(slot[of].max()) + 1, width))[slot[of]]
    return result


def _released(generation: int) -> int:
    """Number of a generation in the keys of generators, which must not be below 0."""
    return generation if generation >= 0 else _BEFORE - generation
