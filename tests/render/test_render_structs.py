"""The structs that numpy packs, against the driver's layouts of the shaders' blocks."""

import sys
from pathlib import Path

import numpy as np
import pytest

from semisynth_gl.inputs.errors import BackendError
from semisynth_gl.render import structs
from semisynth_gl.render.context import open_context
from semisynth_gl.render.programs import link_compute, link_program
from semisynth_gl.render.structs import BLOCKS, Block, check_attributes, members

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from disparity_variants import VARIANT_SHADERS  # and adds its block to BLOCKS

SLIVERS = ("slivers.comp", {"STEP": 0})
FLOW = ("flow.comp", {"STEP": 1})
LIT = ("mesh.vert", "mesh.frag", {"COLOUR": 0, "LIT": 1})
EDGES = ("edges.vert", "edges.frag", {}, "edges.geom")


@pytest.fixture
def context(backend):
    opened = open_context(backend)
    yield opened
    opened.release()


@pytest.mark.parametrize("name", BLOCKS)
def test_a_struct_that_is_packed_otherwise_is_an_error_with_both_layouts(context, name, monkeypatch):
    block = BLOCKS[name]
    wrong = np.dtype({
        "names": list(block.dtype.fields),
        "formats": [field[0] for field in block.dtype.fields.values()],
        "offsets": [field[1] + 16 for field in block.dtype.fields.values()],
        "itemsize": block.dtype.itemsize + 16,
    })  # fmt: skip
    monkeypatch.setitem(structs.BLOCKS, name, Block(block.binding, wrong, block.array))
    drawing = {"Camera64": (*VARIANT_SHADERS, {"PLANE64": 1}), "Wearers": EDGES, "ProjectedLight": LIT}.get(name)
    with pytest.raises(BackendError, match=rf"lays out the block {name} as .* bytes, but the program packs .* bytes"):
        link_program(context, *drawing) if drawing else link_compute(context, *(SLIVERS if name == "Runs" else FLOW))


def test_members_are_named_as_in_glsl():
    assert list(members(structs.MOVE)) == [
        ("turn_and_shift_x", 0, 4, "f"),
        ("turn_and_shift_y", 16, 4, "f"),
        ("turn_and_shift_z", 32, 4, "f"),
        ("centre", 48, 3, "f"),
        ("then", 64, 1, "i"),
    ]  # padding has no name


def test_an_attribute_of_another_size_is_an_error(context):
    program = link_program(context, "mesh.vert", "mesh.frag", {"COLOUR": 0})
    check_attributes(program, structs.VERTEX)
    with pytest.raises(BackendError, match="takes uv as 2 of f, but the program packs 3 of f"):
        check_attributes(program, np.dtype([("position", "<f4", 3), ("uv", "<f4", 3)]))


def test_an_attribute_of_another_kind_is_an_error(context):
    program = link_program(context, "mesh.vert", "mesh.frag", {"COLOUR": 0})
    check_attributes(program, structs.DRAWN_INSTANCE)
    floats = np.dtype(
        [(name, "<f4" if name == "layer" else field[0]) for name, field in structs.DRAWN_INSTANCE.fields.items()]
    )
    with pytest.raises(BackendError, match="takes layer as 1 of i, but the program packs 1 of f"):
        check_attributes(program, floats)
