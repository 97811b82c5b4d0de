"""All engines write the same bytes, also after a kill at any moment."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import pytest
from processes import PATIENCE_S, alive, assert_refused, run_python, wait_for
from recorder import Recorder
from tiny_datasets import PAIRS, SEED, command, digests, tiny

from semisynth_gl.dataset import make
from semisynth_gl.dataset.cluster import RayEngine
from semisynth_gl.dataset.engines import LocalEngine
from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.make import DatasetJob, ShardMaker, encoded_in_order
from semisynth_gl.inputs.errors import InputError

LAYOUTS = ("middlebury", "webdataset")
SHARD = "shards/semisynth-middlebury-train-00000{}.json"


@pytest.fixture(scope="module")
def config():
    return tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})


@pytest.fixture(scope="module")
def wanted(config, tmp_path_factory):
    """Write a dataset of three shards in each layout; return the digests by layout."""
    folder = tmp_path_factory.mktemp("wanted")
    for layout in LAYOUTS:
        generate(config, folder / layout, PAIRS, SEED, layout=layout, shard_pairs=3)
    return {layout: digests(folder / layout) for layout in LAYOUTS}


def run(config, out, engine=None, layout="middlebury", **options):
    options = {"listener": Recorder(), "layout": layout, "shard_pairs": 3, "engine": engine} | options
    made, recorder = generate(config, out, PAIRS, SEED, **options), options["listener"]
    return made, recorder.pairs, recorder.messages


@pytest.mark.parametrize("layout", LAYOUTS)
def test_workers_change_no_byte(config, wanted, tmp_path, layout):
    _, pairs, messages = run(config, tmp_path / "o", LocalEngine(2), layout)
    assert digests(tmp_path / "o") == wanted[layout]
    assert pairs == PAIRS
    assert not [message for message in messages if "died" in message]


@pytest.mark.parametrize(
    ("layout", "workers", "sent", "moment"),
    [
        ("webdataset", 1, signal.SIGKILL, 1.2),
        ("middlebury", 2, signal.SIGKILL, 2.4),
        ("middlebury", 2, signal.SIGTERM, 1.6),
        ("webdataset", 2, signal.SIGINT, 2.2),
    ],
)
def test_killed_at_any_moment_the_same_command_gives_the_same_bytes(
    config, wanted, tmp_path, layout, workers, sent, moment
):
    out, arguments = tmp_path / "o", ("--workers", workers)
    process = subprocess.Popen(
        command(config, out, layout, *arguments), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    time.sleep(moment)
    process.send_signal(sent)
    _, said = process.communicate(timeout=PATIENCE_S)
    # A worker that is starting while its parent is killed may print a traceback.
    assert sent == signal.SIGKILL or "Traceback" not in said
    done = run_python(*command(config, out, layout, *arguments)[1:])
    assert done.code == 0, done.err
    assert digests(out) == wanted[layout]


@pytest.mark.parametrize("engine", [None, LocalEngine(2)], ids=["serial", "local"])
def test_an_interrupt_ends_a_run_and_keeps_complete_shards(config, wanted, tmp_path, monkeypatch, engine):
    monkeypatch.setattr(make, "is_software", lambda _: False)  # then a thread encodes in this process
    with pytest.raises(KeyboardInterrupt):
        run(config, tmp_path / "o", engine, listener=Recorder(4 if engine is None else 1))
    complete = [(tmp_path / "o" / SHARD.format(shard)).exists() for shard in range(3)]
    assert complete == [True, False, False] if engine is None else any(complete) and not all(complete)
    assert not multiprocessing.active_children()
    assert not (tmp_path / "o/index.json").exists()
    _, pairs, _ = run(config, tmp_path / "o", engine)
    assert pairs <= PAIRS - 3 or engine is not None
    assert digests(tmp_path / "o") == wanted["middlebury"]


SCRIPT = """
import os, signal, sys, time
from pathlib import Path
from semisynth_gl.dataset.make import PairRenderer
{fault}
if __name__ == "__main__":
    import json
    from semisynth_gl.config import Config
    from semisynth_gl.dataset.engines import LocalEngine
    from semisynth_gl.dataset.generate import generate
    from semisynth_gl.listener import Listener
    class Told(Listener):
        def on_message(self, text): print(text, flush=True)
    config = Config.model_validate(json.loads(Path(sys.argv[1]).read_text()))
    try:
        generate(config, sys.argv[2], 7, 5, shard_pairs=3, engine=LocalEngine(2), layout="middlebury", listener=Told())
    except Exception as error:
        print(type(error).__name__, error)
"""

FAULT = """
render = PairRenderer.render
def faulty(self, index):
    if index == 4:
        {}
    return render(self, index)
PairRenderer.render = faulty
"""


def in_workers(config, tmp_path, fault):
    """Run a program whose workers fail at pair 4; return its output."""
    (tmp_path / "config.json").write_text(config.model_dump_json())
    (tmp_path / "program.py").write_text(SCRIPT.format(fault=FAULT.format(fault)))
    return run_python(*(tmp_path / name for name in ("program.py", "config.json", "o"))).out


KILL = """
        struck = Path(sys.argv[2] + "-struck")
        while not Path(sys.argv[2] + "-busy").exists():
            time.sleep(0.05)
        if not struck.exists() or len(struck.read_text()) < {}:
            struck.open("a").write("x")
            os.kill(os.getpid(), signal.SIGKILL)
    if index == 6:  # the other worker, which has made the first shard, is in the middle of a pair then
        Path(sys.argv[2] + "-busy").touch()
        time.sleep(1)
