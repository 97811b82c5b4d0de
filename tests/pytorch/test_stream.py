"""Pairs for PyTorch: the dataset's arrays, dealt out to workers and ranks, resumed, without leaks."""

import copy
import gc
import json
import os
import pickle
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from itertools import chain, islice
from pathlib import Path

import numpy as np
import pytest
from backends import backend_fault
from heavy import heavy
from installed_plugins import find_anew, write_package
from PIL import Image
from tiny_datasets import cheap

from semisynth_gl.config import load_config
from semisynth_gl.dataset.engines import threads_each
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.frame.camera import Crop, StereoCamera
from semisynth_gl.frame.channels import View
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.errors import BackendError, InputError
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render import context

torch = heavy("torch")
pytestmark = pytest.mark.heavy

from torch.utils.data import DataLoader, get_worker_info  # noqa: E402 - torch is optional

from semisynth_gl.torch import Hardware, Selection, StereoStream, TrainingProcess, stream  # noqa: E402
from semisynth_gl.torch.dealing import Dealing, Worker  # noqa: E402
from semisynth_gl.torch.samples import to_sample  # noqa: E402

TIMEOUT_S = 120
SEED = 3
STEPS = 500
WARM = 100


def indices(batches):
    return [batch["index"].tolist() for batch in batches]


def loader(dataset, workers=0, batch=1, way="spawn", **options):
    forked = {"multiprocessing_context": way, "timeout": TIMEOUT_S} if workers else {}
    return DataLoader(dataset, batch_size=batch, num_workers=workers, **forked, **options)


def fresh(function):
    """Call a function of this module in a process that has not opened OpenGL, so that it may fork."""
    folders = [str(folder) for folder in Path(__file__).parents[:2]]
    program = (
        f"import json, sys; sys.path[:0] = {folders!r}; import test_stream; "
        f"print(json.dumps(test_stream.{function.__name__}()))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize(("batch", "whole"), [(1, 1), (4, 1), (4, 2), (1, 3), (4, 3)])
@pytest.mark.parametrize("samples", [1, 24, 37])
def test_every_sample_goes_to_one_consumer(workers, ranks, batch, whole, samples):
    dealing = Dealing(10, samples, batch, whole)
    own = {
        (rank, worker): list(dealing.numbers(TrainingProcess(rank, ranks), Worker(worker, workers)))
        for rank in range(ranks)
        for worker in range(workers)
    }
    assert sorted(chain.from_iterable(own.values())) == list(range(10, 10 + samples))
    for numbers in own.values():
        assert numbers == sorted(numbers)
    for rank in range(ranks):
        assert dealing.count(TrainingProcess(rank, ranks)) == sum(len(own[rank, worker]) for worker in range(workers))
    home = {number: place for place, numbers in own.items() for number in numbers}
    assert all(home[number] == home[number - 1] for number in home if (number - 10) % whole)


@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize("ranks", [1, 2])
def test_batches_of_all_ranks_come_in_order(workers, ranks):
    batch, steps = 4, 7
    dealing = Dealing(5, None, batch, 2)
    streams = {
        (rank, worker): dealing.numbers(TrainingProcess(rank, ranks), Worker(worker, workers))
        for rank in range(ranks)
        for worker in range(workers)
    }
    # A loader asks its workers in turn.
    came = [
        number
        for step in range(steps)
        for rank in range(ranks)
        for number in islice(streams[rank, step % workers], batch)
    ]
    assert came == list(range(5, 5 + steps * batch * ranks))
    assert dealing.count(TrainingProcess(0, ranks)) is None


def test_skipping_is_going_on():
    dealing, consumer = Dealing(2, 40, 3, 2), (TrainingProcess(1, 2), Worker(1, 2))
    numbers = list(dealing.numbers(*consumer))
    for skipped in range(len(numbers) + 2):
        assert list(dealing.numbers(*consumer, skipped)) == numbers[skipped:]


def test_tensors_have_torchs_order_of_axes_and_types_that_it_works_with():
    camera = StereoCamera.centred(5, 4, 6.0, 0.25, 1.0)
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (4, 5, 3), dtype=np.uint8)
    flow = rng.normal(size=(4, 5, 4)).astype(np.float32)[..., :2]
    ids = np.full((4, 5), 65535, np.uint16)
    left = View({"image": image, "disparity": flow[..., 0], "instances": ids, "flow": flow})
    frame = Frame(camera, left, View({"image": image}))
    sample = to_sample(7, frame)
    assert sample["index"] == 7
    assert sample["camera"] == {
        "focal_px": 6.0, "baseline_m": 0.25, "doffs_px": 1.0, "cx_left_px": 1.5, "cx_right_px": 2.5, "cy_px": 1.5,
        "right_roll_rad": 0.0, "right_pitch_rad": 0.0, "right_y_px": 0.0, "focal_ratio": 1.0, "focal_y_px": 6.0,
    }  # fmt: skip
    assert set(sample) == {"index", "camera", "left", "right", "disparity_left", "instances_left", "flow_left"}
    assert sample["left"].shape == (3, 4, 5)
    assert sample["left"].is_contiguous()
    assert sample["flow_left"].shape == (2, 4, 5)
    np.testing.assert_array_equal(sample["flow_left"].numpy(), flow.transpose(2, 0, 1))
    assert sample["instances_left"].dtype == torch.int32
    assert int(sample["instances_left"].max()) == 65535


