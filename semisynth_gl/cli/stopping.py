"""Ctrl-C once lets the pairs in hand be finished, twice stops at once; SIGTERM is like the first."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import click

from semisynth_gl.engines.task import Stop


@contextmanager
def asking_to_stop(stop: Stop) -> Iterator[None]:
    """Let the signals that end a program ask to stop, in the block.

    Args:
        stop: what is asked; a second Ctrl-C raises KeyboardInterrupt.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are for the main thread
        return

    def ask(number: int, _: FrameType | None) -> None:
        if stop.asked:
            if number == signal.SIGINT:
                raise KeyboardInterrupt
            return
        stop.ask()
        again = "; Ctrl-C again stops at once" if number == signal.SIGINT else ""
        click.echo(f"Finishing the pairs in hand{again}.", err=True)

    previous = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
