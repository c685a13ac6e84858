"""Trials flown by processes on this machine."""

from collections import Counter
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures.process import BrokenProcessPool
from time import sleep
from typing import Any

from pebble import ProcessExpired, ProcessFuture, ProcessPool

from sato.campaigns.trial import Flights, Outcome, Trial, TrialFunction, one_thread_each
from sato.compilation import announce_all
from sato.scenario.errors import InputError
from sato.workers import check_guard, describe_exit, make_context, place_sockets

AHEAD = 2  # trials that each worker has, one of which waits, so that it is never idle
PRELOADED = ["sato.campaigns.trial", "xarray"]  # by the process from which workers are forked
MOST_FUTILE = 3  # processes in a row, for each worker, that end before they begin
START_TIME = 0.2  # a process that has just started complains where its pipe is gone [s]


class WorkerError(RuntimeError):
    """Workers that end before they have done anything."""


def fly_locally(
    workers: int, function: TrialFunction, trials: Iterable[Trial], time_limit: float | None
) -> Flights:
    """Fly trials in processes, and yield them as they end.

    Each process has a pool of its own, which is replaced when it dies: a process that is ended
    while it takes a trial may leave its pipe locked, and what it took is not known.

    Args:
        workers: Number of processes.
        function: Function of a trial, importable by name.
        trials: Trials, taken as workers become free.
        time_limit: Time after which a trial is ended [s]; None for no limit.

    Raises:
        InputError: A function of the user's cannot be imported by the workers.
        WorkerError: Workers end before they begin.
    """
    check_guard()
    place_sockets()
    context, remaining, futile = make_context(PRELOADED), iter(trials), 0
    again: list[Trial] = []  # trials of processes that died before they began
    flying: dict[ProcessFuture[Outcome], tuple[int, Trial]] = {}
    with one_thread_each():
        pools = [ProcessPool(1, context=context, initializer=announce_all)]
        pools += [ProcessPool(1, context=context) for _ in range(1, workers)]
        try:
            while True:
                waiting = Counter(number for number, _ in flying.values())
                free = [n for ahead in range(AHEAD) for n in range(workers) if waiting[n] <= ahead]
                for number in free:
                    trial = again.pop() if again else next(remaining, None)
                    if trial is None:
                        break
                    if not pools[number].active:  # its process died while it had nothing to do
                        pools[number] = _replace(pools[number], context)
                    future = pools[number].schedule(function, (trial,), timeout=time_limit)
                    flying[future] = number, trial
                if not flying:
                    return
                for future in wait(flying, return_when=FIRST_COMPLETED).done:
                    if future not in flying:
                        continue  # taken back
                    number, trial = flying.pop(future)
                    error = future.exception()
                    if isinstance(error, ProcessExpired | BrokenProcessPool):
                        again += _take_back(flying, number)
                        if isinstance(error, BrokenProcessPool):  # it had not begun
                            again, futile = [*again, trial], futile + 1
                        pools[number] = _replace(pools[number], context)
                    if futile > MOST_FUTILE * workers:
                        raise WorkerError("workers end before they begin; `sato run` may tell why")
                    if not isinstance(error, BrokenProcessPool):
                        futile = 0
                        yield trial, _outcome(future, error, time_limit)
        finally:
            for pool in pools:
                _end(pool)


def _take_back(flying: dict[ProcessFuture[Outcome], tuple[int, Trial]], number: int) -> list[Trial]:
    """Remove the trials of a pool that have no result yet."""
    lost = [
        future
        for future, (owner, _) in flying.items()
        if owner == number and not (future.done() and future.exception() is None)
    ]
    return [flying.pop(future)[1] for future in lost]


def _replace(pool: ProcessPool, context: Any) -> ProcessPool:
    sleep(START_TIME)
    _end(pool)
    return ProcessPool(1, context=context)


def _end(pool: ProcessPool) -> None:
    pool.stop()
    pool.join()


def take_outcome(future: Any) -> Outcome:
    """Return the outcome of a trial, or of an error in its worker.

    An `InputError` is raised again: no other trial could be flown either.
    """
    error = future.exception()
    if isinstance(error, InputError):
        raise error
    if error is not None:
        return {"exit": "error", "error": f"{type(error).__name__}: {error}"}
    outcome: Outcome = future.result()
    return outcome


def _outcome(future: Any, error: BaseException | None, time_limit: float | None) -> Outcome:
    if isinstance(error, TimeoutError):
        return {"exit": "time limit", "error": f"ended after {time_limit:g} s"}
    if isinstance(error, ProcessExpired):
        reason = describe_exit(error.exitcode or 0)
        return {"exit": "died", "error": f"the worker died: {reason}"}
    return take_outcome(future)
