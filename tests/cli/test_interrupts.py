"""Ctrl-C at any moment of the program, from its first statement to its last: one line or none, never a traceback."""

import signal
import subprocess
import sys

import pytest

from semisynth_gl.dataset.interrupts import interrupts_end, interrupts_raise, interrupts_stop
from semisynth_gl.listener import Listener

STOPPED = "Stopped. Complete files and shards stay on disk."

# The program as `python -m semisynth_gl` runs it, with an interrupt at the n-th import that it causes. Python itself
# looks for the package and for its __main__, whose first statement is the program's.
AT_IMPORT = """
import os, runpy, signal, sys

class Interrupt:
    imports = 0

    def find_spec(self, name, *rest):
        if "semisynth_gl" in sys.modules and name != "semisynth_gl.__main__":
            self.imports += 1
            if self.imports == number:
                os.kill(os.getpid(), signal.SIGINT)

number = int(sys.argv.pop(1))
sys.meta_path.insert(0, Interrupt())
runpy.run_module("semisynth_gl", run_name="__main__", alter_sys=True)
"""

# The program with another command in the place of its own.
COMMAND = """
import atexit, os, signal, sys, threading
import click
from semisynth_gl import __main__, cli

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)

class Command:
    def main(self, standalone_mode):
        {}

cli.semisynth_gl = Command()
__main__.main()
"""

# What the command does, and what is said before the process ends.
AT_THE_END = {
    "while another one is dealt with": ("\n        try: interrupt()\n        finally: interrupt()", ""),
    "in an exit function": ("atexit.register(interrupt)", ""),
    "as the interpreter waits for threads": ("threading._register_atexit(interrupt)", ""),
    "after an error": ("atexit.register(interrupt); raise click.UsageError('wrong')", "Error: wrong"),
    "five in a row": ("[atexit.register(interrupt) for _ in range(4)]; interrupt()", STOPPED),
}


def run(script, *arguments):
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=120
    )


# The later ones lie in the imports of the command, and beyond.
@pytest.mark.parametrize("number", [1, 2, 3, 5, 8, 30, 100, 300, 600, 900])
def test_an_interrupt_at_any_import_is_no_traceback(number):
    done = run(AT_IMPORT, number, "configs")
    assert done.returncode in ((-signal.SIGINT,) if number < 300 else (-signal.SIGINT, 2, 0))
    assert done.stderr.strip() == (STOPPED if done.returncode == 2 else "")


@pytest.mark.parametrize("moment", AT_THE_END)
def test_an_interrupt_at_the_end_is_no_traceback(moment):
    code, message = AT_THE_END[moment]
    done = run(COMMAND.format(code))
    assert (done.returncode, done.stderr.strip()) == (-signal.SIGINT, message)


def test_one_interrupt_stops_a_command():
    done = run(COMMAND.format("interrupt()"))
    assert (done.returncode, done.stderr.strip()) == (2, STOPPED)


@pytest.mark.parametrize(
    ("package", "words"),
    [
        ("numpy", ["doctor"]),
        ("moderngl", ["generate", "--config", "eth3d"]),
        ("moderngl", ["preview", "--config", "eth3d"]),
    ],
)
def test_ctrl_c_while_loading_stops_at_once(package, words):
    """Some packages swallow an interrupt while they are imported."""
    script = (
        "import os, signal, sys\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, *rest):\n"
        f"        if name == {package!r}:\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "from semisynth_gl.__main__ import main\n"
        f"sys.argv = ['semisynth-gl', *{words}]\n"
        "main()\n"
    )
    done = run(script)
    assert done.returncode == -signal.SIGINT
    assert done.stdout == done.stderr == ""


def test_handlers_are_put_back():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with interrupts_end():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL
    with pytest.raises(KeyboardInterrupt), interrupts_raise():
        signal.raise_signal(signal.SIGINT)
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def test_the_second_interrupt_of_a_long_run_is_the_last_that_python_hears_of():
    listener = Listener()
    with interrupts_stop(listener):
        signal.raise_signal(signal.SIGINT)
        assert listener.stopping
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL
