"""Faults planted in the files of a dataset, and what `verify` finds of them."""

import numpy as np
from PIL import Image
from tiny_datasets import verified

from semisynth_gl.codecs.flo import Flo
from semisynth_gl.codecs.pfm import PFM, PFM3
from semisynth_gl.codecs.png import GREY8, RGB8


def all_findings(dataset, rays=0):
    return verified(dataset, rays).findings


def findings(dataset, rays=0):
    """What is found beside the digest, which gives every change of a file away."""
    return [finding for finding in all_findings(dataset, rays) if finding.check != "sha256"]


def checks(dataset, rays=0):
    return {finding.check for finding in findings(dataset, rays)}


def change_image(path, change):
    image = np.asarray(Image.open(path))
    changed = np.ascontiguousarray(change(image))
    path.write_bytes((GREY8 if changed.ndim == 2 else RGB8).encode(changed))


def change_disparity(path, change):
    path.write_bytes(PFM.encode(np.asarray(change(PFM.read(path)), np.float32)))


def change_normals(path, change):
    path.write_bytes(PFM3.encode(np.asarray(change(PFM3.read(path)), np.float32)))


def change_vectors(path, change):
    path.write_bytes(Flo().encode(np.asarray(change(Flo().read(path)), np.float32)))


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
