"""A listener for tests. The module loads little: worker processes of tests load it too."""

from collections.abc import Callable

from semisynth_gl.listener import FinishedPair, Listener


class Recorder(Listener):
    """Keeps what it hears, and asks to stop at the first pair that a function picks."""

    def __init__(self, stops_at: Callable[[FinishedPair], bool] = lambda _: False) -> None:
        self.messages: list[str] = []
        self.pairs: list[FinishedPair] = []
        self.stages: list[str] = []
        self._stops_at = stops_at

    def on_message(self, text: str) -> None:
        self.messages.append(text)

    def on_pair(self, pair: FinishedPair) -> None:
        self.pairs.append(pair)
        if self._stops_at(pair):
            self.stop()

    def on_stage(self, stage: str) -> None:
        self.stages.append(stage)
