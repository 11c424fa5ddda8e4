"""Work on many tasks, here or by the workers of a Dask cluster."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any, TypeVar

from lmeasure.core import LMeasureError
from lmeasure.io import cluster_client
from lmeasure.text import message

Task = TypeVar("Task")
Done = TypeVar("Done")
AHEAD = 64
"""Tasks that are handed over before the first of them is done, at least."""
DEATHS = 2
"""Times that the scheduler may give an item up, after some workers died of it, before it has failed."""
AWAY_S = 60.0
"""For which a scheduler may be out of reach."""
NO_WORKER_S = 30.0
"""Within which a scheduler must have a worker."""


class LostError(LMeasureError):
    """A task whose workers died each time."""


def outcomes(
    work: Callable[[Task], Done], tasks: Sequence[tuple[str, Task]], scheduler: str | None
) -> Iterator[tuple[Task, "Done | LostError"]]:
    """Do tasks, and give each with what came of it, as they end.

    Parameters
    ----------
    work
        Function that another process can import. Doing a task twice must do no harm: a worker may die after it.
    tasks
        Tasks by keys that tell them apart.
    scheduler
        Address of a Dask scheduler, `local`, or None: in this process, one after the other.

    Raises
    ------
    LMeasureError
        If no scheduler or worker can be reached; tasks that ended before are given before it.
    """
    if scheduler is None:
        for _, task in tasks:
            yield task, work(task)
        return
    left, since = dict(tasks), time.monotonic()
    while left:
        try:
            with cluster_client(scheduler) as client:
                for key, done in _through(client, work, left):
                    since = time.monotonic()
                    yield left.pop(key), done
        except (ConnectionError, LMeasureError) as error:
            # a scheduler that was there may come back, with none of what it knew
            first = len(left) == len(tasks)
            if (isinstance(error, LMeasureError) and first) or time.monotonic() > since + AWAY_S:
                raise LMeasureError(
                    message("error.of_items_are_left", where=scheduler, n_left=len(left), n_tasks=len(tasks), error=error)
                ) from None
            time.sleep(1.0)


def _through(client: Any, work: Callable[[Task], Done], left: dict[str, Task]) -> Iterator[tuple[str, "Done | LostError"]]:
    """Do what is left by one connection; ConnectionError when it is lost."""
    distributed: Any = import_module("distributed")
    try:
        client.wait_for_workers(1, timeout=NO_WORKER_S)
    except TimeoutError:
        raise LMeasureError(message("error.no_worker_within_s", no_worker_s=NO_WORKER_S)) from None
    waiting, deaths = deque(left), dict.fromkeys(left, 0)
    ahead = max(AHEAD, 4 * sum(client.ncores().values()))
    held: dict[str, str] = {}

    def submitted(key: str) -> Any:
        future = client.submit(work, left[key], key=f"lmeasure-{key}-{deaths[key]}", pure=False)
        held[future.key] = key
        return future

    running = distributed.as_completed([submitted(waiting.popleft()) for _ in range(min(ahead, len(waiting)))], loop=client.loop)
    for future in running:
        key = held.pop(future.key)
        try:
            done: Done | LostError = future.result()
        except distributed.KilledWorker:
            deaths[key] += 1
            if deaths[key] < DEATHS:
                running.add(submitted(key))
                continue
            done = LostError(message("error.times_all_workers_that", deaths=deaths[key]))
        except (distributed.client.FutureCancelledError, distributed.comm.core.CommClosedError) as error:
            raise ConnectionError(" ".join(str(error).split())) from None
        future.release()  # the workers need not keep it any longer
        if waiting:
            running.add(submitted(waiting.popleft()))
        yield key, done
