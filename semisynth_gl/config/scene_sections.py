"""The sections that say what scenes show; a recipe may change their keys."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from semisynth_gl.config.fields import (
    FROM_LIST,
    ZERO,
    NotNegative,
    NotNegativeRange,
    PathText,
    PluginName,
    PositiveRange,
    Range,
    RangeField,
    Section,
    Share,
    Weight,
    at_most,
    count,
)
from semisynth_gl.plugins import BUILT_IN

_EDGE_ON_DEG = 90

_AtLeastOne = Annotated[float, Field(ge=1, le=1024)]

_MOST_PARTICLES = 100_000
_MOST_TEXELS = 1 << 31
_BYTES_PER_TEXEL = 4
# Largest number of items in a list or mapping.
_MOST_ITEMS = 1000

TEXTURE_SOURCES = BUILT_IN["textures"]
"""The program's own sources of patches; any other name is a plug-in's."""

MODEL_FAMILIES = ("simple", "complex", "user")
"""The program's own families of models; the weight of each is a key of `ModelsSection`."""


def _check_foreign(name: str) -> str:
    if name in MODEL_FAMILIES:
        raise ValueError(f"expected the name of a plug-in's family; the weight of this family is models.{name}")
    return name


_Paths = Annotated[tuple[PathText, ...], FROM_LIST, Field(max_length=100_000)]
_FamilyName = Annotated[PluginName, AfterValidator(_check_foreign)]


class BackgroundSection(Section):
    """The background, which closes the view.

    Attributes:
        cuboid: weight of bare rooms.
        plane: weight of bare outdoor scenes.
        room: weight of furnished rooms.
        street: weight of streets.
        wall_disparity_px: disparity of the back wall at the image centre; by default ``disparity.min_px``.
        wall_turn_deg: largest rotation of a bare room about each axis (furnished rooms turn only sideways, by up to
            twice this angle).
        plane_disparity_px: disparity of the far plane or backdrop; under a sky, disparity at which the ground ends.
        sky: share of outdoor scenes whose plane or backdrop is infinitely far away.
    """

    cuboid: Weight = 1.0
    plane: Weight = 0.0
    room: Weight = 0.0
    street: Weight = 0.0
    # Above 0 where the config's disparities are not signed, as all disparities below: `Config` checks that.
    wall_disparity_px: RangeField | None = None
    wall_turn_deg: Annotated[float, Field(ge=0, le=40)] = 15.0
    plane_disparity_px: RangeField = Range(0.2, 1.0)
    sky: Share = 0.0

    def _faults(self) -> Iterator[str]:
        if self.cuboid + self.plane + self.room + self.street == 0:
            yield "expected a weight above 0 for cuboid, plane, room or street"

    @property
    def shows_sky(self) -> bool:
        """Whether any scene can have a sky."""
        return self.sky > 0 and self.plane + self.street > 0

    def shown_px(self) -> dict[str, Range]:
        """Return the stated disparities of the walls and far planes that scenes can have, by key of this section."""
        wall_px = self.wall_disparity_px if self.cuboid or self.room else None
        plane_px = self.plane_disparity_px if self.plane or self.street else None
        stated = {"wall_disparity_px": wall_px, "plane_disparity_px": plane_px}
        return {key: disparity_px for key, disparity_px in stated.items() if disparity_px is not None}


class RoomSection(Section):
    """Furnished rooms, and the camera in them.

    Lengths are true where the far wall is 2.5 to 9 m away; nearer and farther rooms are scaled with all their contents.

    Attributes:
        camera_height_m: height of the camera above the floor.
        floor_row: row where the floor meets the far wall, as a fraction of the image's height; above 1, the floor may
            be out of view.
        roll_deg: standard deviation of the camera's roll.
        furniture: number of objects on the floor.
        small: number of small objects on furniture and floor.
        pictures: number of pictures and other objects on walls.
        doorway: share of walls with a doorway into a second room.
        niche: share of walls with a niche for small objects.
        pillars: number of pillars.
        rug: share of rooms with a rug.
        curtain: share of rooms with a curtain.
    """

    camera_height_m: PositiveRange = Range(0.9, 1.7)
    floor_row: PositiveRange = Range(0.4, 1.05)
    roll_deg: Annotated[float, Field(ge=0, le=20)] = 1.5
    furniture: Annotated[NotNegativeRange, at_most(200)] = Range(4.0, 10.0)
    small: Annotated[NotNegativeRange, at_most(1000)] = Range(6.0, 24.0)
    pictures: Annotated[NotNegativeRange, at_most(200)] = Range(1.0, 6.0)
    doorway: Share = 0.2
    niche: Share = 0.2
    pillars: Annotated[NotNegativeRange, at_most(50)] = Range(0.0, 1.0)
    rug: Share = 0.4
    curtain: Share = 0.4


