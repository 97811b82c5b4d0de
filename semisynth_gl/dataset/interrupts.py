"""Handling of SIGINT (Ctrl-C) and SIGTERM, as context managers. They have no effect outside of the main thread."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from semisynth_gl.listener import Listener

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def interrupts_kept() -> Iterator[None]:
    """Restore the handlers of both signals after a block in which other code may replace them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.getsignal(number) for number in ENDING_SIGNALS}
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)


@contextmanager
def interrupts_stop(listener: "Listener") -> Iterator[None]:
    """Let a signal in the block ask a long function to stop; a second one raises KeyboardInterrupt."""

    def ask(_: int, __: FrameType | None) -> None:
        if listener.stopping:
            raise KeyboardInterrupt
        listener.stop()
        listener.on_message("Stopping; complete shards stay. Ctrl-C again stops at once.")

    with interrupts_kept():
        if threading.current_thread() is threading.main_thread():
            for number in ENDING_SIGNALS:
                signal.signal(number, ask)
        yield


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Let processes that start in the block begin with both signals blocked; here, these wait for its end."""
    # Otherwise the resource tracker would start with the first process, and lift the mask.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
