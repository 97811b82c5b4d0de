"""Faults planted in the files of a dataset, and what `verify` finds of them."""

import json

import numpy as np
from PIL import Image
from tiny_datasets import verified

from semisynth_gl.codecs.flo import Flo
from semisynth_gl.codecs.pfm import PFM, PFM3
from semisynth_gl.codecs.png import GREY8, RGB8


def findings(dataset, rays=0):
    """What is found beside the digest, which gives every change of a file away."""
    return [finding for finding in verified(dataset, rays).findings if finding.check != "sha256"]


def checks(dataset, rays=0):
    return {finding.check for finding in findings(dataset, rays)}


def change_file(path, change, codec=None):
    """Change the array that a file holds; flow may have another codec than its name tells."""
    if codec is None and path.suffix == ".png":
        changed = np.ascontiguousarray(change(np.asarray(Image.open(path))))
        codec = GREY8 if changed.ndim == 2 else RGB8
    else:
        codec = codec or (Flo() if path.suffix == ".flo" else PFM3 if path.name.startswith("normals") else PFM)
        changed = np.ascontiguousarray(change(codec.read(path)), np.float32)
    path.write_bytes(codec.encode(changed))


def change_json(path, change):
    values = json.loads(path.read_text("utf-8"))
    change(values)
    path.write_text(json.dumps(values), "utf-8")


def swap(scene, *stems):
    for one, other in stems:
        (scene / one).rename(scene / "swapped")
        (scene / other).rename(scene / one)
        (scene / "swapped").rename(scene / other)


def at_pixel(row, column, value):
    """What changes an array at one pixel."""

    def change(array):
        array = array.copy()
        array[row, column] = value
        return array

    return change