class StreetSection(Section):
    """Streets: a road, objects along the road, and a far backdrop.

    Lengths are true where the backdrop is 25 m away or more; nearer scenes are scaled with all their contents.

    Attributes:
        camera_height_m: height of the camera above the ground.
        yaw_deg: standard deviation of the angle between the viewing direction and the road.
        tilt_deg: standard deviation of the camera's pitch and roll.
        road_width_m: width of the road.
        pavement: share of roadsides with a raised pavement.
        houses: share of plots along the road with a house.
        fences: share of plots with a fence; plots with neither a house nor a fence are open.
        vehicles: number of cars and bicycles.
        tall: number of trees, lamps, signs and scaffolds.
        low: number of people, animals, benches and bins.
    """

    camera_height_m: PositiveRange = Range(1.2, 2.0)
    yaw_deg: Annotated[float, Field(ge=0, le=60)] = 6.0
    tilt_deg: Annotated[float, Field(ge=0, le=20)] = 1.5
    road_width_m: PositiveRange = Range(5.0, 12.0)
    pavement: Share = 0.7
    houses: Share = 0.5
    fences: Share = 0.25
    vehicles: Annotated[NotNegativeRange, at_most(200)] = Range(1.0, 9.0)
    tall: Annotated[NotNegativeRange, at_most(200)] = Range(2.0, 12.0)
    low: Annotated[NotNegativeRange, at_most(500)] = Range(2.0, 14.0)


class StructuresSection(Section):
    """Large still objects between the background and the particles.

    Attributes:
        ground: share of scenes with a ground plane.
        ground_height_m: height of the camera above the ground.
        ground_disparity_px: disparity of a level ground at the image's lower border, instead of ``ground_height_m``.
        ground_tilt_deg: largest roll and pitch of the ground.
        panels: number of free-standing slanted rectangles.
        panel_disparity_px: disparity of a panel's middle; by default the farther half of the range.
        panel_size_px: width and height of a panel that faces the camera.
        panel_slant_deg: angle between a panel's normal and the viewing direction.
        panel_curved: share of panels bent into a third of a cylinder.
    """

    ground: Share = 0.0
    ground_height_m: PositiveRange = Range(1.2, 2.0)
    ground_disparity_px: RangeField | None = None
    ground_tilt_deg: Annotated[float, Field(ge=0, le=30)] = 2.0
    panels: Annotated[NotNegativeRange, at_most(1000)] = ZERO
    panel_disparity_px: RangeField | None = None
    panel_size_px: PositiveRange = Range(200.0, 800.0)
    panel_slant_deg: NotNegativeRange = Range(0.0, 75.0)
    panel_curved: Share = 0.5

    def _faults(self) -> Iterator[str]:
        if self.panel_slant_deg.high >= _EDGE_ON_DEG:
            yield f"panel_slant_deg: expected less than {_EDGE_ON_DEG}, got {self.panel_slant_deg.high:g}"

        default = type(self).model_fields["ground_height_m"].default
        if self.ground_disparity_px is not None and self.ground_height_m != default:
            yield "give either ground_height_m or ground_disparity_px, not both"


class DepthLayerSection(Section):
    """One depth layer of particles.

    Attributes:
        disparity_px: disparities of its particles; by default the middle four fifths of ``disparity.target``.
        count: number of its particles at any time, in view or just beside the view.
        size_px: diameters of its particles on the screen; by default the sizes that the section ``particles`` gives.
    """

    disparity_px: RangeField | None = None
    count: Annotated[NotNegativeRange, at_most(_MOST_PARTICLES)]
    size_px: PositiveRange | None = None


