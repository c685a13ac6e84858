"""Worker process for a solver, so that a crash or a hang there is an outcome here.

The worker solves requests one by one and verifies its answers itself; only verdicts and times
come back.
"""

import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from importlib import import_module
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from pkgutil import iter_modules
from time import process_time
from typing import Any, Literal, NamedTuple

import problems.solvers
from problems.conic import SolverResult, Verified, verify
from problems.families import Instance
from problems.solvers.adapter import SolverAdapter
from sato.resource_usage import peak_memory_mib

SolverLookup = Callable[[], Mapping[str, SolverAdapter]]
"""Function that returns the adapters by name; both processes must be able to import it."""

SOLVERS_PATH = problems.solvers.__path__
STARTUP_TIMEOUT = 60.0  # for the import of a library [s]
SINGLE_THREAD_ENV = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "RAYON", "NUMBA")
} | {"VECLIB_MAXIMUM_THREADS": "1"}


class SolveRequest(NamedTuple):
    """Request for a solve, and for a re-solve with another right-hand side."""

    instance: Instance
    next_instance: Instance | None  # differs from the instance in b alone
    tolerance: float


class SolveOutcome(NamedTuple):
    """Outcome of one solve."""

    verdict: Verified | Literal["crashed", "skipped"]
    reason: str
    seconds: float = float("nan")  # processor time, with the set-up where it is the first solve
    iterations: int | None = None
    cost_error: float = float("nan")  # |cost − reference| / |reference|
    primal_residual: float = float("nan")  # as in `problems.conic.ConicSolution`
    dual_residual: float = float("nan")
    gap: float = float("nan")


class SolveReply(NamedTuple):
    """Outcomes of a request."""

    first: SolveOutcome
    second: SolveOutcome | None = None
    memory_growth: float = float("nan")  # of the process's peak with the first solve [MiB]

    @property
    def crashed(self) -> bool:
        """True where the process ended in one of the solves."""
        return "crashed" in (self.first.verdict, self.second and self.second.verdict)


class WorkerError(RuntimeError):
    """Error for a process that ended, or was ended, before it answered.

    Attributes:
        seconds: The time limit that it exceeded, if any [s].
    """

    def __init__(self, message: str, seconds: float = float("nan")) -> None:
        super().__init__(message)
        self.seconds = seconds

    @property
    def outcome(self) -> SolveOutcome:
        """Outcome of the solve in which the process ended."""
        return SolveOutcome("crashed", str(self), self.seconds)


class Worker:
    """Solver in a process, which starts with the first request and again after every end."""

    def __init__(
        self, lookup: SolverLookup, name: str, warm_up: SolveRequest, timeout: float
    ) -> None:
        """Choose a solver; no process starts yet.

        Args:
            lookup: Function that returns the adapters.
            name: Name of the solver.
            warm_up: First request to each process, so that no time includes what a library does
                only once in a process.
            timeout: Limit for each solve of the warm-up [s].
        """
        self._lookup, self._name = lookup, name
        self._warm_up: SolveRequest | None = warm_up
        self._warm_up_timeout = timeout
        self._open = ExitStack()  # the process and its files
        self._connection: Connection | None = None
        self.memory_growth = float("nan")  # with the first solve of the last warm-up [MiB]

    def start(self) -> Connection:
        """Start the process, and warm it up.

        Raises:
            WorkerError: The process ended in the warm-up. Later ones start without a warm-up, or
                a solver that fails there could be given no other request.
        """
        connection = self._start_process()
        warm_up, self._warm_up = self._warm_up, None
        if warm_up is None:
            return connection
        reply = self._exchange(connection, warm_up, self._warm_up_timeout)
        self.memory_growth = reply.memory_growth
        if reply.second is not None and reply.crashed:
            raise WorkerError(reply.second.reason, reply.second.seconds)
        self._warm_up = warm_up
        return connection

    def solve(self, request: SolveRequest, timeout: float) -> SolveReply:
        """Make a request, and wait for the reply.

        Args:
            request: The request.
            timeout: Limit for each solve [s].

        Raises:
            WorkerError: The process crashed in the first solve, or exceeded the limit there.
        """
        return self._exchange(self._connection or self.start(), request, timeout)

    def close(self) -> None:
        """End the process."""
        self._open.close()
        self._connection = None

    def _start_process(self) -> Connection:
        handle, path = tempfile.mkstemp(prefix="sato-compare-")
        self._stderr = self._open.enter_context(open(handle, errors="replace"))
        context = _process_context()
        connection: Connection
        connection, remote = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(remote, self._lookup, self._name, path), daemon=True
        )
        before = {name: os.environ.get(name) for name in SINGLE_THREAD_ENV}
        os.environ.update(SINGLE_THREAD_ENV)  # the process reads them before any import
        try:
            self._process.start()
        finally:
            for name, value in before.items():
                os.environ.pop(name) if value is None else os.environ.update({name: value})
        self._open.callback(_end, self._process)
        remote.close()
        self._connection = self._open.enter_context(connection)
        try:
            self._receive(connection, STARTUP_TIMEOUT)
        finally:
            Path(path).unlink()  # both processes hold it open
        return connection

    def _exchange(
        self, connection: Connection, request: SolveRequest, timeout: float
    ) -> SolveReply:
        try:
            connection.send(request)
        except ConnectionError:  # the process ended after its last answer
            raise self._close_with_error(self._exit_reason()) from None
        first, memory = self._receive(connection, timeout)
        second = None
        if request.next_instance is not None:
            try:
                second, _ = self._receive(connection, timeout)
            except WorkerError as end:
                second = end.outcome
        return SolveReply(first, second, memory)

    def _receive(self, connection: Connection, timeout: float) -> Any:
        try:
            if connection.poll(timeout):
                return connection.recv()
        except (EOFError, ConnectionError):
            raise self._close_with_error(self._exit_reason()) from None
        raise self._close_with_error(f"no answer within {timeout:g} s", timeout)

    def _close_with_error(self, message: str, seconds: float = float("nan")) -> WorkerError:
        self.close()
        return WorkerError(message, seconds)

    def _exit_reason(self) -> str:
        self._process.join()
        code, lines = self._process.exitcode, self._stderr.read().split("\n")
        last_line = next((line.strip() for line in reversed(lines) if line.strip()), "")
        if code is not None and code < 0:
            last_line = f"{signal.strsignal(-code) or -code}{last_line and ': '}{last_line}"
        return last_line or f"the process ended with exit code {code}"


