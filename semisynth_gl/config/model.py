"""The typed configuration: every key that a YAML file may set, with its default and its limits."""

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    create_model,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from semisynth_gl.codecs import DISPARITY_CODECS, FLOW_CODECS, IMAGE_CODECS, Encodings
from semisynth_gl.config.distributions import TargetSection, UniformTarget, check_target, wanted_histogram
from semisynth_gl.config.fields import (
    FROM_LIST,
    NotNegative,
    NotNegativeRange,
    PathText,
    Positive,
    PositiveRange,
    Range,
    RangeField,
    Section,
    Weight,
    at_least,
    at_most,
    count,
    one_of,
)
from semisynth_gl.config.merge import Document, merged
from semisynth_gl.config.partial import partial_section
from semisynth_gl.config.yaml_values import Key
from semisynth_gl.frame import ANTIALIAS_PATTERN, DEFAULT_OUTPUTS, OUTPUTS, TruthViews
from semisynth_gl.histogram import Histogram
from semisynth_gl.plugins import Group
from semisynth_gl.splits import Split, SplitName

_EDGE_ON_DEG = 90
_ZERO = Range(0.0, 0.0)

_Share = Annotated[float, Field(ge=0, le=1)]
_AtLeastOne = Annotated[float, Field(ge=1, le=1024)]

# What every OpenGL 4.5 driver of today draws, and what fits into the memory of a large machine.
_WIDEST_PX, _MOST_PIXELS = 16_384, 1 << 27
_MOST_PARTICLES = 100_000
_MOST_TEXELS = 1 << 31
_BYTES_PER_TEXEL = 4
# Items of a list, and characters of a name.
_MOST_ITEMS, _LONGEST_NAME, _LONGEST_LICENCE = 1000, 100, 1000
_MOST_RECIPES = 100

TEXTURE_SOURCES = ("images", "builtin", "photographs", "procedural")
"""The program's own sources of patches; other names are plug-ins'."""

MODEL_FAMILIES = ("simple", "complex", "user")
"""The program's own families of models, which have keys of their own for their weights."""


def _check_foreign(name: str) -> str:
    if name in MODEL_FAMILIES:
        raise ValueError(f"expected the name of a plug-in's family, the weight of this one is models.{name}")
    return name


_Side = Annotated[int, count(_WIDEST_PX)]
_Paths = Annotated[tuple[PathText, ...], FROM_LIST, Field(max_length=100_000)]
_PluginName = Annotated[str, Field(min_length=1, max_length=_LONGEST_NAME)]
_FamilyName = Annotated[_PluginName, AfterValidator(_check_foreign)]
_Licence = Annotated[str, Field(max_length=_LONGEST_LICENCE)]
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9-]*$", max_length=_LONGEST_NAME)]


class CameraSection(Section):
    """The rectified pair of cameras. Every range is drawn once per sequence.

    Attributes:
        width_px: image width.
        height_px: image height.
        focal_px: focal length in pixels, instead of ``focal_mm`` and ``sensor_width_mm``.
        focal_mm: focal length in millimetres.
        sensor_width_mm: width of the sensor that the image covers, in millimetres.
        baseline_m: distance between the two cameras.
        cx_left_px: x of the left principal point; by default both points lie evenly about the image centre.
        cx_right_px: x of the right principal point, instead of ``doffs_px``.
        cy_px: y of both principal points; by default the image centre, (height - 1) / 2.
        doffs_px: cx_right - cx_left; by default 0.
        sway_m: amplitude of the rig's sway along each of its axes; by default the rig stands still.
        sway_deg: amplitude of the rig's rotation about each of its axes.
        sway_s: periods of these oscillations.
    """

    width_px: _Side
    height_px: _Side
    focal_px: PositiveRange | None = None
    focal_mm: PositiveRange | None = None
    sensor_width_mm: Positive | None = None
    baseline_m: PositiveRange
    cx_left_px: RangeField | None = None
    cx_right_px: RangeField | None = None
    cy_px: RangeField | None = None
    doffs_px: RangeField | None = None
    sway_m: NotNegativeRange = _ZERO
    sway_deg: NotNegativeRange = _ZERO
    sway_s: PositiveRange = Range(1.0, 3.0)

    @model_validator(mode="after")
    def _not_too_large(self) -> Self:
        if self.width_px * self.height_px > _MOST_PIXELS:
            size = f"{self.width_px} x {self.height_px}"
            raise ValueError(f"expected width_px x height_px of at most {_MOST_PIXELS}, got {size}")
        return self

    @model_validator(mode="after")
    def _one_focal_length(self) -> Self:
        if (self.focal_px is None) == (self.focal_mm is None):
            raise ValueError("give either focal_px, or focal_mm with sensor_width_mm")
        if (self.focal_mm is None) != (self.sensor_width_mm is None):
            raise ValueError("focal_mm and sensor_width_mm go together")
        if self.cx_right_px is not None and self.doffs_px is not None:
            raise ValueError("give either cx_right_px or doffs_px, not both")
        if self.cx_right_px is not None and self.cx_left_px is None:
            raise ValueError("cx_right_px needs cx_left_px beside it")
        return self

    @property
    def mean_doffs_px(self) -> float:
        """Mean difference of the principal points, cx_right - cx_left."""
        if self.doffs_px is not None:
            return self.doffs_px.middle
        if self.cx_left_px is not None and self.cx_right_px is not None:
            return self.cx_right_px.middle - self.cx_left_px.middle
        return 0.0


