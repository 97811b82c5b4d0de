"""Alternatives that the program does not offer, measured beside those that it offers.

    python benchmarks/alternatives.py --json alternatives.json

Two tables, as choices.py has them: variants of how a pixel gets its disparity, and encodings of
disparities. The default is bold; a star marks alternatives that no other one dominates.
"""

import argparse
import io
import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from choices import section, table
from disparity_encodings import DEFAULT_DISPARITY_ENCODING, Encoding, measure_encodings, offered_encodings
from disparity_variants import RENDERERS_VARIANT, DisparityVariants, Variant
from isal import isal_zlib
from numpy.typing import NDArray
from timing import alternated, alternative_rows, compare_times

from semisynth_gl.bench.accuracy import headline, scene_facts
from semisynth_gl.bench.scenes import BenchScenes, SampledTruth, cast_truth, sample_scenes
from semisynth_gl.bench.summary import error_stats, machine_facts
from semisynth_gl.config import Config, load_config
from semisynth_gl.frame.camera import EYES
from semisynth_gl.render.backends import BACKENDS, Backend

VARIANT_TEXTS: Mapping[Variant, str] = {
    "depth24": "24-bit depth buffer, near plane at 0.05 m, made linear in float64",
    "depth24-tight": "24-bit depth buffer, near plane at the largest disparity, made linear in float64",
    "depth32f": "32-bit float depth buffer, reversed, made linear in float64",
    "linear": "interpolated linear depth",
    "w": "1/gl_FragCoord.w, by way of depth",
    "w-direct": "gl_FragCoord.w times f B",
    "plane": "plane equation of the triangle, float32",
    "plane64": "plane equation of the triangle, double precision",
}
_GRID_STEPS = 1024
_NOTHING = -1  # on the grid, where the disparity is inf
_LARGEST_GRID_PX = (2**31 - 1) // _GRID_STEPS
_Map = NDArray[np.float32]
_Shape = tuple[int, ...]


def measure(config: Config, seed: int, backend: Backend, pairs: int, rays: int, repeats: int) -> dict[str, Any]:
    """Measure all alternatives on the first pairs of a config; the report is in JSON's types."""
    bench = sample_scenes(config, seed, pairs)
    with bench.open_renderer(backend, outputs=("instances",)) as renderer:
        frames, driver = [renderer.render(scene) for scene in bench.scenes], renderer.facts
    truths, _ = cast_truth(bench, frames, rays, np.random.default_rng(seed))
    with DisparityVariants(bench.models, backend) as variants:
        rows, refused = measure_variants(bench, variants, truths, repeats), variants.left_out
    maps = [frame.view(eye).disparity for frame in frames for eye in EYES]
    encodings = [*offered_encodings(), *more_disparity_encodings()]
    stored = measure_encodings(maps, encodings, DEFAULT_DISPARITY_ENCODING, repeats)
    return {
        **scene_facts(bench, seed, truths),
        "machine": machine_facts() | driver,
        "get": section(RENDERERS_VARIANT, refused, rows),
        "store": section(DEFAULT_DISPARITY_ENCODING, {}, stored),
    }


def measure_variants(
    bench: BenchScenes, variants: DisparityVariants, truths: Sequence[SampledTruth], repeats: int
) -> list[dict[str, Any]]:
    """Measure every variant that the driver can do; each draws all scenes ``repeats`` times, in turns.

    Returns:
        A row of each variant. The time is that to draw and read back the disparity of both eyes; "on_front" says that
        no other variant is both faster and more exact (at 99.9 %).
    """
    truth = np.concatenate([part.disparity_px for part in truths])
    errors = {}
    for variant in variants.usable:
        drawn = [
            variants.disparity(bench.scenes[part.scene], part.eye, variant)[part.row, part.column] for part in truths
        ]
        errors[variant] = error_stats(np.concatenate(drawn), truth)

    def draw(variant: Variant) -> None:
        for scene in bench.scenes:
            for eye in EYES:
                variants.disparity(scene, eye, variant)

    seconds = alternated({variant: partial(draw, variant) for variant in variants.usable}, repeats)
    return alternative_rows(
        {variant: VARIANT_TEXTS[variant] for variant in variants.usable},
        compare_times(seconds, RENDERERS_VARIANT, len(bench.scenes)),
        {variant: {"error": error} for variant, error in errors.items()},
        {variant: [error["p999_px"]] for variant, error in errors.items()},
    )


