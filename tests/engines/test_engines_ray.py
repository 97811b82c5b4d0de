"""The cluster engine, on a cluster of two nodes on this machine."""

import os
import signal
import sys
import time
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from heavy import heavy
from recorder import Recorder
from tiny_datasets import digests, tiny

from semisynth_gl.engines import cluster
from semisynth_gl.engines.cluster import RayEngine
from semisynth_gl.generation.generate import generate
from semisynth_gl.inputs.errors import ContextLostError, InputError, WorkerError

ray = heavy("ray")
pytestmark = pytest.mark.heavy

TASKS = range(16)
FAULTY = 3
# Reached only where something that must happen never does.
PATIENCE_S = 120
NODE = {"num_cpus": 1, "object_store_memory": 80_000_000}


@dataclass(frozen=True)
class Squares:
    """Squares numbers, once so many processes have opened it; beside the square comes the node."""

    folder: Path
    fault: str = ""
    processes: int = 1
    waits_for_a_stop: bool = False

    @contextmanager
    def open(self, worker):
        (self.folder / f"opened-{os.getpid()}").open("a").write("x")
        yield lambda number, listener: self._square(worker, number, listener)

    def _square(self, worker, number, listener):
        listener.on_pair((worker, number))
        if number == FAULTY:
            self._fail()
        until = time.monotonic() + PATIENCE_S
        while not self._complete(listener) and time.monotonic() < until:
            time.sleep(0.02)
        if not self._complete(listener):
            raise InputError("nobody told this task of the stop, or processes are missing")
        return number * number, ray.get_runtime_context().get_node_id()

    def _complete(self, listener):
        opened = len(list(self.folder.glob("opened-*")))
        return listener.stopping or (opened >= self.processes and not self.waits_for_a_stop)

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


def run(address, job, tasks=TASKS, result=lambda _: None, recorder=None):
    recorder, results = recorder or Recorder(), []
    with closing(RayEngine(address).run(job, tasks, recorder)) as yielded:
        for each in yielded:
            results.append(each)
            result(each)
    assert len(results) == len(dict(results))
    return dict(results), recorder.pairs, recorder.messages


# One test: to start a cluster takes longer than all that is asked of it, and tests may go to different processes.
def test_a_cluster_of_two_nodes(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_RETRIES", 1)  # each takes seconds
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    with nodes() as (both, second):
        kept = signal.getsignal(signal.SIGTERM)
        for check in (
            tasks_go_to_both_nodes,
            errors_keep_their_type,
            a_stop_lets_running_tasks_return_and_begins_no_other,
            lost_workers_are_replaced,
        ):
            folder = tmp_path / check.__name__
            folder.mkdir()
            check(both.address, folder)
        (tmp_path / "node").mkdir()
        a_node_may_die(both, second, tmp_path / "node")
        assert signal.getsignal(signal.SIGTERM) is kept
        a_dataset_outlives_a_node(both, tmp_path)
        assert not ray.is_initialized()


def tasks_go_to_both_nodes(address, folder):
    results, pairs, messages = run(address, Squares(folder, processes=2))
    assert {number: square for number, (square, _) in results.items()} == {n: n * n for n in TASKS}
    assert len({node for _, node in results.values()}) == 2
    assert sorted(pairs) == [(0, number) for number in TASKS]
    assert messages == []
    # As many processes as cores, each of which opened once.
    assert [path.read_text() for path in folder.glob("opened-*")] == ["x", "x"]


def errors_keep_their_type(address, folder):
    with pytest.raises(InputError, match="three is not allowed") as caught:
        run(address, Squares(folder, "wrong"))
    assert type(caught.value) is InputError


def a_stop_lets_running_tasks_return_and_begins_no_other(address, folder):
    job = Squares(folder, waits_for_a_stop=True)
    results, pairs, _ = run(address, job, range(100), recorder=Recorder(lambda _: True))
    assert 1 <= len(results) <= 2
    assert {number for _, number in pairs} == set(results)


def lost_workers_are_replaced(address, folder):
    results, _, messages = run(address, Squares(folder, "lost once"))
    assert set(results) == set(TASKS)
    assert messages == ["task 3 is done again (the context is gone)"]
    with pytest.raises(WorkerError, match="task 3 could not be done in 2 attempts"):
        run(address, Squares(folder, "kill"), [FAULTY])


def a_node_may_die(both, second, folder):
    gone = []

    def kill(each):
        _, (_, node) = each
        if node == second.node_id and not gone:
            gone.append(node)
            both.remove_node(second, allow_graceful=False)

    results, pairs, messages = run(both.address, Squares(folder, processes=2), result=kill)
    assert gone
    assert {number: square for number, (square, _) in results.items()} == {n: n * n for n in TASKS}
    assert {number for _, number in pairs} == set(TASKS)
    assert all("its worker or its node was lost" in message for message in messages)


def a_dataset_outlives_a_node(both, folder):
    config = tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})
    generate(config, folder / "serial", 12, 5, layout="webdataset", shard_pairs=2)
    second = both.add_node(**NODE)

    class Killer(Recorder):
        def on_pair(self, pair):
            super().on_pair(pair)
            if len(self.pairs) == 2:
                both.remove_node(second, allow_graceful=False)

    generate(
        config, folder / "ray", 12, 5, layout="webdataset", shard_pairs=2, engine=RayEngine(both.address),
        listener=Killer(),
    )  # fmt: skip
    assert digests(folder / "ray") == digests(folder / "serial")


def test_a_cluster_that_is_not_there_is_told_of():
    with pytest.raises(InputError, match=r"address 127.0.0.1:9\) cannot be reached"):
        run("127.0.0.1:9", Squares(Path()))
    with pytest.raises(InputError, match="expected host:port or auto"):
        run("ray://127.0.0.1:9", Squares(Path()))
