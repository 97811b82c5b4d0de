"""What a network is trained on: datasets and streams of this program, mixed, cropped and changed."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from semisynth_gl.augmentation import PRESETS, Augmentation
from semisynth_gl.config import load_config, packaged_configs
from semisynth_gl.config.yaml_values import MOST_BYTES, YamlError, read_yaml
from semisynth_gl.inputs.errors import InputError, SemisynthError, did_you_mean, near, shown
from semisynth_gl.inputs.user_files import expanded, read_file
from semisynth_gl.torch import StereoDataset, StereoMix, StereoStream

Sample = dict[str, Tensor]


def needed(sample: dict[str, Any]) -> Sample:
    """Drop what a sample has beside what is learnt from."""
    return {name: sample[name] for name in ("left", "right", "disparity_left")}


@dataclass(frozen=True, slots=True)
class Data:
    """What is trained on.

    Attributes:
        sources: names or files of configs, whose pairs are rendered, or folders of datasets; each with its share.
        settings: keys of the configs to override.
        crop: height and width, px.
        augmentation: changes of all pairs.
        batch: samples in each batch of a process.
        seed: of pairs, crops and changes.
    """

    sources: tuple[tuple[str, float], ...]
    settings: tuple[str, ...]
    crop: tuple[int, int]
    augmentation: Augmentation
    batch: int
    seed: int

    def samples(self, first: int = 0) -> StereoMix:
        """Open all sources as one, from a sample on.

        Raises:
            InputError: where one cannot be used.
        """
        parts = [(self._source(name), share) for name, share in self.sources]
        mix = StereoMix(parts, self.seed, first=first, batch_size=self.batch)
        # Otherwise workers would make batches in an order that depends on where the first one is.
        if mix.dealing.block != self.batch:
            raise InputError(
                f"--batch {self.batch}: expected a multiple of the pairs that stay together, sequence.length times "
                f"camera baselines, here {mix.source.together}; or give --set sequence.length=1"
            )
        return mix

    def _source(self, name: str) -> Dataset[Sample]:
        path = expanded(name)
        if path.is_dir():
            # A mix reads a dataset over and over, each time with other crops and changes, in another order.
            return StereoDataset(path, crop=self.crop, seed=self.seed, augmentation=self.augmentation, transform=needed)
        stem, known = name.removesuffix(".yaml"), packaged_configs()
        if not path.exists() and stem not in known:
            hint = did_you_mean(near(stem, known))
            raise InputError(
                f"--data {name}: there is neither a file nor a folder {path.absolute()}, nor a packaged config of that "
                f"name; {hint}{' ' if hint else ''}expected a dataset's folder, or a config: a YAML file, or one of: "
                f"{', '.join(known)}"
            )
        # A crop is rendered alone where the rest of its pair need not be looked at.
        stream: Dataset[Sample] = StereoStream(
            load_config(name, list(self.settings)),
            self.seed,
            crop=self.crop,
            augmentation=self.augmentation,
            checked=False,
            transform=needed,
        )
        return stream


def batches_of(data: Data, first: int, workers: int) -> Iterator[Sample]:
    """Put samples together from one on, with worker processes that read or render ahead.

    Raises:
        SemisynthError: where a sample cannot be made, on asking for its batch.
    """
    # Forked workers have no OpenGL once this process has used CUDA.
    context = "spawn" if workers and torch.cuda.is_initialized() else None
    loader: DataLoader[Sample] = DataLoader(
        data.samples(first), batch_size=data.batch, num_workers=workers, multiprocessing_context=context
    )
    try:
        yield from loader
    except (SemisynthError, RuntimeError) as error:
        # PyTorch puts the traceback of a worker before the message, and not all classes survive the way.
        found = re.search(rf"^{SemisynthError.__module__}\.\w+: (.*)", str(error), re.MULTILINE | re.DOTALL)
        if found is None:
            raise
        raise SemisynthError(found[1].strip()) from error


def read_sources(values: tuple[str, ...]) -> tuple[tuple[str, float], ...]:
    """Split each ``NAME=SHARE``; without ``=SHARE``, the share is 1."""
    sources = []
    for value in values:
        name, given, share = value.rpartition("=")
        try:
            sources.append((name, float(share)) if given else (value, 1.0))
        except ValueError:
            raise InputError(f"--data {value}: expected a number after =, the share, got {share}") from None
    return tuple(sources)


def with_augmentation(message: str, value: str) -> str:
    """Return a message, after the option --augment with its value where the message begins with keys of it."""
    keys = message.partition(":")[0].split(", ")
    return f"--augment {value}: {message}" if {*keys} <= {each.name for each in fields(Augmentation)} else message


def read_augmentation(value: str) -> Augmentation:
    """Return a preset by its name, or the keys of a YAML file.

    Raises:
        InputError: where it is neither, or keys or values cannot be used, with a line for each.
    """
    if value in PRESETS:
        return PRESETS[value]
    try:
        values, lines = read_yaml(read_file(expanded(value), MOST_BYTES).decode("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        hint = did_you_mean(near(value, PRESETS))
        raise InputError(
            f"--augment {value}: {hint}{' ' if hint else ''}expected {', '.join(PRESETS)}, or a YAML file with keys of "
            f"Augmentation: {error.strerror if isinstance(error, OSError) else error}"
        ) from None
    except YamlError as error:
        raise InputError(f"--augment {value}{f':{error.line}' if error.line else ''}: {error}") from None
    if not isinstance(values, dict):
        raise InputError(
            f"--augment {value}:1: expected keys of Augmentation, such as noise: [0, 3], got {shown(values)}"
        )
    known = sorted(each.name for each in fields(Augmentation))
    faults = []
    for key, given in values.items():
        at = f"--augment {value}:{lines[key,]}"
        if key not in known:
            hint = did_you_mean(near(key, known), f"expected one of: {', '.join(known)}")
            faults.append(f"{at}: {key}: unknown key; {hint}")
            continue
        try:
            Augmentation(**{key: given})
        except InputError as error:
            faults.append(f"{at}: {error}")
    if faults:
        raise InputError("\n".join(faults))
    return Augmentation(**values)
