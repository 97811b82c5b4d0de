"""The time that each pass of a pair takes: by the GPU's own clock or, in software, CPU time."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Literal, get_args

import moderngl

from semisynth_gl.frame.camera import Eye

PassName = Literal["draw", "edges", "samples", "resolve", "masks", "correspondence", "moment", "flow", "read"]
PASSES: tuple[PassName, ...] = get_args(PassName)
"""The passes that a renderer times for each eye; `semisynth_gl.bench.stages` says what they do."""

PassSeconds = dict[tuple[PassName, Eye], float]
"""Seconds of each pass that has run, by pass and eye."""


class PassClock:
    """Times passes from `start` to `stop`; at any other time it does nothing, and asks the driver for nothing.

    With ``queries``, timer queries measure the passes on a GPU without waiting for them. llvmpipe's timer queries are
    unreliable: after a finish they return 0, or the largest number of 32 bits. So without ``queries``, the driver is
        made
    to finish before and after each pass, and the CPU time between is taken.
    """

    def __init__(self, gl: moderngl.Context, *, queries: bool) -> None:
        self.queries = queries
        self._gl = gl
        self._runs = False
        self._seconds: defaultdict[tuple[PassName, Eye], float] = defaultdict(float)
        self._asked: list[tuple[tuple[PassName, Eye], moderngl.Query]] = []
        # Queries are reused, since moderngl frees them only with their context.
        self._answered: list[moderngl.Query] = []

    def start(self) -> None:
        """Time the passes that follow."""
        self._runs = True

    def stop(self) -> PassSeconds:
        """Stop timing; wait until the driver has done all passes since the start, and return their seconds."""
        self._runs = False
        with self._gl:
            for key, query in self._asked:
                self._seconds[key] += query.elapsed / 1e9
                self._answered.append(query)
        seconds = dict(self._seconds)
        self._asked.clear()
        self._seconds.clear()
        return seconds

    def timed(self, name: PassName, eye: Eye) -> AbstractContextManager[None]:
        """Time the drawing in a ``with`` block; such blocks must not be nested."""
        if not self._runs:
            return nullcontext()
        return self._asked_for(name, eye) if self.queries else self._finished(name, eye)

    @contextmanager
    def _asked_for(self, name: PassName, eye: Eye) -> Iterator[None]:
        query = self._answered.pop() if self._answered else self._gl.query(time=True)
        with query:
            yield
        self._asked.append(((name, eye), query))

    @contextmanager
    def _finished(self, name: PassName, eye: Eye) -> Iterator[None]:
        self._gl.finish()
        start = time.process_time()
        yield
        self._gl.finish()
        self._seconds[name, eye] += time.process_time() - start
