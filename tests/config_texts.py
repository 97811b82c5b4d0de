"""Configs as texts of the tests."""

from pathlib import Path
from tempfile import TemporaryDirectory

from semisynth_gl.config import Config, load_config


def parse_config(text: str) -> Config:
    """Return the config of a file that holds a text, which is called lab.yaml in messages."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "lab.yaml"
        path.write_text(text, "utf-8")
        return load_config(path)