class DisparitySection(Section):
    """The disparities of a dataset, in pixels.

    Attributes:
        min_px: walls and particles aim for this disparity or more; a far plane may have less.
        max_px: hard limit: no pixel exceeds it, because it sets the near plane.
        target: the wanted distribution over all pixels of a dataset. Its ``form`` is ``uniform``, ``uniform-depth``,
            ``gamma``, ``histogram`` or ``mixture``, or ``file`` with a ``path``, which becomes a ``histogram`` when the
            config is read.
    """

    min_px: Positive
    max_px: Positive
    target: TargetSection = UniformTarget()

    @model_validator(mode="after")
    def _range(self) -> Self:
        if self.min_px >= self.max_px:
            raise ValueError(f"expected min_px < max_px, got {self.min_px:g} and {self.max_px:g}: the range is empty")
        return self


class BackgroundSection(Section):
    """What closes the view: the inside of a cuboid, one far plane, a furnished room, or a street before a backdrop.

    Attributes:
        cuboid: weight of indoor scenes of bare walls.
        plane: weight of outdoor scenes before a bare plane.
        room: weight of furnished rooms; see the section ``room``.
        street: weight of furnished open scenes; see the section ``street``.
        wall_disparity_px: disparity of the back wall of a cuboid or room at the image centre; by default the smallest.
        wall_turn_deg: largest rotation of a cuboid about each axis; rooms turn sideways alone, up to twice as far.
        plane_disparity_px: disparity of the far plane, or of a street's backdrop, close to zero but above it.
    """

    cuboid: Weight = 1.0
    plane: Weight = 0.0
    room: Weight = 0.0
    street: Weight = 0.0
    wall_disparity_px: PositiveRange | None = None
    wall_turn_deg: Annotated[float, Field(ge=0, le=40)] = 15.0
    plane_disparity_px: PositiveRange = Range(0.2, 1.0)

    @model_validator(mode="after")
    def _some_kind(self) -> Self:
        if self.cuboid + self.plane + self.room + self.street == 0:
            raise ValueError("expected a weight above 0 for cuboid, plane, room or street")
        return self


class RoomSection(Section):
    """Rooms, where ``background.room`` asks for them: what they hold, and how the camera looks into them.

    A metre is one where the far wall is 2.5 to 9 m away; nearer and farther rooms are scaled with all they hold.

    Attributes:
        camera_height_m: height of the cameras above the floor.
        floor_row: where the floor meets the far wall, as a share of the image's height from its top; above 1 the
            floor is out of view, unless things at the side show it.
        roll_deg: standard deviation of the camera's roll.
        furniture: number of things that stand on the floor.
        small: number of small things, on furniture and on the floor.
        pictures: number of pictures and other things on the walls.
        doorway: share of the walls with a doorway into a second room.
        niche: share of the walls with a niche in which small things stand.
        pillars: number of pillars.
        rug: share of the rooms with a rug.
        curtain: share of the rooms with a curtain.
    """

    camera_height_m: PositiveRange = Range(0.9, 1.7)
    floor_row: PositiveRange = Range(0.4, 1.05)
    roll_deg: Annotated[float, Field(ge=0, le=20)] = 1.5
    furniture: Annotated[NotNegativeRange, at_most(200)] = Range(4.0, 10.0)
    small: Annotated[NotNegativeRange, at_most(1000)] = Range(6.0, 24.0)
    pictures: Annotated[NotNegativeRange, at_most(200)] = Range(1.0, 6.0)
    doorway: _Share = 0.2
    niche: _Share = 0.2
    pillars: Annotated[NotNegativeRange, at_most(50)] = Range(0.0, 1.0)
    rug: _Share = 0.4
    curtain: _Share = 0.4


