"""What the program prints where nobody reads it, and how errors of the process become one line and an exit code."""

import os
import shlex
import subprocess
import sys

import click
import pytest

from semisynth_gl import cli
from semisynth_gl.cli.streams import PrintError

# Commands that write a file and tell of it, as the program itself does, without the time to load it.
PROGRAM = """
import sys
import click
from semisynth_gl import __main__, cli
from semisynth_gl.cli import streams

class Command:
    def __init__(self, kind):
        self.kind = kind

    def main(self, standalone_mode):
        click.echo("message \\udce9", err=True)
        with open(sys.argv[1], "ab") as file:
            print("from a driver", file=sys.stderr, flush=True)
            file.write(b"%d" % (file.fileno() > 2))
        if self.kind == "results":
            for number in range(3):
                click.echo(f"result {number} \\udce9")
        else:
            streams.say("done \\udce9")
            streams.say("next")
        click.echo("message", err=True)
        return 1 if self.kind == "findings" else 0

codes = []
for kind in ("files", "findings", "results"):
    cli.semisynth_gl = Command(kind)
    try:
        __main__.main()
    except SystemExit as end:
        codes.append(end.code)
with open(sys.argv[1], "a") as file:
    file.write(str(codes))
"""

# Redirections, where 9 is a pipe that nobody reads; the exit code of a command that prints its results; whether
# standard error says that they are lost.
PLACES = {
    "": (0, False),
    "2>&-": (0, False),
    "2>/dev/full": (0, False),
    "2>&9": (0, False),
    ">/dev/full": (2, True),
    ">/dev/full 2>/dev/full": (2, False),
    ">/dev/full 2>&-": (2, False),
    ">&9": (2, True),
    ">&9 2>&9": (2, False),
    ">&-": (0, False),
    "<&- >&-": (0, False),
    "<&- >&- 2>&-": (0, False),
}


@pytest.mark.parametrize("place", PLACES)
def test_a_message_that_is_lost_is_no_failure_and_a_result_is(tmp_path, place):
    results_code, told = PLACES[place]
    command = shlex.join([sys.executable, "-c", PROGRAM, str(tmp_path / "file")])
    read, write = os.pipe()
    os.close(read)
    try:
        shell = f"exec 9>&{write} {write}>&-; exec {place} 9>&-; {command}".replace("exec  9>&-; ", "")
        arguments = ["bash", "-c", shell]
        done = subprocess.run(arguments, capture_output=True, text=True, check=False, timeout=60, pass_fds=[write])
    finally:
        os.close(write)
    # Nothing is said by the interpreter as it ends, either.
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr
    assert (tmp_path / "file").read_text() == f"111[0, 1, {results_code}]"
    lost = [line for line in done.stderr.splitlines() if line.endswith("not all of it was printed")]
    assert [line.partition(":")[0] for line in lost] == (["note", "note", "Error"] if told else [])
    if not place:
        assert done.stdout.splitlines().count(r"done \udce9") == 2
        assert r"message \udce9" in done.stderr.splitlines()


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (MemoryError(), 2, "Error: the memory is full."),
        (RecursionError("maximum recursion depth exceeded"), 2, "Error: an input is nested deeper than"),
        (UnicodeEncodeError("utf-8", "a\udce9b", 1, 2, "surrogates not allowed"), 2, r"Error: 'a\udce9b' holds"),
        (BrokenPipeError(32, "Broken pipe"), 2, "Error: Broken pipe."),
        (OSError(28, "No space left on device", "x.png"), 2, "Error: x.png: No space left on device. Free some space"),
        (PrintError("standard output: No space left on device"), 2, "Error: standard output: No space left"),
        (KeyboardInterrupt(), 2, "Stopped."),
        (click.UsageError("no such option"), 2, "Error: no such option"),
    ],
)
def test_errors_of_the_process_are_one_line(monkeypatch, capsys, error, code, said):
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(cli.semisynth_gl, "main", fail)
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    captured = capsys.readouterr()
    assert stopped.value.code == code
    assert captured.out == ""
    assert captured.err.startswith(said) or said in captured.err.splitlines()
    assert len(captured.err.splitlines()) == 1
