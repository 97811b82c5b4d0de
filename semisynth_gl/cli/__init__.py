"""The command line: options in, messages and exit codes out."""

import errno
import logging
import signal
import sys
from importlib import import_module
from typing import NoReturn

import click

from semisynth_gl.inputs.errors import SemisynthError

# Exit code of wrong input, and of a run that was stopped or has filled the disk.
_REFUSED = 2
_STAYS = "Complete files and shards stay on disk; the same command continues."

_COMMANDS = ("bench", "calibrate", "configs", "doctor", "evaluate", "generate", "preview", "report", "verify")


class _LazyGroup(click.Group):
    """Loads only the command that is run."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - click's signature
        if cmd_name not in _COMMANDS:
            return None
        command: click.Command = getattr(import_module(f"semisynth_gl.cli.{cmd_name}"), cmd_name)
        return command


@click.group(
    cls=_LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 success; 1 the command found faults; 2 the input was wrong, or the run could not go on.",
)
@click.version_option(package_name="semisynth-gl")
def semisynth_gl() -> None:
    """Make stereo training pairs with exact disparity from ordinary photographs."""


def main() -> NoReturn:
    """Run the command line and exit."""
    # The library logs a message before work that takes seconds.
    logging.basicConfig(format="%(message)s", force=True)
    logging.getLogger("semisynth_gl").setLevel(logging.INFO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # from a scheduler: the same as Ctrl-C
    sys.exit(_run())


def _run() -> int:
    """Run the command line; return its exit code."""
    try:
        return semisynth_gl.main(standalone_mode=False) or 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):  # click turns the second into the first
        click.echo(f"Stopped. {_STAYS}", err=True)
        return _REFUSED
    except MemoryError:
        text = "the memory is full. Use fewer --workers, smaller images or patches, or fewer models and particles."
    except SemisynthError as error:
        text = str(error)
    except OSError as error:
        file = f"{error.filename}: " if error.filename else ""
        full = error.errno == errno.ENOSPC
        advice = f" Free some space, or choose another folder with --out. {_STAYS}" if full else ""
        text = f"{file}{error.strerror or error}.{advice}"
    click.echo(f"Error: {text}", err=True)
    return _REFUSED
