"""Completeness: is every file there that a loader or the dataset itself counts on, and none that misleads one."""

import hashlib
import json
from typing import Any

from semisynth_gl.read.error import ReadError, read_bytes
from semisynth_gl.read.middlebury import OPTIONAL, SCENE_LIST, SCENES, Index, SceneFiles, of_right_view, required
from semisynth_gl.verify.finding import Verdict


def check_index(index: Index, verdict: Verdict) -> None:
    """Check dataset.json, official_train.txt and the folders of the scenes against each other."""
    if index.fault is not None:
        verdict.add("index", f"{index.fault}: the dataset is not finished")
    elif not index.scenes:
        verdict.add("index", "dataset.json lists no scene")
    config, digest = index.config, index.values.get("config_sha256")
    if index.values and digest_of(config) != digest:
        verdict.add("index", f"config_values have the digest {digest_of(config)[:12]}, config_sha256 is {digest!s:.12}")
    if index.values and index.values.get("pairs") != len(index.scenes):
        verdict.add(
            "index", f"dataset.json lists {len(index.scenes)} scenes, and says {index.values.get('pairs')} pairs"
        )
    if len(set(index.scenes)) < len(index.scenes):
        verdict.add("index", "dataset.json lists a scene twice")
    folder = index.path / SCENES
    held = {entry.name for entry in folder.iterdir()} if folder.is_dir() else set()
    # Loaders take every entry of trainingF for a scene.
    for name in sorted(held - set(index.scenes)):
        verdict.add("files", f"{SCENES}/{name} is not in dataset.json, but loaders will read it as a scene")
    try:
        listed = read_bytes(index.path / SCENE_LIST).decode("utf-8", "replace").splitlines()
    except ReadError as error:
        verdict.add("files", f"{SCENE_LIST} {error.reason}")
        return
    if listed != list(index.scenes):
        lacking = sorted(set(index.scenes) - set(listed))
        example = f"; it lacks {lacking[0]}" if lacking else ""
        verdict.add("files", f"{SCENE_LIST} has {len(listed)} names, not the {len(index.scenes)} of the index{example}")


def check_scene_folder(index: Index, verdict: Verdict) -> bool:
    """Check that a scene's folder holds exactly the files that it should; return whether it is there at all."""
    folder = index.scene_path(verdict.scene)
    if not folder.is_dir():
        verdict.add("files", "the folder of the scene is missing")
        return False
    held = {entry.name for entry in folder.iterdir()}
    always = required(index.encodings).keys()
    needed, allowed = _expected(index)
    if index.left_alone:
        needed -= of_right_view(index.encodings).keys()
    for name in sorted(needed - held - always):
        verdict.add("files", f"{name} is missing")
    for name in sorted(held - needed - allowed):
        why = ": the evaluation kit judges every disp0*.pfm" if name.startswith("disp0") else ""
        verdict.add("files", f"{name} does not belong here{why}")
    return True


def check_sizes(scene: SceneFiles, index: Index, verdict: Verdict) -> bool:
    """Compare the sizes of all arrays with calib.txt's and the config's; return whether all arrays are of one size."""
    camera = scene.calibration.camera
    size = (camera.height_px, camera.width_px)
    wanted = (index.number("camera", "height_px"), index.number("camera", "width_px"))
    if index.values and wanted != size:
        verdict.add("size", f"calib.txt says {size[1]} x {size[0]}, the config {wanted[1]} x {wanted[0]}")
    (left, right), (disparity_left, disparity_right) = scene.encodings.image_names, scene.encodings.disparity_names
    arrays: dict[str, Any] = {
        left: scene.left,
        right: scene.right,
        disparity_left: scene.disparity_left,
    } | scene.optional
    if scene.disparity_right is not None:
        arrays[disparity_right] = scene.disparity_right
    fits = True
    for name, array in arrays.items():
        if array.shape[:2] != size:
            fits = False
            verdict.add("size", f"{name} is {array.shape[1]} x {array.shape[0]}, calib.txt says {size[1]} x {size[0]}")
    return fits


def check_pair(scene: SceneFiles, index: Index, verdict: Verdict) -> None:
    """Compare what pair.json says of its origin with dataset.json and with the scene's place in it."""
    for key in ("program", "version", "config", "config_sha256", "seed"):
        if index.values and scene.pair.get(key) != index.values.get(key):
            verdict.add(
                "origin", f"pair.json has {key} {scene.pair.get(key)!r}, dataset.json {index.values.get(key)!r}"
            )
    number = verdict.scene.rpartition("-")[2]
    if not (number.isdecimal() and scene.pair.get("pair") == int(number)):
        verdict.add("origin", f"pair.json says that it is pair {scene.pair.get('pair')}")


def digest_of(config: dict[str, Any]) -> str:
    """SHA-256 of config values in the form that ``config_sha256`` is taken of, 64 hex digits."""
    return hashlib.sha256(json.dumps(config, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _expected(index: Index) -> tuple[set[str], set[str]]:
    """Names that a scene must hold, and names that it may hold besides."""
    both = required(index.encodings).keys() | {index.encodings.disparity_names[1]}
    if index.outputs is None:
        # Before the key existed there was one mask, and nothing said which further files to expect.
        return both | {"mask0nocc.png"}, {name for files in OPTIONAL.values() for name in files}
    return both | {name for output in index.outputs for name in OPTIONAL.get(output, ())}, set()
