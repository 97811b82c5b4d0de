"""The base of all layouts: names of files, and the role of each.

A layout is a module of this package with one class and its instance, `LAYOUT`. A new layout is a new module.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

from semisynth_gl.codecs import Encodings
from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.frame import CHANNELS, Colour, TruthViews
from semisynth_gl.inputs.errors import counted
from semisynth_gl.layouts.key import Key
from semisynth_gl.layouts.roles import ROLES, Role
from semisynth_gl.seeds.splits import SplitName

_SCENE_NAMES: Mapping[str, str] = {
    "image": "im{n}",
    "visibility": "mask{n}nocc",
    "instances": "inst{n}",
    "flow_visibility": "flow_mask{n}",
    "flow_backward_visibility": "flow_backward_mask{n}",
}


class Layout(ABC):
    """Names of files. What a file holds follows from its role; see `semisynth_gl.layouts.roles`.

    The first line of a layout's docstring names it and, behind a colon, its loaders; see `title`.

    Attributes:
        packed: whether the files of a shard are packed into one tar; else they stand by themselves.
        needs: outputs that the layout cannot do without.
        lacks: outputs that the layout has no files for, since none of its loaders could make sense of them.
        encodings: the layout's own encodings; None where the config's section ``files`` decides.
        three_channels_for: names loaders that fail at grey images of one channel, so that these get three equal ones;
            "" where none does.
        right_truth_for: names loaders that read the right view's truth too; "" where none does.
        positive_for: names loaders that take disparities of 0 and below for none; "" where none does.
        replaced: names that loaders replace, or look for, in the whole path of a file.
        most_frames: how many frames of a sequence the layout's names tell apart, where they count frames; else None.
    """

    packed: ClassVar[bool] = False
    needs: ClassVar[frozenset[str]] = frozenset()
    lacks: ClassVar[frozenset[str]] = frozenset()
    encodings: ClassVar[Encodings | None] = None
    three_channels_for: ClassVar[str] = ""
    right_truth_for: ClassVar[str] = ""
    positive_for: ClassVar[str] = ""
    replaced: ClassVar[tuple[str, ...]] = ()
    most_frames: ClassVar[int | None] = None

    @property
    def title(self) -> tuple[str, str]:
        """The layout's name and its loaders; both are "" under ``python -OO``, which drops docstrings."""
        name, _, loaders = (type(self).__doc__ or "").partition("\n")[0].partition(": ")
        return name, loaders.removesuffix(".")

    @abstractmethod
    def stems(self, key: Key) -> dict[str, str]:
        """Return each role's path without its ending, below the split's folder or inside the shard's tar."""

    def role(self, name: str) -> Role:
        """Return a role by its name."""
        return ROLES[name]

    def files(
        self, key: Key, encodings: Encodings, outputs: Collection[str] | None = None, truth: TruthViews = "both"
    ) -> dict[str, str]:
        """Return the path of each role's file.

        Args:
            key: the pair.
            encodings: see `encodings_for`.
            outputs: the dataset's; None for all files that the layout knows.
            truth: views that have truth.
        """
        files = {}
        for name, stem in self.stems(key).items():
            role = self.role(name)
            made = outputs is None or role.output is None or role.output in outputs
            if made and role.output not in self.lacks and (truth == "both" or role.eye != "right"):
                files[name] = f"{stem}{role.codec(encodings).suffix}"
        return files

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return files about all pairs of a split, such as lists of names, by path below the split's folder."""
        del keys, encodings
        return {}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return symbolic links below a split's folder: path, and target relative to the link's folder."""
        del keys
        return {}

    def folders(self) -> tuple[str, ...]:
        """Return folders that loaders list though they may be empty."""
        return ()

    def folder(self, split: SplitName, splits: Collection[SplitName]) -> str:
        """Return a split's folder in a dataset of these splits, "" or ending in a slash, below the dataset's."""
        return "" if len(splits) == 1 else f"{split}/"

    def advice(self, pairs: int, config: Config, split: SplitName) -> list[str]:
        """Return sentences on what will keep loaders of this layout from reading a split of so many pairs."""
        del split
        sentences = []
        if pairs % config.sequence_pairs:
            whole = "sequence" if config.sequence.length > 1 else "scene"
            sentences.append(
                f"The last {whole} ends early: {counted(pairs, 'pair')}, no multiple of {config.sequence_pairs}, which "
                f"each {whole} has."
            )
        if config.truth != "both" and self.right_truth_for:
            sentences.append(f"{self.right_truth_for} read the right view's truth too: set truth to both.")
        if config.disparity.signed and self.positive_for:
            sentences.append(
                f"{self.positive_for} leave out pixels with disparities of 0 and below, which are valid here."
            )
        return sentences

    def place_advice(self, root: str) -> list[str]:
        """Return sentences on what will keep loaders of this layout from reading a dataset in the folder ``root``."""
        return [
            f"Loaders of this layout replace {name!r} wherever it stands in the path of a file, and {root} has it: "
            "choose another folder for `out`, or move this one before training."
            for name in self.replaced
            if name in root
        ]

    def encodings_for(self, config: Config) -> Encodings:
        """Return the encodings that pairs of a config have in this layout."""
        return self.encodings_of(config.encodings, config.camera.colour)

    def encodings_of(self, chosen: Encodings, colour: Colour) -> Encodings:
        """Return the encodings of images of a colour, and of their truth, where the config has chosen these."""
        encodings = chosen if self.encodings is None else replace(self.encodings, signed=chosen.signed)
        return encodings if colour == "rgb" else encodings.in_grey(three=bool(self.three_channels_for))


def view_stems(names: Mapping[str, str], default: str) -> dict[str, str]:
    """Return the stems of all arrays of a frame by role, channel by channel.

    Args:
        names: stems by channel, with ``{n}`` for 0 (left) or 1 (right), ``{view}`` for the view's name and ``{L}`` for
            the name's first letter, as a capital.
        default: the stem of a channel that ``names`` lacks, with ``{channel}`` too.
    """
    return {
        channel.role(eye): names.get(channel.name, default).format(
            channel=channel.name, n=EYES.index(eye), view=eye, L=eye[0].upper()
        )
        for channel in CHANNELS.values()
        for eye in EYES
    }


def scene_stems(names: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the names of a frame's arrays in layouts that call the left view 0 and the right one 1.

    The first mapping has the arrays of the pair's moment, the second one those that compare it with another moment,
    view by view. ``names`` go over Middlebury's, see `view_stems`.
    """
    stems = view_stems({**_SCENE_NAMES, **names}, "{channel}{n}")
    flow = [channel.role(eye) for eye in EYES for channel in CHANNELS.values() if channel.moment != "now"]
    return {role: stem for role, stem in stems.items() if role not in flow}, {role: stems[role] for role in flow}


VERTICAL: dict[str, str] = {"disparity_y_left": "disp0y", "disparity_y_right": "disp1y"}
"""Middlebury's names for y_left - y_right in pairs that are not rectified."""

SHORT_SPLITS: Mapping[SplitName, str] = {"train": "train", "validation": "val", "test": "test"}
"""The splits' names in lists of pairs that loaders bring along."""


def pair_lines(pairs: Iterable[Mapping[str, str]]) -> bytes:
    """Write a list as loaders read it: each line has a pair's left image, right image and left disparity."""
    return "".join(f"{files['left']} {files['right']} {files['disparity_left']}\n" for files in pairs).encode()
