"""The command line: options in, messages and exit codes out."""

import errno
import logging
import sys
from importlib import import_module
from typing import NoReturn

import click

from semisynth_gl.dataset.interrupts import interrupts_end, interrupts_raise
from semisynth_gl.inputs.errors import SemisynthError, did_you_mean, near

# Also the code of a run that was stopped or ran out of disk space; the same command goes on.
_REFUSED = 2

_COMMANDS = (
    *("bench", "calibrate", "configs", "doctor"),
    *("evaluate", "generate", "preview", "report", "verify"),
)


class _LazyGroup(click.Group):
    """Loads only the command that is run."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        return sorted(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - click's signature
        if cmd_name not in _COMMANDS:
            return None
        with interrupts_end():
            command: click.Command = getattr(import_module(f"semisynth_gl.cli.{cmd_name}"), cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; for an unknown name, suggest the command that was probably meant."""
        if args[0] not in _COMMANDS and (meant := near(args[0], _COMMANDS)):
            ctx.fail(f"No such command {args[0]!r}; {did_you_mean(meant)}")
        return super().resolve_command(ctx, args)


@click.group(
    cls=_LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 success; 1 the command found faults; 2 the input was wrong, or the run could not go on.",
)
@click.version_option(package_name="semisynth-gl")
def semisynth_gl() -> None:
    """Make stereo training pairs with exact disparity from ordinary photographs."""


def _lacks_quotes(error: click.UsageError) -> bool:
    """Return whether a command that takes patterns got too many names, as when the shell expands a pattern."""
    patterns = error.ctx is not None and any(param.metavar == "PATH_OR_GLOB" for param in error.ctx.command.params)
    return patterns and "unexpected extra argument" in error.format_message()


class _OnStderr(logging.Handler):
    """Prints the library's log messages, which announce work that takes seconds, to standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        click.echo(self.format(record), err=True)


_ON_STDERR = _OnStderr()


def main() -> NoReturn:
    """Run the command line and exit."""
    try:
        with interrupts_raise():
            code = _run()
    except KeyboardInterrupt:
        code = _refuse("Stopped. Complete files and shards stay on disk.")
    sys.exit(code)


def _run() -> int:
    """Run the command line; return its exit code. Ctrl-C raises KeyboardInterrupt."""
    logger = logging.getLogger("semisynth_gl")
    logger.addHandler(_ON_STDERR)
    logger.setLevel(logging.INFO)
    try:
        return semisynth_gl.main(standalone_mode=False) or 0
    except click.ClickException as error:
        error.show()
        if isinstance(error, click.UsageError) and _lacks_quotes(error):
            click.echo(
                "Put a pattern such as 'photos/*.jpg' into quotes; else the shell expands it to names.", err=True
            )
        return error.exit_code
    except click.Abort:  # what click makes of KeyboardInterrupt
        raise KeyboardInterrupt from None
    except (SemisynthError, MemoryError, RecursionError, UnicodeEncodeError, OSError) as error:
        return _refuse(f"Error: {_explained(error)}")


def _explained(error: Exception) -> str:
    """Return the text that the user reads about an error."""
    match error:
        case MemoryError():
            return "the memory is full. Use fewer --workers, smaller images or patches, or fewer models and particles."
        case RecursionError():
            return "an input is nested deeper than this program can follow."
        case UnicodeEncodeError():
            text = error.object[max(error.start - 40, 0) : error.end + 40]
            return f"{text!r} holds characters that {error.encoding} cannot write: rename the file or folder."
        case OSError():
            place = f"{error.filename}: " if error.filename else ""
            advice = " Free some space, or choose another folder with --out." if error.errno == errno.ENOSPC else ""
            return f"{place}{error.strerror or error}.{advice}"
        case _:
            return str(error)


def _refuse(message: str) -> int:
    """Show a message on standard error; return the exit code of a refused or stopped run."""
    click.echo(message, err=True)
    return _REFUSED
