"""Locks between runs that work on one folder. A lock ends with its process, even if the process is killed."""

import fcntl
import os
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import BinaryIO

_SECONDS_BETWEEN_TRIES = 0.05
_PATIENCE_S = 30.0


def lock(descriptor: int, *, shared: bool) -> bool:
    """Lock an open file, and return whether that worked: some network file systems have no locks.

    A shared lock keeps exclusive ones out, and an exclusive lock keeps out all others. Raises BlockingIOError where
    another process holds a lock that keeps this one out.
    """
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def open_locked(path: Path, shared: Callable[[], bool], *, patient: bool) -> BinaryIO:
    """Open and lock a file, which other runs may remove when they end; close it to unlock it.

    A missing file and its folder are created. On file systems without locks, the file is returned unlocked.

    Args:
        path: the file.
        shared: called before each try; returns whether to share the lock with other runs.
        patient: whether to wait up to half a minute while another run holds the lock.

    Raises:
        BlockingIOError: where another run holds the lock, for a patient run after its wait.
    """
    deadline = time.monotonic() + (_PATIENCE_S if patient else 0.0)
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError), ExitStack() as unless_locked:
            file = unless_locked.enter_context(path.open("a+b"))
            try:
                lock(file.fileno(), shared=shared())
                # If the file was removed in the meantime, its lock keeps nobody out.
                if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    unless_locked.pop_all()
                    return file
            except BlockingIOError:
                if time.monotonic() >= deadline:
                    raise
        time.sleep(_SECONDS_BETWEEN_TRIES)
