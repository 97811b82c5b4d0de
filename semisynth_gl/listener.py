"""What a long function reports while it runs, and the caller's wish that it stops."""

from dataclasses import dataclass

from semisynth_gl.seeds.splits import SplitName


@dataclass(frozen=True, slots=True)
class FinishedPair:
    """A pair that a long function is finished with, by its number in its split.

    Attributes:
        redrawn: why each earlier attempt failed its checks; only the first frame of a sequence has these reasons.
        share_beyond: share of the pixels whose disparity the encoding cannot store, of the view with the larger share.
        kept: whether an earlier run wrote the pair.
    """

    split: SplitName
    index: int
    redrawn: tuple[str, ...] = ()
    share_beyond: float = 0.0
    kept: bool = False


class Listener:
    """Hears how a long function gets on. No method does anything: override the methods that matter to you.

    Methods run in the process and thread that called the long function. An exception in a method ends the function.
    """

    _stopping = False

    @property
    def stopping(self) -> bool:
        """Whether the long function should return soon, with what it has."""
        return self._stopping

    def stop(self) -> None:
        """Ask the long function to stop soon; a signal handler may do so at any time."""
        self._stopping = True

    def on_message(self, text: str) -> None:
        """Hear a sentence for the user."""

    def on_renderer(self, name: str) -> None:
        """Hear that a worker has opened a renderer, by the driver's name for it (GL_RENDERER)."""

    def on_total(self, pairs: int) -> None:
        """Hear how many pairs will follow, before the first one."""

    def on_pair(self, pair: FinishedPair) -> None:
        """Hear that a pair is on disk, or measured."""

    def on_stage(self, stage: str) -> None:
        """Hear that a stage of a pair has ended, see `PAIR_STAGES`; only renderers with a listener report stages."""