def test_the_example_of_a_real_rig_is_streamed_as_it_is_written():
    example = Path(__file__).resolve().parents[2] / "examples" / "real-rig.yaml"
    small = ["scale=0.2", "textures.source=procedural", "textures.max_patches=8", "textures.large_px=0"]
    config = load_config(example, [*small, "models.complex=0", "models.variants=1"])
    samples = list(StereoStream(config, SEED, Selection(pairs=4)))
    assert [sample["index"] for sample in samples] == [0, 1, 2, 3]
    with PairRenderer(config, SEED) as pairs:
        for sample in samples:
            frame = pairs.render(sample["index"]).frame
            assert sample["left"].shape == (1, 96, 150)
            assert sample["camera"]["right_y_px"] == frame.camera.deviation.y_px
            assert_same(sample, frame)


def assert_same(sample, stored):
    compared, arrays = 0, stored.arrays()
    for name, tensor in sample.items():
        if name in ("index", "camera"):
            continue
        array = tensor.numpy()
        if array.ndim == 3:
            array = array[0] if len(array) == 1 else array.transpose(1, 2, 0)
        np.testing.assert_array_equal(array, arrays[name], err_msg=name)
        compared += 1
    return compared


@pytest.mark.one_backend
@pytest.mark.parametrize("layout", ["middlebury", "webdataset"])
def test_the_stream_yields_what_the_dataset_holds(backend, layout, tmp_path):
    config = cheap()
    generate(config, tmp_path / "set", {"train": 4, "validation": 3}, SEED, layout=layout, backend=backend)
    for split, pairs in (("train", 4), ("validation", 3)):
        dataset = open_dataset(tmp_path / "set", split)
        selection, hardware = Selection(split, ("train", "validation"), pairs=pairs), Hardware(backend)
        whole = list(StereoStream(config, SEED, selection, hardware=hardware))
        assert [sample["index"] for sample in whole] == list(range(pairs))
        places = set()
        for checked in (True, False):
            crops = StereoStream(config, SEED, selection, crop=(20, 30), checked=checked, hardware=hardware)
            for sample, cropped, stored in zip(whole, crops, dataset, strict=True):
                assert assert_same(sample, stored) == 10
                assert sample["camera"]["focal_px"] == pytest.approx(stored.camera.focal_px)
                x = round(sample["camera"]["cx_left_px"] - cropped["camera"]["cx_left_px"])
                y = round(sample["camera"]["cy_px"] - cropped["camera"]["cy_px"])
                places.add((x, y))
                assert cropped["left"].shape == (3, 20, 30)
                assert_same(cropped, stored.cropped(Crop(x, y, 30, 20)).with_own_masks())
        assert len(places) == pairs


@pytest.mark.one_backend
def test_a_split_is_not_its_photographs_used_otherwise(backend):
    config = cheap()
    alone = next(iter(StereoStream(config, SEED, hardware=Hardware(backend))))
    beside = next(iter(StereoStream(config, SEED, Selection(splits=("train", "test")), hardware=Hardware(backend))))
    assert (alone["left"] != beside["left"]).any()