"""


def test_lost_workers_are_replaced_twice(config, wanted, tmp_path):
    said = in_workers(config, tmp_path, KILL.format(2))
    assert said.count("a worker process died: the workers are restarted for ") == 2
    # The first of the three shards is complete before each death.
    assert "for 3 shards" not in said
    assert digests(tmp_path / "o") == wanted["middlebury"]


def test_a_pair_that_always_kills_its_worker_ends_the_run(config, tmp_path):
    said = in_workers(config, tmp_path, KILL.format(1000))
    assert "WorkerError a worker process died, 3 times" in said
    assert [(tmp_path / "o" / SHARD.format(shard)).exists() for shard in range(2)] == [True, False]


def test_errors_of_workers_keep_their_type(config, tmp_path):
    said = in_workers(config, tmp_path, "from semisynth_gl import InputError; raise InputError('four is wrong')")
    assert said.endswith("InputError four is wrong\n")
    assert "died" not in said


def test_shards_by_machine_make_the_whole(config, wanted, tmp_path):
    layout = "webdataset"
    for shards, missing in ((range(2, 3), 2), (range(2), 0)):
        made, _, _ = run(config, tmp_path / "o", layout=layout, shards=shards)
        assert made.missing == missing
        assert (tmp_path / "o/index.json").exists() == (missing == 0)
    assert digests(tmp_path / "o") == wanted[layout]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_full_disk_costs_no_complete_shard(config, wanted, tmp_path, layout):
    """Simulate a full disk by a limit on the size of files."""
    out = tmp_path / "o"
    run(config, out, layout=layout, shards=range(1))
    largest = max(path.stat().st_size for path in out.rglob("*") if path.is_file())
    limit = f"""
import resource, runpy, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({largest // 2}, {largest // 2}))
runpy.run_module("semisynth_gl", run_name="__main__", alter_sys=True)
"""
    assert_refused(run_python("-c", limit, *command(config, out, layout)[3:]), out, "File too large")
    assert (out / SHARD.format(0)).exists()
    _, pairs, _ = run(config, out, layout=layout)
    assert pairs <= PAIRS - 3
    assert digests(out) == wanted[layout]


def test_a_dataset_is_not_replaced_while_another_run_makes_its_shards(config, tmp_path):
    out = tmp_path / "o"
    arguments = [*command(config, out, "middlebury"), "--pairs", "3000", "--shards", "1-900"]
    with subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as first:
        wait_for((out / "shards/plan.json").exists)
        before = (out / "shards/plan.json").read_bytes()
        for overwrite in (False, True):
            said = "another run is making this dataset"
            with pytest.raises(InputError, match=said if overwrite else f"seed|{said}"):
                generate(config, out, 3000, SEED + 1, shards=range(1), overwrite=overwrite, shard_pairs=3)
        # Runs of the same dataset may share its shards, since --overwrite then has nothing to replace.
        generate(config, out, 3000, SEED, shards=range(1), overwrite=True, shard_pairs=3)
        assert (out / SHARD.format(0)).exists()
        assert first.poll() is None
        first.kill()
    assert (out / "shards/plan.json").read_bytes() == before


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_the_first_process(config, tmp_path, sent):
    arguments = [*command(config, tmp_path / "o", "middlebury"), "--workers", "2", "--pairs", "3000"]
    # Ctrl-C in a terminal interrupts the whole process group, so start a new one.
    with subprocess.Popen(
        arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as first:
        wait_for((tmp_path / "o" / SHARD.format(0)).exists)
        children = [int(path.name) for path in Path("/proc").glob("[0-9]*") if parent(path) == first.pid]
        assert len(children) >= 2
        for _ in range(2 if sent == signal.SIGINT else 1):
            os.killpg(first.pid, sent) if sent == signal.SIGINT else first.kill()
            time.sleep(0.2)
        first.wait(PATIENCE_S)
        wait_for(lambda: not any(map(alive, children)))
        assert "Traceback" not in first.stderr.read()


def parent(path):
    try:
        return int((path / "stat").read_text().rpartition(")")[2].split()[1])
    except (OSError, IndexError):
        return None


def test_pairs_are_encoded_while_others_are_rendered_and_come_in_order():
    rendered = [threading.Event() for _ in range(8)]

    def render():
        for number, event in enumerate(rendered):
            event.set()
            yield number

    def encode(number):
        # Each pair but the last waits until the next one is rendered.
        assert rendered[min(number + 1, len(rendered) - 1)].wait(PATIENCE_S)
        return number, threading.current_thread() is threading.main_thread()

    assert list(encoded_in_order(render(), encode, in_thread=True)) == [(number, False) for number in range(8)]
    here = threading.current_thread()
    assert list(encoded_in_order(range(3), lambda _: threading.current_thread() is here, in_thread=False)) == [True] * 3


def test_other_photographs_or_models_in_a_worker_are_refused(config, tmp_path):
    made, _, _ = run(config, tmp_path / "o", shards=range(1))
    changed = made.plan.model_copy(update={"sources": {"train": made.plan.sources["train"] | {"patches": "0" * 64}}})
    maker = ShardMaker(DatasetJob(changed, str(tmp_path / "p"), "auto"))
    with closing(maker), pytest.raises(InputError, match="patches"):
        maker.make_shard(0, Recorder())


def test_without_ray_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray.cloudpickle", None)
    with pytest.raises(InputError, match=r"pip install 'semisynth-gl\[ray\]'"):
        RayEngine().run(None, [], Recorder())
