"""The cluster engine, on a cluster of two nodes on this machine."""

import os
import signal
import sys
import time
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from tiny_datasets import digests, tiny

from semisynth_gl.engines import cluster
from semisynth_gl.engines.cluster import RayEngine
from semisynth_gl.engines.task import Stop
from semisynth_gl.errors import ContextLostError, InputError, WorkerError
from semisynth_gl.generation.generate import Listener, generate

ray = pytest.importorskip("ray")

TASKS = range(16)
FAULTY = 3
LATEST_S = 20
NODE = {"num_cpus": 1, "object_store_memory": 80_000_000}


@dataclass(frozen=True)
class Squares:
    """Squares numbers; beside the square comes the node."""

    folder: Path
    fault: str = ""
    pause_s: float = 0

    @contextmanager
    def open(self, worker):
        (self.folder / f"opened-{os.getpid()}").open("a").write("x")
        yield lambda number, watch: self._square(worker, number, watch)

    def _square(self, worker, number, watch):
        watch.tell((worker, number))
        if number == FAULTY:
            self._fail()
        until = time.monotonic() + self.pause_s
        while time.monotonic() < until and not watch.stopping:
            time.sleep(0.02)
        return number * number, ray.get_runtime_context().get_node_id()

    def _fail(self):
        match self.fault:
            case "wrong":
                raise InputError("three is not allowed")
            case "lost once" if not (self.folder / "struck").exists():
                (self.folder / "struck").touch()
                raise ContextLostError("the context is gone")
            case "kill":
                os.kill(os.getpid(), signal.SIGKILL)


@contextmanager
def nodes():
    from ray.cluster_utils import Cluster

    both = Cluster(initialize_head=True, head_node_args=NODE | {"include_dashboard": False})
    try:
        yield both, both.add_node(**NODE)
    finally:
        both.shutdown()


def run(address, job, tasks=TASKS, result=lambda _: None, stop=None):
    messages, notes, results = [], [], []
    engine = RayEngine(address)
    done = engine.run(job, tasks, told=messages.append, noted=notes.append, stop=stop or Stop())
    with closing(done):
        for each in done:
            results.append(each)
            result(each)
    assert len(results) == len(dict(results))
    return dict(results), messages, notes


# One test: to start a cluster takes longer than all that is asked of it, and tests may go to different processes.
def test_a_cluster_of_two_nodes(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_RETRIES", 1)  # each takes seconds
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    with nodes() as (both, second):
        kept = signal.getsignal(signal.SIGTERM)
        for check in (tasks_go_to_both_nodes, errors_keep_their_type, a_stop_ends_soon, lost_workers_are_replaced):
            folder = tmp_path / check.__name__
            folder.mkdir()
            check(both.address, folder)
        (tmp_path / "node").mkdir()
        a_node_may_die(both, second, tmp_path / "node")
        assert signal.getsignal(signal.SIGTERM) is kept
        a_dataset_outlives_a_node(both, tmp_path)
        assert not ray.is_initialized()


def tasks_go_to_both_nodes(address, folder):
    results, messages, notes = run(address, Squares(folder, pause_s=0.2))
    assert {number: square for number, (square, _) in results.items()} == {n: n * n for n in TASKS}
    assert len({node for _, node in results.values()}) == 2
    assert sorted(messages) == [(0, number) for number in TASKS]
    assert notes == []
    # As many processes as cores, each of which opened once.
    assert [path.read_text() for path in folder.glob("opened-*")] == ["x", "x"]


def errors_keep_their_type(address, folder):
    with pytest.raises(InputError, match="three is not allowed") as caught:
        run(address, Squares(folder, "wrong"))
    assert type(caught.value) is InputError


def a_stop_ends_soon(address, folder):
    stop, began = Stop(), time.monotonic()
    results, messages, _ = run(address, Squares(folder, pause_s=1), range(100), stop=stop, result=lambda _: stop.ask())
    assert time.monotonic() - began < LATEST_S
    assert 1 <= len(results) <= 4
    assert {number for _, number in messages} == set(results)


def lost_workers_are_replaced(address, folder):
    results, _, notes = run(address, Squares(folder, "lost once"))
    assert set(results) == set(TASKS)
    assert notes == ["task 3 is done again (the context is gone)"]
    with pytest.raises(WorkerError, match="task 3 could not be done in 2 attempts"):
        run(address, Squares(folder, "kill"), [FAULTY])


def a_node_may_die(both, second, folder):
    gone = []

    def kill(each):
        _, (_, node) = each
        if node == second.node_id and not gone:
            gone.append(node)
            both.remove_node(second, allow_graceful=False)

    results, messages, notes = run(both.address, Squares(folder, pause_s=0.3), result=kill)
    assert gone
    assert {number: square for number, (square, _) in results.items()} == {n: n * n for n in TASKS}
    assert {number for _, number in messages} == set(TASKS)
    assert all("its worker or its node was lost" in note for note in notes)


def a_dataset_outlives_a_node(both, folder):
    config = tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})
    generate(config, folder / "serial", 12, 5, layout="webdataset", shard_pairs=2)
    second, written = both.add_node(**NODE), []

    def kill(pair):
        written.append(pair)
        if len(written) == 2:
            both.remove_node(second, allow_graceful=False)

    generate(
        config, folder / "ray", 12, 5, layout="webdataset", shard_pairs=2, engine=RayEngine(both.address),
        listener=Listener(written=kill),
    )  # fmt: skip
    assert digests(folder / "ray") == digests(folder / "serial")


def test_a_cluster_that_is_not_there_is_told_of():
    with pytest.raises(InputError, match=r"address 127.0.0.1:9\) cannot be reached"):
        run("127.0.0.1:9", Squares(Path()))
    with pytest.raises(InputError, match="expected host:port or auto"):
        run("ray://127.0.0.1:9", Squares(Path()))


def test_without_ray_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray.util.scheduling_strategies", None)
    with pytest.raises(InputError, match=r"pip install 'semisynth-gl\[ray\]'"):
        cluster.RayEngine().run(Squares(Path()), TASKS, told=print, noted=print, stop=Stop()).send(None)