@pytest.mark.one_backend
def test_frames_of_a_sequence_stay_together_and_share_their_crop(backend):
    config = cheap(sequence={"length": 3})
    selection = Selection(frames=range(2), pairs=8)
    options = {"crop": (20, 30), "hardware": Hardware(backend)}
    ranks = [
        list(StereoStream(config, SEED, selection, process=TrainingProcess(rank, 2), **options)) for rank in (0, 1)
    ]
    assert [[sample["index"] for sample in samples] for samples in ranks] == [[0, 1, 6, 7], [3, 4, 9, 10]]
    crops = []
    with PairRenderer(config, SEED, backend) as renderer:
        for samples in ranks:
            for sample in samples:
                whole = renderer.render(sample["index"]).frame
                x = round(whole.camera.cx_left_px - sample["camera"]["cx_left_px"])
                y = round(whole.camera.cy_px - sample["camera"]["cy_px"])
                crops.append((x, y))
                assert_same(sample, whole.cropped(Crop(x, y, 30, 20)).with_own_masks())
    assert crops[::2] == crops[1::2]
    assert len(set(crops)) == 4


@pytest.mark.one_backend
def test_first_is_where_it_begins_and_each_iteration_begins_there(backend):
    config = cheap()
    one = StereoStream(
        config,
        SEED,
        Selection(first=5, pairs=3),
        hardware=Hardware(backend),
        transform=lambda sample: sample["index"],
    )
    assert len(one) == 3
    assert list(one) == list(one) == [5, 6, 7]
    with pytest.raises(TypeError, match="no end"):
        len(StereoStream(config))


@pytest.mark.one_backend
def test_a_renderer_is_released_however_the_iteration_ends(backend, monkeypatch):
    opened, released = [], []

    class Watched(PairRenderer):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            opened.append(self)

        def release(self):
            released.append(self)
            super().release()

    monkeypatch.setattr(stream, "PairRenderer", Watched)
    endless = StereoStream(cheap(), SEED, hardware=Hardware(backend))
    iterator = iter(endless)
    assert not opened
    next(iterator)
    iterator.close()
    assert opened == released
    for batch in loader(endless, batch=2):
        assert batch["index"].tolist() == [0, 1]
        break
    gc.collect()
    assert opened == released
    failing = StereoStream(cheap(), SEED, hardware=Hardware(backend), transform=lambda sample: sample["nothing"])
    with pytest.raises(KeyError, match="nothing"):
        next(iter(failing))
    assert len(opened) == 3
    assert opened == released


@pytest.mark.one_backend
def test_a_stream_goes_on_after_what_a_state_had_yielded(backend):
    options = {"selection": Selection(pairs=7), "hardware": Hardware(backend), "batch_size": 2, "crop": (20, 30)}
    first = StereoStream(cheap(), SEED, **options)
    iterator = iter(first)
    begun = [next(iterator)["index"] for _ in range(3)]
    state = json.loads(json.dumps(first.state_dict()))
    left = [sample["index"] for sample in iterator]
    assert begun + left == list(range(7))

    other = StereoStream(cheap(), SEED, **options)
    other.load_state_dict(state)
    assert other.state_dict() == state
    assert [sample["index"] for sample in other] == left
    assert [sample["index"] for sample in other] == begun + left


# States of wrong types, and keys of a state with wrong values.
WRONG_STATES = [
    *(None, 3, "yielded", [], ["yielded", "worker", "workers", "stream"], {}, {3: 4, "x": 5}),
    *(("yielded", value) for value in (None, "3", 0.5, True, -1, 10**30, [3])),
    *(("worker", value) for value in (None, "0", -1)),
    *(("workers", value) for value in (None, 0, [1])),
    *(("stream", value) for value in (None, [], "kitti", {"seed": {3}}, {"seed": np.arange(2)}, {(1, 2): 3})),
]


