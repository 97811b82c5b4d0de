"""An engine that runs tasks on a Ray cluster."""

import logging
import os
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import islice
from socket import create_connection
from time import monotonic
from typing import Any, Generic

from semisynth_gl.engines.cluster_worker import Post, do_task
from semisynth_gl.engines.interrupts import interrupts_kept, interrupts_wait
from semisynth_gl.engines.task import Job, Result
from semisynth_gl.engines.worker import Failed, Finished
from semisynth_gl.inputs.errors import InputError, WorkerError, how_to_install
from semisynth_gl.listener import Listener

# How often Ray repeats a task after the loss of its worker or node.
_RETRIES = 3
# Submitted tasks for each task that can run at a time: enough that no worker waits, few enough to stop soon.
_AHEAD = 2
# How long the other workers may go on with their tasks after an error.
_GRACE_S = 5.0
# How soon a request to stop is noticed, and how often the tasks' calls of the listener are fetched.
_TICK_S = 0.2
_COLLECT_S = 0.5
# How long a cluster may take to accept a connection.
_KNOCK_S = 5.0
# Unless told otherwise, Ray reports usage to its makers. Without the second variable, Ray warns of a coming change in
# how it hides GPUs from tasks that ask for none.
_ENVIRONMENT = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}


class RayEngine:
    """Runs tasks on a Ray cluster; this package must be installed on each of its nodes.

    Ray schedules the tasks, starts their processes, and repeats a task after the loss of its node or process. Each
    process opens the job once, as worker 0, since Ray shows each process only the GPUs that it may use.

    Args:
        address: ``host:port`` of a cluster that this machine is part of, or "auto" for a cluster that was started on
            this machine. None takes the cluster of RAY_ADDRESS, else one that was started on this machine, else it
            starts a cluster of this machine alone and shuts it down at the end.
        gpus: number of GPUs that each task takes besides a CPU; 0.25 lets four tasks share a GPU.
    """

    def __init__(self, address: str | None = None, gpus: float = 0) -> None:
        self._address = address
        self._gpus = gpus

    def run(
        self, job: Job[Result], tasks: Iterable[int], listener: Listener
    ) -> Generator[tuple[int, Result], None, None]:
        """Do all tasks; see `Engine.run`.

        Raises:
            InputError: where Ray is missing or the cluster cannot be reached.
            WorkerError: where a task has ended four workers, or where Ray reports another failure.
        """
        ray = _ray()
        with _connected(ray, self._address):
            submission: _Submission[Result] = _Submission(ray, job, self._gpus, listener)
            try:
                yield from submission.results(iter(tasks))
            finally:
                submission.cancel()


