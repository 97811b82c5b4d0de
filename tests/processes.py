"""Other processes, and what the program prints, as tests see them."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

PATIENCE_S = 120
"""Whatever takes longer never happens, s."""


class Ended(NamedTuple):
    """How a command ended, and what it printed."""

    code: int
    out: str
    err: str


def assert_refused(ended, *words):
    """A command refused its input: exit code 2, and nothing printed but a message with these words."""
    assert (ended.code, ended.out, "Traceback" in ended.err) == (2, "", False), ended.err
    for word in words:
        assert str(word) in ended.err


def run_python(*arguments, cwd=None, **environment):
    """Run Python in a process of its own, with other variables of its environment."""
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(
        command, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    return Ended(done.returncode, done.stdout, done.stderr)


def alive(process):
    """Whether the process of a number runs, or could."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_for(condition):
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def without_announcements(stderr):
    """Leave out what is said of the work ahead, which depends on what earlier tests left in the cache."""
    return re.sub(r"^making .+\n", "", stderr, flags=re.MULTILINE)
