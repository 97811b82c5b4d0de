"""Messages and progress on standard error: on a terminal a bar with rate and remaining time, elsewhere plain lines."""

import sys
import time
from typing import Self

import click
from tqdm import tqdm

from semisynth_gl.inputs.errors import counted
from semisynth_gl.listener import Listener

_SECONDS_BETWEEN_LINES = 10.0


class Progress(Listener):
    """Shows messages and counts pairs. A ``with`` block closes the bar at its end."""

    def __init__(self) -> None:
        self._total = self._count = 0
        self._start = self._shown_at = 0.0
        self._bar: tqdm | None = None
        self._renderers: set[str] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def on_message(self, text: str) -> None:
        """Show a message."""
        click.echo(text, err=True)

    def on_renderer(self, name: str) -> None:
        """Show a renderer's name when it appears for the first time."""
        if name not in self._renderers:
            self._renderers.add(name)
            self.on_message(f"rendering with {name}")

    def on_total(self, pairs: int) -> None:
        """Show the bar, and start the clock: the rate excludes the time before the first pair."""
        self._total = pairs
        self._start = self._shown_at = time.monotonic()
        if sys.stderr.isatty():
            self._bar = tqdm(total=pairs, unit="pair", file=sys.stderr)

    def on_pair(self) -> None:
        """Count a pair; without a terminal, print a line every 10 s and at the end."""
        self._count += 1
        if self._bar is not None:
            self._bar.update()
            return
        now = time.monotonic()
        if self._count == self._total or now - self._shown_at >= _SECONDS_BETWEEN_LINES:
            self._shown_at = now
            rate = self._count / max(now - self._start, 1e-9)
            remaining_s = (self._total - self._count) / rate
            self.on_message(
                f"{self._count} of {counted(self._total, 'pair')}, {rate:.2f} pairs/s, {remaining_s:.0f} s left"
            )
