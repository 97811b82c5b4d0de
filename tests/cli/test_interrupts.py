"""Ctrl-C: one ends a command with a line, or a long run after its current pairs; a second one ends the run at once."""

import signal

import pytest
from processes import assert_refused

from semisynth_gl.dataset.interrupts import interrupts_stop
from semisynth_gl.listener import Listener


def test_an_interrupt_ends_a_command_with_a_line(monkeypatch, program):
    monkeypatch.setattr("semisynth_gl.cli.configs.summaries", lambda: signal.raise_signal(signal.SIGINT))
    assert_refused(program("configs"), "Stopped.")


def test_the_second_interrupt_of_a_long_run_ends_it():
    listener = Listener()
    with interrupts_stop(listener):
        signal.raise_signal(signal.SIGINT)
        assert listener.stopping
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
