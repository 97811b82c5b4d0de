"""The typed config: every key that a YAML file may set, with its default and its limits."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from pydantic import (
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

from semisynth_gl.codecs import Encodings
from semisynth_gl.config.dataset_sections import (
    ChecksSection,
    FilesSection,
    ImperfectionsSection,
    LicencesSection,
    RigSection,
    SequenceSection,
    SplitsSection,
)
from semisynth_gl.config.distributions import check_target, wanted_histogram
from semisynth_gl.config.fields import (
    FROM_LIST,
    Name,
    PluginName,
    Range,
    Section,
    Weight,
    check_above_zero,
    one_of,
    written_range,
)
from semisynth_gl.config.merge import Document, merged
from semisynth_gl.config.partial import partial_section
from semisynth_gl.config.rig_sections import CameraSection, DisparitySection, LensSection, ProjectorSection
from semisynth_gl.config.scene_sections import (
    TEXTURE_SOURCES,
    BackgroundSection,
    DepthLayerSection,
    ModelsSection,
    ParticlesSection,
    RoomSection,
    StreetSection,
    StructuresSection,
    TexturesSection,
)
from semisynth_gl.config.yaml_values import Key
from semisynth_gl.frame.channels import ANTIALIAS_PATTERN, DEFAULT_OUTPUTS, DRAWN_OUTPUTS, OUTPUTS, TruthViews
from semisynth_gl.histogram import Histogram, mix_histograms
from semisynth_gl.plugins import Group

_MOST_RECIPES = 100


# The sections that a recipe may change, each with the keys that it may not change, since they hold for all pairs of a
# dataset: the kind of images, the shape of pixels, the number of pairs per scene, the sets of models and patches, the
# sampling of patches by the graphics card, and the limits by which truth is stored and checked.
_OF_RECIPES: Mapping[str, tuple[type[Section], tuple[str, ...]]] = {
    "camera": (CameraSection, ("width_px", "height_px", "fy_over_fx", "baselines", "colour")),
    "disparity": (DisparitySection, ("signed", "min_px", "max_px")),
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
    """A recipe of scenes: keys of sections that replace the config's keys.

    Attributes:
        recipe: name of the recipe: letters, digits and hyphens; by default the name in ``extends``.
        extends: name of a plug-in's recipe, over which the keys are merged when the config is read.
        weight: weight of the recipe; its share of the sequences is in proportion to this.
    """

    recipe: Name
    extends: PluginName | None = None
    weight: Weight = 1.0

    @model_serializer(mode="wrap")
    def _given(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in serialise(self).items() if value is not None}

    def changes(self) -> dict[str, Any]:
        """Return the keys that the recipe changes, by their section, in JSON's types."""
        return self.model_dump(mode="json", exclude={"recipe", "extends", "weight"})


@dataclass(frozen=True, slots=True)
class Recipe:
    """A recipe, which a ``share`` of the sequences follows.

    ``config`` is the whole config with the recipe's keys merged in, and without ``scenes``. A config without recipes is
    its own only recipe, whose name is None.
    """

    name: str | None
    share: float
    config: "Config"


# Context of validation for a recipe without a target of its own: the mix as a whole meets the target, not each recipe.
_WITHIN_MIX = {"within_mix": True}


