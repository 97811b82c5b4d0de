"""The typed config: every key that a YAML file may set, with its default and its limits."""

import hashlib
import json
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

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
from semisynth_gl.config.distributions import target_faults, wanted_histogram
from semisynth_gl.config.fields import (
    FROM_LIST,
    SMALLEST,
    ConfigError,
    Name,
    PluginName,
    Range,
    Section,
    Weight,
    one_of,
)
from semisynth_gl.config.layers import Values, merged
from semisynth_gl.config.rig_sections import CameraSection, DisparitySection, LensSection, ProjectorSection
from semisynth_gl.config.scene_sections import (
    TEXTURE_SOURCES,
    BackgroundSection,
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

RECIPE_KEYS = ("recipe", "extends", "weight")
"""The keys of a recipe beside its sections."""

# The keys that a recipe may change, by section, where it may not change all: the others hold for all pairs of a
# dataset. They are the kind of images, the shape of pixels, the number of pairs per scene, the sets of models and
# patches, the sampling of patches by the graphics card, and the limits by which truth is stored and checked.
_OF_RECIPES: Mapping[str, Collection[str]] = {
    "camera": CameraSection.model_fields.keys() - {"width_px", "height_px", "fy_over_fx", "baselines", "colour"},
    "disparity": {"target"},
    "background": BackgroundSection.model_fields,
    "room": RoomSection.model_fields,
    "street": StreetSection.model_fields,
    "structures": StructuresSection.model_fields,
    "particles": ParticlesSection.model_fields,
    "models": ModelsSection.model_fields.keys() - {"folders", "variants"},
    "textures": {"texels_per_pixel"},
}


class RecipeSection(Section):
    """A recipe of scenes: keys of sections that replace the config's keys.

    In YAML, the sections stand beside ``recipe`` and ``weight``, see `_whole`.
    """

    recipe: Name
    """name of the recipe: letters, digits and hyphens; by default the name in ``extends``"""
    extends: PluginName | None = None
    """name of a plug-in's recipe, over which the keys are merged when the config is read"""
    weight: Weight = 1.0
    """weight of the recipe; its share of the sequences is in proportion to this"""
    given: Annotated[dict[str, Any], Field(max_length=_MOST_RECIPES)]
    """the keys that the recipe states: a mapping for each section, None for each value"""
    config: "Config"
    """the whole config with the recipe's keys merged in, and without recipes"""

    @field_validator("given")
    @classmethod
    def _holds_for_scenes(cls, given: dict[str, Any]) -> dict[str, Any]:
        for section, keys in given.items():
            allowed, field = _OF_RECIPES.get(section), Config.model_fields.get(section)
            known = getattr(field and field.annotation, "model_fields", {})
            wrong = [f"{section}.{key}" for key in keys or () if key in known and key not in (allowed or ())]
            if (allowed is None and field) or wrong:
                key = section if allowed is None else wrong[0]
                text = f"a recipe cannot change this key, which holds for all pairs: set {key} beside scenes"
                raise ConfigError(text, (key,))
        return given

    @model_serializer(mode="wrap")
    def _as_written(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        head = {key: value for key, value in serialise(self).items() if value is not None}
        values: dict[str, Any] = _picked(head.pop("config"), head.pop("given"))
        return values | head


def _whole(base: Values, recipe: Any) -> Any:  # noqa: ANN401 - any YAML value
    """Return the values of a `RecipeSection`, from those of a recipe in YAML and of its config."""
    if not isinstance(recipe, dict):
        return recipe
    head = {key: recipe[key] for key in RECIPE_KEYS if key in recipe}
    changes = {key: value for key, value in recipe.items() if key not in head}
    return head | {"given": _given(changes), "config": merged(base, changes)}


def _given(value: Any) -> Any:  # noqa: ANN401 - any YAML value
    """Return a mapping with None for each value."""
    is_section = isinstance(value, dict) and "form" not in value
    return {key: _given(child) for key, child in value.items()} if is_section else None


def _picked(values: Any, given: Any) -> Any:  # noqa: ANN401 - any JSON value
    """Return the values of the keys that are given."""
    if given is None:
        return values
    return {key: _picked(value, given[key]) for key, value in values.items() if key in given}


@dataclass(frozen=True, slots=True)
class Recipe:
    """A recipe, which a ``share`` of the sequences follows; ``config`` is the whole config of its scenes.

    A config without recipes is its own only recipe, whose name is None.
    """

    name: str | None
    share: float
    config: "Config"


class Config(Section):
    """A config: with a seed and an index, it determines a pair. The class of each section documents its keys."""

    name: Name
    """start of each pair's name: letters, digits and hyphens"""
    # Excluded from the values and the digest, since it changes no pair.
    layout: Annotated[PluginName | None, Field(exclude=True)] = None
    """layout; by default ``middlebury``, from 10,000 pairs on ``webdataset``"""
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
    """list of recipes; each sequence takes one, by weight"""
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
    """outputs besides images and disparities: ``visibility``, ``correspondence``, ``instances``, ``depth``, ``sky``,
    ``normals``, ``flow``, ``flow_backward``, ``disparity_change``; with ``lens``, ``valid``, ``raw``, ``raw_map``"""
    truth: TruthViews = "both"
    """views that get truth: ``both`` or ``left``"""
    antialias: Annotated[str, Field(pattern=ANTIALIAS_PATTERN)] = "none"
    """antialiasing of images: ``none``, ``edges``, or ``ssaa2`` to ``ssaa8``"""

    @model_validator(mode="before")
    @classmethod
    def _merge_recipes(cls, values: Any) -> Any:  # noqa: ANN401 - any YAML value
        if not (isinstance(values, dict) and isinstance(values.get("scenes"), list)):
            return values
        base = {key: value for key, value in values.items() if key not in ("scenes", "layout")}
        return values | {"scenes": [_whole(base, recipe) for recipe in values["scenes"]]}

    @model_serializer(mode="wrap")
    def _without_none(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # A config without a lens or a projector keeps the digest that it had before there were any.
        none = {key for key in ("lens", "projector") if getattr(self, key) is None}
        return {key: value for key, value in serialise(self).items() if key not in none}

    def _faults(self) -> Iterator[ConfigError]:
        yield from self._disparity_faults()
        if "disparity_change" in self.outputs and not self.rig.none():
            text = "the output disparity_change needs rectified pairs: leave out this output, or the section rig"
            yield ConfigError(text, ("outputs", "rig"))
        yield from self._lens_faults()
        names = [section.recipe for section in self.scenes]
        if len(set(names)) < len(names):
            yield ConfigError("expected a name of its own for each recipe", ("scenes",))
        if self.scenes and not sum(section.weight for section in self.scenes) > 0:
            yield ConfigError("expected a weight above 0 for at least one recipe", ("scenes",))

    def _disparity_faults(self) -> Iterator[ConfigError]:
        shown, limit, doffs_px = self._shown_px(), self.disparity.max_px, self.camera.all_doffs_px.low
        if self.disparity.signed:
            lowest = {"disparity.min_px": self.disparity.min_px} | {key: each.low for key, each in shown.items()}
            for key, low_px in lowest.items():
                if low_px + doffs_px <= 0:
                    yield ConfigError(
                        f"{key} goes down to {low_px:g} px, but where the principal points differ by doffs = "
                        f"{doffs_px:g} px, disparities end at {-doffs_px:g} px, which is infinitely far away: raise "
                        f"{key} above that, or raise camera.doffs_px",
                        (key, "camera.doffs_px", "camera.cx_left_px", "camera.cx_right_px"),
                    )
        else:
            for key, values in self._stated_px().items():
                if values.low < SMALLEST:
                    text = f"expected numbers above 0 where disparity.signed is false, got {values.low:g}"
                    yield ConfigError(text, (key,))
        for key, values in shown.items():
            if values.high > limit:
                yield ConfigError(
                    f"{key} goes up to {values.high:g} px, but disparity.max_px, the limit, is {limit:g}: lower the "
                    "first or raise the second",
                    (key, "disparity.max_px"),
                )
        if limit < 0 and len(self.camera.baseline_ranges_m) > 1 and self.camera.cx_right_px is None:
            yield ConfigError(
                f"disparity.max_px is {limit:g} px, but shorter baselines have disparities nearer to "
                "0: state camera.cx_left_px and cx_right_px, which hold for all baselines, or one baseline",
                ("disparity.max_px", "camera.baselines"),
            )

    def _lens_faults(self) -> Iterator[ConfigError]:
        outputs = self.outputs
        if self.lens is None:
            if of_lens := [output for output in outputs if output not in DRAWN_OUTPUTS]:
                text = f"the output {of_lens[0]} needs the section lens: add lens, or leave the output out"
                yield ConfigError(text, ("outputs",))
            return
        masked = [output for output in outputs if output in ("visibility", "flow", "flow_backward")]
        masked += [] if self.lens.border_disparity else ["disparity"]
        if masked and "valid" not in outputs:
            text = f"{masked[0]} leaves out what the sensors of lens did not see, which the output valid marks"
            yield ConfigError(f"{text}: add valid to outputs", ("lens", "outputs"))
        if not self.lens.border_disparity and "disparity_change" in outputs and "flow" not in outputs:
            text = "with lens.border_disparity false, disparity_change is missing where flow leads into a border"
            yield ConfigError(f"{text}: add flow to outputs", ("lens.border_disparity", "outputs"))

    def _stated_px(self) -> dict[str, Range]:
        """Return all disparities that the sections state, by dotted key."""
        stated: dict[str, Range | None] = {
            f"{section}.{key}": getattr(getattr(self, section), key)
            for section in ("background", "structures")
            for key in type(getattr(self, section)).model_fields
            if key.endswith("disparity_px")
        }
        for name, layers in (("layers", self.particles.layers or ()), ("clutter", self.particles.clutter)):
            stated |= {f"particles.{name}.{k}.disparity_px": each.disparity_px for k, each in enumerate(layers)}
        return {key: disparity_px for key, disparity_px in stated.items() if disparity_px is not None}

    def _shown_px(self) -> dict[str, Range]:
        """Return the disparities that the sections state for objects that scenes can show, by dotted key."""
        shown = {f"background.{key}": disparity_px for key, disparity_px in self.background.shown_px().items()}
        return shown | {key: each for key, each in self._stated_px().items() if not key.startswith("background")}

    def target_faults(self) -> Iterator[tuple[Key, ConfigError]]:
        """Yield the targets that scenes cannot show, each with the key of its recipe, () for the config's own.

        The mix as a whole meets the config's target, not each recipe.
        """
        mix = [section.config for section in self.scenes if section.weight > 0] or [self]
        parts: list[tuple[Key, Config, list[Config]]] = [((), self, mix)]
        for number, each in enumerate(self.scenes):
            parts += [(("scenes", number), each.config, [each.config])] if "disparity" in each.given else []
        for key, config, shown in parts:
            wanted, lowest_px = config.disparity, min(each.lowest_px() for each in shown)
            yield from ((key, fault) for fault in target_faults(wanted.target, wanted.min_px, wanted.max_px, lowest_px))

    @property
    def images_as_rendered(self) -> bool:
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
            Recipe(section.recipe, section.weight / total, section.config)
            for section in self.scenes
            if section.weight > 0
        ) or (Recipe(None, 1.0, self),)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values, also in the configs of recipes where they hold for all pairs."""
        copy = super().model_copy(update=update, deep=deep)
        of_all = {key: value for key, value in (update or {}).items() if key not in (*_OF_RECIPES, "scenes", "layout")}
        if not (of_all and copy.scenes):
            return copy
        recipes = [each.model_copy(update={"config": each.config.model_copy(update=of_all)}) for each in copy.scenes]
        return super(Config, copy).model_copy(update={"scenes": tuple(recipes)})

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
        # Without a stated cx_right, doffs is in proportion to the baseline, as disparity is; see `sample_views`.
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
            weights = section.config.models.families
            stated = (section.given.get("models") or {}).get("families") or ()
            families |= {("scenes", number, "models", "families", name): weights[name] for name in stated}
        return used | {key: ("models", str(key[-1])) for key, weight in families.items() if weight > 0}

    def digest(self) -> str:
        """Return the SHA-256 of the config's values, 64 hex digits; notation does not change it."""
        return digest_of(self.model_dump(mode="json"))


def digest_of(values: Mapping[str, Any]) -> str:
    """Return the SHA-256, 64 hex digits, of a config's values in JSON's types; the config may be of any version."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
