"""One open dataset that many processes and threads read: every array is its pair's."""

import multiprocessing
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hand_made_datasets import config_of, write_dataset
from hand_made_pairs import make_frame

from semisynth_gl.dataset.reader import open_dataset

PAIRS, READS = 8, 100

_shared = []


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Opened, and read from, in this process: what a reader holds open is open before it is shared."""
    out = tmp_path_factory.mktemp("shared")
    write_dataset(out, "webdataset", {"train": PAIRS}, 3, config_of(outputs=[]))
    opened = open_dataset(out)
    check(opened, range(PAIRS))
    return opened


def check(opened, numbers):
    for number in numbers:
        truth = make_frame(number, ()).arrays()
        arrays = opened[number].arrays()
        assert arrays.keys() == truth.keys()
        assert all(np.array_equal(array, truth[role]) for role, array in arrays.items())


def share(opened):
    _shared.append(opened)


def check_shared(reader):
    """Read pairs in an order of the reader's own."""
    check(_shared[-1], np.random.default_rng(reader).integers(0, PAIRS, READS).tolist())


@pytest.mark.parametrize(("method", "readers"), [("fork", 4), ("spawn", 2)])
def test_processes_read_what_was_written(dataset, method, readers):
    with multiprocessing.get_context(method).Pool(readers, share, (dataset,)) as pool:
        pool.map(check_shared, range(readers), chunksize=1)


def test_threads_read_what_was_written(dataset):
    share(dataset)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(check_shared, range(4)))
