"""Where shaders/, configs/ and assets/ are: inside an installed package, or beside it in a checkout."""

from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path


def data_root(name: str) -> Traversable:
    """Return the folder "shaders", "configs" or "assets"; raises FileNotFoundError if neither place has it."""
    installed = files("semisynth_gl") / name
    if installed.is_dir():
        return installed
    checkout = Path(__file__).resolve().parents[2]
    if (checkout / "pyproject.toml").is_file() and (checkout / name).is_dir():
        return checkout / name
    raise FileNotFoundError(f"no {name}/ in {installed} or {checkout}: the installation is incomplete, reinstall it")
