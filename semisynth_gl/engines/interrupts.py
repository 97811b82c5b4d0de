"""SIGINT (Ctrl-C) and SIGTERM: when they take effect, and how."""

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
"""How long the pairs in hand may take after SIGTERM, s."""


def interrupts_raise() -> AbstractContextManager[None]:
    """Let Ctrl-C raise KeyboardInterrupt in the block, once: after that it ends the process itself.

    An interrupt that comes while another one is dealt with could only become a traceback.
    """
    return _handlers(_raise_once, (signal.SIGINT,))


def interrupts_end() -> AbstractContextManager[None]:
    """Let Ctrl-C end the process itself in the block.

    Some packages catch every exception while they are imported, an interrupt too.
    """
    return _handlers(signal.SIG_DFL, (signal.SIGINT,))


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Let Ctrl-C take effect after the block.

    Some packages catch every exception while they are imported: the interrupt would vanish, and the package would
    think that what it was about to import is not installed.
    """
    pending: list[tuple[int, FrameType | None]] = []
    with _handlers(lambda *arguments: pending.append(arguments), (signal.SIGINT,)):
        yield
    if pending:
        signal.raise_signal(signal.SIGINT)


@contextmanager
def interrupts_stop(listener: "Listener") -> Iterator[None]:
    """Let Ctrl-C and SIGTERM ask a long function to stop, in the block.

    A second Ctrl-C raises KeyboardInterrupt, once. So does SIGTERM after `GRACE_S`, for whoever sends it kills the
    process before long. The listener asks for the stop, and hears a message about it.
    """

    def ask(number: int, _: FrameType | None) -> None:
        if listener.stopping:
            if number == signal.SIGINT:
                _raise_once(number, None)
            return
        listener.stop()
        rest = f"what is not done in {GRACE_S:g} s is left undone"
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
    """Let the processes that start in the block begin with both signals blocked, until they ignore the signals."""
    # The resource tracker starts with the first process otherwise, and would lift the mask.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def interrupts_kept() -> AbstractContextManager[None]:
    """Restore the handlers of both signals after a block that replaces them."""
    return _handlers(None, _ENDING_SIGNALS)


def _raise_once(_: int, __: FrameType | None) -> NoReturn:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    raise KeyboardInterrupt


@contextmanager
def _handlers(
    handler: Callable[[int, FrameType | None], Any] | signal.Handlers | None, numbers: tuple[signal.Signals, ...]
) -> Iterator[None]:
    """Install a handler, if any, in the block, and restore the previous ones; only the main thread has handlers."""
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
