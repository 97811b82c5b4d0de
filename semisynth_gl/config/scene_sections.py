"""The sections about the content of scenes; a recipe may change their keys."""

from typing import Annotated, Literal

from pydantic import Field

from semisynth_gl.config.fields import (
    FROM_LIST,
    SMALLEST,
    ZERO,
    ConfigError,
    ConfigSection,
    NotNegative,
    NotNegativeRange,
    PathText,
    PluginName,
    PositiveRange,
    Range,
    RangeField,
    Share,
    within,
)

_MOST_PARTICLES = 100_000
# Maximum number of texels of an atlas: 8.6 GB at 4 bytes per texel.
_MOST_TEXELS = 1 << 31

_Paths = Annotated[tuple[PathText, ...], FROM_LIST]
_Scale = Annotated[float, Field(ge=1, le=1024)]


class BackgroundSection(ConfigSection):
    """The background, which fills the view behind all objects."""

    cuboid: NotNegative = 1.0
    """weight of empty rooms"""
    plane: NotNegative = 0.0
    """weight of empty outdoor scenes"""
    room: NotNegative = 0.0
    """weight of furnished rooms"""
    street: NotNegative = 0.0
    """weight of streets"""
    # `Config` checks: unless disparities are signed, this and all other disparities must be above 0.
    wall_disparity_px: RangeField | None = None
    """disparity of the far wall at the image centre; by default ``disparity.min_px``"""
    wall_turn_deg: Annotated[float, Field(ge=0, le=40)] = 15.0
    """maximum rotation of an empty room about each axis; furnished rooms rotate sideways by up to twice this"""
    plane_disparity_px: RangeField = Range(0.2, 1.0)
    """disparity of the far plane or backdrop; under a sky, of the far end of the ground"""
    sky: Share = 0.0
    """share of outdoor scenes with an infinitely distant backdrop"""

    def _check_rules(self) -> None:
        if self.cuboid + self.plane + self.room + self.street == 0:
            keys = "cuboid", "plane", "room", "street"
            raise ConfigError("expected a weight above 0 for cuboid, plane, room or street", keys)


class RoomSection(ConfigSection):
    """Furnished rooms. If the far wall is nearer than 2.5 m or beyond 9 m, the room is scaled with its contents."""

    camera_height_m: PositiveRange = Range(0.9, 1.7)
    """height of the camera above the floor"""
    floor_row: PositiveRange = Range(0.4, 1.05)
    """row where floor and far wall meet, as a share of the image's height"""
    roll_deg: Annotated[float, Field(ge=0, le=20)] = 1.5
    """standard deviation of the camera's roll"""
    furniture: Annotated[RangeField, within(0, 200)] = Range(4.0, 10.0)
    """number of objects on the floor"""
    small: Annotated[RangeField, within(0, 1000)] = Range(6.0, 24.0)
    """number of small objects on furniture and floor"""
    pictures: Annotated[RangeField, within(0, 200)] = Range(1.0, 6.0)
    """number of pictures and other objects on walls"""
    doorway: Share = 0.2
    """share of walls with a doorway into a second room"""
    niche: Share = 0.2
    """share of walls with a niche"""
    pillars: Annotated[RangeField, within(0, 50)] = Range(0.0, 1.0)
    """number of pillars"""
    rug: Share = 0.4
    """share of rooms with a rug"""
    curtain: Share = 0.4
    """share of rooms with a curtain"""


class StreetSection(ConfigSection):
    """A road, objects along it, and a backdrop. If the backdrop is nearer than 25 m, the street is scaled down."""

    camera_height_m: PositiveRange = Range(1.2, 2.0)
    """height of the camera above the ground"""
    yaw_deg: Annotated[float, Field(ge=0, le=60)] = 6.0
    """standard deviation of the angle between view and road"""
    tilt_deg: Annotated[float, Field(ge=0, le=20)] = 1.5
    """standard deviation of the camera's pitch and roll"""
    road_width_m: PositiveRange = Range(5.0, 12.0)
    """width of the road"""
    pavement: Share = 0.7
    """share of roadsides with a pavement"""
    houses: Share = 0.5
    """share of plots with a house"""
    fences: Share = 0.25
    """share of plots with a fence"""
    vehicles: Annotated[RangeField, within(0, 200)] = Range(1.0, 9.0)
    """number of cars and bicycles"""
    tall: Annotated[RangeField, within(0, 200)] = Range(2.0, 12.0)
    """number of trees, lamps, signs and scaffolds"""
    low: Annotated[RangeField, within(0, 500)] = Range(2.0, 14.0)
    """number of people, animals, benches and bins"""


class StructuresSection(ConfigSection):
    """Large objects at rest between the background and the particles."""

    ground: Share = 0.0
    """share of scenes with a ground plane"""
    ground_height_m: PositiveRange = Range(1.2, 2.0)
    """height of the camera above the ground"""
    ground_disparity_px: RangeField | None = None
    """disparity of level ground at the lower border, instead of ``ground_height_m``"""
    ground_tilt_deg: Annotated[float, Field(ge=0, le=30)] = 2.0
    """maximum roll and pitch of the ground"""
    panels: Annotated[RangeField, within(0, 1000)] = ZERO
    """number of free-standing slanted rectangles"""
    panel_disparity_px: RangeField | None = None
    """disparity of a panel's middle; by default from the farther half of the range"""
    panel_size_px: PositiveRange = Range(200.0, 800.0)
    """width and height of a panel that faces the camera"""
    panel_slant_deg: Annotated[RangeField, within(0, 89.999)] = Range(0.0, 75.0)
    """angle between a panel's normal and the viewing direction"""
    panel_curved: Share = 0.5
    """share of panels bent into a third of a cylinder"""


