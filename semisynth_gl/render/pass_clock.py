"""How long each pass of a pair takes: on a GPU by its own clock, in software in CPU time."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Literal, get_args

import moderngl

from semisynth_gl.frame.camera import Eye

PassName = Literal["draw", "edges", "samples", "resolve", "masks", "correspondence", "moment", "flow", "read"]
PASSES: tuple[PassName, ...] = get_args(PassName)
"""What a renderer times, each for both eyes; see `semisynth_gl.bench.stages` for what they do."""

PassSeconds = dict[tuple[PassName, Eye], float]
"""Seconds of each pass that ran."""


class PassClock:
    """Times passes from `start` to `stop`; at any other time it does nothing, and asks the driver for nothing.

    With ``queries``, timer queries tell how long a GPU is at a pass, and no pass waits for them. Those of llvmpipe are
    not to be trusted: where it was made to finish, they say 0, or all that 32 bits hold. So software is made to finish
    before and after each pass, and the CPU time between counts.
    """

    def __init__(self, gl: moderngl.Context, *, queries: bool) -> None:
        self.queries = queries
        self._gl = gl
        self._runs = False
        self._seconds: defaultdict[tuple[PassName, Eye], float] = defaultdict(float)
        self._asked: list[tuple[tuple[PassName, Eye], moderngl.Query]] = []
        # moderngl frees a query with its context alone.
        self._answered: list[moderngl.Query] = []

    def start(self) -> None:
        """Time the passes that follow."""
        self._runs = True

    def stop(self) -> PassSeconds:
        """Time no more; return the seconds of all passes since the start, once the driver has done them."""
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
        """Time what is drawn in the ``with`` block; blocks may not be inside each other."""
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
