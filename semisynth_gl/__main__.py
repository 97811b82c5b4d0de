"""``python -m semisynth_gl`` is the same as ``semisynth-gl``."""


def main() -> None:
    """Load the program and run it; the process ends with its exit code."""
    # Some packages swallow every exception while they are imported, and Ctrl-C with it. So Ctrl-C ends the process
    # itself while no command runs. `signal` would load other modules first; the interpreter has loaded `_signal`.
    import _signal  # type: ignore[import-not-found]  # noqa: PLC0415 - see above; typeshed leaves it out

    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    from semisynth_gl import cli  # noqa: PLC0415 - see above

    cli.main()


if __name__ == "__main__":
    main()
