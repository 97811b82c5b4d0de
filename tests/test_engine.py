"""Engines: what tasks return, raise, and what becomes of workers that die."""

import os
import signal
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

from semisynth_gl.engine import LocalWorkers
from semisynth_gl.errors import InputError, WorkerError


@dataclass(frozen=True)
class Squares:
    """Squares numbers; beside the square comes the worker's process and how often it has opened the job."""

    fault: str = ""

    @contextmanager
    def open(self):
        if self.fault == "open":
            raise InputError("expected a folder, got nothing")
        os.environ["OPENED"] = os.environ.get("OPENED", "") + "x"
        yield self._square

    def _square(self, number):
        if number == 7 and self.fault == "task":
            raise InputError("seven is not allowed")
        if number == 7 and self.fault == "death":
            os.kill(os.getpid(), signal.SIGKILL)
        return number * number, os.getpid(), os.environ["OPENED"], os.environ["LP_NUM_THREADS"]


def test_results_come_in_order_from_workers_that_open_once(monkeypatch):
    monkeypatch.delenv("LP_NUM_THREADS", raising=False)
    monkeypatch.setattr("semisynth_gl.engine.cores", lambda: 2)
    with LocalWorkers(Squares(), 2) as workers:
        results = list(workers.run(range(40)))
    assert [square for square, *_ in results] == [number * number for number in range(40)]
    processes = {process for _, process, *_ in results}
    assert 1 <= len(processes) <= 2
    assert os.getpid() not in processes
    assert {opened for *_, opened, _ in results} == {"x"}
    # Two workers on two cores: each draws with one thread.
    assert {threads for *_, threads in results} == {"0"}


@pytest.mark.parametrize(("fault", "message"), [("open", "got nothing"), ("task", "seven is not allowed")])
def test_what_a_worker_raises_arrives(fault, message):
    with LocalWorkers(Squares(fault), 2) as workers, pytest.raises(InputError, match=message):
        list(workers.run(range(40)))


def test_a_worker_that_dies_is_told_of():
    with LocalWorkers(Squares("death"), 2) as workers, pytest.raises(WorkerError, match="a worker process died"):
        list(workers.run(range(40)))


def test_tasks_are_not_taken_long_before_they_are_done():
    taken = []

    def numbers():
        for number in range(1000):
            taken.append(number)
            yield number

    with LocalWorkers(Squares(), 1) as workers:
        results = workers.run(numbers())
        next(results)
        assert len(taken) <= 5
        results.close()