def test_a_state_of_another_stream_is_refused_with_what_differs():
    config = cheap()
    there = StereoStream(config, SEED)
    iter(there)
    state = there.state_dict()
    for options, message in (
        ({"seed": 4}, r"seed \(3 there, 4 now\)"),
        ({"selection": Selection(first=2)}, r"first \(0 there, 2 now\)"),
        ({"batch_size": 2}, "batch_size"),
        ({"crop": (8, 8)}, "crop"),
        ({"checked": False}, "checked"),
        ({"selection": Selection(splits=("train", "test"))}, "splits"),
        ({"process": TrainingProcess(0, 2)}, "world_size"),
        ({"config": cheap(particles={"most": 100})}, "config_sha256"),
    ):
        with pytest.raises(InputError, match=message):
            StereoStream(**({"config": config, "seed": SEED} | options)).load_state_dict(state)
    StereoStream(config, SEED, Selection(pairs=9)).load_state_dict(state)
    with pytest.raises(InputError, match=r"expected the result of a stream's state_dict\(\)"):
        there.load_state_dict({"_snapshot": {}})
    for wrong in WRONG_STATES:
        with pytest.raises(InputError, match=r"state: |expected the result of a stream's state_dict\(\)"):
            there.load_state_dict(wrong if not isinstance(wrong, tuple) else state | dict([wrong]))
    there.load_state_dict(state | {"worker": 1, "workers": 2})
    with pytest.raises(InputError, match=r"from worker 1 of 2, and this is worker 0 of 1.*first="):
        iter(there)


def photograph(path, seed):
    """Write a photograph of a seed: all of one size."""
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(np.random.default_rng(seed).integers(0, 256, (99, 99, 3), dtype=np.uint8)).save(path)


def solid(path, height):
    """Write a model file: a tetrahedron of a height."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {height}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")


def test_a_state_of_other_photographs_or_models_is_refused(tmp_path):
    config = cheap(
        textures={"source": "images", "images": [str(tmp_path / "photos")]},
        models={"folders": [str(tmp_path / "models")]},
    )
    first, second = tmp_path / "photos/one.png", tmp_path / "models/one.obj"

    def state():
        there = StereoStream(config, SEED)
        iter(there)
        return json.loads(json.dumps(there.state_dict()))

    photograph(first, 0)
    solid(second, 1)
    begun = state()
    photograph(first, 1)
    with pytest.raises(InputError, match=r"yields other samples: sources\.patches \('\w{8}' there.* same photographs"):
        StereoStream(config, SEED).load_state_dict(begun)
    photograph(first, 0)
    StereoStream(config, SEED).load_state_dict(begun)
    solid(second, 2)
    with pytest.raises(InputError, match=r"yields other samples: sources\.models \("):
        StereoStream(config, SEED).load_state_dict(begun)


def test_a_state_of_another_plug_in_is_refused(tmp_path):
    code = """import numpy

def thing(rng):
    yield numpy.random.default_rng({}).integers(0, 256, (99, 99, 3), "uint8")

PLUGINS = {{"textures": {{"thing": thing}}}}
"""

    def stream_with(version, seed):
        """A stream of a plug-in's picture, as a process finds it."""
        folder = tmp_path / f"{version}-{seed}"
        write_package(folder, code.format(seed), version=version)
        patch.syspath_prepend(str(folder))
        find_anew()
        made = StereoStream(cheap(textures={"source": "thing"}), SEED)
        iter(made)
        return made

    with pytest.MonkeyPatch.context() as patch:
        state = stream_with("1", 0).state_dict()
        with pytest.raises(InputError, match=r"samples: plugins\.textures\.thing\.version \('1' there, '2' now\)\."):
            stream_with("2", 0).load_state_dict(state)
        with pytest.raises(InputError, match=r"samples: sources\.patches"):
            stream_with("1", 1).load_state_dict(state)
    find_anew()


@pytest.mark.one_backend
def test_patches_and_models_are_prepared_once_an_iteration(backend, monkeypatch):
    prepared, prepare = [], stream.prepare_sources

    def counted(*arguments):
        prepared.append(arguments)
        return prepare(*arguments)

    monkeypatch.setattr(stream, "prepare_sources", counted)
    options = {"selection": Selection(pairs=3), "hardware": Hardware(backend)}
    first, second = (StereoStream(cheap(), SEED, **options) for _ in range(2))
    assert not prepared
    iterator = iter(first)
    states = [first.state_dict()]
    states += [first.state_dict() for _ in iterator]
    assert len(prepared) == 1
    assert [state["yielded"] for state in states] == [0, 1, 2, 3]
    # A worker gets neither an atlas nor its digest, and finds both in the cache.
    sent = pickle.dumps(first)
    assert len(sent) < 10_000
    second.load_state_dict(states[2])
    assert [sample["index"] for sample in second] == [2]
    assert len(prepared) == 2
    again = pickle.loads(sent)  # noqa: S301 - pickled here
    again.load_state_dict(states[2])
    assert len(prepared) == 3


