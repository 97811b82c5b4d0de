"""Handling of SIGINT (Ctrl-C) and SIGTERM, as context managers. They have no effect outside of the main thread."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import resource_tracker
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from semisynth_gl.listener import Listener

_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)

GRACE_S = 5.0
"""Time that the pairs in hand may take after SIGTERM, s."""


def interrupts_raise() -> AbstractContextManager[None]:
    """Let the first Ctrl-C in the block raise KeyboardInterrupt, and the second one end the process at once.

    A second KeyboardInterrupt during the handling of the first could only become a traceback.
    """
    return _handlers(_raise_once, (signal.SIGINT,))


def interrupts_end() -> AbstractContextManager[None]:
    """Let Ctrl-C in the block end the process at once, without an exception.

    This is for imports: some packages catch every exception while they are imported, KeyboardInterrupt too.
    """
    return _handlers(signal.SIG_DFL, (signal.SIGINT,))


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Delay Ctrl-C until the end of the block.

    This is for imports: some packages catch every exception while they are imported. They would swallow
    KeyboardInterrupt, and take the module that they were importing for missing.
    """
    pending: list[tuple[int, FrameType | None]] = []
    with _handlers(lambda *arguments: pending.append(arguments), (signal.SIGINT,)):
        yield
    if pending:
        signal.raise_signal(signal.SIGINT)


@contextmanager
def interrupts_stop(listener: "Listener") -> Iterator[None]:
    """Let Ctrl-C and SIGTERM in the block ask a long function to stop.

    The signal calls the listener's ``stop`` and ``on_message``. A second Ctrl-C raises KeyboardInterrupt, and a third
    one ends the process. SIGTERM also raises KeyboardInterrupt, after `GRACE_S`, since its sender will kill the process
    before long.
    """

    def ask(number: int, _: FrameType | None) -> None:
        if listener.stopping:
            if number == signal.SIGINT:
                _raise_once(number, None)
            return
        listener.stop()
        rest = f"pairs that are not done in {GRACE_S:g} s are left out"
        if number == signal.SIGINT:
            rest = "Ctrl-C again stops at once"
        else:
            signal.setitimer(signal.ITIMER_REAL, GRACE_S)
        listener.on_message(f"Finishing the pairs in hand; {rest}.")

    with _handlers(ask, _ENDING_SIGNALS), _handlers(_raise_once, (signal.SIGALRM,)):
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Let processes that start in the block begin with SIGINT and SIGTERM blocked, so that they can set handlers."""
    # Otherwise the resource tracker would start with the first process, and lift the mask.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def interrupts_kept() -> AbstractContextManager[None]:
    """Restore the handlers of SIGINT and SIGTERM after a block in which other code may replace them."""
    return _handlers(None, _ENDING_SIGNALS)


def _raise_once(_: int, __: FrameType | None) -> NoReturn:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    raise KeyboardInterrupt


@contextmanager
def _handlers(
    handler: Callable[[int, FrameType | None], Any] | signal.Handlers | None, numbers: tuple[signal.Signals, ...]
) -> Iterator[None]:
    """Install a handler for the block, None for none, and restore the previous handlers after it.

    Does nothing outside of the main thread, which alone can set handlers.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.getsignal(number) for number in numbers}
    for number in numbers if handler is not None else ():
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, handler_before in previous.items():
            signal.signal(number, handler_before)
