"""Making shards: one process renders, encodes and writes the pairs of its shards, shard by shard."""

import hashlib
import json
import tarfile
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from math import ceil, prod
from typing import IO, Any

from upath import UPath

from semisynth_gl.dataset.documents import FORMAT, DatasetPlan, Shard
from semisynth_gl.dataset.pair_files import EncodedPair, encode_pair
from semisynth_gl.dataset.plan import differences, used_plugins
from semisynth_gl.dataset.root import open_root, replace, write
from semisynth_gl.frame.channels import ViewArrays
from semisynth_gl.inputs.errors import InputError, abbreviate
from semisynth_gl.listener import Listener
from semisynth_gl.pairs.pipeline import Pair, PairRenderer
from semisynth_gl.render import Backend, is_software
from semisynth_gl.render.devices import egl_index_of_worker
from semisynth_gl.seeds.splits import SplitName


@dataclass(frozen=True, slots=True)
class DatasetJob:
    """What each process needs to make shards: the dataset's plan and address, and the renderer's backend.

    ``gpus`` are CUDA's numbers of the GPUs, assigned to workers in turn; empty for the default of
    `egl_index_of_worker`.
    """

    plan: DatasetPlan
    address: str
    backend: Backend
    gpus: tuple[int, ...] = ()


class ShardMaker:
    """Makes shards in this process, which is worker ``worker``, with one renderer for successive shards of a split."""

    def __init__(self, job: DatasetJob, worker: int = 0) -> None:
        self._job = job
        self._worker = worker
        self._resources = ExitStack()
        self._renderer: PairRenderer | None = None

    def close(self) -> None:
        """Close the renderer."""
        self._resources.close()

    def make_shard(self, number: int, listener: Listener) -> str:
        """Render, encode and write the pairs of a shard, see `write_shard`; return the renderer's name.

        Raises:
            InputError: where this process has other plug-ins, photographs or models than those in the plan, or pairs
                keep failing the config's checks.
            ContextLostError: where the driver was reset; this process cannot render again.
        """
        plan, shard = self._job.plan, self._job.plan.shards[number]
        renderer = self._renderer_of(shard.split, listener)
        rendered = map(renderer.render, range(shard.first, shard.end))
        in_thread = not is_software(renderer.renderer_name)
        with closing(encoded_in_order(rendered, partial(encode, plan, shard), in_thread=in_thread)) as pairs:
            write_shard(open_root(self._job.address), plan, shard, pairs, listener)
        return renderer.renderer_name

    def _renderer_of(self, split: SplitName, listener: Listener) -> PairRenderer:
        if self._renderer is None or self._renderer.split.name != split:
            self._renderer = None  # so that no closed renderer stays if opening fails
            self._resources.close()
            plan = self._job.plan
            _check_same("plug-ins", plan.plugins, used_plugins(plan.config, plan.layout_name))
            renderer = self._resources.enter_context(open_renderer(self._job, split, self._worker))
            _check_same("photographs or models", plan.sources[split], renderer.sources.digests())
            renderer.forget_pixels()
            listener.on_renderer(renderer.renderer_name)
            self._renderer = renderer
        return self._renderer


