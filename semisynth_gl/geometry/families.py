"""Families of models that plug-ins have: a function from a generator to a mesh each."""

from typing import Any

from semisynth_gl.config.scene_sections import MODEL_FAMILIES
from semisynth_gl.geometry.mesh import Mesh
from semisynth_gl.geometry.model_units import make_model
from semisynth_gl.inputs.errors import InputError
from semisynth_gl.plugins import Plugin, find_plugin, refuse_clash
from semisynth_gl.seeds.seeds import Purpose, generator
from semisynth_gl.seeds.splits import Split

# `Split.share`'s purpose; the program's own families have 0 to 2.
_SHARED = 3
_FUNCTION = "a function from a numpy.random.Generator to a semisynth_gl.Mesh"


def find_family(name: str) -> Plugin:
    """Return the plug-in of a family.

    Raises InputError where there is none, or it cannot be imported, is no function, or has the name of a built-in
    family.
    """
    if name in MODEL_FAMILIES:
        refuse_clash("models", name)
    plugin = find_plugin("models", name)
    if not callable(plugin.value):
        raise plugin.fault(f"expected {_FUNCTION}, got {type(plugin.value).__name__}")
    return plugin


def build_family(name: str, variants: int, split: Split) -> list[Mesh]:
    """Build so many models of a plug-in's family, or a split's share of them.

    Where models are held out, the splits share the models of the dataset's seed; else each split draws other models.
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
