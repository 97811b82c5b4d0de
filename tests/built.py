"""What the cache keeps of fixed inputs, as numbers; tests/built.json has those of each builder's VERSION.

Once the VERSION of a builder is raised, this records its numbers again:

    python tests/built.py

A number stands for an array: the mean of its values, each times a random weight. A hash would not do: the last bits of
sines and matrix products depend on the processor and on numpy's version, and the edges of letters on Pillow's. From
numpy 2.0 and Pillow 11.0 on, with and without AVX, the numbers agree to 6e-5 for painted pictures, and to 1e-12 (all
digits that are written) for everything else.
"""

import json
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from semisynth_gl.cache import Entry, read_entry
from semisynth_gl.config import Config
from semisynth_gl.config.scene_sections import ModelsSection, ParticlesSection, TexturesSection
from semisynth_gl.geometry import model_library
from semisynth_gl.geometry.model_library import build_library
from semisynth_gl.scene import pilots
from semisynth_gl.scene.pilots import sample_pilots
from semisynth_gl.scene.structures import take_stock
from semisynth_gl.seeds.splits import Split
from semisynth_gl.textures import drawn, prepare, sources
from semisynth_gl.textures.prepare import prepare_atlas

BUILDERS = {"atlas": prepare, "models": model_library, "pilots": pilots}
"""The module of each kind of entry, which has its VERSION."""

RECORDED = Path(__file__).with_name("built.json")
_AGREEMENT, _OF_PICTURES = 1e-6, 1e-4
_COMMAND = "record again with `python tests/built.py`"

Numbers = dict[str, float]