def _check_same(what: str, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Raise InputError if this process finds other plug-ins or files than the process that began the dataset."""
    if changed := differences(there, here):
        raise InputError(
            f"this process finds other {what} than the run that began the dataset: {abbreviate(changed)}. Give all "
            "machines the same files and the same versions of packages"
        )


def open_renderer(job: DatasetJob, split: SplitName, worker: int = 0) -> PairRenderer:
    """Open the renderer of a split on the device of a worker; workers are numbered from 0."""
    return PairRenderer(job.plan.config, job.plan.split(split), job.backend, egl_index_of_worker(job.gpus, worker))


def encode(plan: DatasetPlan, shard: Shard, pair: Pair) -> EncodedPair:
    """Encode a pair of a shard."""
    ndisp = max(1, ceil(plan.config.disparity.max_px))
    key = plan.key(shard.split, pair.index)
    return encode_pair(plan.layout, key, pair.frame, pair.provenance, ndisp, plan.encodings)


def encoded_in_order(
    rendered: Iterable[Pair], encode: Callable[[Pair], EncodedPair], *, in_thread: bool
) -> Generator[EncodedPair, None, None]:
    """Encode pairs, and yield the results in order.

    With ``in_thread``, a second thread encodes a pair while this one, which owns the OpenGL context, renders the next.
    On a software renderer, one thread for both is faster.
    """
    if not in_thread:
        yield from map(encode, rendered)
        return
    with ThreadPoolExecutor(1) as pool:
        previous: Future[EncodedPair] | None = None
        for pair in rendered:
            current = pool.submit(encode, pair)
            if previous is not None:
                yield previous.result()
            previous = current
        if previous is not None:
            yield previous.result()


def write_shard(
    root: UPath, plan: DatasetPlan, shard: Shard, pairs: Iterable[EncodedPair], listener: Listener | None = None
) -> None:
    """Write the files of all pairs of a shard, which come in order; then its log, and at last its record.

    The listener is told of each pair whose files are written. Raises OSError if the disk is full or read-only.
    """
    start, listener = time.perf_counter(), listener or Listener()
    packed, digest, size = plan.layout.packed, hashlib.sha256(), 0
    samples: list[dict[str, Any]] = []
    renderers: set[str] = set()
    with ExitStack() as resources:
        if packed:
            tar: IO[bytes] = resources.enter_context((root / shard.tar).open("wb"))
        for number, pair in enumerate(pairs, shard.first):
            files: dict[str, dict[str, Any]] = {}
            for path, data in pair.files.items():
                if packed:
                    files[path] = {"bytes": len(data), "offset": size + tarfile.BLOCKSIZE}
                    stored = _tar_member(path, data)
                    tar.write(stored)
                    digest.update(stored)
                    size += len(stored)
                else:
                    name, sha256 = f"{plan.folder(shard.split)}{path}", hashlib.sha256(data).hexdigest()
                    files[name] = {"bytes": len(data), "sha256": sha256}
                    write(root, name, data)
                    digest.update(f"{sha256}  {name}\n".encode())  # as `sha256sum` writes it
                    size += len(data)
            # All pairs of a sequence have the same list: only the first pair's counts.
            redrawn = [] if number % plan.config.sequence_pairs else pair.provenance.get("redrawn", [])
            # The number of disparities that the encoding cannot store, in the view with more of them.
            beyond = max(pair.provenance.get(ViewArrays.disparity.beyond_key, {}).values(), default=0)
            share = beyond / prod(plan.size)
            samples.append({"pair": number, "redrawn": redrawn, "share_beyond": share, "files": files})
            renderers.add(pair.provenance["renderer"])
            listener.on_pair()
        if packed:  # two empty blocks, and padding to whole tar records
            end = bytes(2 * tarfile.BLOCKSIZE + -(size + 2 * tarfile.BLOCKSIZE) % tarfile.RECORDSIZE)
            tar.write(end)
            digest.update(end)
            size += len(end)
    record: dict[str, Any] = {
        "shard": shard.name,
        "format": FORMAT,
        "split": shard.split,
        "first": shard.first,
        "end": shard.end,
        "redraws": sum(len(sample["redrawn"]) for sample in samples),
        "renderers": sorted(renderers),
        **({"plugins": plan.plugins} if plan.plugins else {}),
        **({"tar": shard.tar} if packed else {}),
        "bytes": size,
        "sha256": digest.hexdigest(),
        "samples": samples,
    }
    write(root, shard.log, f"{json.dumps({'seconds': round(time.perf_counter() - start, 3)})}\n".encode())
    replace(root, shard.record, f"{json.dumps(record)}\n".encode())


def _tar_member(name: str, data: bytes) -> bytes:
    """Encode a file as a member of a tar, without time and owner, and with mode 0644.

    If the name has at most 100 characters, the header has one block, as all readers expect.
    """
    info = tarfile.TarInfo(name)
    info.size = len(data)
    return b"".join((info.tobuf(tarfile.USTAR_FORMAT), data, bytes(-len(data) % tarfile.BLOCKSIZE)))
