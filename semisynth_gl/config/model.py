"""The typed configuration: every key that a YAML file may set, with its default and its limits."""

import hashlib
import json
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from semisynth_gl.codecs import DISPARITY_CODECS, FLOW_CODECS, IMAGE_CODECS, Encodings
from semisynth_gl.config.range import NotNegativeRange, PositiveRange, Range, RangeField
from semisynth_gl.config.section import Count, Positive, Section, Weight, as_tuple, one_of
from semisynth_gl.config.target import TargetSection, UniformTarget, check_reach
from semisynth_gl.frame import ANTIALIAS_PATTERN, DEFAULT_OUTPUTS, OUTPUTS, TruthViews

_EDGE_ON_DEG = 90


class CameraSection(Section):
    """The rectified pair. Every range is drawn once per sequence.

    Attributes:
        width_px: image width.
        height_px: image height.
        focal_px: focal length in pixels; or give ``focal_mm`` and ``sensor_width_mm``.
        focal_mm: focal length in millimetres.
        sensor_width_mm: width of the sensor that the image covers, in millimetres.
        baseline_m: distance of the two cameras.
        cx_left_px: left principal point; by default such that both lie evenly about the image centre.
        cx_right_px: right principal point; or give ``doffs_px``.
        cy_px: y of both principal points; by default the image centre, (height - 1) / 2.
        doffs_px: cx_right - cx_left; by default 0.
        sway_m: how far the rig sways to either side of where it stands, along each of its axes; by default not at all.
        sway_deg: how far it turns to either side, about each axis.
        sway_s: periods of these oscillations.
    """

    width_px: Annotated[int, Field(ge=1)]
    height_px: Annotated[int, Field(ge=1)]
    focal_px: PositiveRange | None = None
    focal_mm: PositiveRange | None = None
    sensor_width_mm: Positive | None = None
    baseline_m: PositiveRange
    cx_left_px: RangeField | None = None
    cx_right_px: RangeField | None = None
    cy_px: RangeField | None = None
    doffs_px: RangeField | None = None
    sway_m: NotNegativeRange = Range(0.0, 0.0)
    sway_deg: NotNegativeRange = Range(0.0, 0.0)
    sway_s: PositiveRange = Range(1.0, 3.0)

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


