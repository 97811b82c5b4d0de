"""A layout: the names of a dataset's files as templates, and the role of each file."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from semisynth_gl.codecs import Encodings
from semisynth_gl.config import Config
from semisynth_gl.frame.camera import EYES
from semisynth_gl.frame.channels import CHANNELS, MOTION_OUTPUTS, TruthViews
from semisynth_gl.layouts.roles import FILE_ROLES, FileRole
from semisynth_gl.seeds.splits import SplitName

_SHORT_SPLITS: Mapping[SplitName, str] = {"train": "train", "validation": "val", "test": "test"}


@dataclass(frozen=True, slots=True)
class PairKey:
    """The identity of a pair in a dataset; layouts name its files by it.

    Attributes:
        config: the config's name; letters, digits and hyphens.
        index: the pair's number in the split, from 0.
        sequence_length: see `sequence_length`; None if names do not show sequences.
        views: number of pairs that show each scene, see `semisynth_gl.config.Config.views`. Loaders see a sequence for
            each right view; its frames are every ``views``-th pair.
    """

    config: str
    split: SplitName
    index: int
    sequence_length: int | None = None
    views: int = 1

    @property
    def sequence(self) -> int:
        """The number of the sequence in which loaders see the pair; `index` where `sequence_length` is None."""
        if self.sequence_length is None:
            return self.index
        scene, view = divmod(self.index, self.views)
        return scene // self.sequence_length * self.views + view

    @property
    def frame(self) -> int:
        """The pair's number in its `sequence`, from 0; 0 where `sequence_length` is None."""
        return 0 if self.sequence_length is None else self.index // self.views % self.sequence_length

    @property
    def name(self) -> str:
        """The pair's name; up to a million pairs, names sort in the order of the indices."""
        return f"{self.config}-{self.index:06d}"


def sequence_length(config: Config) -> int | None:
    """Return the number of frames in a sequence of a dataset with flow; None without flow."""
    return config.sequence.length if MOTION_OUTPUTS.intersection(config.outputs) else None


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """The names of a dataset's files. A file's content follows from its role; see `semisynth_gl.layouts.roles`.

    Paths are templates for `str.format`, in which ``{name}``, ``{index}``, ``{sequence}``, ``{frame}`` and ``{split}``
    are attributes of the pair's `PairKey`, and ``{short_split}`` is train, val or test. The split's folder comes first.

    Attributes:
        stems: the path of each file of a pair by role, without the ending; inside the shard's tar if packed.
        fields: a function of the `PairKey` that returns more values for templates.
        lists: text files about a split: the template of a pair's line, by the file's path. In the line, a role such as
            ``{left}`` stands for the path of the pair's file. Duplicate lines are dropped.
        links: symbolic links by path; the target is relative to the link's folder.
        flow_links: more links, in datasets with an output of flow.
        folders: folders that loaders list even if they are empty.
        splits_in_root: splits whose files are in the dataset's root, not in a folder named after the split.
        roles: roles that this layout uses instead of those of `FILE_ROLES` with the same name.
        packed: whether the files of a shard are packed into one tar; else they are in folders.
        needs: outputs that every dataset in this layout must have.
        lacks: outputs for which the layout has no files, since none of its loaders could read them.
        encodings: the layout's own encodings; None where the config's section ``files`` chooses them.
        three_channels: whether grey images get three equal channels, for loaders that need three.
        most_frames: maximum number of frames that names allow in a sequence with flow; None for no limit.
    """

    stems: Mapping[str, str]
    fields: Callable[[PairKey], Mapping[str, object]] = lambda _: {}
    lists: Mapping[str, str] = field(default_factory=dict)
    links: Mapping[str, str] = field(default_factory=dict)
    flow_links: Mapping[str, str] = field(default_factory=dict)
    folders: tuple[str, ...] = ()
    splits_in_root: frozenset[SplitName] = frozenset()
    roles: Mapping[str, FileRole] = field(default_factory=dict)
    packed: bool = False
    needs: frozenset[str] = frozenset()
    lacks: frozenset[str] = frozenset()
    encodings: Encodings | None = None
    three_channels: bool = False
    most_frames: int | None = None

    def role(self, name: str) -> FileRole:
        """Return a role by its name; raises KeyError for an unknown name."""
        return self.roles.get(name) or FILE_ROLES[name]

    def files(
        self, key: PairKey, encodings: Encodings, outputs: Collection[str] | None = None, truth: TruthViews = "both"
    ) -> dict[str, str]:
        """Return the path of each file of a pair by role, below the split's folder or inside the shard's tar.

        Without ``outputs``, these are the files of all outputs. ``truth`` says which views have truth.
        """
        files, values = {}, self._values(key)
        for name, stem in self.stems.items():
            role = self.role(name)
            made = outputs is None or role.output is None or role.output in outputs
            if made and role.output not in self.lacks and (truth == "both" or role.eye != "right"):
                files[name] = f"{stem.format_map(values)}{role.codec(encodings).suffix}"
        return files

    def lists_of(self, keys: Sequence[PairKey], encodings: Encodings) -> dict[str, bytes]:
        """Return the bytes of a split's `lists` by path; ``keys`` are those of all its pairs."""
        texts = {}
        for path, line in self.lists.items():
            lines = dict.fromkeys(line.format_map(self._values(key) | self.files(key, encodings)) for key in keys)
            texts[path.format_map(self._values(keys[0]))] = "".join(lines).encode()
        return texts

    def links_of(self, keys: Sequence[PairKey]) -> dict[str, str]:
        """Return the targets of a split's links by path; ``keys`` are those of all its pairs."""
        templates = {**self.links, **(self.flow_links if keys[0].sequence_length else {})}
        return {
            path.format_map(values): target.format_map(values)
            for path, target in templates.items()
            for values in map(self._values, keys if "{" in path else keys[:1])
        }

    def folder(self, split: SplitName, splits: Collection[SplitName]) -> str:
        """Return a split's folder below the dataset's, "" or ending in a slash; ``splits`` are the dataset's splits."""
        return "" if len(splits) == 1 or split in self.splits_in_root else f"{split}/"

    def encodings_for(self, config: Config) -> Encodings:
        """Return the codecs for the pairs of a config in this layout."""
        files, signed = config.files, config.disparity.signed
        encodings = Encodings.from_names(files.image, files.disparity, files.flow, signed=signed)
        if self.encodings is not None:
            encodings = replace(self.encodings, signed=signed)
        return encodings if config.camera.colour == "rgb" else encodings.in_grey(three=self.three_channels)

    def _values(self, key: PairKey) -> dict[str, object]:
        names = ("name", "index", "sequence", "frame", "split")
        of_key = {name: getattr(key, name) for name in names} | {"short_split": _SHORT_SPLITS[key.split]}
        return of_key | dict(self.fields(key))


def view_stems(names: Mapping[str, str], default: str) -> dict[str, str]:
    """Return the template of each array of a frame by role, channel by channel.

    In templates, ``{n}`` stands for 0 (left) or 1 (right), ``{view}`` for the view's name, ``{L}`` for the name's first
    letter, as a capital, and ``{channel}`` for the channel. ``default`` is for channels that ``names`` lacks.
    """
    stems = {}
    for channel in CHANNELS.values():
        for number, eye in enumerate(EYES):
            stem = names.get(channel.name, default).replace("{channel}", channel.name).replace("{n}", str(number))
            stems[channel.role(eye)] = stem.replace("{view}", eye).replace("{L}", eye[0].upper())
    return stems
