"""Connections to a Dask scheduler: one that runs somewhere, or one of this machine's own processors."""

import logging
import os
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, TypeVar

from lmeasure.core import LMeasureError, how_to_install
from lmeasure.text import message

ANSWER_S = 10.0
"""Within which a scheduler must answer."""
ADDRESS = re.compile(r"(tcp|tls|ws|wss|ucx)://[^\s/:]+:\d{1,5}|(tcp|tls)://\[[0-9a-fA-F:]+\]:\d{1,5}")
Task = TypeVar("Task")
Done = TypeVar("Done")
LOCAL = "local"
"""Scheduler that is begun on this machine, with one process for each processor."""


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def cluster_client(scheduler: str) -> Iterator[Any]:
    """Connect to a scheduler, and let go of it afterwards.

    Parameters
    ----------
    scheduler
        Address such as `tcp://192.168.0.7:8786`, or `local`.

    Raises
    ------
    LMeasureError
        If Dask is not installed, the address is none, or nothing answers there within 10 s.
    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise LMeasureError(message("error.scheduler_needs_dask", install=how_to_install("cluster"))) from None
    # warnings, such as a dead worker, need no action: the work is repeated
    logging.getLogger("distributed").setLevel(logging.ERROR)
    if scheduler == LOCAL:
        settings: dict[str, Any] = {"n_workers": processors(), "threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": None}
        settings |= {"silence_logs": logging.CRITICAL}
        with distributed.LocalCluster(**settings) as cluster, distributed.Client(cluster, set_as_default=False) as client:
            yield client
        return
    if not ADDRESS.fullmatch(scheduler):  # a client of a wrong one does not go without a quarrel
        raise LMeasureError(message("error.scheduler_is_no_address", scheduler=scheduler))
    try:
        client = distributed.Client(scheduler, timeout=ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise LMeasureError(message("error.no_dask_scheduler_answers", where=scheduler, error=why)) from error
    with client:
        yield client


def in_order(scheduler: str, work: Callable[[Task], Done], tasks: Iterable[Task]) -> Iterator[Done]:
    """Yield the results of tasks in their order; a few more than processors run at once.

    Doing a task twice must do no harm: a worker may die after it. LMeasureError as `cluster_client`, and if the scheduler is lost.
    """
    with cluster_client(scheduler) as client:
        distributed: Any = import_module("distributed")
        waiting: deque[Any] = deque()
        try:
            for task in tasks:
                waiting.append(client.submit(work, task, pure=False))
                if len(waiting) > sum(client.ncores().values()) + 1:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        except (distributed.client.FutureCancelledError, distributed.comm.core.CommClosedError, distributed.KilledWorker) as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise LMeasureError(message("error.scheduler_lost", where=scheduler, why=why)) from None