def more_disparity_encodings() -> list[Encoding]:
    """List the encodings of disparity that the program does not offer; blosc2 where it is installed."""
    encodings = [
        Encoding("half", "half float, NPY", _encode_half, _decode_half),
        Encoding("deflate", "float32, bytes shuffled, deflate", _shuffled, _decode_shuffled),
        Encoding("delta", "float32, difference of bits to the left, shuffled, deflate", _encode_delta, _decode_delta),
        Encoding("grid", "float32 rounded to 1/1024 px, shuffled, deflate", _encode_grid, _decode_shuffled),
        Encoding(
            "grid-delta",
            "multiple of 1/1024 px, difference to the left, shuffled, deflate",
            _encode_grid_delta,
            _decode_grid_delta,
        ),
    ]
    if find_spec("blosc2"):
        encodings.append(Encoding("blosc2", "float32, blosc2, shuffled, LZ4", _encode_blosc2, _decode_blosc2))
    return encodings


def _encode_half(disparity: _Map) -> bytes:
    file = io.BytesIO()
    np.save(file, disparity.astype(np.float16))
    return file.getvalue()


def _decode_half(data: bytes, _: _Shape) -> _Map:
    return np.load(io.BytesIO(data)).astype(np.float32)


def _shuffled(values: NDArray[Any]) -> bytes:
    """Deflate all first bytes, then all second ones and so on: the high bytes of neighbours are alike."""
    planes = np.ascontiguousarray(values).view(np.uint8).reshape(-1, 4).T
    return isal_zlib.compress(np.ascontiguousarray(planes), 1)


def _unshuffled(data: bytes) -> NDArray[np.uint8]:
    planes = np.frombuffer(isal_zlib.decompress(data), np.uint8).reshape(4, -1)
    return np.ascontiguousarray(planes.T)


def _decode_shuffled(data: bytes, shape: _Shape) -> _Map:
    return _unshuffled(data).view(np.float32).reshape(shape)


def _differences(values: NDArray[np.uint32]) -> NDArray[np.uint32]:
    result = values.copy()
    result[:, 1:] -= values[:, :-1]
    return result


def _sums(data: bytes, shape: _Shape) -> NDArray[np.uint32]:
    return np.cumsum(_unshuffled(data).view(np.uint32).reshape(shape), axis=1, dtype=np.uint32)


def _encode_delta(disparity: _Map) -> bytes:
    return _shuffled(_differences(np.ascontiguousarray(disparity).view(np.uint32)))


def _decode_delta(data: bytes, shape: _Shape) -> _Map:
    return _sums(data, shape).view(np.float32)


def _encode_grid(disparity: _Map) -> bytes:
    return _shuffled(np.rint(disparity * np.float32(_GRID_STEPS)) / np.float32(_GRID_STEPS))


def _encode_grid_delta(disparity: _Map) -> bytes:
    kept = disparity < _LARGEST_GRID_PX
    steps = np.rint(np.where(kept, disparity, 0).astype(np.float64) * _GRID_STEPS).astype(np.int32)
    return _shuffled(_differences(np.where(kept, steps, np.int32(_NOTHING)).view(np.uint32)))


def _decode_grid_delta(data: bytes, shape: _Shape) -> _Map:
    steps = _sums(data, shape).view(np.int32)
    return np.where(steps == _NOTHING, np.float32(np.inf), (steps / _GRID_STEPS).astype(np.float32))


def _encode_blosc2(disparity: _Map) -> bytes:
    import blosc2  # noqa: PLC0415 - not installed everywhere

    blosc2.set_nthreads(1)
    return blosc2.compress(
        np.ascontiguousarray(disparity), typesize=4, clevel=5, filter=blosc2.Filter.SHUFFLE, codec=blosc2.Codec.LZ4
    )


def _decode_blosc2(data: bytes, shape: _Shape) -> _Map:
    import blosc2  # noqa: PLC0415 - not installed everywhere

    return np.frombuffer(blosc2.decompress(data), np.float32).reshape(shape)


def command_line() -> argparse.ArgumentParser:
    """Return the parser of this script's options."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", default="eth3d", help="whose scenes: a name or a YAML file")
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="dotted.key=value")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--backend", choices=BACKENDS, default="auto")
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--rays", type=int, default=20_000, help="rays cast for each eye of a pair")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", type=Path)
    return parser


def main() -> None:
    """Measure, print the tables, and write JSON where a path is given."""
    options = command_line().parse_args()
    config = load_config(options.config, options.settings)
    report = measure(config, options.seed, options.backend, options.pairs, options.rays, options.repeats)
    report["command"] = shlex.join(["python", "benchmarks/alternatives.py", *sys.argv[1:]])
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    print(f"{headline(report)}\n\n{table(report)}")


if __name__ == "__main__":
    main()
