"""A listener for tests. The module loads little: worker processes of tests load it too."""

from semisynth_gl.listener import Listener


class Recorder(Listener):
    """Keeps what it hears, counts pairs, and ends the run at a pair as Ctrl-C does."""

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
