"""What the cluster engine runs elsewhere: tasks in Ray's worker processes, and beside the driver the post between both.

Nothing here imports Ray before it runs: it is an extra.
"""

import atexit
import os
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from socket import gethostname
from time import monotonic
from typing import Any

from semisynth_gl.engines.task import Job, Task
from semisynth_gl.engines.worker import Done, Failed, Left, portable
from semisynth_gl.errors import ContextLostError

# How old the answer to "is a stop asked for?" may be.
_STOP_FRESH_S = 0.2


class Post:
    """An actor beside the driver: it gathers what tasks tell, and says whether they should go on."""

    def __init__(self) -> None:
        self._messages: list[object] = []
        self._notes: list[str] = []
        self._begun: Counter[int] = Counter()
        self._losses: dict[int, str] = {}
        self._stopping = False

    def begin(self, number: int) -> bool:
        """Note that a task begins; return whether it may."""
        if self._stopping:
            return False
        if self._begun[number]:
            reason = self._losses.get(number, "its worker or its node was lost")
            self._notes.append(f"task {number} is done again ({reason})")
        self._begun[number] += 1
        return True

    def tell(self, message: object) -> None:
        """Take a task's message."""
        self._messages.append(message)

    def lose(self, number: int, reason: str) -> None:
        """Note why a task's worker is about to end."""
        self._losses[number] = reason

    def collect(self) -> tuple[list[object], list[str]]:
        """Return messages and notes since the last call."""
        collected = self._messages, self._notes
        self._messages, self._notes = [], []
        return collected

    def stop(self) -> set[int]:
        """Let no further task begin; return all that have begun."""
        self._stopping = True
        return set(self._begun)

    def stopping(self) -> bool:
        """Whether tasks should return soon."""
        return self._stopping

    def reason(self, number: int) -> str | None:
        """Why a task's last worker ended, where it said so."""
        return self._losses.get(number)


def do_task(job: bytes, number: int, post: Any) -> Done | Left | Failed:  # noqa: ANN401 - an actor's handle has no type
    """Do one task in a Ray worker process.

    Args:
        job: as pickled by the driver; kept open for further tasks.
        number: the task's.
        post: the actor.
    """
    if not _answer(post.begin.remote(number)):
        return Left()
    try:
        return Done(_open(job)(number, _PostWatch(post)))
    except ContextLostError as error:
        _answer(post.lose.remote(number, str(error)))
        # Ray does the task again in another process. To close the job would ask the lost context once more.
        os._exit(1)
    except Exception as error:  # noqa: BLE001 - the driver raises it: as a result it keeps its type
        return Failed(portable(error, f"a worker on {gethostname()}"))
    finally:
        # Calls arrive in order: with the answer to any one all messages are there, before the result is.
        _answer(post.stopping.remote())


def _answer(reference: Any) -> Any:  # noqa: ANN401 - Ray's reference to whatever comes
    # ray.get would tell the scheduler that this worker is idle, and it would start another one in its place.
    return reference.future().result()


class _PostWatch:
    def __init__(self, post: Any) -> None:  # noqa: ANN401
        self._post = post
        self._stopping = False
        self._asked_at = monotonic()

    @property
    def stopping(self) -> bool:
        if not self._stopping and monotonic() - self._asked_at > _STOP_FRESH_S:
            self._stopping = _answer(self._post.stopping.remote())
            self._asked_at = monotonic()
        return self._stopping

    def tell(self, message: object) -> None:
        self._post.tell.remote(message)


@dataclass(frozen=True, slots=True)
class _Kept:
    """An open job: Ray lends a worker process to one task after the other."""

    job: bytes
    devices: str | None
    task: Task[Any]
    stack: ExitStack


_kept: list[_Kept] = []


def _open(job: bytes) -> Task[Any]:
    """Return the function of a job that is open; open it first if need be."""
    # Ray may give the process another GPU for the next task.
    devices = os.environ.get("CUDA_VISIBLE_DEVICES")
    if _kept and (_kept[0].job, _kept[0].devices) != (job, devices):
        _close()
    if not _kept:
        stack = ExitStack()
        task = stack.enter_context(_unpickled(job).open(0))
        _kept.append(_Kept(job, devices, task, stack))
    return _kept[0].task


def _unpickled(job: bytes) -> Job[Any]:
    from ray import cloudpickle  # noqa: PLC0415 - an extra

    opened: Job[Any] = cloudpickle.loads(job)
    return opened


@atexit.register
def _close() -> None:
    while _kept:
        with suppress(ContextLostError):
            _kept.pop().stack.close()
