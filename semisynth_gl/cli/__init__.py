"""The command line: options in, messages and exit codes out."""

import errno
import sys
from typing import NoReturn

import click

from semisynth_gl.cli.bench import bench
from semisynth_gl.cli.doctor import doctor
from semisynth_gl.cli.generate import generate
from semisynth_gl.cli.preview import preview
from semisynth_gl.cli.verify import verify
from semisynth_gl.errors import SemisynthError

# 2 also stands for a run that was stopped or found no room: nothing half-written is left, and it may be started again.
_REFUSED = 2


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 done; 1 something was found on the way; 2 the input was wrong, or the run could not go on.",
)
@click.version_option(package_name="semisynth-gl")
def semisynth_gl() -> None:
    """Make stereo training pairs with exact disparity from ordinary photographs."""


for command in (generate, preview, doctor, verify, bench):
    semisynth_gl.add_command(command)


def main() -> NoReturn:
    """Run the command line and exit."""
    try:
        code = semisynth_gl.main(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (KeyboardInterrupt, click.Abort):
        _fail("Stopped. Whole pairs stay on disk, nothing half-written does.")
    except SemisynthError as error:
        _fail(f"Error: {error}")
    except BrokenPipeError:
        sys.exit(_REFUSED)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        advice = " Free some space, or choose another folder with --out." if error.errno == errno.ENOSPC else ""
        _fail(f"Error: {place}{error.strerror or error}.{advice}")
    sys.exit(code or 0)


def _fail(message: str) -> NoReturn:
    click.echo(message, err=True)
    sys.exit(_REFUSED)