class ParticleLayerSection(ConfigSection):
    """A depth layer of particles."""

    disparity_px: RangeField | None = None
    """disparities of its particles; by default, those from the 10 % to the 90 % quantile of ``disparity.target``"""
    count: Annotated[RangeField, within(0, _MOST_PARTICLES)]
    """number of its particles at any time, in view or just beside the view"""
    size_px: PositiveRange | None = None
    """diameters of its particles in the image; by default, the sizes in the section ``particles``"""


class ParticlesSection(ConfigSection):
    """The particles: models that fall or float in front of the background."""

    layers: Annotated[tuple[ParticleLayerSection, ...], FROM_LIST] | None = None
    """depth layers, as in ``clutter``; by default solved from ``disparity.target``"""
    clutter: Annotated[tuple[ParticleLayerSection, ...], FROM_LIST] = ()
    """further depth layers: a list of ``{disparity_px, count, size_px}``, all ranges"""
    density: Literal["sparse", "default", "dense"] = "default"
    """number in view; ``sparse``: a third as many models, but larger; ``dense``: three times as many, but smaller"""
    size_px: PositiveRange = Range(40.0, 300.0)
    """diameter of a model, log-uniform"""
    size_m: PositiveRange | None = None
    """diameter of a model, instead of ``size_px``"""
    stretch: PositiveRange = Range(0.5, 1.0)
    """scale along each axis, relative to the largest"""
    thinness: Annotated[RangeField, within(SMALLEST, 1)] = Range(1.0, 1.0)
    """additional scale along one axis, log-uniform; 0.05 makes sheets"""
    fall_m_s: PositiveRange = Range(0.5, 2.0)
    """speed downwards"""
    drift: NotNegativeRange = Range(0.0, 0.3)
    """horizontal speed over ``fall_m_s``"""
    spin_deg_s: NotNegativeRange = Range(0.0, 180.0)
    """angular speed about a random axis"""
    resting: Share = 0.0
    """share of the particles that rest, if a surface can carry them"""
    most: Annotated[int, Field(ge=1, le=_MOST_PARTICLES)] = 2000
    """maximum number in a scene; if the target needs more, particles become larger instead"""

    def _check_rules(self) -> None:
        if self.layers is not None and self.density != "default":
            text = "give either density or layers, not both: each layer states its own count"
            raise ConfigError(text, ("density", "layers"))


class ModelsSection(ConfigSection):
    """The models of the particles."""

    simple: NotNegative = 1.0
    """weight of the simple family (cube, sphere, torus, ...)"""
    complex: NotNegative = 1.0
    """weight of the complex family (chair, mug, plant, ...)"""
    user: NotNegative = 1.0
    """weight of the models in ``folders``; if there are fewer than 25, reduced in proportion"""
    kinds: dict[str, NotNegative] = Field(default_factory=dict)
    """weights of kinds within their family; by default 1"""
    folders: _Paths = ()
    """folders of model files"""
    variants: Annotated[int, Field(ge=1, le=100)] = 3
    """models per kind and per plug-in's family"""
    families: dict[PluginName, NotNegative] = Field(default_factory=dict)
    """weights of plug-ins' families"""

    def _check_rules(self) -> None:
        if self.simple + self.complex + self.user + sum(self.families.values()) == 0:
            text = "expected a weight above 0 for simple, complex or user, or in families"
            raise ConfigError(text, ("simple", "complex", "user", "families"))


class TexturesSection(ConfigSection):
    """The patches, and how models show them."""

    source: PluginName = "builtin"
    """``images`` (yours), ``builtin`` (painted and scikit-image's photographs), ``photographs``, ``procedural``, or a
    plug-in's name"""
    images: _Paths = ()
    """files, folders and globs of the source ``images``"""
    patch_px: Annotated[int, Field(ge=16, le=8192)] = 256
    """side of a patch in the atlas"""
    scales: Annotated[tuple[_Scale, ...], FROM_LIST, Field(min_length=1)] = (
        1.0,
        2.0,
        4.0,
    )
    """sides of the squares that are cropped out of images, as multiples of ``patch_px``"""
    min_texture: NotNegative = 1.0
    """minimum texture: median of the standard deviations of luminance in each of 8 x 8 cells, 8-bit levels"""
    min_sharpness: NotNegative = 0.3
    """minimum sharpness: contrast of the finest octave over that of the third octave"""
    min_difference: Share = 0.04
    """minimum difference of two patches: 1 - correlation of their gradients; 0 keeps all"""
    max_patches: Annotated[int, Field(ge=1, le=2048)] = 512
    """maximum number of patches"""
    large_px: Annotated[int, Field(ge=0, le=4096)] = 0
    """side of patches for walls and other large surfaces; 0 for none"""
    texels_per_pixel: PositiveRange = Range(0.8, 1.5)
    """texels of a patch per pixel of the image"""
    anisotropy: Annotated[int, Field(ge=1, le=16)] = 1
    """maximum number of texture samples per pixel at a grazing angle; 1 blurs"""
    large_anisotropy: Annotated[int, Field(ge=1, le=16)] = 4
    """``anisotropy`` for large patches"""
    wrap: Literal["mirror", "repeat"] = "mirror"
    """continuation beyond a patch's border: ``mirror`` or ``repeat``"""
    sequence: bool = False
    """treat a folder's images as successive frames"""

    def _check_rules(self) -> None:
        most = _MOST_TEXELS // self.patch_px**2
        if self.max_patches > most:
            text = f"expected max_patches of at most {most} with a patch_px of {self.patch_px}, got {self.max_patches}"
            raise ConfigError(f"{text}: the atlas would exceed 8.6 GB", ("max_patches", "patch_px"))
