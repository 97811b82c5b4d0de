"""The engine that makes shards on a Ray cluster. Ray is an optional dependency, so it is imported when used."""

import logging
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import islice
from socket import create_connection
from typing import Any

from semisynth_gl.dataset.engines import keep_freed_memory, report_shard
from semisynth_gl.dataset.make import DatasetJob, ShardMaker
from semisynth_gl.inputs.errors import ContextLostError, InputError, WorkerError, how_to_install
from semisynth_gl.listener import Listener

_RETRIES = 3  # of a shard after the loss of its process or node
_WAIT_BATCH = 1000  # maximum number of shards in a call of `ray.wait`
_CONNECT_S = 5.0  # how long a cluster may take to accept a connection
# Ray sends no usage reports. It leaves CUDA_VISIBLE_DEVICES unchanged in tasks without GPUs: otherwise it would warn
# that this will become the default.
_ENVIRONMENT = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}


class RayEngine:
    """Makes shards on a Ray cluster; this package must be installed on each of its nodes.

    The cluster is the one of RAY_ADDRESS, else one that runs on this machine, else a new one on this machine that ends
    with the run. Each process uses a CPU and ``gpus`` GPUs; with 0.25, four processes share a GPU. A process sees only
    the GPUs that Ray assigned to it.
    """

    def __init__(self, gpus: float = 0) -> None:
        self._gpus = gpus

    def run(self, job: DatasetJob, numbers: Sequence[int], listener: Listener) -> None:
        """Make shards; see `Engine.run`.

        Raises:
            InputError: where Ray is missing or the cluster cannot be reached.
            WorkerError: where a shard's process died four times, or Ray reports a different failure.
        """
        ray = _ray()
        with _connected(ray):
            if self._gpus > max(node["Resources"].get("GPU", 0) for node in ray.nodes() if node["Alive"]):
                listener.on_message(f"no node of the cluster has {self._gpus:g} GPU: shards wait for such a node")
            # By default, Ray ends a process after one task with a GPU; max_calls=0 keeps it.
            make = ray.remote(num_cpus=1, num_gpus=self._gpus, max_retries=_RETRIES, max_calls=0)(_make)
            pickled = ray.put(ray.cloudpickle.dumps(job))
            pending = {make.remote(pickled, number): number for number in numbers}
            try:
                while pending:
                    (ready,), _ = ray.wait(list(islice(pending, _WAIT_BATCH)), num_returns=1)
                    number = pending.pop(ready)
                    report_shard(job, number, _result(ray, ready, number), listener)
            finally:
                with suppress(ray.exceptions.RayError):
                    for reference in pending:
                        ray.cancel(reference, force=True)


def _result(ray: Any, reference: Any, number: int) -> str:  # noqa: ANN401 - Ray has no types
    """Return the renderer's name from a task of `_make`, or raise the task's exception."""
    try:
        return str(ray.get(reference))
    except ray.exceptions.RayError as error:
        cause = getattr(error, "cause", None)
        if isinstance(cause, Exception) and not isinstance(cause, ray.exceptions.RayError):
            raise cause from error
        raise WorkerError(
            f"shard {number} could not be made: {str(error).strip()}. Complete shards stay on disk"
        ) from None


# The ShardMaker of the process's latest task, by job and CUDA_VISIBLE_DEVICES: Ray may change the GPUs between tasks.
_makers: dict[tuple[bytes, str | None], ShardMaker] = {}


def _make(job: bytes, number: int) -> str:
    """Make a shard in a Ray process; return the renderer's name."""
    from ray import cloudpickle  # noqa: PLC0415 - an extra

    key = job, os.environ.get("CUDA_VISIBLE_DEVICES")
    try:
        if key not in _makers:
            while _makers:
                _makers.popitem()[1].close()
            keep_freed_memory()
            _makers[key] = ShardMaker(cloudpickle.loads(job))
        return _makers[key].make_shard(number, Listener())
    except ContextLostError:
        os._exit(1)  # Ray makes the shard again in a new process


def _ray() -> Any:  # noqa: ANN401 - a module
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    try:
        import_module("ray.cloudpickle")
        return import_module("ray")
    except ImportError as error:
        raise InputError(
            f"the engine ray needs the package ray, which cannot be imported ({error}): "
            f"{how_to_install('ray')}; do so here and on all nodes, or choose another engine"
        ) from None


@contextmanager
def _connected(ray: Any) -> Iterator[None]:  # noqa: ANN401
    """Connect this process to the cluster during the block, unless it is connected already."""
    if ray.is_initialized():
        yield
        return
    address = os.environ.get("RAY_ADDRESS", "auto")
    try:
        host, _, port = address.rpartition(":")
        if port.isdigit() and "//" not in host:  # addresses of Ray's client have a scheme
            # Try first, since Ray would try for minutes if nothing listens there.
            create_connection((host.strip("[]"), int(port)), _CONNECT_S).close()
        on_sigterm = signal.getsignal(signal.SIGTERM)
        ray.init(log_to_driver=False, logging_level=logging.CRITICAL, include_dashboard=False)
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, on_sigterm)  # Ray replaces it
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(
            f"the Ray cluster (address {address}) cannot be reached ({error}). Is it running, and is this "
            "machine part of it? `ray status` shows it, `ray start` starts or joins a cluster"
        ) from error
    try:
        yield
    finally:
        ray.shutdown()
