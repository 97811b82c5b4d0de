"""``python -m semisynth_gl`` is the same as ``semisynth-gl``."""

import signal
from typing import NoReturn


def main() -> NoReturn:
    """Load the program and run it."""
    # Some packages swallow every exception while they are imported, and Ctrl-C with it. So it stops the process itself
    # until all is loaded.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from semisynth_gl import cli  # noqa: PLC0415 - see above
    from semisynth_gl.cli import streams  # noqa: PLC0415 - see above

    streams.guard_streams()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    cli.main()


if __name__ == "__main__":
    main()
