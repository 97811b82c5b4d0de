"""Progress reports of long functions."""


class Listener:
    """Receives the progress of a long function. The ``on_`` methods do nothing: override those that you need.

    Methods run in the process and thread that called the long function. An exception in a method ends the function.
    """

    def on_message(self, text: str) -> None:
        """Receive a sentence for the user."""

    def on_renderer(self, name: str) -> None:
        """Called when a worker has opened a renderer; ``name`` is the driver's name for it (GL_RENDERER)."""

    def on_total(self, pairs: int) -> None:
        """Called before the first pair, with the number of pairs that will follow."""

    def on_pair(self) -> None:
        """Called when a pair is on disk, or has been measured."""

    def on_stage(self, stage: str) -> None:
        """Called when a stage of a pair has ended, see `PAIR_STAGES`; only a renderer with a listener reports them."""
