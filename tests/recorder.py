"""A listener for tests. It imports little, since worker processes import it too."""

from semisynth_gl.listener import Listener


class Recorder(Listener):
    """Records messages and stages, counts pairs, and interrupts the run at ``last_pair`` as Ctrl-C does."""

    def __init__(self, last_pair: int | None = None) -> None:
        self.messages: list[str] = []
        self.stages: list[str] = []
        self.pairs = 0
        self._last_pair = last_pair

    def on_message(self, text: str) -> None:
        self.messages.append(text)

    def on_pair(self) -> None:
        self.pairs += 1
        if self.pairs == self._last_pair:
            raise KeyboardInterrupt

    def on_stage(self, stage: str) -> None:
        self.stages.append(stage)
