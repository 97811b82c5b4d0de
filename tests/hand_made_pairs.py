"""Hand-made pairs, encoded in any layout."""

from pathlib import Path

import numpy as np

from semisynth_gl.codecs import Encodings
from semisynth_gl.dataset.pair_files import assemble_frame, decode_file, encode_pair
from semisynth_gl.frame.camera import EYES, StereoCamera
from semisynth_gl.frame.channels import OCCLUDED, OUTPUTS, OUTSIDE, ROLES, SKY, VISIBLE, ViewArrays
from semisynth_gl.frame.frame import Frame
from semisynth_gl.layouts import PairKey

CAMERA = StereoCamera.centred(48, 32, 60.0, 0.25, 1.5)
PAIRS = 7
INF = np.float32(np.inf)
RAW = 36, 50


def make_view(rng, index, side):
    """Make every channel of one eye. Image and disparity encode the pair's number at (4, 4)."""
    height, width = CAMERA.height_px, CAMERA.width_px
    image = rng.integers(0, 256, (height, width, 3), np.uint8)
    image[:8, :8] = index % 32 * 8, 0 if side == "left" else 255, 128
    # The fraction keeps points off the image's border, where rounding would decide whether they are outside.
    disparity = (rng.integers(1, 30, (height, width)) + rng.uniform(0.2, 0.3, (height, width))).astype(np.float32)
    disparity[rng.random((height, width)) < 0.1] = np.inf
    disparity[4, 4] = index + (1.25 if side == "left" else 101.25)
    along = np.where(np.isfinite(disparity), -disparity if side == "left" else disparity, INF)
    ways = np.stack([along, np.where(np.isfinite(disparity), np.float32(0), INF)], axis=2)
    channels = {"image": image, "disparity": disparity, "visibility": mask_of(rng, ways), "correspondence": ways}
    channels["depth"] = np.where(np.isfinite(disparity), CAMERA.depth_m(disparity), np.inf).astype(np.float32)
    channels["instances"] = rng.integers(0, 9, (height, width), np.uint16)
    for kind in ("flow", "flow_backward"):
        # As for the disparity.
        flow = rng.integers(-20, 20, (height, width, 2)) + rng.uniform(0.2, 0.3, (height, width, 2))
        flow[rng.random((height, width)) < 0.1] = np.inf
        channels[kind] = flow.astype(np.float32)
        channels[f"{kind}_visibility"] = mask_of(rng, channels[kind])
    change = rng.normal(0, 3, (height, width)).astype(np.float32)
    channels["disparity_change"] = np.where(np.isfinite(disparity), change, INF)
    normals = rng.normal(size=(height, width, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    channels["normals"] = np.where(np.isfinite(disparity)[..., None], normals, 0).astype(np.float32)
    channels["sky"] = np.where(np.isfinite(disparity), 0, SKY).astype(np.uint8)
    channels["valid"] = rng.choice([VISIBLE, OUTSIDE], (height, width)).astype(np.uint8)
    channels["raw"] = rng.integers(0, 256, (*RAW, 3), np.uint8)
    channels["raw_map"] = rng.uniform(0, RAW[0], (height, width, 2)).astype(np.float32)
    return ViewArrays(channels)


def mask_of(rng, ways):
    """Make a visibility mask for vectors from pixels to their points in another image."""
    height, width = ways.shape[:2]
    column, row = np.arange(width) + ways[..., 0], np.arange(height)[:, None] + ways[..., 1]
    inside = (column >= -0.5) & (column < width - 0.5) & (row >= -0.5) & (row < height - 0.5)
    return np.where(inside, rng.choice([VISIBLE, OCCLUDED], (height, width)), OUTSIDE).astype(np.uint8)


def make_frame(index, outputs=OUTPUTS, truth="both"):
    rng = np.random.default_rng(index)
    arrays = Frame(CAMERA, *(make_view(rng, index, side) for side in EYES)).arrays()
    asked = {
        role
        for role, (side, channel) in ROLES.items()
        if channel.output in {None, *outputs} and (truth == "both" or side == "left" or not channel.is_truth)
    }
    return Frame.from_arrays(CAMERA, {role: array for role, array in arrays.items() if role in asked})


def make_provenance(index):
    """Make a record like the pipeline's: some pairs lack some keys, and numbers mix int and float."""
    provenance = {
        "pair": index,
        "split": "train",
        "program": "semisynth-gl",
        "version": "0.1.0",
        "config": "lab",
        "config_sha256": "0" * 64,
        "seed": 2**62 + 1,
        "renderer": "llvmpipe",
        "backend": "egl",
        "sequence": index,
        "frame": 0,
        "background": "cuboid",
        "near_m": 0.5 if index % 2 else 1,
        "camera": CAMERA.values(),
        "lens": {eye: {"height_px": RAW[0], "width_px": RAW[1]} for eye in EYES},
        "models": {"face": 6, f"model-{index}": 2},
        "instances": [{"model": "face" if row < 6 else "cube", "patch": row, "still": row < 6} for row in range(8)],
    }
    if index > 5:
        provenance["redrawn"] = ["too dark"]
    return provenance


def encode(*arguments, **options):
    """Return a pair's files by path."""
    return encoded(*arguments, **options).files


def encoded(layout, index, split="train", frame=None, encodings=None, length=None):
    key = PairKey("lab", split, index, length)
    frame = make_frame(index) if frame is None else frame
    provenance = make_provenance(index) | {"split": split, "camera": frame.camera.values()}
    return encode_pair(layout, key, frame, provenance, 256, encodings or layout.encodings or Encodings())


def decode(layout, index, files, split="train", encodings=None, length=None):
    encodings = encodings or layout.encodings or Encodings()
    key = PairKey("lab", split, index, length)
    roles = {path: role for role, path in layout.files(key, encodings).items()}
    values = {
        roles[path]: decode_file(layout, roles[path], data, Path(path), encodings) for path, data in files.items()
    }
    return assemble_frame(key, values, encodings)
