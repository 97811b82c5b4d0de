"""The parts of the cluster engine that run in other processes: tasks in Ray's workers, and the `Post` on this machine.

Ray is an extra, so it is imported only where it runs.
"""

import atexit
import os
from collections import Counter
from contextlib import ExitStack, suppress
from socket import gethostname
from time import monotonic
from typing import Any

from semisynth_gl.engines.task import Call, Job, Relay, Task
from semisynth_gl.engines.worker import Failed, Finished, NotBegun, portable
from semisynth_gl.inputs.errors import ContextLostError

# Age at which the answer to "should the task stop?" is asked for again.
_STOP_FRESH_S = 0.2


class Post:
    """An actor on the driver's node, which gathers the tasks' calls of the listener and passes requests to stop on."""

    def __init__(self) -> None:
        self._calls: list[Call] = []
        self._begun: Counter[int] = Counter()
        self._reasons: dict[int, str] = {}
        self._stopping = False

    def begin(self, number: int) -> bool:
        """Record that a task begins; return False if it must not, because of a stop."""
        if self._stopping:
            return False
        if self._begun[number]:
            reason = self._reasons.get(number, "its worker or its node was lost")
            self.add(Call("on_message", f"task {number} is done again ({reason})"))
        self._begun[number] += 1
        return True

    def add(self, call: Call) -> None:
        """Keep a call of the listener until it is collected."""
        self._calls.append(call)

    def collect(self) -> list[Call]:
        """Return the calls since the last collection."""
        calls, self._calls = self._calls, []
        return calls

    def stop(self) -> set[int]:
        """Let no further task begin; return the numbers of the tasks that have begun, finished ones too."""
        self._stopping = True
        return set(self._begun)

    def stopping(self) -> bool:
        """Return whether tasks should return soon."""
        return self._stopping

    def break_worker(self, number: int, reason: str) -> None:
        """Record why the worker of a task is about to end."""
        self._reasons[number] = reason

    def reason(self, number: int) -> str | None:
        """Return why the last worker of a task ended, if the worker gave a reason."""
        return self._reasons.get(number)


def do_task(job: bytes, number: int, post: Any) -> Finished | NotBegun | Failed:  # noqa: ANN401 - an actor's handle has no type
    """Do one task of a pickled job in a Ray worker process, where the job stays open; ``post`` is a handle of a `Post`.

    A lost OpenGL context ends the process.
    """
    if not _answer(post.begin.remote(number)):
        return NotBegun()
    try:
        return Finished(_open(job)(number, _PostRelay(post)))
    except ContextLostError as error:
        _answer(post.break_worker.remote(number, str(error)))
        # Ray does the task again in another process. Closing the job would use the broken context again.
        os._exit(1)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - the driver raises it: as a result it keeps its type
        return Failed(portable(error, f"a worker on {gethostname()}"))
    finally:
        # Calls of an actor arrive in order. So, once the post answers, it has all calls of the task; and the answer
        # comes before the driver gets the task's result.
        _answer(post.stopping.remote())


def _answer(reference: Any) -> Any:  # noqa: ANN401 - Ray's reference to whatever comes
    # ray.get would tell the scheduler that this worker is idle, and Ray would start another worker in its place.
    return reference.future().result()


class _PostRelay(Relay):
    """Passes a task's calls to the post, and asks the post whether to stop."""

    def __init__(self, post: Any) -> None:  # noqa: ANN401
        super().__init__(post.add.remote)
        self._post = post
        self._asked_at = monotonic()

    @property
    def stopping(self) -> bool:
        if not self._stopping and monotonic() - self._asked_at > _STOP_FRESH_S:
            self._stopping = _answer(self._post.stopping.remote())
            self._asked_at = monotonic()
        return self._stopping


# The task function and the resources of the open job, by the job's bytes and the process's GPUs. Ray uses a worker
# process for one task after the other, and may give it another GPU for the next task.
_open_jobs: dict[tuple[bytes, str | None], tuple[Task[Any], ExitStack]] = {}


def _open(job: bytes) -> Task[Any]:
    """Return the job's task function; open the job if it is not open, and close another one."""
    key = job, os.environ.get("CUDA_VISIBLE_DEVICES")
    if key not in _open_jobs:
        _close()
        from ray import cloudpickle  # noqa: PLC0415 - an extra

        unpickled: Job[Any] = cloudpickle.loads(job)
        resources = ExitStack()
        _open_jobs[key] = resources.enter_context(unpickled.open(0)), resources
    return _open_jobs[key][0]


@atexit.register
def _close() -> None:
    while _open_jobs:
        _, (_, resources) = _open_jobs.popitem()
        with suppress(ContextLostError):
            resources.close()
