"""A process of its own for each solver: what crashes there, or hangs, is found out here.

A solver is told the questions one by one, judged where it was asked, and only verdicts and
times come back.
"""

import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from pkgutil import iter_modules
from time import process_time
from typing import Any, Literal, NamedTuple, TextIO

import problems.solvers
from problems.conic import ConicProgram, SolverResult, Verified, verify
from problems.families import Instance
from problems.solvers.adapter import SolverAdapter
from sato.resource_usage import peak_memory_mib

SolverLookup = Callable[
    [], Mapping[str, SolverAdapter]
]  # the solvers that there are; known to both processes

SOLVERS_PATH = problems.solvers.__path__
STARTUP_TIMEOUT = 60.0  # in which a library is imported, or never [s]
SINGLE_THREAD_ENV = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "RAYON", "NUMBA")
} | {"VECLIB_MAXIMUM_THREADS": "1"}


class SolveRequest(NamedTuple):
    """What a solver is asked at once."""

    instance: Instance  # read, and solved
    next_instance: (
        Instance | None
    )  # another right-hand side of the same, solved by who has read the first
    tolerance: float


class SolveOutcome(NamedTuple):
    """What became of one solve."""

    verdict: Verified | Literal["crashed", "skipped"]
    reason: str
    seconds: float = float("nan")  # of the processor, reading included where it was read
    iterations: int | None = None
    cost_error: float = float("nan")  # |cost − reference| / |reference|
    primal_residual: float = float("nan")  # as `problems.conic.Answer` has them
    dual_residual: float = float("nan")
    gap: float = float("nan")


class SolveReply(NamedTuple):
    """What became of a question."""

    first: SolveOutcome
    second: SolveOutcome | None
    memory_growth: float  # by which the most that the process held had grown after the first [MiB]

    @property
    def crashed(self) -> bool:
        """Whether the process ended in one of the solves."""
        return "crashed" in (self.first.verdict, self.second and self.second.verdict)


class WorkerError(RuntimeError):
    """The process of a solver ended, or had to be ended, before it answered."""

    def __init__(self, words: str, seconds: float = float("nan")) -> None:
        """Keep for how long it was waited for, where that was the end of it."""
        super().__init__(words)
        self.seconds = seconds

    @property
    def outcome(self) -> SolveOutcome:
        """What became of the solve in which it ended."""
        return SolveOutcome("crashed", str(self), self.seconds)


class Worker:
    """A solver in its process, which is begun when first asked and after every end."""

    def __init__(
        self, find: SolverLookup, name: str, warm_up: SolveRequest, seconds: float
    ) -> None:
        """Say whom to ask; nothing is begun yet.

        Args:
            find: The solvers that there are.
            name: Which of them.
            warm_up: What each process is asked first, so that what a library does once in its
                life is no part of a time.
            seconds: After which nothing more is expected of a solve of that.
        """
        self._lookup, self._name = find, name
        self._warm_up: SolveRequest | None = warm_up
        self._patience = seconds
        self._process: Any = None
        self._connection: Connection | None = None
        self._stderr: TextIO | None = None
        self.memory_growth = float("nan")  # by the first solve of the last warm-up [MiB]

    def start(self) -> Connection:
        """Begin the process, and warm it up.

        Raises:
            Gone: It ended in that; it is begun cold from then on, or a solver that cannot take
                its warm-up would be asked nothing else.
        """
        line = self._start_process()
        warm_up, self._warm_up = self._warm_up, None
        if warm_up is None:
            return line
        reply = self._exchange(line, warm_up, self._patience)
        self.memory_growth = reply.memory_growth
        if reply.second is not None and reply.crashed:
            raise WorkerError(reply.second.reason, reply.second.seconds)
        self._warm_up = warm_up
        return line

    def solve(self, question: SolveRequest, seconds: float) -> SolveReply:
        """Ask, and wait for the reply.

        Args:
            question: What is asked.
            seconds: After which nothing more is expected of a solve.

        Raises:
            Gone: The process crashed before it had answered once, or did not answer in time.
        """
        return self._exchange(self._connection or self.start(), question, seconds)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
            self._process = None
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._stderr is not None:
            self._stderr.close()
            self._stderr = None

    def _start_process(self) -> Connection:
        handle, path = tempfile.mkstemp(prefix="sato-compare-")
        self._stderr = open(handle, errors="replace")
        context = _process_context()
        line: Connection
        line, far = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(far, self._lookup, self._name, path), daemon=True
        )
        before = {name: os.environ.get(name) for name in SINGLE_THREAD_ENV}
        os.environ.update(SINGLE_THREAD_ENV)  # the process reads them before it loads anything
        try:
            self._process.start()
        finally:
            for name, value in before.items():
                os.environ.pop(name) if value is None else os.environ.update({name: value})
        far.close()
        self._connection = line
        try:
            self._receive(line, STARTUP_TIMEOUT)
        finally:
            Path(path).unlink()  # both hold it open
        return line

    def _exchange(self, line: Connection, question: SolveRequest, seconds: float) -> SolveReply:
        try:
            line.send(question)
        except ConnectionError:  # it ended after its last answer
            raise self._close_with_error(self._exit_reason()) from None
        first, memory = self._receive(line, seconds)
        if question.next_instance is None:
            return SolveReply(first, None, memory)
        try:
            again, _ = self._receive(line, seconds)
        except WorkerError as end:
            again = end.outcome
        return SolveReply(first, again, memory)

    def _receive(self, line: Connection, seconds: float) -> Any:
        try:
            if line.poll(seconds):
                return line.recv()
        except (EOFError, ConnectionError):
            raise self._close_with_error(self._exit_reason()) from None
        raise self._close_with_error(f"no answer within {seconds:g} s", seconds)

    def _close_with_error(self, words: str, seconds: float = float("nan")) -> WorkerError:
        self.close()
        return WorkerError(words, seconds)

    def _exit_reason(self) -> str:
        self._process.join()
        code, last = self._process.exitcode, ""
        if self._stderr is not None:
            lines = self._stderr.read().split("\n")
            last = next((line.strip() for line in reversed(lines) if line.strip()), "")
        if code is not None and code < 0:
            last = f"{signal.strsignal(-code) or -code}{last and ': '}{last}"
        return last or f"the process ended with exit code {code}"


