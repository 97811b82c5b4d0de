"""QOI and JPEG XL, through imagecodecs, which is an extra since its wheel with many more codecs has 26 MB."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.codecs.codec import GREY_PIXEL_BYTES, PHOTOGRAPH_PIXEL_BYTES, Codec, check_image
from semisynth_gl.inputs.errors import InputError, ReadError, how_to_install

_QOI_END = bytes(7) + b"\x01"
# The fastest effort: the next one takes ten times as long for a tenth of the bytes.
_JXL_EFFORT = 1


class ByImagecodecs(Codec[NDArray[np.uint8]]):
    """A format that imagecodecs encodes and decodes in one thread: (H, W, 3) uint8 RGB or, if ``grey``, (H, W) uint8.

    ``function`` is imagecodecs' name for the format, and ``options`` go to its encoder; `Codec` explains the rest.
    """

    def __init__(
        self,
        name: str,
        media_type: str,
        description: str,
        function: str,
        *,
        is_image: bool = True,
        grey: bool = False,
        **options: Any,  # noqa: ANN401 - imagecodecs has no types
    ) -> None:
        self.name = name
        self.is_image = is_image
        self.media_type = media_type
        self.description = description
        self.pixel_bytes = GREY_PIXEL_BYTES if grey else PHOTOGRAPH_PIXEL_BYTES
        self._grey = grey
        self._function = function
        self._options = options

    def check_installed(self) -> None:
        """Raise InputError where imagecodecs is not installed."""
        self._library()

    def encode(self, value: NDArray[np.uint8]) -> bytes:
        """Encode an image."""
        encode = getattr(self._library(), f"{self._function}_encode")
        data: bytes = encode(np.ascontiguousarray(value), **self._options)
        return data

    def decode(self, data: bytes, path: Path) -> NDArray[np.uint8]:
        """Decode an image; see `Codec.decode`."""
        # QOI decoders invent pixels where the end of the file is missing.
        if data[:4] == b"qoif" and not data.endswith(_QOI_END):
            raise ReadError(path, "does not end as a QOI does: cut off, or something follows")
        decode = getattr(self._library(), f"{self._function}_decode")
        try:
            return check_image(np.asarray(decode(data)), path, grey=self._grey)
        except (RuntimeError, ValueError, LookupError) as error:
            raise ReadError(path, f"cannot be decoded: {error}") from None

    def _library(self) -> Any:  # noqa: ANN401 - a module without types
        try:
            return import_module("imagecodecs")
        except ImportError as error:
            raise InputError(
                f"the encoding {self.name} needs the package imagecodecs, which cannot be imported ({error}): "
                f"{how_to_install('codecs')}; or choose another with files.image"
            ) from None


QOI = ByImagecodecs("qoi", "https://qoiformat.org/qoi-specification.pdf", "QOI, 8-bit RGB, lossless", "qoi")
JXL, JXL_GREY = (
    ByImagecodecs(
        "jxl",
        "image/jxl",
        f"JPEG XL, 8-bit {'grey' if grey else 'RGB'}, lossless",
        "jpegxl",
        is_image=False,  # Pillow reads it only with a plug-in
        grey=grey,
        lossless=True,
        effort=_JXL_EFFORT,
        numthreads=1,
    )
    for grey in (False, True)
)