class StreetSection(Section):
    """Open scenes, where ``background.street`` asks for them: a road, what stands along it, a far backdrop.

    A metre is one where the backdrop is 25 m away or more; nearer scenes are scaled with all they hold.

    Attributes:
        camera_height_m: height of the cameras above the ground.
        yaw_deg: standard deviation of the angle between view and road.
        tilt_deg: standard deviation of the camera's pitch and roll.
        road_width_m: width of the road.
        pavement: share of the road's sides with a raised pavement.
        houses: share of the plots along the road that hold a house.
        fences: share of the plots that hold a fence; the rest is open.
        vehicles: number of cars and bicycles.
        tall: number of trees, lamps, signs and scaffolds.
        low: number of people, animals, benches, bins and other things.
    """

    camera_height_m: PositiveRange = Range(1.2, 2.0)
    yaw_deg: Annotated[float, Field(ge=0, le=60)] = 6.0
    tilt_deg: Annotated[float, Field(ge=0, le=20)] = 1.5
    road_width_m: PositiveRange = Range(5.0, 12.0)
    pavement: _Share = 0.7
    houses: _Share = 0.5
    fences: _Share = 0.25
    vehicles: Annotated[NotNegativeRange, at_most(200)] = Range(1.0, 9.0)
    tall: Annotated[NotNegativeRange, at_most(200)] = Range(2.0, 12.0)
    low: Annotated[NotNegativeRange, at_most(500)] = Range(2.0, 14.0)


