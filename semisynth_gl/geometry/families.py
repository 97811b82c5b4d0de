"""Families of models from plug-ins: each is a function from a random generator to a mesh."""

from typing import Any

from semisynth_gl.config.scene_sections import MODEL_FAMILIES
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_units import make_model
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.plugins import Plugin, find_plugin, refuse_clash
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split

# The ``purpose`` for `Split.share`; the built-in families and the user's models have 0 to 2.
_SHARED = 3
_FUNCTION = "a function from a numpy.random.Generator to a semisynth_gl.Mesh"


def find_family(name: str) -> Plugin:
    """Return the plug-in of a family, imported.

    Raises InputError where there is no such plug-in, or it cannot be imported, is not a function, or has the name of a
    built-in family.
    """
    if name in MODEL_FAMILIES:
        refuse_clash("models", name)
    plugin = find_plugin("models", name)
    if not callable(plugin.value):
        raise plugin.fault(f"expected {_FUNCTION}, got {type(plugin.value).__name__}")
    return plugin


def build_family(name: str, variants: int, split: Split) -> list[Mesh]:
    """Build ``variants`` models of a plug-in's family, or a split's share of them.

    Where models are held out, ``variants`` models of the dataset's seed are shared out among the splits; else each
    split has ``variants`` models of its own seed. The models are normalised, as by `make_model`.

    Raises InputError where the plug-in cannot be used, fails, or returns no mesh, or the models are too few for all
    splits.
    """
    plugin, numbers = find_family(name), range(variants)
    if not (split.models and split.held_out):
        return [_built(plugin, split.seed, number) for number in numbers]
    what = f"models of the family {name} (models.variants)"
    own = split.share(numbers, what, _SHARED, [f"{name}/{number}" for number in numbers])
    return [_built(plugin, split.dataset_seed, number) for number in own]


def _built(plugin: Plugin, seed: int, number: int) -> Mesh:
    with plugin.blamed(f"fails for model {number}"):
        mesh: Any = plugin.value(generator(seed, Purpose.MODELS, plugin.group, plugin.name, number))
        if not isinstance(mesh, Mesh):
            raise InputError(f"expected {_FUNCTION}, got {type(mesh).__name__}; make_model makes a Mesh")
        return make_model(f"{plugin.name}/{mesh.name}", mesh.positions, mesh.triangles, mesh.uv)
