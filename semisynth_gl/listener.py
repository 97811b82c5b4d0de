"""Reports of a long function while it runs, and the caller's way to stop it."""

from dataclasses import dataclass

from semisynth_gl.seeds.splits import SplitName


@dataclass(frozen=True, slots=True)
class FinishedPair:
    """A pair that a long function has finished; ``index`` is its number in its split.

    ``redrawn`` says why each earlier attempt failed its checks; only the first frame of a sequence has these reasons.
    ``share_beyond`` is the share of the pixels whose disparity the encoding cannot store, in the view with the larger
    share.
    """

    split: SplitName
    index: int
    redrawn: tuple[str, ...] = ()
    share_beyond: float = 0.0


class Listener:
    """Receives the progress of a long function. The ``on_`` methods do nothing: override those that you need.

    Methods run in the process and thread that called the long function. An exception in a method ends the function.
    """

    stopping = False
    """Whether the long function should return soon, with its results so far."""

    def stop(self) -> None:
        """Ask the long function to stop soon; a signal handler may do so at any time."""
        self.stopping = True

    def on_message(self, text: str) -> None:
        """Receive a sentence for the user."""

    def on_renderer(self, name: str) -> None:
        """Called when a worker has opened a renderer; ``name`` is the driver's name for it (GL_RENDERER)."""

    def on_total(self, pairs: int) -> None:
        """Called before the first pair, with the number of pairs that will follow."""

    def on_pair(self, pair: FinishedPair) -> None:
        """Called when a pair is on disk, or has been measured."""

    def on_stage(self, stage: str) -> None:
        """Called when a stage of a pair has ended, see `PAIR_STAGES`; only renderers with a listener report stages."""