def _process_context() -> Any:
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    context = get_context("forkserver")
    # One small parent for all, which has loaded what they share: a child's peak begins anew.
    shared = (f"{problems.solvers.__name__}.{file.name}" for file in iter_modules(SOLVERS_PATH))
    context.set_forkserver_preload([__name__, *shared])
    return context


def _serve(line: Connection, find: SolverLookup, name: str, last_words: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asked ends it
    _redirect_output(last_words)
    solver = find()[name]
    import_module(solver.module)
    held = peak_memory_mib()
    line.send(None)
    while True:
        try:
            question: SolveRequest = line.recv()
        except EOFError:
            return
        for outcome in _solve_request(
            solver, question
        ):  # each before the next solve, which may crash
            line.send((outcome, peak_memory_mib() - held))


def _redirect_output(last_words: str) -> None:
    # Libraries print at a depth where only the descriptors are known.
    sys.stdout.flush()
    sys.stderr.flush()
    with open(os.devnull, "w") as nowhere, open(last_words, "w") as file:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(file.fileno(), 2)


def _solve_request(solver: SolverAdapter, question: SolveRequest) -> Iterator[SolveOutcome]:
    problem, tolerance = question.instance.problem, question.tolerance
    began = process_time()
    session = solver.session_factory(
        problem, tolerance
    )  # what it can take was found out in planning
    claim = session.solve(problem.b)
    yield _evaluate(question.instance, claim, tolerance, process_time() - began)
    if question.next_instance is None:
        return
    b = question.next_instance.problem.b
    began = process_time()
    claim = session.solve(b)
    yield _evaluate(question.next_instance, claim, tolerance, process_time() - began)


def _evaluate(
    instance: Instance, claim: SolverResult, tolerance: float, seconds: float
) -> SolveOutcome:
    problem: ConicProgram = instance.problem
    kind, answer, why, _ = verify(problem, claim, tolerance)
    if kind == "unproven" and instance.is_feasible:
        kind, why = "wrong claim", f"{why}, but there is a point"
    if kind == "wrong claim" and claim.status == "infeasible" and not instance.is_feasible:
        kind = "unproven"  # it is right, and cannot show it
    outcome = SolveOutcome(kind, why, seconds, claim.iterations)
    if answer is None:
        return outcome
    outcome = outcome._replace(
        primal_residual=answer.primal_residual, dual_residual=answer.dual_residual, gap=answer.gap
    )
    if not instance.is_feasible:
        return outcome
    off = abs(float(problem.q @ answer.x) - instance.reference_cost)
    return outcome._replace(cost_error=off / instance.cost_scale)
