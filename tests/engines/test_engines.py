"""Engines in this process and in worker processes: results, messages, stops, and what becomes of lost workers."""

import os
import platform
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest
from engine_jobs import FAULTY, Arrays, Squares
from processes import PATIENCE_S, alive, wait_for
from recorder import Recorder

from semisynth_gl.engines import local
from semisynth_gl.engines.cluster import RayEngine
from semisynth_gl.engines.interrupts import interrupts_wait
from semisynth_gl.engines.local import LocalEngine, SerialEngine
from semisynth_gl.inputs.errors import ContextLostError, InputError, WorkerError
from semisynth_gl.listener import Listener

ENGINES = {"serial": SerialEngine(), "local": LocalEngine(2, 60)}
TASKS = range(12)


@dataclass
class Run:
    """Everything that an engine gives."""

    results: dict
    messages: list
    pairs: list

    @property
    def processes(self):
        return {process for _, process, _ in self.results.values()}


def run(engine, job, tasks=TASKS, recorder=None):
    recorder, results = recorder or Recorder(), []
    with closing(engine.run(job, tasks, recorder)) as yielded:
        results.extend(yielded)
    assert len(results) == len(dict(results))
    return Run(dict(results), recorder.messages, recorder.pairs)


def opened(folder):
    """Processes that opened the job, each with how often."""
    return Counter({int(path.name.split("-")[1]): len(path.read_text()) for path in folder.glob("opened-*")})


@pytest.mark.parametrize("name", ENGINES)
def test_all_tasks_are_done_once_by_workers_that_open_once(name, tmp_path, monkeypatch):
    monkeypatch.delenv("LP_NUM_THREADS", raising=False)
    monkeypatch.setattr("semisynth_gl.engines.task.cores", lambda: 2)
    made = run(ENGINES[name], Squares(tmp_path))
    assert {number: square for number, (square, *_) in made.results.items()} == {n: n * n for n in TASKS}
    assert set(opened(tmp_path).values()) == {1}
    assert {int(path.name.split("-")[1]) for path in tmp_path.glob("closed-*")} == set(opened(tmp_path))
    assert made.messages == []
    if name == "local":
        assert os.getpid() not in made.processes
        assert len(opened(tmp_path)) == 2
        # Two workers on two cores: each draws with one thread.
        assert {threads for *_, threads in made.results.values()} == {"0"}
        assert not any(map(alive, opened(tmp_path)))


@pytest.mark.parametrize("name", ENGINES)
def test_calls_of_tasks_arrive_in_order(name, tmp_path):
    made = run(ENGINES[name], Squares(tmp_path))
    assert sorted(number for _, number, _ in made.pairs) == sorted([*TASKS, *TASKS])
    for worker in {worker for worker, *_ in made.pairs}:
        calls = [call[1:] for call in made.pairs if call[0] == worker]
        assert calls[::2] == [(number, "begun") for number, _ in calls[::2]]
        assert calls[1::2] == [(number, "done") for number, _ in calls[::2]]


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries keep memory as they like")
def test_workers_keep_the_memory_of_a_pair_for_the_next():
    with closing(LocalEngine(1, 60).run(Arrays(), range(4), Listener())) as results:
        faults = dict(results)
    assert faults[0] > 10_000
    assert all(faults[number] < 1000 for number in (2, 3))


def test_there_are_no_more_workers_than_tasks_and_tasks_are_taken_late(tmp_path):
    assert set(run(LocalEngine(8, 60), Squares(tmp_path), [5]).results) == {5}
    assert len(opened(tmp_path)) == 1
    assert run(LocalEngine(8, 60), Squares(tmp_path), []).results == {}
    assert len(opened(tmp_path)) == 1
    taken = []
    numbers = (taken.append(number) or number for number in range(1000))
    recorder = Recorder()
    with closing(LocalEngine(1, 60).run(Squares(tmp_path), numbers, recorder)) as results:
        next(results)
    assert recorder.messages == []
    assert len(taken) <= 2


