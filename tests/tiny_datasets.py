"""Configs of tiny pairs, and datasets generated from them."""

import hashlib
import json
import sys
from pathlib import Path

from semisynth_gl.config import Config, Range, load_config
from semisynth_gl.judge.verify import verify

SCALE = 1 / 8
# Removes the recipes of a packaged config.
CLUTTER_ALONE = ("scenes=[]", "textures.large_px=0")
# The folder of scenes in Middlebury's layout.
SCENES = "MiddEval3/trainingF"
# Used by `command`.
PAIRS = 7
SEED = 5


def scaled(value):
    """Scale a value in pixels to a sensor an eighth as wide; the scene stays the same."""
    if isinstance(value, list):
        return [each * SCALE for each in value]
    return None if value is None else value * SCALE


def tiny(name="middlebury", **sections):
    """Load a packaged config without recipes, at an eighth of its size, and replace keys of sections."""
    values = load_config(name, CLUTTER_ALONE).model_dump(mode="json")
    camera, disparity, background = values["camera"], values["disparity"], values["background"]
    for key in ("focal_px", "cx_left_px", "cx_right_px", "cy_px", "doffs_px"):
        camera[key] = scaled(camera[key])
    camera["width_px"], camera["height_px"] = int(camera["width_px"] * SCALE), int(camera["height_px"] * SCALE)
    for key in ("min_px", "max_px"):
        disparity[key] = scaled(disparity[key])
    disparity["target"]["bin_px"] = scaled(disparity["target"]["bin_px"])
    for key in ("wall_disparity_px", "plane_disparity_px"):
        background[key] = scaled(background[key])
    values["particles"]["size_px"] = scaled(values["particles"]["size_px"])
    for layer in values["particles"]["layers"] or ():
        layer["disparity_px"] = scaled(layer["disparity_px"])
    values["models"]["variants"] = 1
    values["textures"] |= {"patch_px": 64, "max_patches": 64}
    if values["textures"]["source"] == "builtin":
        # Painting the built-in pictures takes seconds.
        values["textures"]["source"] = "photographs"
    for section, keys in sections.items():
        values[section] |= keys
    return Config.model_validate(values)


def lean(name="middlebury", **sections):
    """Like `tiny`, with a tenth of the models."""
    most = load_config(name).disparity.max_px * SCALE
    few = {"layers": [{"disparity_px": [0.1 * most, 0.9 * most], "count": 60}]}
    return tiny(name, **{"particles": few, "models": {"complex": 0.3}} | sections)


def cheap(**sections):
    """Make a config whose pairs render in milliseconds."""
    particles = {"layers": [{"disparity_px": [2, 12], "count": 5}]}
    base = {"particles": particles, "models": {"complex": 0, "variants": 1}, "textures": {"max_patches": 16}}
    values = tiny("sceneflow", **base).model_dump(mode="json")
    values["camera"] |= {"width_px": 64, "height_px": 48}
    values["outputs"] = ["visibility", "instances", "depth"]
    for section, keys in sections.items():
        values[section] = values.get(section, {}) | keys if isinstance(keys, dict) else keys
    return Config.model_validate(values)


# Lenses for `cheap`, whose pairs have 64 x 48 px and a focal length of 131.25 px.
EYE = {"fx_px": 140, "distortion": [-0.3, 0.05, 0.001, 0], "rotation_deg": [0.2, [-1, 1], 0.3]}
LENS = {"raw_width_px": 64, "raw_height_px": 48, "left": EYE, "right": EYE | {"fx_px": [135, 145]}}


def with_lens(**changes):
    """Like `cheap`, with lenses that leave invalid borders."""
    lens = LENS | changes.pop("lens", {})
    return cheap(**{"lens": lens, "outputs": ["visibility", "valid", "depth"]} | changes)


def config_of(**changes):
    """Make a config of few large models with few triangles, so that rays are cheap."""
    config = tiny(
        "middlebury", models={"complex": 0.0, "user": 0.0}, textures={"source": "procedural", "max_patches": 24}
    )
    particles = config.particles.model_copy(update={"size_px": Range(30.0, 120.0), "most": 120})
    return config.model_copy(update={"particles": particles, **changes})


def digests(folder):
    """Return each file's digest by path; a shard's log has none, since it records a duration."""
    found = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_file():
            data = path.read_bytes()
            if path.parent.name == "shards" and path.suffix == ".log":
                log = json.loads(data)
                assert list(log) == ["seconds"]
                assert log["seconds"] > 0
                data = b""
            found[path.relative_to(folder).as_posix()] = hashlib.sha256(data).hexdigest()
    return found


def verified(out, rays=0):
    """Verify a dataset with ``rays`` rays for each pair."""
    return verify(out, rays=sys.maxsize * bool(rays), pixels=rays or 1)


def findings(out, rays=0):
    return list(map(str, verified(out, rays).findings))


def command(config, out, layout, *options):
    path = Path(out).parent / "config.yaml"
    # JSON is YAML.
    path.write_text(json.dumps(config.model_dump(mode="json", exclude_none=True)))
    arguments = ["--config", path, "--out", out, "--pairs", PAIRS, "--seed", SEED, "--layout", layout]
    return [sys.executable, "-m", "semisynth_gl", "generate", *map(str, (*arguments, "--shard-pairs", 3, *options))]