class ParticlesSection(Section):
    """The particles: models that fall or float in front of the background.

    Attributes:
        layers: depth layers, a list as in ``clutter``; by default solved from ``disparity.target``.
        clutter: further depth layers: a list of ``{disparity_px, count, size_px}``, all ranges.
        density: number of particles: ``default``, ``sparse`` (a third as many, larger ones), ``dense`` (three times as
            many, smaller ones), or the mean number in the left view.
        size_px: diameter of a model's bounding sphere, log-uniform.
        size_m: diameter of a model's bounding sphere in metres, instead of ``size_px``.
        stretch: scale along each axis of a model, relative to the largest of its three scales.
        thinness: additional scale along one axis, log-uniform; 0.05 makes sheets.
        fall_m_s: speed downwards.
        drift: speed in a random horizontal direction, relative to ``fall_m_s``.
        spin_deg_s: angular speed about a random axis.
        resting: share of particles that lie at rest instead of falling, where a surface below can carry them.
        most: largest number of particles in a scene; where the target takes more, they become larger.
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
    resting: Share = 0.0
    most: Annotated[int, count(_MOST_PARTICLES)] = 2000

    def _faults(self) -> Iterator[str]:
        if self.layers is not None and self.density != "default":
            yield "give either density or layers, not both: each layer states its own count"
        if isinstance(self.density, Range) and self.density.high > self.most:
            yield f"density goes up to {self.density.high:g} particles in view, but most allows {self.most} in a scene"
        if self.thinness.high > 1:
            yield f"thinness makes models thinner: expected at most 1, got {self.thinness.high:g}"


class ModelsSection(Section):
    """The models of the particles.

    Attributes:
        simple: weight of the simple family (cube, sphere, torus, ...).
        complex: weight of the complex family (chair, mug, plant, ...).
        user: weight of the models in ``folders``; with fewer than 25 models it is reduced in proportion.
        kinds: weights of kinds within their family, by name; by default 1.
        folders: folders of model files.
        variants: number of models, of different proportions, per kind and per plug-in's family.
        families: weights of plug-ins' families, by the plug-in's name.
    """

    simple: Weight = 1.0
    complex: Weight = 1.0
    user: Weight = 1.0
    kinds: Annotated[dict[str, Weight], Field(max_length=_MOST_ITEMS)] = Field(default_factory=dict)
    folders: _Paths = ()
    variants: Annotated[int, count(100)] = 3
    families: Annotated[dict[_FamilyName, Weight], Field(max_length=_MOST_ITEMS)] = Field(default_factory=dict)

    def _faults(self) -> Iterator[str]:
        if self.simple + self.complex + self.user + sum(self.families.values()) == 0:
            yield "expected a weight above 0 for simple, complex or user, or in families"


class TexturesSection(Section):
    """The patches, and how models wear them.

    Attributes:
        source: ``images`` (yours), ``builtin`` (drawn pictures, and scikit-image's photographs), ``photographs``
            (only scikit-image's photographs), ``procedural``, or a plug-in's name.
        images: files, folders and globs of the source ``images``.
        patch_px: side of a patch in the atlas.
        scales: sides of the squares that are cut from images, in multiples of ``patch_px``.
        min_texture: least texture of a patch: the median over 8 x 8 cells of the standard deviation of luminance, 8-bit
            levels; squares with less than 1 are nearly of one colour, or overexposed.
        min_sharpness: least sharpness of a patch: contrast of its finest octave over the contrast of its third octave.
        min_difference: least difference of two patches, 1 minus the correlation of their luminance gradients on a
            coarse grid; 0 keeps all.
        max_patches: largest number of patches.
        large_px: side of large patches, for walls, grounds and other large surfaces; 0 for none.
        texels_per_pixel: texels of a patch per pixel of the image: above 1 the patch looks reduced, below 1 enlarged.
        anisotropy: largest number of samples of a patch per pixel on surfaces at a grazing angle; 1 blurs them.
        large_anisotropy: ``anisotropy`` of large patches.
        wrap: continuation of a patch beyond its border: its ``mirror`` image, or a ``repeat``.
        sequence: take a folder's images as successive frames, which an instance shows in turn.
    """

    source: PluginName = "builtin"
    images: _Paths = ()
    patch_px: Annotated[int, Field(ge=16, le=8192)] = 256
    scales: Annotated[tuple[_AtLeastOne, ...], FROM_LIST, Field(min_length=1, max_length=100)] = (1.0, 2.0, 4.0)
    min_texture: NotNegative = 1.0
    min_sharpness: NotNegative = 0.3
    min_difference: Share = 0.04
    max_patches: Annotated[int, Field(ge=1, le=2048)] = 512
    large_px: Annotated[int, Field(ge=0, le=4096)] = 0
    texels_per_pixel: PositiveRange = Range(0.8, 1.5)
    anisotropy: Annotated[int, Field(ge=1, le=16)] = 1
    large_anisotropy: Annotated[int, Field(ge=1, le=16)] = 4
    wrap: Literal["mirror", "repeat"] = "mirror"
    sequence: bool = False

    def _faults(self) -> Iterator[str]:
        most = _MOST_TEXELS // self.patch_px**2
        if self.max_patches > most:
            size = self.max_patches * self.patch_px**2 * _BYTES_PER_TEXEL / 1e9
            yield (
                f"{self.max_patches} patches of {self.patch_px} x {self.patch_px} pixels would take {size:.0f} GB: "
                f"expected max_patches of at most {most}, or a smaller patch_px"
            )
