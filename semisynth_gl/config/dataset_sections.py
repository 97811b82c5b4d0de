"""The sections that are the same for all pairs of a dataset, so that no recipe may change them."""

from collections.abc import Collection, Iterator
from typing import Annotated

from pydantic import Field

from semisynth_gl.codecs import DISPARITY_CODECS, FLOW_CODECS, IMAGE_CODECS
from semisynth_gl.config.fields import ConfigSection, NotNegative, Positive, Rule, Share, one_of
from semisynth_gl.plugins import BUILT_IN
from semisynth_gl.seeds.splits import Split, SplitName

LAYOUTS = BUILT_IN["layouts"]
"""The names of the built-in layouts."""


class ChecksSection(ConfigSection):
    """Conditions on each pair (in a sequence, on its first frame). A scene that fails is sampled again."""

    min_brightness: Annotated[float, Field(ge=0, le=255)] = 8.0
    """minimum mean level of the darker image, 8-bit levels"""
    min_texture: NotNegative = 1.0
    """minimum texture of the flatter image, measured as for ``textures.min_texture``"""
    min_valid: Share = 0.5
    """minimum share of valid disparities in each view"""
    attempts: Annotated[int, Field(ge=1, le=10_000)] = 10
    """number of attempts before the run fails"""


class SequenceSection(ConfigSection):
    """Successive frames of one moving scene."""

    length: Annotated[int, Field(ge=1, le=100_000)] = 1
    """frames per sequence"""
    frame_s: Positive = 0.04
    """time between two frames"""


class FilesSection(ConfigSection):
    """Encodings of the dataset's files."""

    image: Annotated[str, one_of(IMAGE_CODECS)] = "png"
    """``png``"""
    disparity: Annotated[str, one_of(DISPARITY_CODECS)] = "pfm"
    """``pfm``, or KITTI's ``png16`` (up to 256 px; -128 to 128 px where signed)"""
    flow: Annotated[str, one_of(FLOW_CODECS)] = "flo"
    """Middlebury's ``flo``, SceneFlow's ``pfm``, or KITTI's ``png16`` (up to 512 px)"""


class SplitsSection(ConfigSection):
    """How much material only validation pairs or only test pairs show."""

    validation: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """share of the photographs' subjects"""
    test: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """share of the photographs' subjects"""
    models: bool = False
    """split models too, with the same shares"""

    def _rules(self) -> Iterator[Rule]:
        total = self.validation + self.test
        yield total >= 1, f"validation and test add up to {total:g}: expected less than 1", ("validation", "test")

    def split(self, name: SplitName, splits: Collection[SplitName], seed: int) -> Split:
        """Return the split ``name`` of a dataset with this seed; ``splits`` are all splits that the dataset has."""
        shares: dict[SplitName, float] = {"validation": self.validation, "test": self.test}
        return Split(seed, name, {held: share for held, share in shares.items() if held in splits}, self.models)


class LicencesSection(ConfigSection):
    """Licences that the dataset's index and card state."""

    dataset: str = "unknown"
    """licence of the dataset, by the name that hubs use"""
    images: str = "unknown"
    """licence of your photographs and of a plug-in's pictures"""
    models: str = "unknown"
    """licence of your models and of a plug-in's models"""
