"""Configs from texts."""

from pathlib import Path
from tempfile import TemporaryDirectory

from semisynth_gl.config import Config, load_config


def parse_config(text: str) -> Config:
    """Load a config from a text; error messages call its file lab.yaml."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "lab.yaml"
        path.write_text(text, "utf-8")
        return load_config(path)
