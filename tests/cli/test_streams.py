"""What the program does where nobody reads it, and how errors of the process become one line and an exit code."""

import os
import shlex
import subprocess
import sys

import click
import pytest

from semisynth_gl import cli


def in_shell(redirection):
    """Run a command that prints a result in bash, with 9 as a pipe that nobody reads."""
    command = shlex.join([sys.executable, "-m", "semisynth_gl", "configs"])
    read, write = os.pipe()
    os.close(read)
    try:
        shell = ["bash", "-c", f"{command} {redirection.replace('9', str(write))}"]
        return subprocess.run(shell, capture_output=True, text=True, check=False, timeout=60, pass_fds=[write])
    finally:
        os.close(write)


@pytest.mark.parametrize(
    ("redirection", "code", "said"),
    [
        ("", 0, ""),
        (">/dev/full", 1, "Error: standard output: No space left on device: not all was printed.\n"),
        (">&9", 1, ""),  # as other programs in a pipe
        (">/dev/full 2>/dev/full", 1, ""),
    ],
)
def test_a_result_that_cannot_be_printed_is_a_fault(redirection, code, said):
    done = in_shell(redirection)
    assert (done.returncode, done.stderr) == (code, said)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "the memory is full"),
        (OSError(28, "No space left on device", "x.png"), "x.png: No space left on device"),
        (KeyboardInterrupt(), "Stopped."),
        (click.UsageError("no such option"), "no such option"),
    ],
)
def test_errors_of_the_process_are_one_line(monkeypatch, capsys, error, said):
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(cli.semisynth_gl, "main", fail)
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    captured = capsys.readouterr()
    assert stopped.value.code == 2
    assert captured.out == ""
    assert said in captured.err
    assert len(captured.err.splitlines()) == 1
