"""A process that only reads models, so that no file can exhaust the main process's memory or time, or crash it.

How much a file takes to read cannot be told beforehand: trimesh has some twenty readers, its own and those of other
packages, and a few bytes may stand for parts without end. The operating system's limits hold for all readers.
"""

import ctypes
import json
import os
import resource
import signal
import subprocess
import sys
from contextlib import suppress
from io import BufferedReader
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, cast

import numpy as np
from numpy.typing import NDArray

from semisynth_gl.geometry.model_parts import BrokenModelError, Part, PlacedParts
from semisynth_gl.inputs.errors import WorkerError

MAX_MEMORY = 4 << 30
"""Most bytes of memory that reading one model may take, in the process that reads."""

MAX_CPU_S = 120
"""Most seconds of processor time that reading one model may take; the time on the clock depends on what else runs."""

_DECIMATE = "decimate the model, for example in MeshLab or Blender, or save it as .glb"
_TOO_MUCH_MEMORY = f"takes more than {MAX_MEMORY >> 30} GiB of memory to read: {_DECIMATE}"
_TOO_MUCH_TIME = f"takes more than {MAX_CPU_S} s of a processor's time to read: {_DECIMATE}"
_CRASHED = "crashes its reader"

PASSING = (_TOO_MUCH_MEMORY, _TOO_MUCH_TIME, _CRASHED)
"""Beginnings of the reasons for leaving a model out that may be gone the next time; they are not cached."""

_PR_SET_PDEATHSIG = 1


class ModelReader:
    """Reads models in another process, which runs as long as the ``with`` block; it is started anew after a crash."""

    formats: frozenset[str]
    """File name suffixes that trimesh knows, in lower case without the leading dot."""

    def __enter__(self) -> Self:
        self._start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._ended()

    def read(self, path: Path) -> PlacedParts:
        """Read the parts of a model's file, as `model_reader.read_parts` does.

        Raises BrokenModelError where that raises it, and where reading exceeds `MAX_MEMORY` or `MAX_CPU_S`, or crashes.
        """
        try:
            return self._answer(path)
        except (BrokenPipeError, EOFError):
            code = self._ended()
            self._start()
            reason = _TOO_MUCH_TIME if code == -signal.SIGXCPU else f"{_CRASHED} ({_ending(code)})"
            raise BrokenModelError(reason) from None

    def _start(self) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - this interpreter and this module
            # -P: no module is imported from the current folder, whatever its files are called.
            [sys.executable, "-P", "-c", f"from {__name__} import serve; serve({MAX_MEMORY}, {MAX_CPU_S})"],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            process_group=0,  # Ctrl-C reaches only this process, which then ends the other process
        )
        greeting = cast("BufferedReader", self._process.stdout).readline()
        if not greeting:
            raise WorkerError(f"the process that reads models did not start ({_ending(self._ended())})")
        self.formats = frozenset(json.loads(greeting))

    def _ended(self) -> int:
        """Close the pipes of a process that is ending, wait for it, and return its exit code."""
        with suppress(BrokenPipeError), self._process:
            pass
        return self._process.returncode

    def _answer(self, path: Path) -> PlacedParts:
        """Ask for a file's parts; raises BrokenPipeError or EOFError where the process ends without an answer."""
        questions, stream = cast("BinaryIO", self._process.stdin), cast("BufferedReader", self._process.stdout)
        questions.write(f"{json.dumps(str(path))}\n".encode())
        questions.flush()
        header = stream.readline()
        if not header.endswith(b"\n"):
            raise EOFError
        answer = json.loads(header)
        if "reason" in answer:
            raise BrokenModelError(answer["reason"])
        parts = tuple(
            Part(
                _received(stream, (vertices, 3), np.float64),
                _received(stream, (triangles, 3), np.int64),
                _received(stream, (vertices, 2), np.float64) if has_uv else None,
            )
            for vertices, triangles, has_uv in answer["parts"]
        )
        placed = _received(stream, (answer["placed"],), np.int64)
        return PlacedParts(parts, placed, _received(stream, (answer["placed"], 4, 4), np.float64))


def serve(max_memory: int, max_cpu_s: int) -> None:
    """Answer the questions of a `ModelReader`, from standard input to standard output, until the input ends.

    ``max_memory`` is in bytes, on top of the memory that this process has when it starts. ``max_cpu_s`` holds for each
    model.
    """
    from semisynth_gl.geometry.model_reader import FORMATS, read_parts  # noqa: PLC0415  # trimesh loads only in this process

    # Ends this process with its parent: while it reads a model, nothing else tells it that the parent was killed.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
    answers = os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "wb") as nowhere:  # noqa: PTH123 - a device
        for stream in (1, 2):  # readers may print
            os.dup2(nowhere.fileno(), stream)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    _lower_limit(resource.RLIMIT_AS, pages * resource.getpagesize() + max_memory)
    _lower_limit(resource.RLIMIT_CORE, 0)
    answers.write(f"{json.dumps(sorted(FORMATS))}\n".encode())
    answers.flush()
    for question in sys.stdin.buffer:
        used = resource.getrusage(resource.RUSAGE_SELF)
        _lower_limit(resource.RLIMIT_CPU, int(used.ru_utime + used.ru_stime) + 1 + max_cpu_s)
        try:
            read = read_parts(Path(json.loads(question)))
        except BrokenModelError as error:
            _send(answers, {"reason": str(error)})
        except MemoryError:
            _send(answers, {"reason": _TOO_MUCH_MEMORY})
        else:
            sizes = [(len(part.vertices), len(part.triangles), part.uv is not None) for part in read.parts]
            arrays = [array for part in read.parts for array in (part.vertices, part.triangles, part.uv)]
            header = {"parts": sizes, "placed": len(read.placed)}
            _send(answers, header, *arrays, read.placed, read.scene_from_part)


def _lower_limit(kind: int, limit: int) -> None:
    """Set a limit of this process, but never above its hard limit."""
    _, most = resource.getrlimit(kind)
    resource.setrlimit(kind, (limit if most == resource.RLIM_INFINITY else min(limit, most), most))


def _send(stream: BinaryIO, header: dict[str, Any], *arrays: NDArray[Any] | None) -> None:
    stream.write(f"{json.dumps(header)}\n".encode())
    stream.writelines(_bytes(np.ascontiguousarray(array)) for array in arrays if array is not None)
    stream.flush()


def _received(stream: BufferedReader, shape: tuple[int, ...], kind: type[np.generic]) -> NDArray[Any]:
    array = np.empty(shape, kind)
    if stream.readinto(_bytes(array)) < array.nbytes:
        raise EOFError
    return array


def _bytes(array: NDArray[Any]) -> memoryview:
    return array.reshape(-1).view(np.uint8).data


def _ending(code: int) -> str:
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"
