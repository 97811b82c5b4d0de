"""The kinds of built-in models: their builders by name, in two families, and their weights."""

from collections.abc import Callable, Mapping
from functools import partial
from inspect import isfunction
from types import ModuleType
from typing import Final

import numpy as np

from semisynth_gl.geometry import furniture, hardware, outdoors, plants, soft, solids, structures, vessels
from semisynth_gl.geometry.mesh import Mesh, Parts, merged, normalised
from semisynth_gl.inputs.errors import InputError, did_you_mean, most_similar


def _build(kind: Callable[[np.random.Generator], Parts], rng: np.random.Generator) -> Mesh:
    return normalised(merged(kind.__name__, kind(rng)))


def _builders(*modules: ModuleType) -> dict[str, Callable[[np.random.Generator], Mesh]]:
    """Return the builders of all kinds: a kind is a public function that one of the modules defines.

    A builder makes one model from a generator, normalised and named after the kind.
    """
    return {
        name: partial(_build, function)
        for module in modules
        for name, function in vars(module).items()
        if isfunction(function) and function.__module__ == module.__name__ and not name.startswith("_")
    }


SIMPLE_KINDS: Final = _builders(solids)
"""Builders of simple models by kind: solids of geometry, such as cones."""

COMPLEX_KINDS: Final = _builders(furniture, vessels, structures, plants, hardware, soft, outdoors)
"""Builders of complex models by kind: everyday things with holes, thin parts and overlaps, at which networks fail."""


def kind_weights(given: Mapping[str, float]) -> dict[str, float]:
    """Return the weight of every kind, 1 if none is given; raises InputError if ``given`` has an unknown kind."""
    known = [*SIMPLE_KINDS, *COMPLEX_KINDS]
    unknown = [kind for kind in given if kind not in known]
    if unknown:
        hint = did_you_mean(most_similar(unknown[0], known), f"expected some of: {', '.join(sorted(known))}")
        raise InputError(f"models.kinds.{unknown[0]}: no such kind of model; {hint}")
    return dict.fromkeys(known, 1.0) | dict(given)
