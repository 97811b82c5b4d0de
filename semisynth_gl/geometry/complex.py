"""Complex models: everyday things with holes, thin parts and overlaps, where stereo networks fail."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from semisynth_gl.geometry.build import Builder
from semisynth_gl.geometry.furniture import (
    bookcase,
    chair,
    clothes_rack,
    lamp,
    lattice_panel,
    picture_frame,
    shelf,
    table,
)
from semisynth_gl.geometry.hardware import (
    bolt,
    cable,
    chain,
    fan,
    flat_coil,
    gear,
    grating,
    hook_rail,
    spoked_wheel,
    spring,
    torus_knot,
    umbrella,
)
from semisynth_gl.geometry.plants import cactus, flower, grass, potted_plant, tree
from semisynth_gl.geometry.structures import (
    fence,
    ladder,
    pipe_run,
    rod_bundle,
    scaffold,
    spiral_stairs,
    stairs,
    truss_bridge,
)
from semisynth_gl.geometry.vessels import basket, bottle, bowl_stack, cage, goblet, jug, mug, vase

_BUILDERS: Final[tuple[Builder, ...]] = (
    *(table, chair, bookcase, shelf, lamp, picture_frame, lattice_panel, clothes_rack),
    *(bottle, vase, mug, goblet, bowl_stack, jug, basket, cage),
    *(stairs, spiral_stairs, ladder, fence, pipe_run, scaffold, truss_bridge, rod_bundle),
    *(potted_plant, tree, cactus, grass, flower),
    *(gear, torus_knot, spring, chain, spoked_wheel, umbrella, bolt, fan, cable, flat_coil, grating, hook_rail),
)

COMPLEX_KINDS: Final[Mapping[str, Builder]] = MappingProxyType({builder.__name__: builder for builder in _BUILDERS})
"""Builders of complex models, by the name their meshes carry."""