def _end(process: Any) -> None:
    process.kill()
    process.join()
    process.close()


def _process_context() -> Any:
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    context = get_context("forkserver")
    # All workers are forked from a small process with the shared imports, so that the peak memory
    # of each starts anew.
    shared = (f"{problems.solvers.__name__}.{file.name}" for file in iter_modules(SOLVERS_PATH))
    context.set_forkserver_preload([__name__, *shared])
    return context


def _serve(connection: Connection, lookup: SolverLookup, name: str, stderr: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process ends the worker
    _redirect_output(stderr)
    solver = lookup()[name]
    import_module(solver.module)
    before = peak_memory_mib()
    connection.send(None)
    while True:
        try:
            request: SolveRequest = connection.recv()
        except EOFError:
            return
        # Each outcome is sent before the next solve, which may crash.
        for outcome in _solve_request(solver, request):
            connection.send((outcome, peak_memory_mib() - before))


def _redirect_output(stderr: str) -> None:
    # Libraries in C write to the file descriptors, not to sys.stdout.
    sys.stdout.flush()
    sys.stderr.flush()
    with open(os.devnull, "w") as discarded, open(stderr, "w") as file:
        os.dup2(discarded.fileno(), 1)
        os.dup2(file.fileno(), 2)


def _solve_request(solver: SolverAdapter, request: SolveRequest) -> Iterator[SolveOutcome]:
    began = process_time()
    # Not `open_session`: the plan has checked that the solver supports the problem.
    session = solver.session_factory(request.instance.problem, request.tolerance)
    for instance in filter(None, (request.instance, request.next_instance)):
        result = session.solve(instance.problem.b)
        yield _evaluate(instance, result, request.tolerance, process_time() - began)
        began = process_time()


def _evaluate(
    instance: Instance, result: SolverResult, tolerance: float, seconds: float
) -> SolveOutcome:
    verdict, solution, reason, _ = verify(instance.problem, result, tolerance)
    if verdict == "unproven" and instance.is_feasible:
        verdict, reason = "wrong claim", f"{reason}, but there is a point"
    if verdict == "wrong claim" and result.status == "infeasible" and not instance.is_feasible:
        verdict = "unproven"  # the claim is true, and its proof is not
    outcome = SolveOutcome(verdict, reason, seconds, result.iterations)
    if solution is None:
        return outcome
    outcome = outcome._replace(
        primal_residual=solution.primal_residual,
        dual_residual=solution.dual_residual,
        gap=solution.gap,
    )
    if not instance.is_feasible:
        return outcome
    error = abs(float(instance.problem.q @ solution.x) - instance.reference_cost)
    return outcome._replace(cost_error=error / instance.cost_scale)
