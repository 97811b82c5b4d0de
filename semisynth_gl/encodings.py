"""Which encodings a dataset may have: their names, and what comes at the end of a file's name.

What encodes stands in `semisynth_gl.write.encodings`, what decodes in `semisynth_gl.read.encodings`; both have an entry
for each name here. A config chooses among `ImageEncoding`, `DisparityEncoding` and `FlowEncoding`; the others belong to
layouts that leave no choice.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, get_args

from semisynth_gl.errors import InputError

ImageEncoding = Literal["png", "qoi", "jxl"]
DisparityEncoding = Literal["pfm", "png16", "tiff"]
FlowEncoding = Literal["flo", "pfm", "png16"]
LayoutImageEncoding = Literal["jpg"]
LayoutDisparityEncoding = Literal["png16-32"]
IMAGE_ENCODINGS: tuple[ImageEncoding, ...] = get_args(ImageEncoding)
DISPARITY_ENCODINGS: tuple[DisparityEncoding, ...] = get_args(DisparityEncoding)
FLOW_ENCODINGS: tuple[FlowEncoding, ...] = get_args(FlowEncoding)

_SUFFIXES = {"png16": ".png", "png16-32": ".png"}
# imagecodecs is an extra: its wheel holds every codec there is, 26 MB.
_CODECS = "imagecodecs"
_NEED_CODECS = frozenset({"qoi", "jxl"})


@dataclass(frozen=True, slots=True)
class Encodings:
    """How a dataset's files are encoded; masks and ids are PNG, depth and change of disparity PFM whatever this says.

    Attributes:
        image: of both images; ``jpg`` alone loses something.
        disparity: of both disparities; ``png16`` counts 1/256 px, ``png16-32`` 1/32 px, and the others do not round.
        flow: of flow to the next and to the previous frame; ``png16`` counts 1/64 px, and the others do not round.
    """

    image: ImageEncoding | LayoutImageEncoding = "png"
    disparity: DisparityEncoding | LayoutDisparityEncoding = "pfm"
    flow: FlowEncoding = "flo"

    @property
    def image_suffix(self) -> str:
        """What names of images end in, with the dot."""
        return _SUFFIXES.get(self.image, f".{self.image}")

    @property
    def disparity_suffix(self) -> str:
        """What names of disparities end in, with the dot."""
        return _SUFFIXES.get(self.disparity, f".{self.disparity}")

    @property
    def flow_suffix(self) -> str:
        """What names of flow end in, with the dot."""
        return _SUFFIXES.get(self.flow, f".{self.flow}")

    @property
    def image_names(self) -> tuple[str, str]:
        """File names of the left and the right image."""
        return f"im0{self.image_suffix}", f"im1{self.image_suffix}"

    @property
    def disparity_names(self) -> tuple[str, str]:
        """File names of the left and the right disparity."""
        return f"disp0GT{self.disparity_suffix}", f"disp1GT{self.disparity_suffix}"

    def check(self) -> None:
        """Check that what they need is installed.

        Raises:
            InputError: where it is not.
        """
        if self.image in _NEED_CODECS:
            codecs(self.image)


def codecs(encoding: str) -> Any:  # noqa: ANN401 - a module
    """Import imagecodecs.

    Args:
        encoding: what it is needed for, for the message.

    Raises:
        InputError: where it is not installed.
    """
    try:
        return import_module(_CODECS)
    except ImportError as error:
        raise InputError(
            f"the encoding {encoding} needs the package imagecodecs, which cannot be imported ({error}): "
            "pip install 'semisynth-gl[codecs]', or choose another with files.image"
        ) from None
