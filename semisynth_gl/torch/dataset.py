"""Written pairs for a training loop: `StereoDataset`, which reads any layout."""

from os import PathLike
from typing import Any

from semisynth_gl.augmentation import Augmentation
from semisynth_gl.dataset.reader import open_dataset
from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.arguments import to_whole
from semisynth_gl.seeds.splits import Split, SplitName
from semisynth_gl.torch.samples import PairDataset, Transform


class StereoDataset(PairDataset):
    """The pairs of a written dataset, in any layout: ``dataset[i]`` equals the sample of a `StereoStream`.

    A sample is a dictionary, see `to_sample`. Files are read when a sample is asked for, and no file stays open, so the
    dataset can be pickled, and workers may be forked or spawned. It needs no OpenGL.

    Args:
        address: the dataset's folder, or an address that fsspec knows.
        split: a split of the dataset; None for all pairs, training pairs first.
        crop: height and width, px: cut a crop out of each pair; None for whole images.
        seed: decides, with the pair's sequence and the epoch, the crops and the augmentation; by default the seed of
            the dataset, with which they are those of `StereoStream`.
        augmentation: changes of each pair, before the transform.
        transform: a function that gets the sample and returns the object to use instead.

    Attributes:
        pairs: the dataset as `open_dataset` opens it: ``dataset.pairs[i].provenance`` says how a pair was made.

    Raises:
        InputError: where the address has no dataset, the dataset is not finished or has no such split, or an argument
            cannot be used.
        ReadError: where the dataset's index is damaged.
    """

    def __init__(
        self,
        address: str | PathLike[str],
        split: SplitName | None = "train",
        *,
        crop: tuple[int, int] | None = None,
        seed: int | None = None,
        augmentation: Augmentation | None = None,
        transform: Transform | None = None,
    ) -> None:
        self.pairs = open_dataset(address, split)
        plan = self.pairs.about.plan
        self._seed = plan.seed if seed is None else to_whole("seed", seed, least=0)
        self._pairs_in_sequence = plan.config.sequence.length * plan.views
        super().__init__(plan.size, crop, augmentation, transform)

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, number: int) -> Any:  # noqa: ANN401 - what the transform returns
        """Read a sample; its ``index`` is the pair's number in its split.

        Raises:
            InputError: where the number is not a whole number, or a codec needs a package that is not installed.
            IndexError: where the dataset has fewer pairs.
            ReadError: where a file is missing, cut off or cannot be read.
        """
        split, index = self.pairs.pair(number)

        def read(crop: Crop | None) -> Frame:
            frame = self.pairs[number]
            return frame if crop is None else frame.cropped(crop)

        return self._sample(index, index // self._pairs_in_sequence, Split(self._seed, split).seed, read)
