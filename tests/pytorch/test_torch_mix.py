"""Streams and datasets mixed: each in its share, the same whoever draws, resumed anywhere."""

import copy
import json
import pickle
from collections import Counter
from fractions import Fraction
from itertools import chain, islice

import numpy as np
import pytest
from hand_made_datasets import config_of, write_dataset
from heavy import heavy
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from tiny_datasets import cheap

from semisynth_gl.inputs.errors import InputError

torch = heavy("torch")
pytestmark = pytest.mark.heavy

from torch.utils.data import ConcatDataset, DataLoader, Dataset, IterableDataset  # noqa: E402 - torch is optional

from semisynth_gl.torch import (  # noqa: E402
    Hardware,
    Selection,
    StereoDataset,
    StereoMix,
    StereoStream,
    TrainingProcess,
    collate,
)
from semisynth_gl.torch.mix import Turns  # noqa: E402

SEED = 3
CROP = (20, 30)
TIMEOUT_S = 120


class Numbers(Dataset):
    """Samples that say where they are from."""

    def __init__(self, name, length):
        self.name, self.length = name, length

    def __len__(self):
        return self.length

    def __getitem__(self, number):
        assert 0 <= number < self.length
        return f"{self.name}{number}"


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two datasets of pairs made by hand, of 7 and 3 pairs."""
    made = {}
    for name, pairs in (("lab", 7), ("hall", 3)):
        made[name] = tmp_path_factory.mktemp(name)
        write_dataset(made[name], "webdataset", {"train": pairs}, 3, config_of(name=name))
    return made


def marked(sample):
    """A pair by its number and the place of its crop."""
    return sample["index"], sample["camera"]["cx_left_px"], sample["camera"]["cy_px"]


def mixed(folders, **options):
    lab, hall = (StereoDataset(folder, crop=CROP, transform=marked) for folder in folders.values())
    return StereoMix([(lab, 1), (Numbers("n", 5), 2), (hall, 0.5)], SEED, **options)


def identity(sample):
    return sample


def drawn(mix, workers=0, batch=2):
    """The samples of a mix in the order in which a loader has them."""
    ways = {"multiprocessing_context": "fork", "timeout": TIMEOUT_S} if workers else {}
    return list(chain.from_iterable(DataLoader(mix, batch, num_workers=workers, collate_fn=identity, **ways)))


@pytest.mark.parametrize("shares", [(1,), (1, 1), (1, 2, 0.5), (0.7, 0.2, 0.1), (1000, 1), (3, 5, 7, 11), (1e-9, 1)])
@pytest.mark.parametrize("seed", [0, 1, 2**70])
def test_each_source_has_its_share_at_any_time(shares, seed):
    parts = [Fraction(share) / sum(map(Fraction, shares)) for share in shares]
    turns, counts = Turns(parts, seed), np.zeros(len(parts), int)
    for turn in range(20 * 256):
        source, earlier = turns[turn]
        assert earlier == counts[source]
        counts[source] += 1
        if turn % 256 == 255:
            # Whole windows are exact but for what the golden section makes up for.
            assert np.abs(counts - (turn + 1) * np.array(parts, float)).max() < 2


@given(
    st.lists(st.integers(1, 1000), min_size=1, max_size=5),
    st.integers(0, 2**64),
    st.lists(st.integers(0, 10**7), max_size=5),
)
def test_a_turn_is_the_same_from_wherever_it_is_asked_for(shares, seed, asked):
    parts = [Fraction(share, sum(shares)) for share in shares]
    turns = Turns(parts, seed)
    for turn in asked:
        source, earlier = turns[turn]
        assert (source, earlier) == Turns(parts, seed)[turn]
        # The next turns of the same source go on counting.
        later = next(each for each in range(turn + 1, turn + 10**7) if turns[each][0] == source)
        assert turns[later][1] == earlier + 1
        assert abs(earlier - turn * float(parts[source])) < 70


def test_the_seed_decides_the_order():
    turns = [Turns([Fraction(1, 2)] * 2, seed) for seed in range(20)]
    assert len({tuple(each[turn][0] for turn in range(64)) for each in turns}) == 20
    # No pattern that batches or ranks could fall in step with.
    long = [turns[0][turn][0] for turn in range(4096)]
    for step in range(1, 40):
        agree = np.mean([one == other for one, other in zip(long, long[step:], strict=False)])
        assert 0.4 < agree < 0.6


def test_datasets_are_read_whole_before_they_are_read_again(folders):
    samples = list(islice(mixed(folders), 700))
    numbers = [sample for sample in samples if isinstance(sample, str)]
    pairs = [sample for sample in samples if not isinstance(sample, str)]
    assert abs(len(numbers) - 400) <= 3
    passes = [numbers[begin : begin + 5] for begin in range(0, 395, 5)]
    assert {tuple(sorted(each)) for each in passes} == {("n0", "n1", "n2", "n3", "n4")}
    assert len({*map(tuple, passes)}) > 50  # of 79 passes and 120 orders
    assert all(pairs.count(pair) < 20 for pair in pairs)  # crops are others in each pass
    assert list(islice(mixed(folders, first=333), 40)) == samples[333:373]


def test_first_passes_have_the_crops_of_the_first_epochs(folders):
    lab = StereoDataset(folders["lab"], crop=CROP, transform=marked)
    samples = list(islice(StereoMix([(lab, 3)], SEED), 21))
    for epoch in range(3):
        part = samples[7 * epoch : 7 * epoch + 7]
        assert sorted(part) == sorted(lab.at_epoch(epoch))
        assert part != sorted(part)


def test_a_mix_is_the_same_whoever_draws(folders):
    wanted = drawn(mixed(folders, pairs=60, first=5, batch_size=2))
    assert len(wanted) == 60
    assert wanted == list(islice(mixed(folders), 65))[5:]
    for workers in (1, 2, 3):
        assert drawn(mixed(folders, pairs=60, first=5, batch_size=2), workers) == wanted
    for workers in (0, 2):
        ranks = [
            drawn(mixed(folders, pairs=60, first=5, batch_size=2, process=TrainingProcess(rank, 2)), workers)
            for rank in (0, 1)
        ]
        steps = [[rank[at : at + 2] for rank in ranks] for at in range(0, 30, 2)]
        assert list(chain.from_iterable(chain.from_iterable(steps))) == wanted
    assert len(mixed(folders, pairs=60, batch_size=2, process=TrainingProcess(1, 2))) == 30


@pytest.mark.parametrize("process", [TrainingProcess(), TrainingProcess(1, 2)], ids=["alone", "second of two"])
def test_a_mix_goes_on_where_it_was(folders, process):
    options = {"pairs": 41, "batch_size": 2, "process": process}
    first = mixed(folders, **options)
    whole = list(first)
    for after in (0, 1, 7, len(whole)):
        iterator = iter(first)
        begun = list(islice(iterator, after))
        state = json.loads(json.dumps(first.state_dict()))
        other = pickle.loads(pickle.dumps(mixed(folders, **options)))  # noqa: S301 - pickled here
        other.load_state_dict(state)
        assert begun + list(other) == whole
        assert list(other) == whole


@pytest.mark.parametrize("process", [TrainingProcess(), TrainingProcess(1, 2)], ids=["alone", "second of two"])
def test_torchdatas_loader_resumes_a_mix_in_workers(folders, process):
    stateful = pytest.importorskip("torchdata.stateful_dataloader")

    def made():
        mix = mixed(folders, pairs=40, batch_size=2, process=process)
        return stateful.StatefulDataLoader(
            mix, batch_size=2, num_workers=2, collate_fn=identity, multiprocessing_context="fork"
        )

    whole = list(made())
    batches, begun = made(), []
    for batch in batches:
        begun.append(batch)
        if len(begun) == 5:
            state = batches.state_dict()
            break
    resumed = made()
    resumed.load_state_dict(copy.deepcopy(state))
    assert begun + list(resumed) == whole


def test_the_state_of_another_mix_is_refused(folders):
    there = mixed(folders)
    iter(there)
    state = json.loads(json.dumps(there.state_dict()))
    lab, hall = (StereoDataset(folder, crop=CROP) for folder in folders.values())
    numbers = Numbers("n", 5)
    for sources, message in (
        ([(lab, 1), (numbers, 2), (hall, 1)], r"sources\.0\.share"),
        ([(lab, 1), (numbers, 2)], r"sources\.2 "),
        ([(hall, 1), (numbers, 2), (lab, 0.5)], r"sources\.0\.dataset\.config \('lab' there, 'hall' now\)"),
        ([(lab, 1), (Numbers("n", 6), 2), (hall, 0.5)], r"sources\.1\.length \(5 there, 6 now\)"),
        ([(StereoDataset(folders["lab"]), 1), (numbers, 2), (hall, 0.5)], r"sources\.0\.crop"),
        ([(lab, 1), (ConcatDataset([numbers]), 2), (hall, 0.5)], r"sources\.1\.dataset"),
    ):
        with pytest.raises(InputError, match=message):
            StereoMix(sources, SEED).load_state_dict(state)
    with pytest.raises(InputError, match=r"seed \(3 there, 4 now\)"):
        StereoMix([(lab, 1), (numbers, 2), (hall, 0.5)], SEED + 1).load_state_dict(state)
    with pytest.raises(InputError, match="batch_size"):
        mixed(folders, batch_size=2).load_state_dict(state)
    # The ratios count, the length does not.
    StereoMix([(lab, 2), (numbers, 4), (hall, 1)], SEED, pairs=9).load_state_dict(state)


def test_the_state_of_a_mix_of_other_photographs_is_refused(folders, tmp_path):
    moved, other = tmp_path / "moved", tmp_path / "other"
    for folder, level in ((moved, 0), (other, 90)):
        write_dataset(folder, "webdataset", {"train": 7}, 3, config_of(name="lab"), level=level)
    there = StereoMix([(StereoDataset(folders["lab"]), 1)], SEED)
    iter(there)
    state = json.loads(json.dumps(there.state_dict()))
    StereoMix([(StereoDataset(moved), 1)], SEED).load_state_dict(state)
    with pytest.raises(InputError, match=r"sources\.0\.dataset\.sources\.train\.patches .*with the same photographs"):
        StereoMix([(StereoDataset(other), 1)], SEED).load_state_dict(state)
    config = cheap(textures={"source": "images", "images": [str(tmp_path / "photos")]})
    (tmp_path / "photos").mkdir()

    def of_photograph(number):
        pixels = np.random.default_rng(number).integers(0, 256, (99, 99, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / "photos/one.png")
        return StereoMix([(StereoStream(config, SEED), 1), (StereoDataset(moved), 1)], SEED)

    there = of_photograph(0)
    iter(there)
    state = json.loads(json.dumps(there.state_dict()))
    of_photograph(0).load_state_dict(state)
    with pytest.raises(InputError, match=r"samples: sources\.0\.sources\.patches"):
        of_photograph(1).load_state_dict(state)


def test_mixes_are_mixed():
    inner = StereoMix([(Numbers("a", 3), 1), (Numbers("b", 3), 1)], 1, first=2, pairs=10)
    wanted = list(inner)
    samples = list(islice(StereoMix([(inner, 2), (Numbers("c", 3), 1)], SEED), 90))
    own = [sample for sample in samples if not sample.startswith("c")]
    assert Counter(own[: len(own) // 10 * 10]) == Counter(wanted * (len(own) // 10))
    assert own[:20] == wanted + wanted  # it ends, and begins again
    assert samples == list(islice(StereoMix([(inner, 2), (Numbers("c", 3), 1)], SEED), 90))


@pytest.mark.one_backend
def test_streams_and_datasets_are_mixed_in_workers_and_ranks(backend, folders):
    hardware = Hardware(backend)
    wide = cheap(camera={"width_px": 80})
    streams = [
        StereoStream(cheap(), SEED, crop=CROP, hardware=hardware, batch_size=7),
        StereoStream(wide, SEED, Selection(first=2, pairs=3), crop=CROP, hardware=hardware),
    ]
    lab = StereoDataset(folders["lab"], crop=CROP)

    def mix(**options):
        shares = [(streams[0], 1), (streams[1], 1), (lab, 1)]
        return StereoMix(shares, SEED, pairs=18, batch_size=3, **options)

    alone = list(mix())
    for source, wanted in ((streams[0], range(20)), (streams[1], [2, 3, 4] * 7)):
        pairs = {sample["index"]: sample for sample in islice(source, 20)}
        own = [sample for sample in alone if any(torch.equal(sample["left"], pair["left"]) for pair in pairs.values())]
        assert [sample["index"] for sample in own] == list(wanted)[: len(own)]
        assert own
        assert all(torch.equal(sample["disparity_left"], pairs[sample["index"]]["disparity_left"]) for sample in own)
    # Only the streams have depth and instances.
    options = {"num_workers": 2, "multiprocessing_context": "spawn", "timeout": TIMEOUT_S}
    loaded = DataLoader(mix(), 3, collate_fn=collate, **options)
    lefts = torch.cat([batch["left"] for batch in loaded])
    assert torch.equal(lefts, torch.stack([sample["left"] for sample in alone]))
    ranks = [list(mix(process=TrainingProcess(rank, 2))) for rank in (0, 1)]
    dealt = [*ranks[0][:3], *ranks[1][:3], *ranks[0][3:6], *ranks[1][3:6], *ranks[0][6:], *ranks[1][6:]]
    assert torch.equal(torch.stack([sample["left"] for sample in dealt]), lefts)


@pytest.mark.one_backend
def test_frames_of_a_sequence_stay_together_in_a_mix(backend, folders):
    moving = StereoStream(
        cheap(sequence={"length": 3}), SEED, Selection(frames=(0, 2)), hardware=Hardware(backend), crop=CROP,
        transform=lambda sample: sample["index"],
    )  # fmt: skip
    mix = StereoMix([(moving, 1), (StereoDataset(folders["lab"], transform=lambda _: "lab"), 1)], SEED, pairs=24)
    samples = list(mix)
    assert all(samples[at] == samples[at + 1] - 2 for at in range(0, 24, 2) if samples[at] != "lab")
    assert [sample for sample in samples if sample != "lab"][:6] == [0, 2, 3, 5, 6, 8]
    ranks = [list(StereoMix([(moving, 1)], SEED, pairs=8, process=TrainingProcess(rank, 2))) for rank in (0, 1)]
    assert ranks == [[0, 2, 6, 8], [3, 5, 9, 11]]


class Endless(IterableDataset):
    def __iter__(self):
        return iter(range(3))


class Lengthless(Dataset):
    def __getitem__(self, number):
        return number


@pytest.mark.parametrize(
    ("sources", "message"),
    [
        ([], "at least one"),
        ([Numbers("n", 3)], r"pairs of \(source, share\), got"),
        ([(Numbers("n", 3), 1, 2)], r"pairs of \(source, share\), got"),
        ([(Numbers("n", 3), "1")], "share: must be a finite number, got '1'"),
        ([(Numbers("n", 3), float("nan"))], "share: must be a finite number, got nan"),
        ([(Numbers("n", 3), 0)], "share: must be above 0, got 0: leave the source out"),
        ([(Numbers("n", 3), -1)], "share: must be above 0, got -1"),
        ([("out/lab", 1)], "a StereoStream, a StereoDataset, .*got 'out/lab'"),
        ([([1, 2], 1)], "a StereoStream, a StereoDataset, .*got"),
        ([(Endless(), 1)], "map-style dataset of PyTorch's with a length, got .*Endless"),
        ([(Lengthless(), 1)], "with a length, got .*Lengthless"),
        ([(Numbers("n", 0), 1)], "a dataset with samples, got .*Numbers"),
    ],
)
def test_sources_that_cannot_be_mixed_are_refused(sources, message):
    with pytest.raises(InputError, match=message):
        StereoMix(sources)


def test_shares_and_numbers_of_numpy_are_numbers():
    three, five = Numbers("three", 3), Numbers("five", 5)
    expected = StereoMix([(three, 0.5), (five, 2)], SEED, pairs=9)
    mix = StereoMix([(three, np.float32(0.5)), (five, np.int64(2))], np.int64(SEED), pairs=np.int32(9))
    assert list(mix) == list(expected)
    assert json.loads(json.dumps(mix.state_dict())) == expected.state_dict()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"first": 10**30}, "first: must be from 0 to 9007199254740992"),
        ({"seed": -1}, "seed: must be 0 or more"),
        ({"first": -1}, "first: must be from 0 to"),
        ({"pairs": 0}, "pairs: must be from 1 to"),
        ({"batch_size": 0}, "1 or more"),
    ],
)
def test_options_that_cannot_be_used_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        StereoMix([(Numbers("n", 3), 1)], **options)
