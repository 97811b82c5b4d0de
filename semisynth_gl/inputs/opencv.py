"""OpenCV, which only lenses and calibration need."""

from importlib import import_module
from typing import Any

from semisynth_gl.inputs.errors import InputError, how_to_install


def open_opencv(what: str) -> Any:  # noqa: ANN401 - a module without types
    """Import OpenCV for ``what``, with which the message begins; raises InputError if OpenCV is missing."""
    try:
        return import_module("cv2")
    except ImportError as error:
        raise InputError(
            f"{what} needs OpenCV, which cannot be imported ({error}): {how_to_install('opencv')}"
        ) from None
