"""Entries of the cache that are overwritten, cut off or forged, at any time: the same values, or none, and no crash."""

import json
import os
import tracemalloc
from io import BufferedReader, FileIO
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault
from hypothesis import given
from hypothesis import strategies as st
from isal import isal_zlib
from recorder import Recorder
from tiny_datasets import SEED, cheap, digests

from semisynth_gl.cache import store
from semisynth_gl.cache.lookup import cached
from semisynth_gl.cache.store import Entry, read_entry, write_entry
from semisynth_gl.generation.generate import generate

ARRAYS = {
    "layers": np.random.default_rng(0).integers(0, 256, (40, 16, 16, 4), dtype=np.uint8),
    "none": np.zeros((0, 3)),
    "lengths": np.linspace(0, 1, 3000, dtype=np.float32).reshape(1000, 3),
}


@pytest.fixture(scope="module", autouse=True)
def path(tmp_path_factory):
    """The path of the entry ``e``, in a cache of the module's own."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SEMISYNTH_GL_CACHE", str(folder))
        yield folder / f"e{store.SUFFIX}"


@pytest.fixture(scope="module")
def whole(path):
    write_entry("e", Entry({"a": [1, None]}, ARRAYS))
    return path.read_bytes()


def assert_as_written(entry):
    assert entry.values == {"a": [1, None]}
    assert list(entry.arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        found = entry.arrays[name]
        assert (found.dtype, found.shape, found.tobytes()) == (array.dtype, array.shape, array.tobytes())
        assert found.flags.writeable


def overwritten(path, data):
    """Put other bytes into a file that may be open or mapped."""
    with path.open("r+b") as file:
        file.write(data)
        file.truncate()


CHANGES = st.one_of(
    st.builds(lambda share: lambda data: data[: int(share * len(data))], st.floats(0, 1)),
    st.builds(
        lambda share, other: lambda data: data[: (at := int(share * len(data)))] + other + data[at + len(other) :],
        st.floats(0, 1),
        st.binary(min_size=1, max_size=5000),
    ),
    st.builds(lambda byte: lambda data: bytes([byte]) * len(data), st.integers(0, 255)),
)


@given(CHANGES)
def test_what_was_read_stays_whatever_becomes_of_the_file(path, whole, change):
    path.write_bytes(whole)
    found = read_entry("e")
    overwritten(path, change(whole))
    assert_as_written(found)
    path.unlink()
    assert_as_written(found)


@given(CHANGES)
def test_a_changed_file_counts_as_absent(path, whole, change):
    changed = change(whole)
    path.write_bytes(changed)
    found = read_entry("e")
    assert (found is None) == (changed != whole)
    if found is not None:
        assert_as_written(found)


@given(CHANGES, st.integers(0, len(ARRAYS) - 1))
def test_a_file_that_changes_while_it_is_read_gives_the_same_or_nothing(path, whole, change, moment):
    path.write_bytes(whole)
    parts = []

    class Meddled(BufferedReader):
        def readinto(self, part):
            parts.append(part)
            if len(parts) == moment + 1:
                overwritten(path, change(whole))
            return super().readinto(part)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "open_file", lambda each: Meddled(FileIO(each)))
        found = read_entry("e")
    assert parts
    if found is not None:
        assert_as_written(found)


def split(whole):
    """The first line of an entry's file, its head as text, and its arrays; not the length and checksum of the head."""
    line, sizes, rest = whole[: (at := whole.index(b"\n") + 1)], whole[at : at + 12], whole[at + 12 :]
    length = int.from_bytes(sizes[:8], "little")
    assert int.from_bytes(sizes[8:], "little") == isal_zlib.crc32(rest[:length])
    return line, rest[:length], rest[length:]


def with_head(whole, text):
    """An entry with another head, whose length and checksum are right."""
    line, _, arrays = split(whole)
    return line + len(text).to_bytes(8, "little") + isal_zlib.crc32(text).to_bytes(4, "little") + text + arrays


def head_of(whole):
    return json.loads(split(whole)[1])


JUNK = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(2**70), 2**70),
        st.floats(),
        st.sampled_from(["O", "|O", "V8", "f4,f4", "(2,", "<U1", "|u1", "<f8", "layers", "<M8[s]"]),
        st.text(max_size=5),
    ),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
    max_leaves=6,
)


@given(st.integers(0, len(ARRAYS) - 1), st.integers(0, 3), JUNK)
def test_a_forged_description_of_an_array_gives_nothing(path, whole, number, field, value):
    head = head_of(whole)
    before = head["arrays"][number][field]
    head["arrays"][number][field] = value
    path.write_bytes(with_head(whole, json.dumps(head).encode()))
    found = read_entry("e")
    if type(value) is type(before) and value == before:
        assert_as_written(found)
    else:
        assert found is None


@pytest.mark.parametrize("size", [-1, -(2**63), 2**40, 2**64, 10**30, [1], None, 0.5, "9", True])
@pytest.mark.parametrize("times", [None, 10**9])
def test_a_forged_shape_takes_no_memory_and_reads_nothing_outside(path, whole, size, times):
    for name in ARRAYS:
        head = head_of(whole)
        shape = next(row for row in head["arrays"] if row[0] == name)[2]
        shape[0] = size
        if times is not None:
            shape[1] = times
        path.write_bytes(with_head(whole, json.dumps(head).encode()))
        tracemalloc.start()
        try:
            assert read_entry("e") is None
            assert tracemalloc.get_traced_memory()[1] < 10 * len(whole)
        finally:
            tracemalloc.stop()


@given(st.one_of(JUNK.map(lambda value: json.dumps(value).encode()), st.binary(max_size=60)), st.binary(max_size=40))
def test_a_forged_head_gives_nothing(path, whole, text, rest):
    forged = with_head(whole, text)
    for data in (forged, forged.removesuffix(split(whole)[2]) + rest, text + rest):
        path.write_bytes(data)
        assert read_entry("e") is None


@given(JUNK, st.sampled_from(["values", "files"]))
def test_an_entry_whose_values_make_no_sense_is_made_again(tmp_path_factory, value, place):
    source = tmp_path_factory.mktemp("source") / "file"
    source.write_text("content")

    def ask():
        return cached(
            "number",
            1,
            dict,
            files=[source],
            build=lambda: (built.append(1) or 5, [source]),
            pack=lambda result: Entry({"result": result}, {}),
            unpack=lambda entry: entry.values["result"],
        )

    built = []
    assert ask() == 5
    [path] = Path(os.environ["SEMISYNTH_GL_CACHE"]).glob("number-*")
    entry = read_entry(path.stem)
    forged = value if place == "values" else entry.values | {"files": value}
    write_entry(path.stem, Entry(forged, {}))
    assert ask() == 5
    assert ask() == 5
    path.unlink()


def test_a_dataset_is_the_same_though_the_cache_is_overwritten_in_place_meanwhile(tmp_path, path):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    config = cheap(textures={"source": "procedural", "max_patches": 16})
    generate(config, tmp_path / "wanted", 3, SEED)
    entries = list(path.parent.glob(f"*{store.SUFFIX}"))
    assert len(entries) >= 3

    def overwrite_all(_):
        for entry in entries:
            overwritten(entry, bytes([7]) * entry.stat().st_size)
        return False

    recorder = Recorder(overwrite_all)
    generate(config, tmp_path / "found", 3, SEED, listener=recorder)
    assert len(recorder.pairs) == 3
    assert digests(tmp_path / "found") == digests(tmp_path / "wanted")
