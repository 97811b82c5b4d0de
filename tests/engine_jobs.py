"""Tasks for the tests of engines. Workers import this module, so it imports little: no pytest."""

import os
import resource
import signal
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from semisynth_gl.inputs.errors import ContextLostError, InputError

FAULTY = 7


class StubbornError(Exception):
    """Pickles, and fails to come back."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


RAISED = {
    "lost": ContextLostError("the context is gone"),
    "wrong": InputError("seven is not allowed"),
    "stubborn": StubbornError("one", "two"),
    "exits": SystemExit(0),
}


@dataclass(frozen=True)
class Squares:
    """Squares numbers, and has a fault at one of them: as often as it says, counted by files in a folder."""

    folder: Path
    fault: str = ""
    times: int = 1
    pause_s: float = 0

    @contextmanager
    def open(self, worker):
        if self.fault == "open":
            raise InputError("expected a folder, got nothing")
        if self.fault == "lost at opening" and self._strikes():
            raise ContextLostError("the context is gone")
        (self.folder / f"opened-{os.getpid()}").open("a").write("x")
        yield lambda number, listener: self._square(worker, number, listener)
        (self.folder / f"closed-{os.getpid()}").touch()

    def _square(self, worker, number, listener):
        listener.on_pair((worker, number, "begun"))
        if number == FAULTY and self.fault and self._strikes():
            self._fail(listener)
        until = time.monotonic() + self.pause_s
        while time.monotonic() < until and not listener.stopping:
            time.sleep(0.01)
        if self.pause_s and not listener.stopping:
            raise InputError("nobody told this task of the stop")
        listener.on_pair((worker, number, "done"))
        return number * number, os.getpid(), os.environ.get("LP_NUM_THREADS")

    def _strikes(self):
        count = len(list(self.folder.glob("struck-*")))
        if count < self.times:
            (self.folder / f"struck-{count}").touch()
        return count < self.times

    def _fail(self, listener):
        match self.fault:
            case "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            case "exit":
                os._exit(3)
            case "hang":
                time.sleep(1000)
            case "slow":
                for _ in range(18):
                    time.sleep(0.25)
                    listener.on_stage("still here")
            case "signals":
                os.kill(os.getpid(), signal.SIGINT)
                os.kill(os.getpid(), signal.SIGTERM)
            case name:
                raise RAISED[name]


@dataclass(frozen=True)
class Arrays:
    """Makes and frees arrays of a pair's size, and returns how many pages the kernel had to give out for them."""

    @contextmanager
    def open(self, _worker):
        yield self._faults

    def _faults(self, _number, _listener):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        made = [bytearray(6_000_000) for _ in range(10)]
        del made
        return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
