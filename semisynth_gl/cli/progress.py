"""Progress on standard error: a bar with rate and time left on a terminal, plain lines elsewhere."""

import sys
import time
from types import TracebackType
from typing import Self

import click
from tqdm import tqdm

_SECONDS_BETWEEN_LINES = 10.0


class Progress:
    """Counts pairs. Use it in a ``with`` block, and `begin` when the first one is about to be made."""

    def __init__(self) -> None:
        self._total = 0
        self._done = 0
        self._start = self._said = 0.0
        self._bar: tqdm | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.close()

    def begin(self, total: int) -> None:
        """Start the clock and show the bar; what is read and opened before is no part of the rate.

        Args:
            total: how many pairs there will be.
        """
        self._total = total
        self._start = self._said = time.monotonic()
        if sys.stderr.isatty():
            self._bar = tqdm(total=self._total, unit="pair", file=sys.stderr)

    def drop(self) -> None:
        """Count one pair less: it was there already."""
        self._total -= 1
        if self._bar is not None:
            self._bar.total = self._total
            self._bar.refresh()

    def advance(self) -> None:
        """Count one pair."""
        self._done += 1
        if self._bar is not None:
            self._bar.update()
            return
        now = time.monotonic()
        if self._done == self._total or now - self._said >= _SECONDS_BETWEEN_LINES:
            self._said = now
            rate = self._done / max(now - self._start, 1e-9)
            left = (self._total - self._done) / rate
            click.echo(f"{self._done} of {self._total} pairs, {rate:.2f} pairs/s, {left:.0f} s left", err=True)
