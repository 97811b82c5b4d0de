"""Making the plan of a dataset: its layout, and the number of pairs in a shard."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from math import ceil
from typing import Any

from pydantic import ValidationError

from semisynth_gl.config import Config
from semisynth_gl.config.errors import reason_of
from semisynth_gl.dataset.documents import FORMAT, MOST_PAIRS, PROGRAM, DatasetPlan
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.inputs.errors import InputError, shown
from semisynth_gl.layouts import Layout, find_layout
from semisynth_gl.layouts.layout import sequence_length
from semisynth_gl.plugins import BUILT_IN, PluginPackage, plugin_packages
from semisynth_gl.seeds.splits import SPLITS, SplitName

# Shards are small, since a run that is killed loses its unfinished shards.
_MOST_SHARD_PAIRS = 64
# Maximum number of pixels of a shard's left images; the shard's files then have about 1 GB.
_SHARD_PIXELS = 86_000_000
# Number of shards to aim for in the largest split, so that several workers have work.
_FEWEST_SHARDS = 8
# From this number of pairs on, single files are slower than tars on most file systems.
_MANY_PAIRS = 10_000
_ABSENT = object()


def make_plan(
    config: Config, seed: int, layout_name: str | None, pairs: Mapping[SplitName, int], shard_pairs: int | None = None
) -> DatasetPlan:
    """Make the plan of a dataset; the config gets outputs that the layout needs.

    Args:
        config: the config of the pairs.
        seed: 0 or more.
        layout_name: by default the config's, else ``middlebury``, and ``webdataset`` from 10,000 pairs on.
        pairs: number of pairs of each split, which may be 0.
        shard_pairs: pairs in a shard; by default 64, or fewer in small datasets or with large images, rounded up to
            whole sequences.

    Raises:
        InputError: where a number is out of range, there is no such layout, or the layout cannot hold the config's
            outputs, encodings or sequences.
    """
    if not pairs.keys() <= {*SPLITS}:
        raise InputError(f"expected the splits {', '.join(SPLITS)}, got {shown(list(pairs))}", argument="pairs")
    counts = {name: to_whole(f"pairs of {name}", pairs[name], 1, MOST_PAIRS) for name in SPLITS if pairs.get(name)}
    if not counts:
        raise InputError(f"expected at least one pair, got {dict(pairs)}")
    layout_name = layout_name or config.layout or ("middlebury" if sum(counts.values()) < _MANY_PAIRS else "webdataset")
    layout = find_layout(layout_name)
    if (reason := _conflict(config, layout)) is not None:
        raise InputError(f"the layout {layout_name} {reason}; or choose another layout, such as middlebury")
    if lacking := sorted(layout.needs.difference(config.outputs)):
        config = _with_outputs(config, lacking, layout_name)
    if shard_pairs is None:
        shard_pairs = _shard_pairs(config, max(counts.values()))
    return DatasetPlan.model_validate(
        {
            "program": PROGRAM,
            "version": version(PROGRAM),
            "format": FORMAT,
            "config": config.name,
            "config_sha256": config.digest(),
            "config_values": config.model_dump(mode="json"),
            "seed": to_whole("seed", seed, least=0),
            "layout": layout_name,
            "pairs": counts,
            "shard_pairs": to_whole("shard_pairs", shard_pairs, 1, MOST_PAIRS),
            "views": config.views,
            "plugins": used_plugins(config, layout_name),
        }
    )


def _with_outputs(config: Config, outputs: Sequence[str], layout_name: str) -> Config:
    """Return a config with the outputs that the layout needs; raises InputError if the config cannot have them."""
    values = config.model_dump(mode="json") | {"outputs": [*config.outputs, *outputs]}
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        reasons = "; ".join(dict.fromkeys(map(reason_of, error.errors(include_url=False))))
        raise InputError(f"the layout {layout_name} needs the output {', '.join(outputs)}; then {reasons}") from None


def _conflict(config: Config, layout: Layout) -> str | None:
    """Return why a layout cannot hold a config's outputs, encodings or sequences; None if it can."""
    encodings, length, most = layout.encodings_for(config), sequence_length(config), layout.most_frames
    if layout.encodings is not None and config.files != type(config.files)():
        return "sets the encodings itself: leave the section files out of the config"
    if length is not None and most is not None and length > most:
        return f"has names for {most} frames of a sequence with flow: lower sequence.length to {most}"
    if unknown := layout.lacks.intersection(config.outputs):
        return f"has no files for the output {min(unknown)}: leave it out of outputs"
    if encodings.signed and not encodings.disparity.signed:
        return f"stores disparities as {encodings.disparity.description}, which cannot be signed"
    return None


def used_plugins(config: Config, layout_name: str) -> dict[str, dict[str, PluginPackage]]:
    """Return the records of a dataset's plug-ins; raises InputError if one is not installed."""
    used = [*config.used_plugins().values()]
    if layout_name not in BUILT_IN["layouts"]:
        used.append(("layouts", layout_name))
    return plugin_packages(used)


def _shard_pairs(config: Config, pairs: int) -> int:
    pixels = config.camera.width_px * config.camera.height_px
    if config.lens is not None and "raw" in config.outputs:
        pixels += config.lens.raw_width_px * config.lens.raw_height_px
    fitting = max(1, min(_MOST_SHARD_PAIRS, _SHARD_PIXELS // pixels, ceil(pairs / _FEWEST_SHARDS)))
    # Shards have whole sequences: the scene of a sequence in two shards would be made twice.
    return ceil(fitting / config.sequence_pairs) * config.sequence_pairs


def differences(before: Mapping[Any, Any], now: Mapping[Any, Any], prefix: str = "") -> list[str]:
    """Describe the differences of two mappings in JSON's types: a text for each dotted key, with both values."""
    texts: list[str] = []
    for key in dict.fromkeys((*before, *now)):
        old, new = before.get(key, _ABSENT), now.get(key, _ABSENT)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            texts += differences(old, new, f"{prefix}{key}.")
        elif old != new:
            texts.append(f"{prefix}{key} ({_shown(old)} there, {_shown(new)} now)")
    return texts


def _shown(value: object) -> str:
    return "nothing" if value is _ABSENT else shown(value, 40)
