"""Faults planted in a dataset's files, and the findings of `verify`."""

import json

import numpy as np
from PIL import Image
from tiny_datasets import verified

from semisynth_gl.codecs.flo import Flo
from semisynth_gl.codecs.pfm import PFM, PFM3
from semisynth_gl.codecs.png import GREY8, RGB8


def findings(dataset, rays=0):
    """Return verify's findings without those of digests, which any change of a file causes."""
    return [finding for finding in verified(dataset, rays).findings if finding.check != "sha256"]


def checks(dataset, rays=0):
    return {finding.check for finding in findings(dataset, rays)}


def change_file(path, change, codec=None):
    """Change the array in a file. ``codec`` is for flow whose codec does not follow from the file's name."""
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
    """Return a function that sets one pixel of a copy of an array."""

    def change(array):
        array = array.copy()
        array[row, column] = value
        return array

    return change
