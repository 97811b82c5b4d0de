"""`StereoStream` renders pairs while a network trains: a map-style PyTorch dataset without files."""

import os
from collections.abc import Sequence
from typing import Any, Literal, get_args

import torch
from torch.utils.data import get_worker_info

from semisynth_gl.augmentation.augmentation import Augmentation
from semisynth_gl.config import Config
from semisynth_gl.dataset.engines import LLVMPIPE_THREADS, threads_each
from semisynth_gl.frame.camera import Crop
from semisynth_gl.frame.frame import Frame
from semisynth_gl.inputs.arguments import check_one_of, check_type, to_whole
from semisynth_gl.inputs.errors import InputError, counted
from semisynth_gl.pairs.pipeline import PairRenderer
from semisynth_gl.render import BACKENDS, Backend
from semisynth_gl.render.devices import egl_index_of_worker
from semisynth_gl.render.readers import read_array
from semisynth_gl.seeds.seeds import LARGEST_NUMBER
from semisynth_gl.seeds.splits import SPLITS, SplitName
from semisynth_gl.torch.cuda_reader import CudaPixelReader
from semisynth_gl.torch.dataset import PairDatasetBase, Transform

TensorDevice = Literal["cpu", "cuda"]


class StereoStream(PairDatasetBase):
    """A map-style dataset, not an iterable one: ``stream[i]`` renders pair i of the dataset that `generate` writes.

    A sample is a dictionary, see `to_sample`. Each process opens a renderer for its first sample and keeps it; `close`
    releases it. Spawn workers: forked workers fail if this process has used OpenGL or CUDA. Samples may be accessed in
    any order, but pairs of one scene or sequence render faster one after the other.

    Args:
        config: the config of the pairs.
        seed: seed of all pairs, 0 or more.
        pairs: number of pairs, ``len(stream)``.
        split: the split that the pairs belong to.
        splits: names of all splits of the dataset. No photograph is used in two splits.
        crop: height and width, px, of a random crop of each pair; None for whole images. Crop and augmentation depend
            on the seed, the pair's sequence and the epoch.
        augmentation: changes of each pair, before the transform.
        checked: whether scenes that fail the config's checks are sampled again, as in a dataset. Without checks, crops
            are much faster, but the few pairs that fail the checks differ from the dataset's pairs.
        transform: a function of the sample; its result replaces the sample.
        backend: "auto", "egl" or "osmesa".
        gpus: CUDA's numbers of the GPUs that workers use in turn. The default is the first GPU of CUDA_VISIBLE_DEVICES
            or, where that is not set, EGL's first device; with device "cuda", it is torch's current GPU.
        device: "cpu", or "cuda" for tensors that never leave the GPU; "cuda" needs a DataLoader without workers.

    Raises:
        InputError: if an argument cannot be used.
    """

    def __init__(
        self,
        config: Config,
        seed: int,
        pairs: int,
        *,
        split: SplitName = "train",
        splits: Sequence[SplitName] = ("train",),
        crop: tuple[int, int] | None = None,
        augmentation: Augmentation | None = None,
        checked: bool = True,
        transform: Transform | None = None,
        backend: Backend = "auto",
        gpus: Sequence[int] = (),
        device: TensorDevice = "cpu",
    ) -> None:
        check_type("config", config, Config, "load_config(NAME_OR_PATH) reads one")
        seed = to_whole("seed", seed, least=0)
        self._pairs = to_whole("pairs", pairs, 1, LARGEST_NUMBER)
        self._config, self._checked = config, checked
        for each in splits:
            check_one_of("splits", each, SPLITS)
        check_one_of("split", split, splits)
        self._split = config.splits.split(split, splits, seed)
        self._gpus = tuple(to_whole("gpus", number, least=0) for number in gpus)
        check_one_of("backend", backend, BACKENDS)
        check_one_of("device", device, get_args(TensorDevice))
        self._backend, self._device = backend, device
        if device == "cuda":
            self._check_cuda(augmentation)
        self._renderer: PairRenderer | None = None
        self._reader: CudaPixelReader | None = None
        self._process = os.getpid()
        super().__init__((config.camera.height_px, config.camera.width_px), crop, augmentation, transform)

    def __len__(self) -> int:
        return self._pairs

    def __getitem__(self, number: int) -> Any:  # noqa: ANN401 - what the transform returns
        """Render a sample; its ``index`` is the pair's number in its split.

        Raises:
            InputError: if ``number`` is not a whole number, photographs or models cannot be used, or all attempts at
                the pair fail the config's checks.
            IndexError: if the stream has fewer pairs.
            BackendError: if OpenGL cannot be used.
        """
        index = to_whole("number", number)
        if not -self._pairs <= index < self._pairs:
            raise IndexError(f"expected one of {counted(self._pairs, 'pair')}, got number {index}")
        index %= self._pairs

        def render(crop: Crop | None) -> Frame:
            return self._open_renderer().render(index, crop=crop, checked=self._checked).frame

        return self._sample(index, index // self._config.sequence_pairs, self._split.seed, render)

    def __getstate__(self) -> dict[str, Any]:
        # Each worker opens a renderer.
        return self.__dict__ | {"_renderer": None, "_reader": None}

    def close(self) -> None:
        """Release this process's renderer; the next sample opens a new one."""
        if self._process == os.getpid():
            if self._reader is not None:
                self._reader.close()
            if self._renderer is not None:
                self._renderer.release()
        self._renderer = self._reader = None

    def _open_renderer(self) -> PairRenderer:
        """Return this process's renderer, opened at the first call."""
        if self._process != os.getpid():
            self._renderer, self._reader, self._process = None, None, os.getpid()
        if self._renderer is None:
            worker, gpus = get_worker_info(), self._gpus
            if worker is not None:
                os.environ.setdefault(LLVMPIPE_THREADS, str(threads_each(worker.num_workers)))
            if self._device == "cuda":
                if worker is not None:
                    raise InputError("device='cuda' needs num_workers=0: a worker cannot send tensors on a GPU")
                gpus = gpus or (torch.cuda.current_device(),)
                self._reader = CudaPixelReader(torch.device("cuda", gpus[0]))
            index = egl_index_of_worker(gpus, worker.id if worker is not None else 0)
            read = self._reader or read_array
            self._renderer = PairRenderer(self._config, self._split, self._backend, index, read)
            self._renderer.forget_pixels()
        return self._renderer

    def _check_cuda(self, augmentation: Augmentation | None) -> None:
        if self._checked or augmentation is not None or not self._config.images_as_rendered:
            raise InputError(
                "device='cuda' needs checked=False, no augmentation, and a config without a lens or imperfections, "
                "since these use main memory: change them, or use device='cpu' and pin_memory=True in the DataLoader"
            )
        if self._backend == "osmesa" or not torch.cuda.is_available():
            raise InputError("device='cuda' needs EGL and a GPU that torch finds: use device='cpu'")
