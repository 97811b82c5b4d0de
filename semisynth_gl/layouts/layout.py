"""The base of all layouts: the names of files, and the role of each file.

A layout is a module of this package with one class and its instance, `LAYOUT`. A new layout is a new module.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

from semisynth_gl.codecs import Encodings
from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.channels import CHANNELS, Colour, TruthViews
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
    """The names of a dataset's files. A file's content follows from its role; see `semisynth_gl.layouts.roles`.

    Attributes:
        packed: whether the files of a shard are packed into one tar; else each file stands in a folder.
        needs: outputs that every dataset in this layout must have.
        lacks: outputs for which the layout has no files, since none of its loaders could read them.
        encodings: the layout's own encodings; None where the config's section ``files`` chooses them.
        three_channels: whether grey images get three equal channels, since loaders fail at one.
        most_frames: largest number of frames of a sequence that the layout's names can count; None for no limit.
        copied: folders whose images loaders read a second time under another name, each with that name; both end in a
            slash. Object stores hold no links, and get copies there: without them, loaders find nothing and go on.
    """

    packed: ClassVar[bool] = False
    needs: ClassVar[frozenset[str]] = frozenset()
    lacks: ClassVar[frozenset[str]] = frozenset()
    encodings: ClassVar[Encodings | None] = None
    three_channels: ClassVar[bool] = False
    most_frames: ClassVar[int | None] = None
    copied: ClassVar[Mapping[str, str]] = {}

    @abstractmethod
    def stems(self, key: Key) -> dict[str, str]:
        """Return each role's path without its ending, below the split's folder or inside the shard's tar."""

    def role(self, name: str) -> Role:
        """Return a role by its name; raises KeyError for an unknown name."""
        return ROLES[name]

    def files(
        self, key: Key, encodings: Encodings, outputs: Collection[str] | None = None, truth: TruthViews = "both"
    ) -> dict[str, str]:
        """Return the path of each file of a pair by role, below the split's folder or inside the shard's tar.

        Args:
            key: the pair.
            encodings: the codecs that `encodings_for` returns.
            outputs: the dataset's outputs; None for all files that the layout knows.
            truth: the views that have truth.
        """
        files = {}
        for name, stem in self.stems(key).items():
            role = self.role(name)
            made = outputs is None or role.output is None or role.output in outputs
            if made and role.output not in self.lacks and (truth == "both" or role.eye != "right"):
                files[name] = f"{stem}{role.codec(encodings).suffix}"
        return files

    def lists(self, keys: Sequence[Key], encodings: Encodings) -> dict[str, bytes]:
        """Return the bytes of files about pairs of one split, such as lists of names, by path below its folder."""
        del keys, encodings
        return {}

    def links(self, keys: Sequence[Key]) -> dict[str, str]:
        """Return the targets of symbolic links, relative to the link's folder, by path below the split's folder."""
        del keys
        return {}

    def folders(self) -> tuple[str, ...]:
        """Return folders, below a split's folder, that loaders list even where they are empty."""
        return ()

    def folder(self, split: SplitName, splits: Collection[SplitName]) -> str:
        """Return a split's folder below the dataset's, "" or ending in a slash, in a dataset of these splits."""
        return "" if len(splits) == 1 else f"{split}/"

    def encodings_for(self, config: Config) -> Encodings:
        """Return the codecs for the pairs of a config in this layout."""
        return self.encodings_of(config.encodings, config.camera.colour)

    def encodings_of(self, chosen: Encodings, colour: Colour) -> Encodings:
        """Return the codecs in this layout, for the config's choice of encodings and the cameras' ``colour``."""
        encodings = chosen if self.encodings is None else replace(self.encodings, signed=chosen.signed)
        return encodings if colour == "rgb" else encodings.in_grey(three=self.three_channels)


def view_stems(names: Mapping[str, str], default: str) -> dict[str, str]:
    """Return the stem of each array of a frame by role, channel by channel; a stem is a path without its ending.

    Args:
        names: templates of stems by channel: ``{n}`` stands for 0 (left) or 1 (right), ``{view}`` for the view's name,
            and ``{L}`` for the name's first letter, as a capital.
        default: the template for channels that ``names`` lacks, in which ``{channel}`` also stands for the channel.
    """
    return {
        channel.role(eye): names.get(channel.name, default).format(
            channel=channel.name, n=EYES.index(eye), view=eye, L=eye[0].upper()
        )
        for channel in CHANNELS.values()
        for eye in EYES
    }


def scene_stems(names: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the names of a frame's arrays by role, in layouts that call the left view 0 and the right view 1.

    The first dictionary has the arrays of the pair's own moment. The second one has the arrays that compare it with
    another moment, view by view. ``names`` are templates as in `view_stems`, which override Middlebury's.
    """
    stems = view_stems({**_SCENE_NAMES, **names}, "{channel}{n}")
    flow = [channel.role(eye) for eye in EYES for channel in CHANNELS.values() if channel.moment != "now"]
    return {role: stem for role, stem in stems.items() if role not in flow}, {role: stems[role] for role in flow}


VERTICAL: dict[str, str] = {"disparity_y_left": "disp0y", "disparity_y_right": "disp1y"}
"""Middlebury's names for y_left - y_right in pairs that are not rectified."""

SHORT_SPLITS: Mapping[SplitName, str] = {"train": "train", "validation": "val", "test": "test"}
"""The splits' short names, as loaders' own lists of pairs have them."""


def pair_lines(pairs: Iterable[Mapping[str, str]]) -> bytes:
    """Return a list of pairs as loaders read it, from each pair's paths by role.

    A line has the paths of a pair's left image, right image and left disparity.
    """
    return "".join(f"{files['left']} {files['right']} {files['disparity_left']}\n" for files in pairs).encode()
