"""Writing a shard: the files of its pairs, then its record, which says that it is complete."""

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from tempfile import NamedTemporaryFile
from typing import Any, NamedTuple

from upath import UPath

from semisynth_gl.dataset.documents import Plan, Shard
from semisynth_gl.dataset.names import FORMAT, log_path, record_path, tar_path
from semisynth_gl.dataset.root import is_local, replace, write
from semisynth_gl.dataset.tar import tar_end, tar_member


class PairFiles(NamedTuple):
    """A pair as files.

    Attributes:
        files: the files' bytes by path, below the split's folder or inside the tar.
        redrawn: why each earlier attempt failed its checks; only the first frame of a sequence has these reasons.
        share_beyond: share of the pixels whose disparity the encoding cannot store, in the view with the larger share.
        renderer: the driver's name of the renderer.
    """

    files: Mapping[str, bytes]
    redrawn: list[str]
    share_beyond: float
    renderer: str


def write_shard(
    root: UPath,
    plan: Plan,
    shard: Shard,
    pairs: Iterable[PairFiles],
    on_pair: Callable[[int, PairFiles], object] = lambda *_: None,
) -> bool:
    """Write the files of a shard's pairs, then its record.

    Args:
        root: the dataset's root.
        plan: its plan.
        shard: the shard.
        pairs: the shard's pairs, in order; an iterable that ends early leaves the shard without a record.
        on_pair: called with the number of each pair in its split once its files are written.

    Returns:
        Whether the shard is complete.

    Raises:
        OSError: where the disk is full or cannot be written to.
    """
    start = time.perf_counter()
    samples: list[dict[str, Any]] = []
    renderers: set[str] = set()
    with ExitStack() as resources:
        store = _Tar(root, shard, resources) if plan.layout.packed else _Folder(root, plan.folder(shard.split))
        for pair in pairs:
            number = shard.first + len(samples)
            files = store.add(pair.files)
            facts = {"pair": number, "redrawn": pair.redrawn, "share_beyond": pair.share_beyond}
            samples.append(facts | {"files": files})
            renderers.add(pair.renderer)
            on_pair(number, pair)
        if len(samples) < shard.end - shard.first:
            return False
        size, digest = store.finish()
    record: dict[str, Any] = {
        "shard": shard.name,
        "format": FORMAT,
        "split": shard.split,
        "first": shard.first,
        "end": shard.end,
        "redraws": sum(len(sample["redrawn"]) for sample in samples),
        "renderers": sorted(renderers),
        **({"plugins": plan.plugin_records} if plan.plugins else {}),
        **({"tar": tar_path(shard.name)} if plan.layout.packed else {}),
        "bytes": size,
        "sha256": digest,
        "samples": samples,
    }
    write(root, log_path(shard.name), f"{json.dumps({'seconds': round(time.perf_counter() - start, 3)})}\n".encode())
    replace(root, record_path(shard.name), f"{json.dumps(record)}\n".encode())
    return True


class _Folder:
    """Files in folders; the shard's digest is that of the lines that `sha256sum` writes."""

    def __init__(self, root: UPath, folder: str) -> None:
        self._root = root
        self._folder = folder
        self._size = 0
        self._digest = hashlib.sha256()

    def add(self, files: Mapping[str, bytes]) -> dict[str, dict[str, Any]]:
        described = {}
        for path, data in files.items():
            name = f"{self._folder}{path}"
            write(self._root, name, data)
            sha256 = hashlib.sha256(data).hexdigest()
            described[name] = {"bytes": len(data), "sha256": sha256}
            self._size += len(data)
            self._digest.update(f"{sha256}  {name}\n".encode())
        return described

    def finish(self) -> tuple[int, str]:
        return self._size, self._digest.hexdigest()


class _Tar:
    """Files in the tar of a shard; a store gets the tar as a whole."""

    def __init__(self, root: UPath, shard: Shard, resources: ExitStack) -> None:
        self._root = root
        self._path = root / tar_path(shard.name)
        if is_local(root):
            self._path.parent.mkdir(parents=True, exist_ok=True)
        file = self._path.open("wb") if is_local(root) else NamedTemporaryFile()  # noqa: SIM115 - entered below
        self._file: Any = resources.enter_context(file)
        self._size = 0
        self._digest = hashlib.sha256()

    def add(self, files: Mapping[str, bytes]) -> dict[str, dict[str, Any]]:
        described = {}
        for name, data in files.items():
            member, offset = tar_member(name, data)
            described[name] = {"bytes": len(data), "offset": self._size + offset}
            self._write(member)
        return described

    def finish(self) -> tuple[int, str]:
        self._write(tar_end(self._size))
        if not is_local(self._root):
            self._file.flush()
            self._root.fs.put_file(self._file.name, self._path.path)
        return self._size, self._digest.hexdigest()

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._digest.update(data)
        self._size += len(data)