def test_a_process_that_has_yielded_nothing_has_no_state():
    with pytest.raises(InputError, match=r"has not begun to iterate.*StatefulDataLoader.*first="):
        StereoStream(cheap()).state_dict()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "seed: must be 0 or more, got -1"),
        ({"batch_size": 0}, "1 or more, got 0"),
        (
            {"selection": Selection(frames=range(4))},
            "from 0 to 2, since the config's sequence.length is 3, got \\(0, 1, 2, 3\\)",
        ),
        ({"selection": Selection(frames=())}, "got \\(\\)"),
        ({"selection": Selection(frames=(1, 0))}, "rising"),
        ({"crop": (49, 10)}, "up to \\(48, 64\\) px.*got \\(49, 10\\)"),
        ({"crop": (0, 10)}, "got \\(0, 10\\)"),
        ({"hardware": Hardware(device="cuda")}, "checked=False.*pin_memory=True"),
        ({"hardware": Hardware("osmesa", device="cuda"), "checked": False}, "EGL and a GPU that torch finds"),
    ],
)
def test_arguments_that_cannot_be_used_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        StereoStream(cheap(sequence={"length": 3}), **options)


@pytest.mark.parametrize(
    ("option", "values", "message"),
    [
        (Selection, {"split": "training"}, "expected one of splits.*got split='training'"),
        (Selection, {"split": "validation"}, "expected one of splits.*splits=\\('train',\\)"),
        (Selection, {"splits": ("train", "dev")}, "train, validation, test"),
        (Selection, {"first": -2}, "first: must be from 0 .* got -2"),
        (Selection, {"pairs": 0}, "pairs: must be from 1 .* got 0"),
        (TrainingProcess, {"rank": 2, "world_size": 2}, "got rank=2 and world_size=2"),
        (TrainingProcess, {"rank": -1, "world_size": 2}, "got rank=-1 and world_size=2"),
        (TrainingProcess, {"rank": 1}, "got rank=1 and world_size=1.*torch.distributed for both"),
        (Hardware, {"backend": "glx"}, "auto, egl, osmesa, got 'glx'"),
        (Hardware, {"device": "gpu"}, "cpu, cuda, got 'gpu'"),
    ],
)
def test_options_that_cannot_be_used_are_refused(option, values, message):
    with pytest.raises(InputError, match=message):
        option(**values)


def test_ranks_are_those_of_torch_distributed(monkeypatch):
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_rank", lambda: 1)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 3)
    selection = Selection(pairs=5)
    assert len(StereoStream(cheap(), selection=selection, batch_size=2)) == 2
    assert len(StereoStream(cheap(), selection=selection, batch_size=2, process=TrainingProcess(2, 3))) == 1


def test_a_worker_without_a_context_says_what_to_do(monkeypatch):
    def refuse(*_):
        raise BackendError("device 0: eglGetError 0x3001")

    # Forked workers inherit what is set here.
    monkeypatch.setattr(context, "_opened_in", set())
    monkeypatch.setattr(context, "_open_egl", refuse)
    one = StereoStream(cheap(), hardware=Hardware("egl"))
    with pytest.raises(BackendError, match=r"(?s)the stream cannot render: no OpenGL context.*0x3001.*doctor"):
        next(iter(one))
    with pytest.raises(BackendError, match=r"(?s)worker 0 of 2 cannot render: no OpenGL context.*0x3001.*doctor"):
        next(iter(loader(one, 2, way="fork")))


@pytest.mark.one_backend
def test_workers_forked_from_a_process_with_opengl_are_told_apart(backend):
    one = StereoStream(cheap(), hardware=Hardware(backend))
    next(iter(one))
    with pytest.raises(BackendError, match=r"worker 0 of 1 cannot render: this process was forked.*'spawn'"):
        next(iter(loader(one, 1, way="fork")))


def scores(batch):
    return [int(value) for value in batch["left"].sum(dim=(1, 2, 3)) + batch["disparity_left"].isfinite().sum()]