@pytest.mark.parametrize("name", ENGINES)
def test_a_stop_lets_running_tasks_return_and_begins_no_other(name, tmp_path):
    recorder = Recorder(lambda _: True)
    # A task goes on until it sees the stop, and fails where it never does: a result shows that it has.
    with closing(ENGINES[name].run(Squares(tmp_path, pause_s=PATIENCE_S), range(100), recorder)) as yielded:
        results = dict(yielded)
    assert 1 <= len(results) <= 2
    assert set(results) == {pair[1] for pair in recorder.pairs}
    assert recorder.messages == []


@pytest.mark.parametrize("name", ENGINES)
def test_nothing_is_begun_where_a_stop_came_before(name, tmp_path):
    listener = Listener()
    listener.stop()
    assert list(ENGINES[name].run(Squares(tmp_path), TASKS, listener)) == []
    assert not opened(tmp_path)


@pytest.mark.parametrize(
    ("fault", "how"),
    [("kill", "killed by SIGKILL"), ("exit", "it ended with exit code 3"), ("lost", "the context is gone")],
)
@pytest.mark.parametrize("times", [1, 2])
def test_a_worker_that_is_lost_is_replaced_and_its_task_done_again(fault, how, times, tmp_path):
    made = run(LocalEngine(2, 60), Squares(tmp_path, fault, times))
    assert {number: square for number, (square, *_) in made.results.items()} == {n: n * n for n in TASKS}
    assert len(made.messages) == times
    for note in made.messages:
        assert re.fullmatch(rf"worker [01] is replaced \({how}\): task 7 is done again", note)
    # Nobody but the unlucky task begins twice, and numbers stay those of the first workers.
    begun = Counter(number for _, number, state in made.pairs if state == "begun")
    assert begun == Counter(TASKS) + Counter({FAULTY: times})
    assert {worker for worker, *_ in made.pairs} == {0, 1}


def test_a_context_lost_at_opening_is_opened_by_another_worker(tmp_path):
    made = run(LocalEngine(1, 60), Squares(tmp_path, "lost at opening", 2), range(3))
    assert set(made.results) == {0, 1, 2}
    assert made.messages == ["worker 0 is replaced (the context is gone): task 0 is done again"] * 2


@pytest.mark.parametrize("fault", ["lost", "lost at opening"])
def test_the_serial_engine_opens_again_after_a_lost_context(fault, tmp_path):
    made = run(SerialEngine(), Squares(tmp_path, fault, 2))
    assert set(made.results) == set(TASKS)
    assert made.messages == [f"the context is gone: task {FAULTY if fault == 'lost' else 0} is done again"] * 2
    (tmp_path / "struck-0").unlink()
    with pytest.raises(ContextLostError):
        run(SerialEngine(), Squares(tmp_path, fault, 1000))


def test_a_task_that_ends_every_worker_is_given_up(tmp_path):
    with pytest.raises(WorkerError, match=r"task 7 has ended 3 workers.*SIGKILL.*stay on disk.*fewer workers"):
        run(LocalEngine(2, 60), Squares(tmp_path, "kill", 1000))
    assert len(list(tmp_path.glob("struck-*"))) == 3
    assert not any(map(alive, opened(tmp_path)))


class Clock(Recorder):
    """A clock for the engine that stands still but for the time between a faulty task's beginning and its replacement.

    Otherwise it would count how long processes take to start, which is long where the machine is busy.
    """

    def __init__(self):
        super().__init__()
        self.passed_s, self.runs_since = 0.0, None

    def __call__(self):
        return self.passed_s + (time.monotonic() - self.runs_since if self.runs_since else 0.0)

    def on_pair(self, pair):
        super().on_pair(pair)
        if pair[1:] == (FAULTY, "begun") and not self.messages:
            self.runs_since = time.monotonic()

    def on_message(self, message):
        super().on_message(message)
        self.passed_s, self.runs_since = self(), None