class StructuresSection(Section):
    """Large still things between background and particles. By default there are none: a scene has only what it needs.

    Attributes:
        ground: share of scenes with a ground plane.
        ground_height_m: height of the cameras above the ground.
        ground_disparity_px: disparity of a level ground at the middle of the image's lower border, which says how high
            the cameras of a rig are, instead of ``ground_height_m``.
        ground_tilt_deg: largest roll and pitch of the ground.
        panels: number of free-standing walls in a scene; each is a slanted rectangle.
        panel_disparity_px: disparity of a panel's middle; by default in the farther half of the range.
        panel_size_px: width and height of a panel on the screen, as if it faced the camera.
        panel_slant_deg: angle between a panel's normal and the viewing direction, to any side.
        panel_curved: share of the panels that are bent, as a third of a cylinder.
    """

    ground: _Share = 0.0
    ground_height_m: PositiveRange = Range(1.2, 2.0)
    ground_disparity_px: PositiveRange | None = None
    ground_tilt_deg: Annotated[float, Field(ge=0, le=30)] = 2.0
    panels: Annotated[NotNegativeRange, at_most(1000)] = _ZERO
    panel_disparity_px: PositiveRange | None = None
    panel_size_px: PositiveRange = Range(200.0, 800.0)
    panel_slant_deg: NotNegativeRange = Range(0.0, 75.0)
    panel_curved: _Share = 0.5

    @model_validator(mode="after")
    def _not_edge_on(self) -> Self:
        if self.panel_slant_deg.high >= _EDGE_ON_DEG:
            raise ValueError(f"panel_slant_deg: expected less than {_EDGE_ON_DEG}, got {self.panel_slant_deg.high:g}")
        return self

    @model_validator(mode="after")
    def _one_height(self) -> Self:
        default = type(self).model_fields["ground_height_m"].default
        if self.ground_disparity_px is not None and self.ground_height_m != default:
            raise ValueError("give either ground_height_m or ground_disparity_px, not both")
        return self

    @model_serializer(mode="wrap")
    def _without_no_disparity(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # The values, and the digest, of a config without this key are those that it had before there was the key.
        values = serialise(self)
        return {key: value for key, value in values.items() if key != "ground_disparity_px" or value is not None}


class DepthLayerSection(Section):
    """One depth layer of particles.

    Attributes:
        disparity_px: disparities of its particles; by default the middle four fifths of ``disparity.target``.
        count: number of its particles at any time, inside the view and just beside it.
        size_px: diameters of its particles on the screen; by default the sizes of all particles.
    """

    disparity_px: PositiveRange | None = None
    count: Annotated[NotNegativeRange, at_most(_MOST_PARTICLES)]
    size_px: PositiveRange | None = None


class ParticlesSection(Section):
    """The falling models.

    Attributes:
        layers: depth layers with their numbers of particles; by default they are solved from ``disparity.target``.
        clutter: depth layers beside the solved layers, such as many small things far away.
        density: number of objects that share the area of the target. ``default`` keeps the sizes, ``sparse`` has a
            third as many objects, which are larger, ``dense`` has three times as many, which are smaller, and a number
            is the mean number of objects in the left view; of a range, each sequence has a number of its own.
        size_px: diameter of a model's bounding sphere on the screen, drawn uniformly in its logarithm.
        size_m: diameter of a model's bounding sphere in metres, instead of ``size_px``; a far model is smaller on the
            screen.
        stretch: scale along each of a model's own axes relative to the largest scale.
        thinness: a further scale along one axis, drawn uniformly in its logarithm; 0.05 makes a sheet.
        fall_m_s: speed downwards.
        drift: speed in a random horizontal direction, relative to the speed downwards.
        spin_deg_s: angular speed about a random axis.
        most: upper limit of the number of particles in a scene.
    """

    layers: Annotated[tuple[DepthLayerSection, ...], FROM_LIST, Field(max_length=_MOST_ITEMS)] | None = None
    clutter: Annotated[tuple[DepthLayerSection, ...], FROM_LIST, Field(max_length=_MOST_ITEMS)] = ()
    density: Literal["sparse", "default", "dense"] | Annotated[PositiveRange, at_most(_MOST_PARTICLES)] = "default"
    size_px: PositiveRange = Range(40.0, 300.0)
    size_m: PositiveRange | None = None
    stretch: PositiveRange = Range(0.5, 1.0)
    thinness: PositiveRange = Range(1.0, 1.0)
    fall_m_s: PositiveRange = Range(0.5, 2.0)
    drift: NotNegativeRange = Range(0.0, 0.3)
    spin_deg_s: NotNegativeRange = Range(0.0, 180.0)
    most: Annotated[int, count(_MOST_PARTICLES)] = 2000

    @model_validator(mode="after")
    def _one_answer(self) -> Self:
        if self.layers is not None and self.density != "default":
            raise ValueError("density shares out what the target asks for; with layers, their counts say how many")
        if self.thinness.high > 1:
            raise ValueError(f"thinness makes models thinner: expected at most 1, got {self.thinness.high:g}")
        return self


class ModelsSection(Section):
    """The models of the particles.

    Attributes:
        simple: weight of the simple family (cube, sphere, torus, ...).
        complex: weight of the complex family (chair, mug, plant, ...).
        user: weight of the models in ``folders``, in full where there are 25 of them or more, else in proportion.
        kinds: weights of kinds within their family, by name. A kind without a weight has 1, and 0 leaves a kind out.
        folders: folders of model files; trimesh reads the files.
        variants: number of models of each kind and of each of ``families``; each variant has its own proportions.
        families: weights of families of models that plug-ins have, by the plug-in's name.
    """

    simple: Weight = 1.0
    complex: Weight = 1.0
    user: Weight = 1.0
    kinds: Annotated[dict[str, Weight], Field(max_length=_MOST_ITEMS)] = Field(default_factory=dict)
    folders: _Paths = ()
    variants: Annotated[int, count(100)] = 3
    # Left out of the values where there are none: those of a dataset without plug-ins are the same as ever.
    families: Annotated[
        dict[_FamilyName, Weight], Field(max_length=_MOST_ITEMS, exclude_if=lambda families: not families)
    ] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _some_family(self) -> Self:
        if self.simple + self.complex + self.user + sum(self.families.values()) == 0:
            raise ValueError("expected a weight above 0 for simple, complex or user, or in families")
        return self


class TexturesSection(Section):
    """The patches: their source, their selection and their mapping onto the models.

    Attributes:
        source: ``images`` (the user's), ``builtin`` (pictures that are drawn, and the photographs in scikit-image),
            ``photographs`` (those alone), ``procedural``, or the name of a plug-in.
        images: files, folders and globs of the source ``images``.
        patch_px: side of a patch in the atlas.
        scales: sides of the squares cut from an image, in units of ``patch_px``.
        min_texture: smallest texture measure (`semisynth_gl.textures.crops.texture_measure`). Crops below it are flat
            and left out, but for ``flat_share``.
        min_sharpness: smallest sharpness measure (`semisynth_gl.textures.crops.sharpness_measure`). Crops below it are
            blurred and left out.
        min_difference: smallest difference of two crops (`semisynth_gl.textures.crops.fingerprint`). A crop that
            differs less from another crop is left out; 0 keeps all crops.
        flat_share: share of the surfaces that wear flat patches: flat crops, or others with their contrast lowered.
        max_patches: largest number of patches.
        large_px: side of large patches, the largest square of an image each, which walls, grounds and other large
            surfaces wear; 0 for none.
        texels_per_pixel: mapping scale: 1 shows a patch at its own resolution, above 1 smaller, below 1 blown up.
        anisotropy: largest number of samples of a patch for a pixel at a grazing angle; 1 blurs there.
        large_anisotropy: the same of large patches.
        wrap: continuation of a patch beyond its border: its mirror image, or the patch again.
        sequence: take the images of a folder as successive frames, which an instance shows in turn.
    """

    source: _PluginName = "builtin"
    images: _Paths = ()
    patch_px: Annotated[int, Field(ge=16, le=8192)] = 256
    scales: Annotated[tuple[_AtLeastOne, ...], FROM_LIST, Field(min_length=1, max_length=100)] = (1.0, 2.0, 4.0)
    min_texture: NotNegative = 4.0
    min_sharpness: NotNegative = 0.3
    min_difference: _Share = 0.04
    flat_share: Annotated[float, Field(ge=0, lt=1)] = 0.0
    max_patches: Annotated[int, Field(ge=1, le=2048)] = 512
    large_px: Annotated[int, Field(ge=0, le=4096)] = 0
    texels_per_pixel: PositiveRange = Range(0.8, 1.5)
    anisotropy: Annotated[int, Field(ge=1, le=16)] = 1
    large_anisotropy: Annotated[int, Field(ge=1, le=16)] = 4
    wrap: Literal["mirror", "repeat"] = "mirror"
    sequence: bool = False

    @model_validator(mode="after")
    def _flat_patches_are_possible(self) -> Self:
        if self.flat_share > 0 and not (self.min_texture > 0 and self.max_patches > 1):
            raise ValueError(
                f"flat_share is {self.flat_share:g}: expected a min_texture above 0, below which patches are flat, and "
                "max_patches of at least 2"
            )
        return self

    @model_validator(mode="after")
    def _atlas_fits_into_memory(self) -> Self:
        most = _MOST_TEXELS // self.patch_px**2
        if self.max_patches > most:
            size = self.max_patches * self.patch_px**2 * _BYTES_PER_TEXEL / 1e9
            raise ValueError(
                f"{self.max_patches} patches of {self.patch_px} x {self.patch_px} pixels would take {size:.0f} GB: "
                f"expected max_patches of at most {most}, or a smaller patch_px"
            )
        return self


class ImperfectionsSection(Section):
    """Imperfections of a real rig's images, drawn per pair and eye, and recorded. By default there are none.

    Attributes:
        exposure_stops: the image is multiplied by 2 to this power.
        gamma: exponent of the tone curve.
        noise: standard deviation of the sensor's noise, 8-bit levels.
        blur_px: standard deviation of the lens blur.
    """

    exposure_stops: Annotated[RangeField, at_most(20), at_least(-20)] = _ZERO
    gamma: Annotated[PositiveRange, at_most(100)] = Range(1.0, 1.0)
    noise: Annotated[NotNegativeRange, at_most(255)] = _ZERO
    blur_px: Annotated[NotNegativeRange, at_most(1000)] = _ZERO

    @model_validator(mode="before")
    @classmethod
    def _no_vertical_disparity(cls, values: Any) -> Any:  # noqa: ANN401 - whatever the YAML holds
        for key in ("vertical_offset_px", "roll_deg"):
            if isinstance(values, dict) and key in values:
                fault = "would need the vertical disparity as truth, which is not made"
                raise ValueError(f"{key} {fault}: leave it out, and rectify")
        return values

    def none(self) -> bool:
        """Return whether the section leaves the images as they are rendered."""
        return self == ImperfectionsSection()


class ChecksSection(Section):
    """Conditions on a rendered pair. A pair that fails one is drawn again from the next sub-seed.

    The first frame of a sequence is checked, and all its frames are drawn again together.

    Attributes:
        min_brightness: smallest mean of the darker image, 8-bit levels.
        min_texture: smallest texture measure of the flatter image, 8-bit levels.
        min_valid: smallest share of pixels with a valid disparity, in each view.
        attempts: number of attempts before a pair is an error.
    """

    min_brightness: Annotated[float, Field(ge=0, le=255)] = 8.0
    min_texture: NotNegative = 1.0
    min_valid: _Share = 0.5
    attempts: Annotated[int, count(10_000)] = 10


class SequenceSection(Section):
    """Pairs i n to (i + 1) n - 1 are the frames of one moving scene.

    Attributes:
        length: frames per sequence, n.
        frame_s: time between two frames.
    """

    length: Annotated[int, count(100_000)] = 1
    frame_s: Positive = 0.04


class FilesSection(Section):
    """The encodings of files. Masks and ids are PNG; depth, normals and change of disparity are PFM in any case.

    Attributes:
        image: ``png``, ``qoi`` or ``jxl``, all lossless; the latter two need the extra ``codecs``.
        disparity: ``pfm``; ``tiff``, smaller, lossless too; or ``png16``, KITTI's, which counts 1/256 px and ends at
            256 px.
        flow: ``flo``, Middlebury's; ``pfm``, SceneFlow's, of three channels; or ``png16``, KITTI's, which counts 1/64
            px and ends at 512 px.
    """

    image: Annotated[str, one_of(IMAGE_CODECS)] = "png"
    disparity: Annotated[str, one_of(DISPARITY_CODECS)] = "pfm"
    flow: Annotated[str, one_of(FLOW_CODECS)] = "flo"

    @property
    def encodings(self) -> Encodings:
        """The codecs of these names."""
        return Encodings.from_names(self.image, self.disparity, self.flow)


class SplitsSection(Section):
    """Photographs and models that are held out of training, where a dataset has validation or test pairs.

    Attributes:
        validation: share of the photographs that only validation pairs show, at least one photograph.
        test: share of the photographs that only test pairs show, at least one photograph.
        models: hold out the same shares of each family of models too.
    """

    validation: Annotated[float, Field(gt=0, lt=1)] = 0.1
    test: Annotated[float, Field(gt=0, lt=1)] = 0.1
    models: bool = False

    @model_validator(mode="after")
    def _some_to_train_on(self) -> Self:
        if self.validation + self.test >= 1:
            raise ValueError(f"validation and test take {self.validation + self.test:g} of all: nothing is left")
        return self

    def split(self, name: SplitName, splits: Collection[SplitName]) -> Split:
        """Return a split of a dataset.

        Args:
            name: name of the split.
            splits: names of all splits of the dataset.
        """
        shares: dict[SplitName, float] = {"validation": self.validation, "test": self.test}
        return Split(name, {split: share for split, share in shares.items() if split in splits}, self.models)


class LicencesSection(Section):
    """Licences for index, card and Croissant file; only you know what your photographs and models allow.

    Attributes:
        dataset: licence of the dataset, under the name that the hubs use.
        images: licence of the user's photographs, and of a plug-in's pictures.
        models: licence of the user's models, and of a plug-in's.
    """

    dataset: _Licence = "unknown"
    images: _Licence = "unknown"
    models: _Licence = "unknown"


# The sections that a recipe may change, with the keys that hold for all pairs of a dataset: the size of images, models
# and patches themselves, how the graphics card samples patches, and the limits that truth is stored and checked by.
_OF_RECIPES: Mapping[str, tuple[type[Section], tuple[str, ...]]] = {
    "camera": (CameraSection, ("width_px", "height_px")),
    "disparity": (DisparitySection, ("min_px", "max_px")),
    "background": (BackgroundSection, ()),
    "room": (RoomSection, ()),
    "street": (StreetSection, ()),
    "structures": (StructuresSection, ()),
    "particles": (ParticlesSection, ()),
    "models": (ModelsSection, ("folders", "variants")),
    "textures": (TexturesSection, tuple(key for key in TexturesSection.model_fields if key != "texels_per_pixel")),
}
_partial_sections: dict[str, Any] = {
    name: (partial_section(section, without) | None, None) for name, (section, without) in _OF_RECIPES.items()
}
_Changes = create_model("_Changes", __base__=Section, **_partial_sections)


class RecipeSection(_Changes):
    """A recipe of scenes: keys of sections that take the place of the config's.

    Attributes:
        recipe: name of the recipe; letters, digits and hyphens. By default that of ``extends``.
        extends: name of a plug-in's recipe that the keys go over; its keys become the recipe's when the config is read.
        weight: weight of the recipe; shares of sequences are in proportion to weights.
    """

    recipe: _Name
    extends: _PluginName | None = None
    weight: Weight = 1.0

    @model_serializer(mode="wrap")
    def _given(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in serialise(self).items() if value is not None}

    def changes(self) -> dict[str, Any]:
        """Return the keys that the recipe changes, by their section, in JSON's types."""
        return self.model_dump(mode="json", exclude={"recipe", "extends", "weight"})


@dataclass(frozen=True, slots=True)
class Recipe:
    """A recipe by which the scenes of some sequences are made.

    Attributes:
        name: its name; None where a config has no recipes, so that all sequences are made by the config itself.
        share: its share of the sequences.
        config: the config with the recipe's keys, and without recipes of its own.
    """

    name: str | None
    share: float
    config: "Config"


# Tells a config that it is a recipe of a mix, whose target the mix has to meet and not each recipe.
_WITHIN_MIX = {"within_mix": True}


class Config(Section):
    """All that determines a pair, with a seed and an index. The class of each section documents its keys.

    Attributes:
        name: first part of the name of every sample; letters, digits and hyphens.
        scenes: recipes, of which each sequence takes one, by their weights. Their keys go over the sections above; by
            default all sequences follow these sections.
        outputs: further outputs beside images and disparities: ``visibility``, ``instances``, ``depth``, ``normals``,
            ``flow``, ``flow_backward``, ``disparity_change``.
        truth: views whose disparity and outputs are written: ``both``, or ``left`` alone.
        antialias: antialiasing of colour: ``none``, ``msaa4`` (or another number of samples that the driver offers),
            ``ssaa2`` to ``ssaa8``.
    """

    name: _Name
    camera: CameraSection
    disparity: DisparitySection
    background: BackgroundSection = BackgroundSection()
    room: RoomSection = RoomSection()
    street: StreetSection = StreetSection()
    structures: StructuresSection = StructuresSection()
    particles: ParticlesSection = ParticlesSection()
    models: ModelsSection = ModelsSection()
    textures: TexturesSection = TexturesSection()
    scenes: Annotated[tuple[RecipeSection, ...], FROM_LIST, Field(max_length=_MOST_RECIPES)] = ()
    sequence: SequenceSection = SequenceSection()
    imperfections: ImperfectionsSection = ImperfectionsSection()
    checks: ChecksSection = ChecksSection()
    files: FilesSection = FilesSection()
    splits: SplitsSection = SplitsSection()
    licences: LicencesSection = LicencesSection()
    outputs: Annotated[tuple[Annotated[str, one_of(OUTPUTS)], ...], FROM_LIST, Field(max_length=100)] = DEFAULT_OUTPUTS
    truth: TruthViews = "both"
    antialias: Annotated[str, Field(pattern=ANTIALIAS_PATTERN)] = "none"

    @model_validator(mode="after")
    def _nothing_nearer_than_allowed(self) -> Self:
        nearest = {
            "structures.ground_disparity_px": self.structures.ground_disparity_px,
            "structures.panel_disparity_px": self.structures.panel_disparity_px,
            "background.wall_disparity_px": self.background.wall_disparity_px
            if self.background.cuboid or self.background.room
            else None,
            "background.plane_disparity_px": self.background.plane_disparity_px
            if self.background.plane or self.background.street
            else None,
        }
        for name, layers in (("layers", self.particles.layers or ()), ("clutter", self.particles.clutter)):
            nearest |= {f"particles.{name}.{k}": layer.disparity_px for k, layer in enumerate(layers)}
        limit = self.disparity.max_px
        for key, values in nearest.items():
            if values is not None and values.high > limit:
                raise ValueError(f"{key} goes up to {values.high:g} px, but disparity.max_px, the limit, is {limit:g}")
        return self

    @field_validator("scenes")
    @classmethod
    def _recipes_differ_in_name(cls, scenes: tuple[RecipeSection, ...]) -> tuple[RecipeSection, ...]:
        names = [section.recipe for section in scenes]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"expected a name of its own for each recipe, but several are named {name}")
        if scenes and not sum(section.weight for section in scenes) > 0:
            raise ValueError("expected a weight above 0 for at least one recipe")
        return scenes

    @model_validator(mode="after")
    def _recipes_hold(self, info: ValidationInfo) -> Self:
        faults = []
        lowest_px = [] if self.scenes else [self.lowest_px()]
        for number, section in enumerate(self.scenes):
            try:
                config = self._with(section)
            except ValidationError as error:
                for fault in error.errors(include_url=False):
                    reason = PydanticCustomError("recipe", "{reason}", {"reason": fault["msg"]})
                    location = ("scenes", number, *fault["loc"])
                    faults.append(InitErrorDetails(type=reason, loc=location, input=fault["input"]))
            else:
                if section.weight > 0:
                    lowest_px.append(config.lowest_px())
        if faults:
            raise ValidationError.from_exception_data("Config", faults)
        if info.context != _WITHIN_MIX:
            check_target(self.disparity.target, self.disparity.min_px, self.disparity.max_px, min(lowest_px))
        return self

    def lowest_px(self) -> float:
        """Return the smallest disparity that the sections allow scenes to show."""
        background, lowest = self.background, [self.disparity.min_px]
        if background.plane or background.street:
            lowest.append(background.plane_disparity_px.low)
        if (background.cuboid or background.room) and background.wall_disparity_px is not None:
            lowest.append(background.wall_disparity_px.low)
        return min(lowest)

    @model_serializer(mode="wrap")
    def _without_no_scenes(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # A config without recipes has the values, and the digest, that it had before there were any.
        return {key: value for key, value in serialise(self).items() if key != "scenes" or value}

    def recipes(self) -> tuple[Recipe, ...]:
        """Return the recipes of the sequences, at least one; those of weight 0 are left out."""
        total = sum(section.weight for section in self.scenes)
        return tuple(
            Recipe(section.recipe, section.weight / total, self._with(section))
            for section in self.scenes
            if section.weight > 0
        ) or (Recipe(None, 1.0, self),)

    def _with(self, section: RecipeSection) -> Self:
        """Return the config with a recipe's keys over its own."""
        base, changes = self.model_dump(mode="json", exclude={"scenes"}), section.changes()
        has_target = "disparity" in changes
        values = merged(Document(base), Document(changes)).values
        return type(self).model_validate(values, context=None if has_target else _WITHIN_MIX)

    def wanted_histogram(self) -> Histogram:
        """Return the distribution of disparity that ``disparity.target`` asks for.

        A histogram keeps its bins. Every other form gets 24 bins of equal width from ``min_px`` to ``max_px``.

        Raises:
            InputError: where a target uniform in depth reaches beyond infinity.
        """
        section = self.disparity
        return wanted_histogram(section.target, section.min_px, section.max_px, self.camera.mean_doffs_px)

    def used_plugins(self) -> dict[Key, tuple[Group, str]]:
        """Return group and name of each plug-in that the config asks for, by the key that does so."""
        used: dict[Key, tuple[Group, str]] = {}
        if self.textures.source not in TEXTURE_SOURCES:
            used["textures", "source"] = ("textures", self.textures.source)
        base = self.models.families
        families: dict[Key, float] = {("models", "families", name): weight for name, weight in base.items()}
        for number, section in enumerate(self.scenes):
            if section.extends is not None:
                used["scenes", number, "extends"] = ("recipes", section.extends)
            weights = section.changes().get("models", {}).get("families", {})
            families |= {("scenes", number, "models", "families", name): weight for name, weight in weights.items()}
        return used | {key: ("models", str(key[-1])) for key, weight in families.items() if weight > 0}

    def digest(self) -> str:
        """Return the SHA-256 of the config's values, 64 hex digits; equal for equal values in any notation."""
        return digest_of(self.model_dump(mode="json"))


def digest_of(values: Mapping[str, Any]) -> str:
    """Return the SHA-256, 64 hex digits, of the values of a config of any version, in JSON's types."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
