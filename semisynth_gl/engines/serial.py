"""An engine without workers: everything happens in this process."""

from collections.abc import Generator, Iterable
from contextlib import ExitStack, suppress

from semisynth_gl.engines.task import Job, Result, Task
from semisynth_gl.errors import ContextLostError
from semisynth_gl.listener import Listener

# How often a task is repeated after a loss of its context.
_RETRIES = 2


class SerialEngine:
    """Does one task after the other in this process; the first task opens the job."""

    def run(
        self, job: Job[Result], tasks: Iterable[int], listener: Listener
    ) -> Generator[tuple[int, Result], None, None]:
        """Do all tasks; see `Engine.run`.

        Raises:
            ContextLostError: where a task loses its context in every attempt.
        """
        task: Task[Result] | None = None
        with ExitStack() as resources:
            for number in tasks:
                if listener.stopping:
                    return
                for attempt in range(_RETRIES + 1):
                    try:
                        task = task or resources.enter_context(job.open(0))
                        result = task(number, listener)
                        break
                    except ContextLostError as error:
                        if attempt == _RETRIES:
                            raise
                        listener.on_message(f"{error}: task {number} is done again")
                        task = None
                        # Closing may stumble over the same loss.
                        with suppress(ContextLostError):
                            resources.close()
                yield number, result
