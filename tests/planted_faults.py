"""Faults planted in the files of a dataset, and what `verify` finds of them."""

import numpy as np
from PIL import Image

from semisynth_gl.dataset.reader import read_index
from semisynth_gl.read.pfm import read_pfm
from semisynth_gl.verify.dataset import verify_dataset
from semisynth_gl.write.pfm import encode_pfm
from semisynth_gl.write.png import encode_png


def all_findings(dataset, rays=0):
    return [finding for verdict in verify_dataset(read_index(dataset), rays) for finding in verdict.findings]


def findings(dataset, rays=0):
    """What is found beside the digest, which gives every change of a file away."""
    return [finding for finding in all_findings(dataset, rays) if finding.check != "sha256"]


def checks(dataset, rays=0):
    return {finding.check for finding in findings(dataset, rays)}


def change_image(path, change):
    image = np.asarray(Image.open(path))
    path.write_bytes(encode_png(np.ascontiguousarray(change(image))))


def change_disparity(path, change):
    path.write_bytes(encode_pfm(np.asarray(change(read_pfm(path)), np.float32)))


def swap(scene, *stems):
    for one, other in stems:
        (scene / one).rename(scene / "swapped")
        (scene / other).rename(scene / one)
        (scene / "swapped").rename(scene / other)
