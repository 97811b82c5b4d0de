"""Families of models from plug-ins: each is a function from a random generator to a mesh."""

from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_units import make_model
from semisynth_gl.plugins import find_plugin
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split

# The ``purpose`` for `Split.share`; the built-in families and the user's models have 0 to 2.
_SHARED = 3


def build_family(name: str, variants: int, split: Split) -> list[Mesh]:
    """Build ``variants`` models of a plug-in's family, or a split's share of them.

    Where models are held out, ``variants`` models of the dataset's seed are shared out among the splits; else each
    split has ``variants`` models of its own seed. The models are normalised, as by `make_model`.

    Raises InputError where no plug-in has the name, or the models are too few for all splits.
    """
    build = find_plugin("models", name).value
    seed, numbers = split.seed, list(range(variants))
    if split.models and split.held_out:
        what = f"models of the family {name} (models.variants)"
        seed = split.dataset_seed
        numbers = split.share(numbers, what, _SHARED, [f"{name}/{number}" for number in numbers])
    meshes = [build(generator(seed, Purpose.MODELS, "models", name, number)) for number in numbers]
    return [make_model(f"{name}/{mesh.name}", mesh.positions, mesh.triangles, mesh.uv) for mesh in meshes]
