"""Processes that tests start, and what they print."""

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
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


def assert_refused(ended, *words):
    """Check that a command refused its input: exit code 2, and only a message with these words."""
    assert (ended.code, ended.out, "Traceback" in ended.err) == (2, "", False), ended.err
    for word in words:
        assert str(word) in ended.err


def run_python(*arguments, cwd=None, **environment):
    """Run Python in a new process with additional environment variables."""
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(
        command, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    return Ended(done.returncode, done.stdout, done.stderr)


def alive(process):
    """Tell whether a process exists and is no zombie."""
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
    """Remove the lines "making ...", which depend on what the cache already has."""
    return re.sub(r"^making .+\n", "", stderr, flags=re.MULTILINE)