class Config(Section):
    """A config: with a seed and an index, it determines a pair. The class of each section documents its keys.

    Attributes:
        name: first part of every sample's name: letters, digits and hyphens.
        layout: layout where ``--layout`` is not set; by default ``middlebury``, or ``webdataset`` from 10,000 pairs on.
        scenes: recipes, of which each sequence takes one, by weight.
        outputs: outputs besides images and disparities: ``visibility``, ``correspondence``, ``instances``, ``depth``,
            ``sky``, ``normals``, ``flow``, ``flow_backward``, ``disparity_change``; with ``lens``, ``valid``,
            ``raw``, ``raw_map``.
        truth: views that get truth: ``both`` or ``left``; both get images, ``raw`` and ``raw_map``.
        antialias: antialiasing of colour: ``none``, ``edges``, or ``ssaa2`` to ``ssaa8``.
    """

    name: Name
    # Excluded from the values and the digest, since it changes no pair.
    layout: Annotated[PluginName | None, Field(exclude=True)] = None
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
    rig: RigSection = RigSection()
    lens: LensSection | None = None
    projector: ProjectorSection | None = None
    sequence: SequenceSection = SequenceSection()
    imperfections: ImperfectionsSection = ImperfectionsSection()
    checks: ChecksSection = ChecksSection()
    files: FilesSection = FilesSection()
    splits: SplitsSection = SplitsSection()
    licences: LicencesSection = LicencesSection()
    outputs: Annotated[tuple[Annotated[str, one_of(OUTPUTS)], ...], FROM_LIST, Field(max_length=100)] = DEFAULT_OUTPUTS
    truth: TruthViews = "both"
    antialias: Annotated[str, Field(pattern=ANTIALIAS_PATTERN)] = "none"

    @model_serializer(mode="wrap")
    def _without_none(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # A config without a lens or a projector keeps the digest that it had before there were any.
        none = {key for key in ("lens", "projector") if getattr(self, key) is None}
        return {key: value for key, value in serialise(self).items() if key not in none}

    def _faults(self) -> Iterator[str]:
        stated = self._stated_px()
        if self.disparity.signed:
            doffs_px = self.camera.all_doffs_px.low
            lowest = {"disparity.min_px": self.disparity.min_px} | {key: each.low for key, each in stated.items()}
            for key, low_px in lowest.items():
                if low_px + doffs_px <= 0:
                    yield (
                        f"{key} goes down to {low_px:g} px, but where the principal points differ by doffs = "
                        f"{doffs_px:g} px, disparities end at {-doffs_px:g} px, which is infinitely far away: raise "
                        f"{key} above that, or raise camera.doffs_px"
                    )
        else:
            self._check_positive()
        limit = self.disparity.max_px
        for key, values in stated.items():
            if values.high > limit:
                yield (
                    f"{key} goes up to {values.high:g} px, but disparity.max_px, the limit, is {limit:g}: lower the "
                    "first or raise the second"
                )
        if limit < 0 and len(self.camera.baseline_ranges_m) > 1 and self.camera.cx_right_px is None:
            yield (
                f"disparity.max_px is {limit:g} px, but shorter baselines have disparities nearer to "
                "0: state camera.cx_left_px and cx_right_px, which hold for all baselines, or one baseline"
            )
        if "disparity_change" in self.outputs and not self.rig.none():
            yield "the output disparity_change needs rectified pairs: leave out this output, or the section rig"
        yield from self._camera_faults()

    def _camera_faults(self) -> Iterator[str]:
        masked = [output for output in ("visibility", "flow", "flow_backward") if output in self.outputs]
        if self.lens is not None and masked and "valid" not in self.outputs:
            yield (
                f"the masks of {masked[0]} leave out what the sensors of lens did not see, and the output valid says "
                "where that is: add valid to outputs"
            )
        if self.lens is not None and not self.lens.border_disparity:
            if "valid" not in self.outputs:
                yield "lens.border_disparity false leaves out what the output valid marks: add valid to outputs"
            if "disparity_change" in self.outputs and "flow" not in self.outputs:
                yield (
                    "with lens.border_disparity false, disparity_change is missing where flow leads into a border: add "
                    "flow to outputs"
                )
        if self.lens is not None:
            yield from self.lens.view_faults(self.camera)
        of_lens = [output for output in self.outputs if output not in DRAWN_OUTPUTS]
        if self.lens is None and of_lens:
            yield f"the output {of_lens[0]} needs the section lens: add lens, or leave the output out"

    def _check_positive(self) -> None:
        background, structures = self.background, self.structures
        stated: dict[Key, Range | None] = {
            ("background", "wall_disparity_px"): background.wall_disparity_px,
            ("background", "plane_disparity_px"): background.plane_disparity_px,
            ("structures", "ground_disparity_px"): structures.ground_disparity_px,
            ("structures", "panel_disparity_px"): structures.panel_disparity_px,
        }
        stated |= {(*key, "disparity_px"): layer.disparity_px for key, layer in self._layers().items()}
        faults = []
        for key, values in stated.items():
            if values is not None:
                try:
                    check_above_zero(values)
                except ValueError as error:
                    faults.append(_fault("disparity", str(error), key, written_range(values)))
        if faults:
            raise ValidationError.from_exception_data("Config", faults)

    def _stated_px(self) -> dict[str, Range]:
        """Return the disparities that the sections state for objects that scenes can show, by dotted key."""
        stated = {
            "structures.ground_disparity_px": self.structures.ground_disparity_px,
            "structures.panel_disparity_px": self.structures.panel_disparity_px,
        }
        stated |= {f"background.{key}": disparity_px for key, disparity_px in self.background.shown_px().items()}
        stated |= {".".join(map(str, key)): layer.disparity_px for key, layer in self._layers().items()}
        return {key: disparity_px for key, disparity_px in stated.items() if disparity_px is not None}

    def _layers(self) -> dict[Key, DepthLayerSection]:
        """Return all depth layers by their keys."""
        lists = {"layers": self.particles.layers or (), "clutter": self.particles.clutter}
        return {("particles", name, k): layer for name, layers in lists.items() for k, layer in enumerate(layers)}

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
                faults += [
                    _fault("recipe", fault["msg"], ("scenes", number, *fault["loc"]), fault["input"])
                    for fault in error.errors(include_url=False)
                ]
            else:
                if section.weight > 0:
                    lowest_px.append(config.lowest_px())
        if faults:
            raise ValidationError.from_exception_data("Config", faults)
        if info.context != _WITHIN_MIX:
            wanted, infinity_px = self.disparity, -self.camera.all_doffs_px.low
            note = f"; {infinity_px:g} px is infinitely far away, by camera.doffs_px" if wanted.signed else ""
            check_target(wanted.target, wanted.min_px, wanted.max_px, min(lowest_px), note)
        return self

    @property
    def images_as_drawn(self) -> bool:
        """Whether images stay as they are drawn: no lens and no imperfections change them."""
        return self.lens is None and self.imperfections.none()

    @property
    def views(self) -> int:
        """Number of pairs per scene: pair i shows scene i // views, seen by right camera i % views."""
        return len(self.camera.baseline_ranges_m) * (2 if self.rig.twin else 1)

    @property
    def sequence_pairs(self) -> int:
        """Number of pairs of each sequence."""
        return self.sequence.length * self.views

    def lowest_px(self) -> float:
        """Return the smallest disparity that the sections allow scenes to show."""
        background, sky_px = self.background, -self.camera.all_doffs_px.high
        lowest = [self.disparity.min_px, *(disparity_px.low for disparity_px in background.shown_px().values())]
        return min([*lowest, sky_px] if background.shows_sky and (self.disparity.signed or sky_px > 0) else lowest)

    @property
    def encodings(self) -> Encodings:
        """The codecs that the section ``files`` names, signed or not as the config's disparities are."""
        files = self.files
        return Encodings.from_names(files.image, files.disparity, files.flow, signed=self.disparity.signed)

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
        """Return the distribution of disparity, px, that ``disparity.target`` asks for.

        A target of form ``histogram`` keeps its bins. Any other target gets 24 bins of equal width from ``min_px`` to
        ``max_px``.

        Raises:
            InputError: where a target uniform in depth reaches beyond infinity.
        """
        section = self.disparity
        return wanted_histogram(section.target, section.min_px, section.max_px, self.camera.mean_doffs_px)

    def shown_histogram(self) -> Histogram:
        """Return the distribution of disparity over all pairs, if scenes match the wanted distribution.

        The two distributions differ where a scene has several baselines: the longest baseline has the wanted one, and
        pairs with shorter baselines show smaller disparities.

        Raises:
            InputError: see `wanted_histogram`.
        """
        wanted = self.wanted_histogram()
        if self.views == 1:
            return wanted
        parts = [(recipe.share, recipe.config.across_baselines(wanted)) for recipe in self.recipes()]
        # The part that reaches lowest has the edges of all other parts.
        lowest = min((part for _, part in parts), key=lambda part: float(part.edges_px[0]))
        return mix_histograms(parts, lowest.edges_px)

    def across_baselines(self, longest: Histogram) -> Histogram:
        """Return the distribution of disparity over all pairs, given that of the longest baselines' pairs."""
        ratios = self.camera.baseline_ratios()
        if len(ratios) == 1:
            return longest
        # Without a stated cx_right, doffs is in proportion to the baseline, as disparity is; see `draw_views`.
        doffs_px = 0.0 if self.camera.cx_right_px is None else self.camera.mean_doffs_px
        parts = [(share, longest.seen_from(ratio, doffs_px)) for share, ratio in ratios]
        lowest = float(min(part.edges_px[0] for _, part in parts))
        if not self.disparity.signed:
            # Disparities that are not signed end at 0.
            lowest = max(0.0, lowest)
        width = longest.edges_px[1] - longest.edges_px[0]
        below = np.linspace(lowest, longest.edges_px[0], 1 + math.ceil((longest.edges_px[0] - lowest) / width))
        edges = np.concatenate([below[:-1], longest.edges_px])
        return Histogram.from_counts(edges, sum(share * np.diff(part.cumulative(edges)) for share, part in parts))

    def used_plugins(self) -> dict[Key, tuple[Group, str]]:
        """Return the group and name of each plug-in that the config asks for, by the key that names it."""
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
        """Return the SHA-256 of the config's values, 64 hex digits; notation does not change it."""
        return digest_of(self.model_dump(mode="json"))


def _fault(kind: str, reason: str, key: Key, value: object) -> InitErrorDetails:
    return InitErrorDetails(type=PydanticCustomError(kind, "{reason}", {"reason": reason}), loc=key, input=value)


def digest_of(values: Mapping[str, Any]) -> str:
    """Return the SHA-256, 64 hex digits, of a config's values in JSON's types; the config may be of any version."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