def test_a_worker_that_hangs_is_replaced_and_one_that_tells_is_not(tmp_path, monkeypatch):
    def run_by(clock, fault):
        monkeypatch.setattr(local, "monotonic", clock)
        return run(LocalEngine(2, 4), Squares(tmp_path, fault), recorder=clock)

    made = run_by(Clock(), "hang")
    assert set(made.results) == set(TASKS)
    assert len(made.messages) == 1
    assert "(nothing came from it for 4 s): task 7 is done again" in made.messages[0]
    (tmp_path / "struck-0").unlink()
    made = run_by(Clock(), "slow")
    assert set(made.results) == set(TASKS)
    assert made.messages == []


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(("fault", "message"), [("open", "got nothing"), ("wrong", "seven is not allowed")])
def test_errors_keep_their_type(name, fault, message, tmp_path):
    with pytest.raises(InputError, match=message):
        run(ENGINES[name], Squares(tmp_path, fault, 1000))
    assert not any(alive(process) for process in opened(tmp_path) if process != os.getpid())


def test_without_ray_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray.util.scheduling_strategies", None)
    with pytest.raises(InputError, match=r"pip install 'semisynth-gl\[ray\]'"):
        next(RayEngine().run(Squares(tmp_path), TASKS, Listener()))


def test_an_error_that_does_not_pickle_arrives_as_text(tmp_path):
    with pytest.raises(WorkerError, match=r"worker [01] met StubbornError: one and two"):
        run(LocalEngine(2, 60), Squares(tmp_path, "stubborn"))


def test_a_task_that_ends_its_process_by_exception_is_an_error_at_once(tmp_path):
    with pytest.raises(WorkerError, match=r"^worker [01] met SystemExit: 0$"):
        run(LocalEngine(2, 60), Squares(tmp_path, "exits"))


def test_other_tasks_in_hand_are_finished_before_an_error_is_raised(tmp_path):
    results = []
    with (
        pytest.raises(InputError),
        closing(
            LocalEngine(2, 60).run(Squares(tmp_path, "wrong", pause_s=1000), [1, FAULTY, 2], Listener())
        ) as yielded,
    ):
        results.extend(yielded)
    assert [number for number, _ in results] in ([], [1])
    assert not any(map(alive, opened(tmp_path)))


def test_signals_to_a_worker_are_left_to_the_first_process(tmp_path):
    made = run(LocalEngine(2, 60), Squares(tmp_path, "signals"))
    assert set(made.results) == set(TASKS)
    assert made.messages == []


def test_closing_the_iterator_ends_all_workers(tmp_path):
    results = LocalEngine(2, 60).run(Squares(tmp_path), range(1000), Listener())
    next(results)
    wait_for(lambda: len(opened(tmp_path)) == 2)
    results.close()
    assert not any(map(alive, opened(tmp_path)))


PROGRAM = """
import sys
from pathlib import Path
from engine_jobs import Squares
from semisynth_gl.engines.local import LocalEngine
from semisynth_gl.listener import Listener
if __name__ == "__main__":
    engine = LocalEngine(2, 60)
    results = engine.run(Squares(Path(sys.argv[1]), pause_s=1000), range(9), Listener())
    next(results)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_the_first_process(number, tmp_path):
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)
    paths = (str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH"))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    # A session of its own: the interrupt goes to all of it, as from a terminal.
    with subprocess.Popen(
        [sys.executable, script, tmp_path], env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True,
        stdout=subprocess.DEVNULL,
    ) as program:  # fmt: skip
        wait_for(lambda: len(opened(tmp_path)) == 2)
        if number == signal.SIGINT:
            os.killpg(program.pid, number)
        else:
            program.kill()
        program.wait(PATIENCE_S)
        wait_for(lambda: not any(map(alive, opened(tmp_path))))
        errors = program.stderr.read()
    # Workers say nothing of it.
    assert errors.count("Traceback") == (number == signal.SIGINT)


def test_an_interrupt_waits_for_what_would_swallow_it():
    before = signal.getsignal(signal.SIGINT)
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts_wait():
        done += [signal.raise_signal(signal.SIGINT), "what follows"]
    assert done == [None, "what follows"]
    assert signal.getsignal(signal.SIGINT) == before
