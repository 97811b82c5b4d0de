"""The config in a dataset's index or plan: the keys without which pairs cannot be read or shown, typed."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticKnownError

from semisynth_gl.codecs import Encodings
from semisynth_gl.config.dataset_sections import FilesSection
from semisynth_gl.config.fields import Finite, count
from semisynth_gl.config.model import Config
from semisynth_gl.frame.channels import DEFAULT_OUTPUTS, OUTPUTS, Colour, TruthViews

# More pairs than any dataset has, and few enough for lists and sums of them.
MOST_PAIRS = 10**8

_Count = Annotated[int, count(MOST_PAIRS)]
_Object = dict[str, Any]


class StoredObject(BaseModel):
    """An object in a file about a dataset. Values are not coerced, and unknown keys are ignored."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)


class StoredDocument(StoredObject):
    """A stored object that also keeps all keys of its file, for code that writes it again or hands it on."""

    _values: Mapping[str, Any] = PrivateAttr(default_factory=dict)

    @model_validator(mode="wrap")
    @classmethod
    def _keep_values(cls, values: Any, validate: ModelWrapValidatorHandler[Self]) -> Self:  # noqa: ANN401 - of a file
        document = validate(values)
        document._values = values  # noqa: SLF001 - its own
        return document

    @property
    def values(self) -> Mapping[str, Any]:
        """All values of the object, in JSON's types, in the file's order."""
        return self._values


class _Camera(StoredObject):
    width_px: _Count | None = None
    height_px: _Count | None = None
    colour: Colour = "rgb"


class _Disparity(StoredObject):
    signed: bool = False
    max_px: Finite | None = None

    @field_validator("max_px")
    @classmethod
    def _is_positive(cls, max_px: float | None, info: ValidationInfo) -> float | None:
        if max_px is not None and max_px <= 0 and not info.data.get("signed", True):
            raise PydanticKnownError("greater_than", {"gt": 0})
        return max_px


class _Sequence(StoredObject):
    length: Annotated[int, Field(ge=1, le=MOST_PAIRS)] = 1


class _Files(FilesSection):
    model_config = ConfigDict(extra="ignore")


class _Particles(StoredObject):
    layers: list[_Object] | None = None
    clutter: list[_Object] | None = None


def _known_outputs(outputs: list[str]) -> list[str]:
    return [name for name in OUTPUTS if name in outputs]


class StoredConfig(StoredDocument):
    """The part of a config that readers of a dataset need; `Config` has all keys.

    All keys except the name are optional, since configs of other versions may lack them. Outputs that this version does
    not know are left out. ``particles``, ``textures``, ``lens``, ``projector``, ``imperfections`` and ``checks``
    are only checked to be objects, for code that looks up their keys in `values`.
    """

    name: Annotated[str, *Config.model_fields["name"].metadata]
    outputs: Annotated[list[str], AfterValidator(_known_outputs)] = list(DEFAULT_OUTPUTS)
    truth: TruthViews = "both"
    camera: _Camera = _Camera()
    disparity: _Disparity = _Disparity()
    sequence: _Sequence = _Sequence()
    files: _Files = _Files()
    particles: _Particles | None = None
    textures: _Object | None = None
    lens: _Object | None = None
    projector: _Object | None = None
    imperfections: _Object | None = None
    checks: _Object | None = None

    @property
    def encodings(self) -> Encodings:
        """The codecs that the section ``files`` names, for the config's disparities."""
        files = self.files
        return Encodings.from_names(files.image, files.disparity, files.flow, signed=self.disparity.signed)

    @property
    def size(self) -> tuple[int, int] | None:
        """Height and width of the images, px; None where the config does not state both."""
        height, width = self.camera.height_px, self.camera.width_px
        return None if height is None or width is None else (height, width)