class DisparitySection(Section):
    """Where disparities lie, in pixels.

    Attributes:
        min_px: walls and particles aim not to fall below it; a far plane may.
        max_px: hard limit, it sets the near plane: no pixel exceeds it.
        target: the wanted distribution over all pixels of a dataset: ``form`` is ``uniform``, ``uniform-depth``,
            ``gamma``, ``histogram`` or ``mixture``. A file reads ``form: file`` with its ``path``; loading the config
            turns it into a histogram.
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
    """What closes the view: the inside of a cuboid, or one far plane.

    Attributes:
        cuboid: weight of indoor scenes.
        plane: weight of outdoor scenes.
        wall_disparity_px: disparity of the cuboid's back wall at the image centre.
        wall_turn_deg: largest rotation of the cuboid about each axis.
        plane_disparity_px: disparity of the far plane, close to zero but above it.
    """

    cuboid: Weight = 1.0
    plane: Weight = 0.0
    wall_disparity_px: PositiveRange | None = None
    wall_turn_deg: Annotated[float, Field(ge=0, le=40)] = 15.0
    plane_disparity_px: PositiveRange = Range(0.2, 1.0)

    @model_validator(mode="after")
    def _some_kind(self) -> Self:
        if self.cuboid + self.plane == 0:
            raise ValueError("expected a weight above 0 for cuboid or plane")
        return self


class StructuresSection(Section):
    """Large still things between background and particles. By default there are none: model only what a scene needs.

    Attributes:
        ground: share of scenes with a ground plane.
        ground_height_m: height of the cameras above it.
        ground_tilt_deg: largest roll and pitch of the ground.
        panels: how many free-standing walls a scene has; each is a slanted rectangle.
        panel_disparity_px: disparity of a panel's middle; by default in the farther half of the range.
        panel_size_px: width and height on the screen, as if it faced the camera.
        panel_slant_deg: angle between a panel's normal and the viewing direction, to any side.
        panel_curved: share of the panels that are bent, as a third of a cylinder.
    """

    ground: Annotated[float, Field(ge=0, le=1)] = 0.0
    ground_height_m: PositiveRange = Range(1.2, 2.0)
    ground_tilt_deg: Annotated[float, Field(ge=0, le=30)] = 2.0
    panels: NotNegativeRange = Range(0.0, 0.0)
    panel_disparity_px: PositiveRange | None = None
    panel_size_px: PositiveRange = Range(200.0, 800.0)
    panel_slant_deg: NotNegativeRange = Range(0.0, 75.0)
    panel_curved: Annotated[float, Field(ge=0, le=1)] = 0.5

    @model_validator(mode="after")
    def _not_edge_on(self) -> Self:
        if self.panel_slant_deg.high >= _EDGE_ON_DEG:
            raise ValueError(f"panel_slant_deg: expected less than {_EDGE_ON_DEG}, got {self.panel_slant_deg.high:g}")
        return self


class LayerSection(Section):
    """One layer of depth.

    Attributes:
        disparity_px: where its particles are.
        count: how many it holds at any time, inside the view and just beside it.
        size_px: their diameters on the screen; by default those of all particles.
    """

    disparity_px: PositiveRange
    count: NotNegativeRange
    size_px: PositiveRange | None = None


class ParticlesSection(Section):
    """The falling models.

    Attributes:
        layers: numbers per layer of depth; by default they are solved from ``disparity.target``.
        clutter: further layers beside those that are solved, such as many small things far away.
        density: how many objects share the area that the target asks for: ``default`` takes the sizes as they are,
            ``sparse`` has a third as many, larger ones, ``dense`` three times as many, smaller ones, and a number is
            the mean number of objects in the left view.
        size_px: diameter of a model's bounding sphere on the screen, drawn uniformly in its logarithm.
        size_m: or the same in metres: far ones are smaller on the screen.
        stretch: scale along each of a model's own axes relative to the largest.
        thinness: a further scale along one axis, drawn uniformly in its logarithm; 0.05 makes a sheet.
        fall_m_s: speed downwards.
        drift: speed in a random horizontal direction, relative to the speed downwards.
        spin_deg_s: angular speed about a random axis.
        most: upper limit of the number of particles in a scene.
    """

    layers: Annotated[tuple[LayerSection, ...], BeforeValidator(as_tuple)] | None = None
    clutter: Annotated[tuple[LayerSection, ...], BeforeValidator(as_tuple)] = ()
    density: Literal["sparse", "default", "dense"] | Positive = "default"
    size_px: PositiveRange = Range(40.0, 300.0)
    size_m: PositiveRange | None = None
    stretch: PositiveRange = Range(0.5, 1.0)
    thinness: PositiveRange = Range(1.0, 1.0)
    fall_m_s: PositiveRange = Range(0.5, 2.0)
    drift: NotNegativeRange = Range(0.0, 0.3)
    spin_deg_s: NotNegativeRange = Range(0.0, 180.0)
    most: Count = 2000

    @model_validator(mode="after")
    def _one_answer(self) -> Self:
        if self.layers is not None and self.density != "default":
            raise ValueError("density shares out what the target asks for; with layers, their counts say how many")
        if self.thinness.high > 1:
            raise ValueError(f"thinness makes models thinner: expected at most 1, got {self.thinness.high:g}")
        return self


class ModelsSection(Section):
    """Which models fall.

    Attributes:
        simple: weight of the simple family (cube, sphere, torus, ...).
        complex: weight of the complex family (chair, mug, plant, ...).
        user: weight of the models in ``folders``.
        kinds: weights of kinds within their family, by name; 1 where nothing is said, 0 leaves a kind out.
        folders: folders with files that trimesh reads.
        variants: how many of each kind are built, each with other proportions.
    """

    simple: Weight = 1.0
    complex: Weight = 1.0
    user: Weight = 1.0
    kinds: dict[str, Weight] = Field(default_factory=dict)
    folders: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    variants: Count = 3

    @model_validator(mode="after")
    def _some_family(self) -> Self:
        if self.simple + self.complex + self.user == 0:
            raise ValueError("expected a weight above 0 for simple, complex or user")
        return self


class TexturesSection(Section):
    """Where the patches come from and how they lie on the models.

    Attributes:
        source: ``images`` (the user's), ``builtin`` (photographs that scikit-image ships) or ``procedural``.
        images: files, folders and globs, for ``images``.
        patch_px: side of a patch in the atlas.
        scales: sides of the squares cut from an image, in units of ``patch_px``.
        min_texture: crops below this measure are flat (see `semisynth_gl.textures.crops.texture_measure`), and left
            out but for ``flat_share``.
        min_sharpness: crops below this measure are blurred, and left out (see
            `semisynth_gl.textures.crops.sharpness_measure`).
        min_difference: crops that differ less from another one are left out (see
            `semisynth_gl.textures.crops.fingerprint`); 0 keeps all.
        flat_share: share of flat crops wanted among all patches.
        max_patches: how many are kept.
        texels_per_pixel: mapping scale; 1 shows a patch at its own resolution, above 1 smaller, below 1 blown up.
        anisotropy: most samples of a patch for a pixel that sees it at a grazing angle; 1 blurs there.
        wrap: what lies beyond a patch's border, its mirror image or the patch again.
        sequence: treat the images of a folder as successive frames, which an instance shows one after the other.
    """

    source: Literal["images", "builtin", "procedural"] = "builtin"
    images: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    patch_px: Annotated[int, Field(ge=16, le=8192)] = 256
    scales: Annotated[
        tuple[Annotated[float, Field(ge=1, allow_inf_nan=False)], ...], BeforeValidator(as_tuple), Field(min_length=1)
    ] = (
        1.0,
        2.0,
        4.0,
    )
    min_texture: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 4.0
    min_sharpness: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.3
    min_difference: Annotated[float, Field(ge=0, le=1)] = 0.04
    flat_share: Annotated[float, Field(ge=0, lt=1)] = 0.0
    max_patches: Annotated[int, Field(ge=1, le=2048)] = 512
    texels_per_pixel: PositiveRange = Range(0.8, 1.5)
    anisotropy: Annotated[int, Field(ge=1, le=16)] = 1
    wrap: Literal["mirror", "repeat"] = "mirror"
    sequence: bool = False


class ImperfectionsSection(Section):
    """What a real rig does to its images. Each is drawn per pair and eye, and recorded; by default there are none.

    Attributes:
        exposure_stops: the image is multiplied by 2 to this power.
        gamma: exponent of the tone curve.
        noise: standard deviation of the sensor's noise, 8-bit levels.
        blur_px: standard deviation of the lens blur.
    """

    exposure_stops: RangeField = Range(0.0, 0.0)
    gamma: PositiveRange = Range(1.0, 1.0)
    noise: NotNegativeRange = Range(0.0, 0.0)
    blur_px: NotNegativeRange = Range(0.0, 0.0)

    @model_validator(mode="before")
    @classmethod
    def _no_vertical_disparity(cls, values: Any) -> Any:  # noqa: ANN401 - whatever the YAML holds
        for key in ("vertical_offset_px", "roll_deg"):
            if isinstance(values, dict) and key in values:
                raise ValueError(
                    f"{key} would need the vertical disparity as truth, which is not made: leave it out, and rectify"
                )
        return values

    def none(self) -> bool:
        """Whether images stay as they are rendered."""
        return self == ImperfectionsSection()


class ChecksSection(Section):
    """What a pair must fulfil as it is rendered; one that does not is drawn again from the next sub-seed.

    Of a sequence, the first frame is judged, and all its frames are drawn again together.

    Attributes:
        min_brightness: mean of the darker image, 8-bit levels.
        min_texture: texture measure of the flatter image, 8-bit levels.
        min_valid: share of pixels with a valid disparity, in each view.
        attempts: how often to draw before giving up.
    """

    min_brightness: Annotated[float, Field(ge=0, le=255)] = 8.0
    min_texture: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1.0
    min_valid: Annotated[float, Field(ge=0, le=1)] = 0.5
    attempts: Count = 10


class SequenceSection(Section):
    """Pairs i n to (i + 1) n - 1 are the frames of one moving scene.

    Attributes:
        length: frames per sequence, n.
        frame_s: time between two frames.
    """

    length: Count = 1
    frame_s: Positive = 0.04


class FilesSection(Section):
    """How files are encoded. Masks and ids are PNG, depth and change of disparity are PFM in any case.

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
    """What is held out where a dataset has validation or test pairs beside those to train on.

    Attributes:
        validation: share of the photographs that only validation pairs show, at least one.
        test: share of the photographs that only test pairs show, at least one.
        models: hold out the same shares of each family of models too.
    """

    validation: Annotated[float, Field(gt=0, lt=1)] = 0.1
    test: Annotated[float, Field(gt=0, lt=1)] = 0.1
    models: bool = False

    @model_validator(mode="after")
    def _some_left(self) -> Self:
        if self.validation + self.test >= 1:
            raise ValueError(f"validation and test take {self.validation + self.test:g} of all: nothing is left")
        return self


class LicencesSection(Section):
    """What index, card and Croissant file say of rights; only you know what your photographs and models allow.

    Attributes:
        dataset: of the whole, as the hubs name licences.
        images: of the user's photographs.
        models: of the user's models.
    """

    dataset: str = "unknown"
    images: str = "unknown"
    models: str = "unknown"


class Config(Section):
    """Everything that, with a seed and an index, determines a pair.

    Attributes:
        name: begins the name of every sample; letters, digits and hyphens.
        camera: see `CameraSection`.
        disparity: see `DisparitySection`.
        background: see `BackgroundSection`.
        structures: see `StructuresSection`.
        particles: see `ParticlesSection`.
        models: see `ModelsSection`.
        textures: see `TexturesSection`.
        sequence: see `SequenceSection`.
        imperfections: see `ImperfectionsSection`.
        checks: see `ChecksSection`.
        files: see `FilesSection`.
        splits: see `SplitsSection`.
        licences: see `LicencesSection`.
        outputs: what is written beside images and disparities: ``visibility``, ``instances``, ``depth``, ``flow``,
            ``flow_backward``, ``disparity_change``.
        truth: of which views disparity and outputs are written: ``both``, or ``left`` alone, which is faster.
        antialias: of colour: ``none``, ``msaa4`` (or what the driver has), ``ssaa2`` to ``ssaa8``.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9-]*$")]
    camera: CameraSection
    disparity: DisparitySection
    background: BackgroundSection = BackgroundSection()
    structures: StructuresSection = StructuresSection()
    particles: ParticlesSection = ParticlesSection()
    models: ModelsSection = ModelsSection()
    textures: TexturesSection = TexturesSection()
    sequence: SequenceSection = SequenceSection()
    imperfections: ImperfectionsSection = ImperfectionsSection()
    checks: ChecksSection = ChecksSection()
    files: FilesSection = FilesSection()
    splits: SplitsSection = SplitsSection()
    licences: LicencesSection = LicencesSection()
    outputs: Annotated[tuple[Annotated[str, one_of(OUTPUTS)], ...], BeforeValidator(as_tuple)] = DEFAULT_OUTPUTS
    truth: TruthViews = "both"
    antialias: Annotated[str, Field(pattern=ANTIALIAS_PATTERN)] = "none"

    @model_validator(mode="after")
    def _nothing_nearer_than_allowed(self) -> Self:
        nearest = {
            "structures.panel_disparity_px": self.structures.panel_disparity_px,
            "background.wall_disparity_px": self.background.wall_disparity_px if self.background.cuboid else None,
            "background.plane_disparity_px": self.background.plane_disparity_px if self.background.plane else None,
        }
        for name, layers in (("layers", self.particles.layers or ()), ("clutter", self.particles.clutter)):
            nearest |= {f"particles.{name}.{k}": layer.disparity_px for k, layer in enumerate(layers)}
        for key, values in nearest.items():
            if values is not None and values.high > self.disparity.max_px:
                raise ValueError(
                    f"{key} goes up to {values.high:g} px, but disparity.max_px, the limit, is "
                    f"{self.disparity.max_px:g}"
                )
        return self

    @model_validator(mode="after")
    def _target_can_be_shown(self) -> Self:
        ends = [self.disparity.min_px]
        if self.background.plane:
            ends.append(self.background.plane_disparity_px.low)
        if self.background.cuboid and self.background.wall_disparity_px is not None:
            ends.append(self.background.wall_disparity_px.low)
        check_reach(self.disparity.target, self.disparity.min_px, self.disparity.max_px, min(ends))
        return self

    def digest(self) -> str:
        """SHA-256 of the config's values, 64 hex digits; equal for equal configs however they were written down."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()
