"""Handling of SIGINT (Ctrl-C) and SIGTERM, as context managers. They have no effect outside of the main thread."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from multiprocessing import resource_tracker
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from semisynth_gl.listener import Listener

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def _handlers(
    handler: Callable[[int, FrameType | None], Any] | signal.Handlers | None, *numbers: int
) -> Iterator[None]:
    """Install a handler for the block, None for none, and restore the previous handlers after it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.getsignal(number) for number in numbers}
    for number in numbers if handler is not None else ():
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)


def _raise_once(_: int, __: FrameType | None) -> NoReturn:
    # A second KeyboardInterrupt during the handling of the first could only become a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    raise KeyboardInterrupt


interrupts_raise = partial(_handlers, _raise_once, signal.SIGINT)
"""Let the first Ctrl-C in the block raise KeyboardInterrupt, and the second one end the process at once."""
interrupts_end = partial(_handlers, signal.SIG_DFL, signal.SIGINT)
"""Let Ctrl-C in the block end the process at once: packages may catch KeyboardInterrupt while they are imported."""
interrupts_kept = partial(_handlers, None, *ENDING_SIGNALS)
"""Restore the handlers of SIGINT and SIGTERM after a block in which other code may replace them."""


def interrupts_stop(listener: "Listener") -> AbstractContextManager[None]:
    """Let Ctrl-C and SIGTERM in the block ask a long function to stop; a second one raises KeyboardInterrupt."""

    def ask(number: int, frame: FrameType | None) -> None:
        if listener.stopping:
            _raise_once(number, frame)
        listener.stop()
        listener.on_message("Stopping; complete shards stay. Ctrl-C again stops at once.")

    return _handlers(ask, *ENDING_SIGNALS)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Let processes that start in the block begin with SIGINT and SIGTERM blocked; here, these wait for its end."""
    # Otherwise the resource tracker would start with the first process, and lift the mask.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
