"""The config: each key that a YAML file may set, with type, default and limits."""

import hashlib
import json
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from semisynth_gl.codecs import Encodings
from semisynth_gl.config.dataset_sections import (
    ChecksSection,
    FilesSection,
    LicencesSection,
    SequenceSection,
    SplitsSection,
)
from semisynth_gl.config.distributions import UniformDepthTarget, wanted_histogram
from semisynth_gl.config.fields import (
    FROM_LIST,
    ConfigError,
    ConfigSection,
    Name,
    PluginName,
    Range,
    Rule,
    Weight,
    one_of,
)
from semisynth_gl.config.layers import Values, merged
from semisynth_gl.config.rig_sections import (
    CameraSection,
    DisparitySection,
    ImperfectionsSection,
    LensSection,
    ProjectorSection,
    RigSection,
)
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
from semisynth_gl.config.yaml_values import KeyPath
from semisynth_gl.frame.channels import ANTIALIASING, DEFAULT_OUTPUTS, OUTPUTS, RENDERED_OUTPUTS, TruthViews
from semisynth_gl.histogram import Histogram
from semisynth_gl.plugins import Group

# None is omitted from the values, so that configs without these newer keys keep their digests.
_OMIT_NONE = Field(exclude_if=lambda section: section is None)

RECIPE_KEYS = ("recipe", "extends", "weight")
"""The keys of a recipe that are not sections."""

# The sections that a recipe may change, except for these keys, which are the same for all pairs: size and colour of
# images, shape of pixels, number of pairs per scene, models, patches and their sampling, and the limits by which truth
# is stored and checked.
_FIXED: Mapping[str, Collection[str]] = {
    "camera": {"width_px", "height_px", "fy_over_fx", "baselines", "colour"},
    "disparity": DisparitySection.model_fields.keys() - {"target"},
    "models": {"folders", "variants"},
    "textures": TexturesSection.model_fields.keys() - {"texels_per_pixel"},
    **dict.fromkeys(("background", "room", "street", "structures", "particles"), ()),
}


