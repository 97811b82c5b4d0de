"""Loading packages so that Ctrl-C stops it."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stopped_by_interrupts() -> Iterator[None]:
    """Let Ctrl-C stop the process itself: some packages swallow every exception while they are imported."""
    handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
