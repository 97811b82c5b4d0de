"""Ctrl-C while packages are imported that would swallow it."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Let Ctrl-C take effect after the block.

    Some packages catch every exception while they are imported: an interrupt would be lost, and the package take what
    it was about to import for absent.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # interrupts are for the main thread
        return
    pending: list[tuple[int, FrameType | None]] = []
    previous = signal.signal(signal.SIGINT, lambda *arguments: pending.append(arguments))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
    if pending:
        signal.raise_signal(signal.SIGINT)
