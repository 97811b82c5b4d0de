"""Locks between runs that work on one folder. A lock ends with its process, however that ends."""

import fcntl
import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

_SECONDS_BETWEEN_TRIES = 0.05
_PATIENCE_S = 30.0


def lock(descriptor: int, *, shared: bool) -> None:
    """Lock an open file, or go without where the file system has no locks.

    Raises:
        BlockingIOError: where another process holds it.
    """
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        # Some network file systems have none: two runs then do the same work twice, and write the same bytes.
        return


def open_locked(path: Path, shared: Callable[[], bool], *, patient: bool) -> BinaryIO:
    """Open and lock a file, which other runs may remove when they end.

    Args:
        path: it is created where it is missing, and its folder too.
        shared: whether to lock beside others; asked anew before each try.
        patient: wait up to half a minute for another run to let go.

    Returns:
        The file; close it to unlock it.

    Raises:
        BlockingIOError: where another run holds it.
        OSError: where it cannot be opened.
    """
    given_up = time.monotonic() + (_PATIENCE_S if patient else 0.0)
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            file = path.open("a+b")
            try:
                lock(file.fileno(), shared=shared())
                # A lock of a file that has been removed since keeps nobody out.
                if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    return file
            except BlockingIOError:
                file.close()
                if time.monotonic() >= given_up:
                    raise
            except BaseException:
                file.close()
                raise
            file.close()
        time.sleep(_SECONDS_BETWEEN_TRIES)