class RecipeSection(ConfigSection):
    """A recipe of scenes: keys that replace the config's keys.

    In YAML, the sections are beside ``recipe`` and ``weight``; `_recipe_values` rearranges them.
    """

    recipe: Name
    """name of the recipe: letters, digits and hyphens; by default the name in ``extends``"""
    extends: Annotated[PluginName | None, _OMIT_NONE] = None
    """name of a plug-in's recipe, over which the keys are merged when the config is read"""
    weight: Weight = 1.0
    """weight of the recipe; its share of the sequences is in proportion"""
    given: dict[str, Any]
    """the keys that the recipe states, as in YAML"""
    config: "Config"
    """the whole config with the recipe's keys merged in, and without recipes"""

    @field_validator("given")
    @classmethod
    def _refuse_fixed_keys(cls, given: dict[str, Any]) -> dict[str, Any]:
        for section, keys in given.items():
            fixed = [f"{section}.{key}" for key in _FIXED.get(section, ()) if isinstance(keys, dict) and key in keys]
            if section in Config.model_fields and section not in _FIXED:
                fixed = [section]
            for key in fixed:
                text = f"a recipe cannot change this key, which is the same for all pairs: set {key} outside scenes"
                raise ConfigError(text, (key,))
        return given

    @model_serializer(mode="wrap")
    def _as_written(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        head: dict[str, Any] = serialise(self)
        values: dict[str, Any] = _stated_values(head.pop("config"), head.pop("given"))
        return values | head


def _recipe_values(base: Values, recipe: Any) -> Any:  # noqa: ANN401 - any YAML value
    """Return the values of a `RecipeSection`: its keys, and the config with the recipe merged over it."""
    if not isinstance(recipe, dict):
        return recipe
    head = {key: recipe[key] for key in RECIPE_KEYS if key in recipe}
    given = {key: value for key, value in recipe.items() if key not in head}
    return head | {"given": given, "config": merged(base, given)}


def _stated_values(values: Any, given: Any) -> Any:  # noqa: ANN401 - any JSON value
    """Return those values of a config that a recipe states."""
    if not isinstance(given, dict) or "form" in given:
        return values
    return {key: _stated_values(value, given[key]) for key, value in values.items() if key in given}


@dataclass(frozen=True, slots=True)
class Recipe:
    """A recipe, the ``share`` of the sequences that use it, and the whole ``config`` of its scenes.

    A config without recipes has one recipe: itself, with the name None.
    """

    name: str | None
    share: float
    config: "Config"


class Config(ConfigSection):
    """A config. Config, seed and index determine a pair. The class of each section documents its keys."""

    name: Name
    """beginning of each pair's name: letters, digits and hyphens"""
    # Excluded from values and digest, since it changes no pair.
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
    scenes: Annotated[tuple[RecipeSection, ...], FROM_LIST] = ()
    """list of recipes; each sequence has one, sampled by weight"""
    rig: RigSection = RigSection()
    lens: Annotated[LensSection | None, _OMIT_NONE] = None
    projector: Annotated[ProjectorSection | None, _OMIT_NONE] = None
    sequence: SequenceSection = SequenceSection()
    imperfections: ImperfectionsSection = ImperfectionsSection()
    checks: ChecksSection = ChecksSection()
    files: FilesSection = FilesSection()
    splits: SplitsSection = SplitsSection()
    licences: LicencesSection = LicencesSection()
    outputs: Annotated[tuple[Annotated[str, one_of(OUTPUTS)], ...], FROM_LIST] = DEFAULT_OUTPUTS
    """outputs besides images and disparities: ``visibility``, ``correspondence``, ``instances``, ``depth``, ``sky``,
    ``normals``, ``flow``, ``flow_backward``, ``disparity_change``; with ``lens``, ``valid``, ``raw``, ``raw_map``"""
    truth: TruthViews = "both"
    """views that get truth: ``both`` or ``left``"""
    antialias: Annotated[str, one_of(ANTIALIASING)] = "none"
    """antialiasing of images: ``none``, ``edges``, or ``ssaa2`` to ``ssaa8``"""

    @model_validator(mode="before")
    @classmethod
    def _merge_recipes(cls, values: Any) -> Any:  # noqa: ANN401 - any YAML value
        if not (isinstance(values, dict) and isinstance(values.get("scenes"), list)):
            return values
        base = {key: value for key, value in values.items() if key not in ("scenes", "layout")}
        return values | {"scenes": [_recipe_values(base, recipe) for recipe in values["scenes"]]}

    def _rules(self) -> Iterator[Rule]:
        yield from self._disparity_rules()
        outputs = set(self.outputs)
        text = "the output disparity_change needs rectified pairs: leave out this output, or the section rig"
        yield "disparity_change" in outputs and not self.rig.is_rectified(), text, ("outputs", "rig")
        of_lens = " and ".join(sorted(outputs - {*RENDERED_OUTPUTS}))
        text = f"the output {of_lens} needs the section lens: add lens, or leave out this output"
        yield self.lens is None and of_lens != "", text, ("outputs",)
        if self.lens is not None:
            is_cut = not self.lens.border_disparity
            masked = [name for name in self.outputs if name in ("visibility", "flow", "flow_backward")]
            for name in masked or ["disparity"] * is_cut:
                text = f"{name} has no values where sensors see nothing: add valid to outputs, which marks these pixels"
                yield "valid" not in outputs, text, ("lens", "outputs")
            text = "with lens.border_disparity false, disparity_change is missing where flow leads into a border"
            has_no_flow = "disparity_change" in outputs and "flow" not in outputs
            yield is_cut and has_no_flow, f"{text}: add flow to outputs", ("lens.border_disparity", "outputs")
        names = [section.recipe for section in self.scenes]
        yield len(set(names)) < len(names), "expected recipes with different names", ("scenes",)
        is_weightless = names and sum(section.weight for section in self.scenes) == 0
        yield bool(is_weightless), "expected a weight above 0 for at least one recipe", ("scenes",)

    def _disparity_rules(self) -> Iterator[Rule]:
        disparity, doffs_px = self.disparity, self.camera.all_doffs_px
        others: tuple[str, ...] = ("camera.doffs_px", "camera.cx_left_px", "camera.cx_right_px")
        least = 0.0 - doffs_px.low if disparity.signed else 0.0
        why = f"which is infinitely far away where the principal points differ by doffs = {doffs_px.low:g} px"
        if not disparity.signed:
            why, others = "as disparity.signed is false", ("disparity.signed",)
        shown, width_px = self._shown_px(), self.camera.width_px
        for key, px in shown.items():
            text = f"{key} goes down to {px.low:g} px: expected more than {least:g}, {why}"
            yield px.low <= least, text, (key, *others)
            text = f"{key} goes up to {px.high:g} px: expected at most {disparity.max_px:g}, the limit disparity.max_px"
            yield px.high > disparity.max_px, text, (key, "disparity.max_px")
        # Pairs of a shorter baseline have smaller disparities, and the sky has that of infinity.
        has_others = len(self.camera.baseline_ranges_m) > 1 or self.background.sky > 0 or not self.rig.is_rectified()
        least_px = {"disparity.min_px": min(px.low for px in shown.values()), "disparity.max_px": -disparity.max_px}
        for key, least in least_px.items():
            text = f"no point is in both images if all disparities reach the width, {width_px} px"
            hint = "is baseline_m in metres, and focal_px in pixels?"
            yield not has_others and least >= width_px, f"{text}: {hint}", (key, "camera.width_px")
        least = -doffs_px.middle
        text = f"a target uniform in depth needs a min_px above {least:g}, which is infinitely far away for this camera"
        is_beyond = isinstance(disparity.target, UniformDepthTarget) and disparity.min_px <= least
        yield is_beyond, text, ("disparity.min_px", "disparity.target", "camera.doffs_px")

    def _shown_px(self) -> dict[str, Range]:
        """Return the stated disparities of all objects that scenes can show, by dotted key."""
        disparity, background, structures, particles = self.disparity, self.background, self.structures, self.particles
        shown: dict[str, Range | None] = {"disparity.min_px": Range(disparity.min_px, disparity.min_px)}
        if background.cuboid or background.room:
            shown["background.wall_disparity_px"] = background.wall_disparity_px
        if background.plane or background.street:
            shown["background.plane_disparity_px"] = background.plane_disparity_px
        for key in ("ground_disparity_px", "panel_disparity_px"):
            shown[f"structures.{key}"] = getattr(structures, key)
        for name, layers in (("layers", particles.layers or ()), ("clutter", particles.clutter)):
            shown |= {f"particles.{name}.{k}.disparity_px": layer.disparity_px for k, layer in enumerate(layers)}
        return {key: px for key, px in shown.items() if px is not None}

    @property
    def images_as_rendered(self) -> bool:
        """Whether neither a lens nor imperfections change the rendered images."""
        return self.lens is None and self.imperfections.changes_nothing()

    @property
    def views(self) -> int:
        """Number of pairs per scene: pair i shows scene i // views with right camera i % views."""
        return len(self.camera.baseline_ranges_m) * (2 if self.rig.twin else 1)

    @property
    def sequence_pairs(self) -> int:
        """Number of pairs of each sequence."""
        return self.sequence.length * self.views

    @property
    def encodings(self) -> Encodings:
        """The codecs that the section ``files`` names; they are for signed disparities if the config's are signed."""
        files = self.files
        return Encodings.from_names(files.image, files.disparity, files.flow, signed=self.disparity.signed)

    def recipes(self) -> tuple[Recipe, ...]:
        """Return the recipes with a weight above 0, at least one."""
        total = sum(section.weight for section in self.scenes)
        return tuple(
            Recipe(section.recipe, section.weight / total, section.config)
            for section in self.scenes
            if section.weight > 0
        ) or (Recipe(None, 1.0, self),)

    def wanted_histogram(self) -> Histogram:
        """Return the distribution of disparity, px, that ``disparity.target`` asks for.

        A target of form ``histogram`` keeps its bins. Any other target gets 24 bins of equal width from ``min_px`` to
        ``max_px``.
        """
        section = self.disparity
        return wanted_histogram(section.target, section.min_px, section.max_px, self.camera.all_doffs_px.middle)

    def shown_histogram(self) -> Histogram:
        """Return the distribution of disparity over all pairs, if scenes match the wanted distribution.

        Of several baselines, only pairs of the longest have the wanted distribution; the others have smaller
        disparities.
        """
        return self.across_baselines(self.wanted_histogram())

    def across_baselines(self, longest: Histogram) -> Histogram:
        """Return the distribution of disparity over all pairs, given that of the pairs of the longest baseline."""
        ratios, counts = self.camera.baseline_ratios()
        if len(ratios) == 1:
            return longest
        # Without a stated cx_right, doffs is in proportion to the baseline, as disparity is; see `sample_cameras`.
        doffs_px = 0.0 if self.camera.cx_right_px is None else self.camera.all_doffs_px.middle
        parts = [(count, longest.at_baseline(ratio, doffs_px)) for ratio, count in zip(ratios, counts, strict=True)]
        lowest = float(min(part.edges_px[0] for _, part in parts))
        if not self.disparity.signed:  # unsigned disparities end at 0
            lowest = max(0.0, lowest)
        width = longest.edges_px[1] - longest.edges_px[0]
        below = np.linspace(lowest, longest.edges_px[0], 1 + math.ceil((longest.edges_px[0] - lowest) / width))
        edges = np.concatenate([below[:-1], longest.edges_px])
        return Histogram.from_counts(edges, sum(count * np.diff(part.cumulative(edges)) for count, part in parts))

    def used_plugins(self) -> dict[KeyPath, tuple[Group, str]]:
        """Return the group and name of each plug-in that the config uses, by the key that names it."""
        used: dict[KeyPath, tuple[Group, str]] = {}
        if self.textures.source not in TEXTURE_SOURCES:
            used["textures", "source"] = ("textures", self.textures.source)
        configs: list[tuple[KeyPath, Config]] = [((), self)]
        for number, recipe in enumerate(self.scenes):
            configs.append((("scenes", number), recipe.config))
            if recipe.extends is not None:
                used["scenes", number, "extends"] = ("recipes", recipe.extends)
        for at, config in configs:
            for name, weight in config.models.families.items():
                if weight > 0 and ("models", name) not in used.values():
                    used[*at, "models", "families", name] = ("models", name)
        return used

    def digest(self) -> str:
        """Return the SHA-256 of the config's values, 64 hex digits; it does not depend on their notation in YAML."""
        return digest_of(self.model_dump(mode="json"))


def digest_of(values: Mapping[str, Any]) -> str:
    """Return the SHA-256, 64 hex digits, of a config's values in JSON's types; an older version may have written it."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