class _Submission(Generic[Result]):
    """The tasks of one run, as submitted to Ray."""

    def __init__(self, ray: Any, job: Job[Result], gpus: float, listener: Listener) -> None:  # noqa: ANN401 - a module
        self._ray = ray
        self._needs = {"CPU": 1.0} | ({"GPU": gpus} if gpus else {})
        self._listener = listener
        here = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(
            ray.get_runtime_context().get_node_id(), soft=False
        )
        self._post = ray.remote(num_cpus=0, scheduling_strategy=here)(Post).remote()
        # Ray ends a process after one task with a GPU unless max_calls says that it may do many.
        self._do = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=_RETRIES, max_calls=0)(do_task)
        # Pickled once, since a worker recognises the job that it has open by equal bytes.
        self._job = ray.put(ray.cloudpickle.dumps(job))
        self._pending: dict[Any, int] = {}
        self._collected_at = monotonic()
        self._failure: Exception | None = None
        self._waits = False

    def results(self, numbers: Iterator[int]) -> Iterator[tuple[int, Result]]:
        latest = float("inf")
        begun: set[int] | None = None  # known once no further task begins
        while monotonic() < latest:
            if begun is None and (self._listener.stopping or self._failure):
                begun = self._ray.get(self._post.stop.remote())
            if self._failure:
                latest = min(latest, monotonic() + _GRACE_S)
            if begun is None:
                self._submit(numbers)
            if not (self._pending if begun is None else begun.intersection(self._pending.values())):
                break
            results = list(self._receive())
            if monotonic() - self._collected_at > _COLLECT_S:
                self._collect()
            yield from results
        self._collect()
        if self._failure:
            raise self._failure

    def cancel(self) -> None:
        """End all pending tasks at once."""
        with suppress(self._ray.exceptions.RayError):
            for reference in self._pending:
                self._ray.cancel(reference, force=True)
            self._ray.kill(self._post)

    def _submit(self, numbers: Iterator[int]) -> None:
        slots = self._slots()
        if not slots and not self._waits:
            self._waits = True
            needs = " and ".join(f"{count:g} {kind}" for kind, count in self._needs.items())
            self._listener.on_message(f"no node of the cluster has {needs}: tasks wait until such a node joins")
        # One task is submitted even if no node can run it, since clusters that grow by themselves start nodes for
        # waiting tasks. After the loss of a node, more tasks may be pending than the other nodes can run.
        for number in islice(numbers, max(max(_AHEAD * slots, 1) - len(self._pending), 0)):
            self._pending[self._do.remote(self._job, number, self._post)] = number

    def _slots(self) -> int:
        """Return how many tasks can run at a time."""
        nodes = [node["Resources"] for node in self._ray.nodes() if node["Alive"]]
        needs = self._needs.items()
        return sum(min(int(node.get(kind, 0) / count + 1e-6) for kind, count in needs) for node in nodes)

    def _receive(self) -> Iterator[tuple[int, Result]]:
        """Wait for results for a moment; yield the number and result of each finished task."""
        self._ray.wait(list(self._pending), num_returns=1, timeout=_TICK_S)
        ready, _ = self._ray.wait(list(self._pending), num_returns=len(self._pending), timeout=0)
        for reference in ready:
            number = self._pending.pop(reference)
            try:
                outcome = self._ray.get(reference)
            except self._ray.exceptions.RayError as error:
                self._failure = self._failure or self._error(number, error)
                continue
            if isinstance(outcome, Failed):
                self._failure = self._failure or outcome.error
            elif isinstance(outcome, Finished):
                yield number, outcome.result

    def _error(self, number: int, error: Exception) -> Exception:
        cause = getattr(error, "cause", None)
        if isinstance(cause, Exception) and not isinstance(cause, self._ray.exceptions.RayError):
            return cause
        reason = self._ray.get(self._post.reason.remote(number)) or str(error).strip()
        return WorkerError(
            f"task {number} could not be done in {_RETRIES + 1} attempts; the last one failed because: {reason}. "
            "Finished files stay on disk"
        )

    def _collect(self) -> None:
        calls = self._ray.get(self._post.collect.remote())
        self._collected_at = monotonic()
        for call in calls:
            call.repeat(self._listener)


def _ray() -> Any:  # noqa: ANN401 - a module
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    try:
        with interrupts_wait():
            import_module("ray.util.scheduling_strategies")
            import_module("ray.cloudpickle")
            return import_module("ray")
    except ImportError as error:
        raise InputError(
            f"the engine ray needs the package ray, which cannot be imported ({error}): "
            f"{how_to_install('ray')}; do so here and on all nodes, or choose another engine"
        ) from None


@contextmanager
def _connected(ray: Any, address: str | None) -> Iterator[None]:  # noqa: ANN401
    """Connect this process to the cluster for the block, unless it is connected already."""
    if ray.is_initialized():
        yield
        return
    if address and "://" in address:
        raise InputError(
            f"the Ray cluster's address: expected host:port or auto, got {address}. Run this on a node of the "
            "cluster, or with: ray job submit"
        )
    where = address or os.environ.get("RAY_ADDRESS") or "auto"
    try:
        host, _, port = where.rpartition(":")
        if port.isdigit():
            # Without this, Ray would try for minutes to reach an address where nothing listens.
            create_connection((host.strip("[]"), int(port)), _KNOCK_S).close()
        with interrupts_kept():
            ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL, include_dashboard=False)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(
            f"the Ray cluster (address {where}) cannot be reached ({error}). Is it running, and is this "
            "machine part of it? `ray status` tells, `ray start` starts or joins one"
        ) from error
    try:
        yield
    finally:
        ray.shutdown()
