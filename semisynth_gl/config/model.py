"""The config with all its sections, and those sections that are about the dataset, its files and its recipes."""

import hashlib
import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from semisynth_gl.codecs import DISPARITY_CODECS, FLOW_CODECS, IMAGE_CODECS
from semisynth_gl.config.disparity_section import DisparitySection
from semisynth_gl.config.fields import (
    FROM_LIST,
    ConfigError,
    ConfigSection,
    Name,
    NotNegative,
    PluginName,
    Positive,
    Range,
    Share,
    one_of,
)
from semisynth_gl.config.layers import Values, merged
from semisynth_gl.config.rig_sections import (
    CameraSection,
    ImperfectionsSection,
    LensSection,
    ProjectorSection,
    RigSection,
)
from semisynth_gl.config.scene_sections import (
    BackgroundSection,
    ModelsSection,
    ParticlesSection,
    RoomSection,
    StreetSection,
    StructuresSection,
    TexturesSection,
)
from semisynth_gl.config.yaml_values import KeyPath
from semisynth_gl.frame.channels import ANTIALIASING, DEFAULT_OUTPUTS, LENS_OUTPUTS, OUTPUTS, TruthViews
from semisynth_gl.histogram import Histogram
from semisynth_gl.plugins import BUILT_IN, Group
from semisynth_gl.seeds.splits import Split, SplitName

# If None, the key is left out of `model_dump`, so that configs from before the key was added keep their digests.
_OMIT_NONE = Field(exclude_if=lambda value: value is None)

# Number of scenes whose baselines are sampled to predict a distribution of disparity.
_SCENES = 200

RECIPE_KEYS = ("recipe", "extends", "weight")
"""The keys of a recipe that are not sections."""

# The sections that a recipe may change, each with the keys that it may not change. All pairs of a dataset share these
# keys, which set the images' format, the baselines, the atlas of patches, the models and the limits of disparity.
_FIXED: Mapping[str, Collection[str]] = {
    "camera": {"width_px", "height_px", "fy_over_fx", "baselines", "colour"},
    "disparity": DisparitySection.model_fields.keys() - {"target"},
    "models": {"folders", "variants"},
    "textures": TexturesSection.model_fields.keys() - {"texels_per_pixel"},
    **dict.fromkeys(("background", "room", "street", "structures", "particles"), ()),
}


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
    """Shares of photographs and models that no training pair shows."""

    validation: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """share of the photographs' subjects"""
    test: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """share of the photographs' subjects"""
    models: bool = False
    """split models too, with the same shares"""

    def _check_rules(self) -> None:
        total = self.validation + self.test
        if total >= 1:
            raise ConfigError(f"validation and test add up to {total:g}: expected less than 1", ("validation", "test"))

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


