"""Trials flown by the workers of a Dask scheduler, which moves them from workers that die."""

import faulthandler
import os
import re
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from itertools import islice
from time import sleep
from typing import Any
from uuid import uuid4

from sato.campaigns.local import AHEAD, WorkerError, take_outcome
from sato.campaigns.trial import Flights, Outcome, Trial, TrialFunction
from sato.scenario.errors import InputError

CONNECT_TIMEOUT = 6.0  # [s]
ADDRESS = re.compile(r"inproc://\S+|(\w+://)?[^/\s]+:\d+")
FAREWELL = 1.0  # time that the scheduler is given to hear of a time limit [s]


@contextmanager
def connect(address: str) -> Iterator[Any]:
    """Connect to a scheduler by its address, "tcp://host:8786"; refuse workers with threads.

    A `WorkerError` says that it cannot be reached.
    """
    if not ADDRESS.fullmatch(address):
        raise InputError("", f"a scheduler has an address as tcp://HOST:8786, got {address}")
    try:
        from distributed import Client
    except ImportError as error:
        reason = "a scheduler needs Dask: pip install 'sato-swarm[cluster]'"
        raise InputError("", reason) from error
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except Exception as error:  # of many kinds where something else listens there
        raise WorkerError(f"{address}: no Dask scheduler can be reached: {error}") from error
    with client:
        if any(threads > 1 for threads in client.nthreads().values()):
            raise InputError("", "workers must have one thread each: dask worker --nthreads 1")
        yield client


def fly_on_cluster(
    client: Any, function: TrialFunction, trials: Iterable[Trial], time_limit: float | None
) -> Flights:
    """Fly trials on a cluster, and yield them as they end.

    Dask flies the trial of a worker that died on another one, up to its own limit
    (`distributed.scheduler.allowed-failures`). A thread cannot be ended, so a worker ends itself
    at the time limit, and its nanny starts another one; workers without are refused. Arguments and
    errors are as of `fly_locally`; a `WorkerError` also says that the scheduler was lost.
    """
    from distributed import as_completed

    topic, remaining = f"sato-{uuid4().hex}", iter(trials)
    flying: dict[Any, Trial] = {}
    late: set[str] = set()  # keys of trials that a worker has ended
    completed = as_completed(loop=client.loop, raise_errors=False)

    async def end(event: tuple[float, str]) -> None:
        late.add(event[1])
        await client.cancel([future for future in [*flying] if future.key == event[1]])

    def submit() -> None:
        wanted = AHEAD * max(1, len(client.nthreads())) - len(flying)
        for trial in islice(remaining, max(0, wanted)):
            arguments = (function, trial, time_limit, topic)
            key = f"{topic}-{trial.row}"
            future = client.submit(_fly_on_worker, *arguments, key=key, pure=False)
            flying[future] = trial
            completed.add(future)

    try:
        client.subscribe_topic(topic, end)
        submit()
        for future in completed:
            trial = flying.pop(future)
            yield trial, _outcome(future, future.key in late, time_limit)
            submit()
    except (OSError, CancelledError) as error:
        raise WorkerError("the scheduler was lost; --resume goes on") from error


def _outcome(future: Any, is_late: bool, time_limit: float | None) -> Outcome:
    from distributed import KilledWorker

    if is_late:
        return {"exit": "time limit", "error": f"ended after {time_limit:g} s"}
    if future.status in ("cancelled", "lost", "pending"):
        raise CancelledError(future.status)
    if isinstance(error := future.exception(), KilledWorker):
        return {"exit": "died", "error": f"{error}"}
    return take_outcome(future)


def _fly_on_worker(
    function: TrialFunction, trial: Trial, time_limit: float | None, topic: str
) -> Outcome:
    """Fly a trial; end this process, and tell the scheduler why, where that takes too long."""
    from distributed import get_worker

    if time_limit is None:
        return function(trial)
    worker = get_worker()
    if worker.nanny is None:  # nothing would start it again
        reason = "needs workers with nannies, as `dask worker` has"
        raise InputError("campaign.time_limit_s", reason)

    def end() -> None:
        worker.log_event(topic, f"{topic}-{trial.row}")
        sleep(FAREWELL)
        os._exit(1)

    timer = threading.Timer(time_limit, end)
    timer.daemon = True
    timer.start()
    # The timer waits for compiled code that holds the interpreter's lock; this one does not.
    faulthandler.dump_traceback_later(time_limit + 10 * FAREWELL, exit=True)
    try:
        return function(trial)
    finally:
        timer.cancel()
        faulthandler.cancel_dump_traceback_later()
