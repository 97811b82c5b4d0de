"""Writing a shard: the files of its pairs, then its record, which says that it is complete."""

import hashlib
import json
import tarfile
import time
from collections.abc import Iterable
from contextlib import ExitStack
from typing import IO, Any

from upath import UPath

from semisynth_gl.dataset.documents import Plan, Shard
from semisynth_gl.dataset.names import FORMAT, RECORDS, log_path, record_path, tar_path
from semisynth_gl.dataset.root import is_local, replace, write
from semisynth_gl.dataset.sample import EncodedPair
from semisynth_gl.listener import FinishedPair, Listener


def write_shard(
    root: UPath, plan: Plan, shard: Shard, pairs: Iterable[EncodedPair], listener: Listener | None = None
) -> bool:
    """Write the files of a shard's pairs, then its record; return whether the shard is complete.

    ``pairs`` are in order; an iterable that ends early leaves the shard without a record. The listener hears each pair
    once its files are written. Raises OSError where the disk is full or cannot be written to.
    """
    start, listener = time.perf_counter(), listener or Listener()
    packed, digest, size = plan.layout.packed, hashlib.sha256(), 0
    samples: list[dict[str, Any]] = []
    renderers: set[str] = set()
    with ExitStack() as resources:
        if packed:
            if is_local(root):
                (root / RECORDS).mkdir(parents=True, exist_ok=True)
            tar: IO[bytes] = resources.enter_context((root / tar_path(shard.name)).open("wb"))
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
            # All pairs of a sequence carry the same redraws.
            redrawn = [] if number % plan.config.sequence_pairs else pair.provenance.get("redrawn", [])
            facts = {"pair": number, "redrawn": redrawn, "share_beyond": pair.share_beyond}
            samples.append(facts | {"files": files})
            renderers.add(pair.provenance["renderer"])
            listener.on_pair(FinishedPair(shard.split, number, tuple(redrawn), pair.share_beyond))
        if len(samples) < shard.end - shard.first:
            return False
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
        **({"tar": tar_path(shard.name)} if packed else {}),
        "bytes": size,
        "sha256": digest.hexdigest(),
        "samples": samples,
    }
    write(root, log_path(shard.name), f"{json.dumps({'seconds': round(time.perf_counter() - start, 3)})}\n".encode())
    replace(root, record_path(shard.name), f"{json.dumps(record)}\n".encode())
    return True


def _tar_member(name: str, data: bytes) -> bytes:
    """Encode a file as a member of a tar, without time and owner, and with mode 0644.

    The header takes one block, as all readers know it, where the name has 100 characters or less.
    """
    info = tarfile.TarInfo(name)
    info.size = len(data)
    return b"".join((info.tobuf(tarfile.USTAR_FORMAT), data, bytes(-len(data) % tarfile.BLOCKSIZE)))