_BOX = (
    "".join(f"v {x} {y} {z}\n" for x in (0, 2) for y in (0, 1) for z in (0, 3))
    + "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)
_CAMERA = {"width_px": 64, "height_px": 48, "focal_px": [40, 90], "baseline_m": [0.05, 0.4]}
_SCENES: dict[str, dict[str, Any]] = {
    "room": {"background": {"cuboid": 0, "room": 1}},
    "street": {"background": {"cuboid": 0, "street": 1}},
    "walls": {"structures": {"ground": 0.5, "panels": [1, 3], "panel_size_px": [10, 40]}},
    "sky": {
        "background": {"cuboid": 0, "plane": 1, "sky": 0.5},
        "camera": _CAMERA | {"sway_m": [0.01, 0.05], "baselines": 2},
        "rig": {"right_roll_deg": [-1, 1], "right_y_px": [-3, 3]},
    },
}


def faults(results: dict[str, Numbers]) -> list[str]:
    """Return what to do about results that are not the recorded ones; nothing where all agree."""
    recorded = json.loads(RECORDED.read_text("utf-8"))
    found = []
    for name, numbers in results.items():
        builder = BUILDERS[name.partition("/")[0]]
        before = recorded["versions"].get(name.partition("/")[0])
        if before != builder.VERSION:
            found.append(f"{builder.__name__}.VERSION is {builder.VERSION}, recorded is {before}: {_COMMAND}")
        elif recorded.get(name) != pytest.approx(numbers, rel=_OF_PICTURES if "pixels" in numbers else _AGREEMENT):
            found.append(f"{name} is not what it was: raise VERSION in {builder.__name__}, then {_COMMAND}")
    return found


def drawn_picture(kind: Callable[[np.random.Generator], Any]) -> NDArray[np.uint8]:
    """Paint a picture of a kind. All of them take seconds, so the test of their contrast compares them too."""
    return np.asarray(kind(np.random.default_rng(7)))


def of_picture(pixels: NDArray[np.uint8]) -> Numbers:
    """Return what stands for a painted picture."""
    return {"pixels": _number(pixels)}


def built(folder: Path) -> dict[str, Numbers]:
    """Build all else from fixed inputs, and return what the cache would keep.

    Args:
        folder: an empty one, for photographs and a model.
    """
    photographs = folder / "photographs"
    photographs.mkdir()
    for number in range(4):
        _photograph(number).save(photographs / f"{number}.png")
    wide = _photograph(9)  # both views of one scene
    for name, left in (("left", 12), ("right", 0)):
        wide.crop((left, 0, left + 220, 180)).save(photographs / f"{name}.png")
    (folder / "models").mkdir()
    (folder / "models/box.obj").write_text(_BOX)
    own = {"source": "images", "images": (str(photographs),), "patch_px": 32}
    textures, particles = partial(TexturesSection, **own), ParticlesSection()
    frames, train = f"{photographs}/?.png", Split(0, "train", {"validation": 0.3}, models=True)
    # Rooms and streets hold them too.
    all_kinds = cache(lambda: build_library(ModelsSection(variants=2), particles, Split(0)))
    cases: dict[str, Callable[[], object]] = {
        "photographs": lambda: prepare_atlas(textures(max_patches=60, large_px=128), train),
        "frames": lambda: prepare_atlas(textures(images=(frames,), max_patches=4, sequence=True), Split(0)),
        "procedural": lambda: prepare_atlas(textures(source="procedural", max_patches=10), Split(0)),
        "pictures": lambda: prepare_atlas(textures(source="builtin", max_patches=60, large_px=64), Split(0)),
        "all kinds": all_kinds,
        "training": lambda: build_library(ModelsSection(variants=2, complex=0.0), particles, train),
        "user": lambda: build_library(
            ModelsSection(folders=(str(folder / "models"),), complex=0.0, variants=1), particles, Split(0)
        ),
    }
    for name, scene in _SCENES.items():
        values = {"name": name, "camera": _CAMERA, "disparity": {"min_px": 1, "max_px": 20}}
        config = Config.model_validate(values | scene)
        cases[name] = lambda config=config: sample_pilots(config, 0, take_stock(all_kinds()))
    return {
        f"{kind}/{name}": numbers for name, build in cases.items() for kind, numbers in _kept(folder, build).items()
    }


def _photograph(seed: int) -> Image.Image:
    """Like a photograph: the same contrast at 1, 4, 16 and 64 pixels."""
    rng = np.random.default_rng(seed)
    octaves = [
        rng.integers(0, 64, (-(-192 // n), -(-256 // n), 3), np.uint8).repeat(n, 0).repeat(n, 1)[:192, :256]
        for n in (1, 4, 16, 64)
    ]
    return Image.fromarray(np.sum(octaves, axis=0).astype(np.uint8))


def _kept(folder: Path, build: Callable[[], object]) -> dict[str, Numbers]:
    """Build something with an empty cache, and return the entries that it gets, by their kinds."""
    kept = mkdtemp(dir=folder)
    # Kinds that are quick to paint stand for the program's own: which are painted, and in which order.
    kinds = [_named(kind.__name__, number) for number, kind in enumerate(drawn.KINDS)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SEMISYNTH_GL_CACHE", kept)
        patch.setattr(drawn, "KINDS", kinds)
        patch.setitem(sources.SOURCES, "builtin", replace(sources.SOURCES["builtin"], files=lambda _: ()))
        build()
    return {path.name.partition("-")[0]: _numbers(read_entry(path)) for path in sorted(Path(kept).iterdir())}


def _named(name: str, number: int) -> Callable[[np.random.Generator], Any]:
    def kind(_: np.random.Generator) -> Any:
        return np.asarray(_photograph(number))

    kind.__name__ = name
    return kind


def _numbers(entry: Entry) -> Numbers:
    arrays = {name: _number(array) for name, array in entry.arrays.items()}
    # Exact hashes of pixels are no part of what is compared.
    values = {key: value for key, value in entry.values.items() if key != "pictures"}
    leaves = list(_leaves(values))
    texts = "\n".join(leaf for leaf in leaves if isinstance(leaf, str))
    numbers = np.array([float(leaf) for leaf in leaves if not isinstance(leaf, str)])
    return {**arrays, "numbers": _number(numbers), "texts": zlib.crc32(texts.encode())}


def _leaves(value: Any) -> Iterator[Any]:
    """Yield the keys, texts and numbers in a value of JSON's types."""
    if isinstance(value, dict):
        for key in sorted(value):
            yield key
            yield from _leaves(value[key])
    elif isinstance(value, (list, tuple)):
        for each in value:
            yield from _leaves(each)
    elif value is not None:
        yield value


def _number(array: Any) -> float:
    flat = np.asarray(array, np.float64).ravel()
    return float(f"{np.random.default_rng(len(flat)).random(len(flat)) @ flat / max(len(flat), 1):.12g}")


def main() -> None:
    """Write tests/built.json, unless a builder's results are others and its VERSION is not."""
    with TemporaryDirectory() as folder:
        results = built(Path(folder))
    results |= {f"atlas/{kind.__name__}": of_picture(drawn_picture(kind)) for kind in drawn.KINDS}
    if RECORDED.exists():
        recorded = json.loads(RECORDED.read_text("utf-8"))
        same = {kind for kind, module in BUILDERS.items() if recorded["versions"][kind] == module.VERSION}
        known = {name: each for name, each in results.items() if name in recorded and name.partition("/")[0] in same}
        if found := faults(known):
            raise SystemExit("\n".join(found))
    versions = {kind: module.VERSION for kind, module in BUILDERS.items()}
    lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in ({"versions": versions} | results).items()]
    RECORDED.write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")


if __name__ == "__main__":
    main()
