"""``python -m semisynth_gl`` is the same as ``semisynth-gl``."""

from semisynth_gl.cli import main

if __name__ == "__main__":
    main()
