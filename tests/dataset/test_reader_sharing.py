"""One open dataset that many processes and threads read: every array is its pair's."""

import multiprocessing
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hand_made_datasets import config_of, write_dataset
from hand_made_pairs import make_frame

from semisynth_gl.dataset.reader import open_dataset

PAIRS = 8
READS = 400

_shared = []


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Opened, and read from, in this process: what a reader holds open is open before it is shared."""
    out = tmp_path_factory.mktemp("shared")
    write_dataset(out, "webdataset", {"train": PAIRS}, 3, config_of(outputs=[]))
    opened = open_dataset(out)
    assert len(opened) == PAIRS
    assert count_wrong(opened, range(PAIRS)) == 0
    return opened


def count_wrong(opened, numbers):
    """Read pairs, and count those that fail or have a pixel that is not theirs."""
    truth = [make_frame(number, ()).arrays() for number in range(PAIRS)]
    wrong = 0
    for number in numbers:
        try:
            arrays = opened[number].arrays()
            same = arrays.keys() == truth[number].keys() and all(
                np.array_equal(array, truth[number][role]) for role, array in arrays.items()
            )
        except Exception:  # noqa: BLE001 - every failure counts, of whatever kind
            same = False
        wrong += not same
    return wrong


def orders(readers):
    """The pairs that each reader reads, in an order of its own."""
    return [np.random.default_rng(reader).integers(0, PAIRS, READS // readers).tolist() for reader in range(readers)]


def keep(opened):
    _shared.append(opened)


def count_wrong_of_shared(numbers):
    return count_wrong(_shared[-1], numbers)


@pytest.mark.parametrize(("method", "readers"), [("fork", 4), ("spawn", 2)])
def test_processes_read_what_was_written(dataset, method, readers):
    with multiprocessing.get_context(method).Pool(readers, keep, (dataset,)) as pool:
        assert pool.map(count_wrong_of_shared, orders(readers), chunksize=1) == [0] * readers


def test_threads_read_what_was_written(dataset):
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda numbers: count_wrong(dataset, numbers), orders(4))) == [0] * 4


def test_a_reader_travels(dataset):
    assert count_wrong(pickle.loads(pickle.dumps(dataset)), range(PAIRS)) == 0  # noqa: S301 - pickled here
