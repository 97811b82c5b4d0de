"""Ctrl-C at any moment of the program, from its first statement to its last: one line or none, never a traceback."""

import signal
import subprocess
import sys

import pytest

from semisynth_gl.dataset.interrupts import interrupts_stop
from semisynth_gl.listener import Listener

# The program, with an interrupt at the n-th import of its main module. Some packages swallow one while they load.
AT_IMPORT = """
import os, runpy, signal, sys

class Interrupt:
    imports = None

    def find_spec(self, name, *rest):
        if name == "semisynth_gl.__main__":
            self.imports = 0
        elif self.imports is not None:
            self.imports += 1
            if str(self.imports) == moment or name == moment:
                os.kill(os.getpid(), signal.SIGINT)

moment = sys.argv.pop(1)
sys.meta_path.insert(0, Interrupt())
runpy.run_module("semisynth_gl", run_name="__main__", alter_sys=True)
"""

# The program with another command in the place of its own.
COMMAND = """
import atexit, os, signal
from semisynth_gl import __main__, cli

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)

class Command:
    def main(self, standalone_mode):
        {}

cli.semisynth_gl = Command()
__main__.main()
"""


def run(script, *arguments):
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False, timeout=120
    )
    return done.returncode, done.stderr.strip()


@pytest.mark.parametrize("moment", ["1", "300", "moderngl"])
def test_an_interrupt_at_any_import_stops_at_once(moment):
    code, said = run(AT_IMPORT, moment, "generate", "--config", "eth3d")
    # Before the command begins, the process ends by the signal.
    assert code == -signal.SIGINT or (moment == "300" and code == 2)
    assert said.partition(".")[0] == ("Stopped" if code == 2 else "")
    assert "\n" not in said


def test_one_interrupt_stops_a_command_and_those_after_it_say_nothing():
    for code in ("interrupt()", "[atexit.register(interrupt) for _ in range(4)]; interrupt()"):
        done, said = run(COMMAND.format(code))
        assert done == (-signal.SIGINT if "atexit" in code else 2)
        assert said.startswith("Stopped")
        assert "\n" not in said


def test_the_second_interrupt_of_a_long_run_ends_it():
    listener = Listener()
    with interrupts_stop(listener):
        signal.raise_signal(signal.SIGINT)
        assert listener.stopping
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
