"""Locks between runs that work on one folder. A lock ends with its process, however that ends."""

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
    """Lock an open file, and return whether it is locked: some network file systems have no locks.

    Raises BlockingIOError where another process holds the lock.
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

    A missing file is created, and its folder too. ``shared`` is asked before each try whether to lock beside other
    runs. A patient run waits up to half a minute for another run's unlocking. See `lock` on file systems without locks,
    and on the error where another run holds the lock.
    """
    deadline = time.monotonic() + (_PATIENCE_S if patient else 0.0)
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError), ExitStack() as unless_locked:
            file = unless_locked.enter_context(path.open("a+b"))
            try:
                lock(file.fileno(), shared=shared())
                # A lock of a file that was removed in the meantime keeps nobody out.
                if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    unless_locked.pop_all()
                    return file
            except BlockingIOError:
                if time.monotonic() >= deadline:
                    raise
        time.sleep(_SECONDS_BETWEEN_TRIES)