def forked():
    """What loaders of 0 to 3 workers yield; those with workers first, since no process forks after it has drawn."""
    options = {"batch_size": 2, "selection": Selection(pairs=7, first=1)}
    found = {}
    for workers in (3, 2, 1, 0):
        one = StereoStream(cheap(), SEED, **options)
        batches = list(loader(one, workers, 2, "fork"))
        found[workers] = [indices(batches), [scores(batch) for batch in batches]]
    return found


def forked_epochs():
    """Two epochs of workers that stay."""
    batches = loader(
        StereoStream(cheap(), SEED, Selection(pairs=6), batch_size=2), 2, 2, "fork", persistent_workers=True
    )
    return [indices(batches) for _ in range(2)]


def forked_resuming():
    """A loader's state, taken in the midst of its batches, resumed by another."""
    stateful = import_module("torchdata.stateful_dataloader")

    def made():
        one = StereoStream(cheap(), SEED, Selection(pairs=11), batch_size=2)
        return stateful.StatefulDataLoader(one, batch_size=2, num_workers=2, multiprocessing_context="fork")

    batches, begun = made(), []
    for batch in batches:
        begun += indices([batch])
        if len(begun) == 3:
            state = batches.state_dict()
            break
    resumed = made()
    resumed.load_state_dict(copy.deepcopy(state))
    return begun, indices(resumed), indices(resumed)


def every_forked():
    """All of the above, in one process: most of the time goes into starting it."""
    resumed = None if find_spec("torchdata") is None else forked_resuming()
    # Last, since the loader without workers opens OpenGL.
    return {"epochs": forked_epochs(), "resumed": resumed, "workers": forked()}


@pytest.fixture(scope="module")
def from_forked():
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    return fresh(every_forked)


def test_forked_workers_yield_the_same_in_order(from_forked):
    found = from_forked["workers"]
    assert found["0"][0] == [[1, 2], [3, 4], [5, 6], [7]]
    assert found["1"] == found["2"] == found["3"] == found["0"]


def test_each_epoch_of_workers_that_stay_begins_at_first(from_forked):
    assert from_forked["epochs"] == [[[0, 1], [2, 3], [4, 5]]] * 2


def test_torchdatas_loader_resumes_workers(from_forked):
    pytest.importorskip("torchdata.stateful_dataloader")
    begun, left, again = from_forked["resumed"]
    assert begun + left == again == [*([each, each + 1] for each in range(0, 10, 2)), [10]]


def open_files():
    return len(list(Path("/proc/self/fd").iterdir()))


def look(sample):
    """Add what the worker holds to some of the samples."""
    sample["pid"] = os.getpid()
    sample["threads"] = int(os.environ["LP_NUM_THREADS"])
    if sample["index"] in (WARM, WARM + 1, STEPS - 2, STEPS - 1):
        renderers = [each for each in gc.get_objects() if type(each) is PairRenderer]
        assert get_worker_info() is not None
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        sample["held"] = torch.tensor(
            [
                pages * os.sysconf("SC_PAGE_SIZE"),
                open_files(),
                len(renderers),
                sum(renderers[0].count_objects().values()),
            ]
        )
    else:
        sample["held"] = torch.zeros(4, dtype=torch.int64)
    return sample


@pytest.mark.one_backend
def test_five_hundred_steps_repeat_nothing_and_leak_nothing(backend):
    one = StereoStream(cheap(), SEED, hardware=Hardware(backend), transform=look, crop=(32, 48))
    seen, held, files = [], {}, []
    for batch in islice(loader(one, 2), STEPS):
        seen += batch["index"].tolist()
        assert batch["threads"].tolist() == [threads_each(2)]
        if batch["held"].any():
            held.setdefault(int(batch["pid"]), []).append(batch["held"][0].tolist())
            files.append(open_files())
    assert seen == list(range(STEPS))
    assert len(held) == 2
    assert os.getpid() not in held
    for early, late in held.values():
        assert late[0] - early[0] < 16e6
        # A batch on its way holds a file for each tensor on both sides, and there are up to four of them.
        assert late[1] - early[1] < 100
        assert early[2:] == late[2:]
        assert early[2] == 1
    assert max(files) - min(files) < 100