class RecipeSection(ConfigSection):
    """A recipe of scenes: keys that replace the config's keys.

    In YAML, a recipe is one mapping with ``recipe``, ``extends``, ``weight`` and sections; see `_recipe_values`.
    """

    recipe: Name
    """name of the recipe: letters, digits and hyphens; by default the name in ``extends``"""
    extends: Annotated[PluginName | None, _OMIT_NONE] = None
    """name of a plug-in's recipe; this recipe's keys are merged over it"""
    weight: NotNegative = 1.0
    """weight of the recipe; its share of the sequences is in proportion"""
    given: dict[str, Any]
    """the keys that the recipe states, as in YAML"""
    config: "Config"
    """the whole config with the recipe's keys merged in, and without recipes"""

    @field_validator("given")  # before `config`, whose faults may follow from fixed keys
    @classmethod
    def _check_fixed(cls, given: dict[str, Any]) -> dict[str, Any]:
        for section in (name for name in given if name in Config.model_fields):  # `config` reports unknown keys
            fixed = [section]
            if section in _FIXED:
                keys = given[section] if isinstance(given[section], dict) else ()
                fixed = [f"{section}.{key}" for key in keys if key in _FIXED[section]]
            if fixed:
                text = f"a recipe cannot change this key, which all pairs share: set {fixed[0]} outside scenes"
                raise ConfigError(text, fixed)
        return given

    @model_serializer(mode="wrap")
    def _as_written(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        head: dict[str, Any] = serialise(self)
        values: dict[str, Any] = _stated_values(head.pop("config"), head.pop("given"))
        return values | head


def _recipe_values(base: Values, recipe: Any) -> Any:  # noqa: ANN401 - any YAML value
    """Return a `RecipeSection`'s values, made from a recipe in YAML and ``base``, the values of its config."""
    if not isinstance(recipe, dict):
        return recipe
    head = {key: recipe[key] for key in RECIPE_KEYS if key in recipe}
    given = {key: value for key, value in recipe.items() if key not in head}
    return head | {"given": given, "config": merged(base, given)}


def _stated_values(values: Any, given: Any) -> Any:  # noqa: ANN401 - any JSON value
    """Return the part of a dumped config that has the keys of ``given``; lists and targets are returned whole."""
    if not isinstance(given, dict) or "form" in given:
        return values
    return {key: _stated_values(value, given[key]) for key, value in values.items() if key in given}


@dataclass(frozen=True, slots=True)
class Recipe:
    """A recipe, the ``share`` of the sequences that have it, and the config of their scenes.

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

    def _check_rules(self) -> None:
        self._check_disparities()
        self._check_outputs()
        names = [section.recipe for section in self.scenes]
        if len(set(names)) < len(names):
            raise ConfigError("expected recipes with different names", ("scenes",))
        if self.scenes and not any(section.weight for section in self.scenes):
            raise ConfigError("expected a weight above 0 for at least one recipe", ("scenes",))

    def _check_outputs(self) -> None:
        outputs, lens = set(self.outputs), self.lens
        if "disparity_change" in outputs and not self.rig.is_rectified():
            text = "the output disparity_change needs rectified pairs: leave out this output, or the section rig"
            raise ConfigError(text, ("outputs", "rig"))
        if lens is None:
            if of_lens := " and ".join(sorted(outputs.intersection(LENS_OUTPUTS))):
                text = f"the output {of_lens} needs the section lens: add lens, or leave out this output"
                raise ConfigError(text, ("outputs",))
            return
        masked = [name for name in self.outputs if name in ("visibility", "flow", "flow_backward")]
        if "valid" not in outputs and (masked or not lens.border_disparity):
            fault = f"{masked[0]} marks points as hidden" if lens.border_disparity else "disparity has no values"
            text = f"{fault} in borders, where the sensor saw nothing: add valid to outputs, which marks the borders"
            raise ConfigError(text, ("lens", "outputs"))
        if not lens.border_disparity and "disparity_change" in outputs and "flow" not in outputs:
            text = "with lens.border_disparity false, disparity_change is missing where flow leads into a border"
            raise ConfigError(f"{text}: add flow to outputs", ("lens.border_disparity", "outputs"))

    def _check_disparities(self) -> None:
        disparity, camera, shown = self.disparity, self.camera, self._shown_px()
        doffs_px = camera.all_doffs_px.low
        least, keys = 0.0 - doffs_px, ["camera.doffs_px", "camera.cx_left_px", "camera.cx_right_px"]
        reason = f"which is infinitely far away where the principal points differ by doffs = {doffs_px:g} px"
        if least <= 0 and not disparity.signed:
            least, keys, reason = 0.0, ["disparity.signed"], "as disparity.signed is false"
        for key, px in shown.items():
            if px.low <= least:
                text = f"{key} goes down to {px.low:g} px: expected more than {least:g}, {reason}"
                raise ConfigError(text, (key, *keys))
            if px.high > disparity.max_px:
                text = f"{key} goes up to {px.high:g} px: expected at most disparity.max_px, {disparity.max_px:g}"
                raise ConfigError(text, (key, "disparity.max_px"))
        # Shorter baselines, the sky and deviating cameras have smaller disparities than the config states.
        has_smaller = len(camera.baseline_ranges_m) > 1 or self.background.sky > 0 or not self.rig.is_rectified()
        if not has_smaller and min(px.low for px in shown.values()) >= camera.width_px:
            text = f"no point is in both images if all disparities reach the width, {camera.width_px} px"
            hint = "is baseline_m in metres, and focal_px in pixels?"
            raise ConfigError(f"{text}: {hint}", ("disparity.min_px", "camera.width_px"))

    def _shown_px(self) -> dict[str, Range]:
        """Return the ranges of disparity that the config states for visible objects, by dotted key."""
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
        return self.disparity.wanted_histogram(self.camera.all_doffs_px.middle)

    def shown_histogram(self) -> Histogram:
        """Return the distribution of disparity over all pairs, if scenes match the wanted distribution.

        Of several baselines, only pairs of the longest have the wanted distribution; the others have smaller
        disparities.
        """
        return self.across_baselines(self.wanted_histogram())

    def across_baselines(self, longest: Histogram) -> Histogram:
        """Return the distribution of disparity over all pairs, given that of the pairs of the longest baseline."""
        # Ratios of the baselines of some scenes to the longest baseline of the scene.
        low_m, high_m = np.transpose([(each.low, each.high) for each in self.camera.baseline_ranges_m])
        sampled_m = low_m + (high_m - low_m) * np.random.default_rng(0).random((_SCENES, len(low_m)))
        ratios, counts = np.unique(sampled_m / sampled_m.max(axis=1, keepdims=True), return_counts=True)
        if len(ratios) == 1:
            return longest
        # Without a stated cx_right, doffs is in proportion to the baseline, as disparity is; see `sample_cameras`.
        doffs_px = 0.0 if self.camera.cx_right_px is None else self.camera.all_doffs_px.middle
        parts = [Histogram(ratio * (longest.edges_px + doffs_px) - doffs_px, longest.shares) for ratio in ratios]
        lowest = float(min(part.edges_px[0] for part in parts))
        if not self.disparity.signed:  # unsigned disparities end at 0
            lowest = max(0.0, lowest)
        width = longest.edges_px[1] - longest.edges_px[0]
        below = np.linspace(lowest, longest.edges_px[0], 1 + math.ceil((longest.edges_px[0] - lowest) / width))
        edges = np.concatenate([below[:-1], longest.edges_px])
        shares = (count * np.diff(part.cumulative(edges)) for count, part in zip(counts, parts, strict=True))
        return Histogram.from_counts(edges, sum(shares))

    def used_plugins(self) -> dict[KeyPath, tuple[Group, str]]:
        """Return the group and name of each plug-in that the config uses, except layouts, by the key that names it."""
        used: dict[KeyPath, tuple[Group, str]] = {}
        if self.textures.source not in BUILT_IN["textures"]:
            used["textures", "source"] = ("textures", self.textures.source)
        configs: dict[KeyPath, Config] = {(): self}
        for number, recipe in enumerate(self.scenes):
            configs["scenes", number] = recipe.config
            if recipe.extends is not None:
                used["scenes", number, "extends"] = ("recipes", recipe.extends)
        for at, config in configs.items():
            families = [name for name, weight in config.models.families.items() if weight > 0]
            used |= {(*at, "models", "families", name): ("models", name) for name in families}
        return used

    def digest(self) -> str:
        """Return the SHA-256 of the config's values, 64 hex digits; 1, 1.0 and [1, 1] are the same value."""
        return digest_of(self.model_dump(mode="json"))


def digest_of(values: Mapping[str, Any]) -> str:
    """Return the SHA-256, 64 hex digits, of a dumped config, of this or an older version of the program."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
