"""Progress reports of long functions."""


class Listener:
    """Receives the progress of a long function. Override the methods that you need; these do nothing.

    The caller's process and thread run the methods. An exception in a method ends the long function.
    """

    def on_message(self, text: str) -> None:
        """Receive a sentence for the user."""

    def on_renderer(self, name: str) -> None:
        """Called when a worker has opened a renderer; ``name`` is the driver's name for it (GL_RENDERER)."""

    def on_total(self, pairs: int) -> None:
        """Called before the first pair, with the number of pairs that will follow."""

    def on_pair(self) -> None:
        """Called when a pair is finished: written to disk, rendered for a preview, checked, or measured."""

    def on_stage(self, stage: str) -> None:
        """Called when a stage of `PAIR_STAGES` has ended, if the listener is a `PairRenderer`'s."""
