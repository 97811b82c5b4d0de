"""What the program prints where nobody reads it, and how errors of the process become one line and an exit code."""

import os
import shlex
import subprocess
import sys

import click
import pytest

from semisynth_gl import cli
from semisynth_gl.cli.streams import PrintError

# Commands that print results, or write a file and tell of it, as the program itself does, without the time to load it.
PROGRAM = """
import sys
import click
from semisynth_gl import __main__, cli
from semisynth_gl.cli import streams

class Command:
    def main(self, standalone_mode):
        click.echo("message \\udce9", err=True)
        with open(sys.argv[1], "ab") as file:
            print("from a driver", file=sys.stderr, flush=True)
            file.write(b"%d" % (file.fileno() > 2))
        click.echo("result") if results else streams.say("done \\udce9")
        click.echo("message", err=True)

codes = []
for results in (False, True):
    cli.semisynth_gl = Command()
    try:
        __main__.main()
    except SystemExit as end:
        codes.append(end.code)
with open(sys.argv[1], "a") as file:
    file.write(str(codes))
"""


@pytest.mark.parametrize(
    ("place", "code"),
    [
        ("", 0),
        ("2>/dev/full", 0),
        (">/dev/full", 2),
        (">&9 2>&9", 2),  # a pipe that nobody reads
        ("<&- >&- 2>&-", 0),
    ],
)
def test_a_message_that_is_lost_is_no_failure_and_a_result_is(tmp_path, place, code):
    command = shlex.join([sys.executable, "-c", PROGRAM, str(tmp_path / "file")])
    read, write = os.pipe()
    os.close(read)
    try:
        shell = ["bash", "-c", f"{command} {place.replace('9', str(write))}"]
        done = subprocess.run(shell, capture_output=True, text=True, check=False, timeout=60, pass_fds=[write])
    finally:
        os.close(write)
    # Nothing is said by the interpreter as it ends, either.
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr
    assert (tmp_path / "file").read_text() == f"11[0, {code}]"
    assert ("not all of it was printed" in done.stderr) == (place == ">/dev/full")
    if not place:
        assert r"done \udce9" in done.stdout
        assert r"message \udce9" in done.stderr


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "the memory is full"),
        (UnicodeEncodeError("utf-8", "a\udce9b", 1, 2, "surrogates not allowed"), r"'a\udce9b'"),
        (OSError(28, "No space left on device", "x.png"), "x.png: No space left on device"),
        (PrintError("standard output: No space left on device"), "standard output"),
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
