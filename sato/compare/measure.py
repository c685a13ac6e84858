"""Measurement of solvers in turn, each in its own process: crashes and hangs are outcomes."""

import os
import signal
from collections.abc import Callable, Iterator
from importlib import import_module
from multiprocessing.connection import Connection
from statistics import median
from time import process_time
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.random import Generator
from threadpoolctl import threadpool_limits

from problems.conic import SolverResult, Verified, verify
from problems.families import Family, Instance
from problems.solvers.adapter import SolverAdapter
from sato.compare.plan import ComparisonPlan, format_tolerance, refusal
from sato.workers import describe_exit, make_context, place_sockets

NAN = float("nan")
SEVERITY = ("skipped", "solved", "infeasible", "unproven", "failed", "wrong claim", "crashed")
# Limit in wall-clock time, relative to the patience: other processes may keep the processor busy.
HANG_FACTOR = 10.0
WARM_UP_TIMEOUT = 60.0  # for what a library does only once, such as compiling [s]

CONTEXT = make_context([__name__, "problems.solvers"])


class SolveOutcome(NamedTuple):
    """Outcome of one solve."""

    verdict: Verified | Literal["crashed", "skipped"]
    reason: str
    seconds: float = NAN  # processor time, with the set-up where it is the first solve
    iterations: int | None = None
    cost_error: float = NAN  # |cost − reference| / |reference|
    primal_residual: float = NAN  # as in `problems.conic.ConicSolution`
    dual_residual: float = NAN
    gap: float = NAN


class Measurement(NamedTuple):
    """Result of a solver on an instance at a tolerance."""

    solver: str
    family: Family
    instance: Instance
    tolerance: float
    # First solve, with its set-up, and the re-solve after another instance with the same A, if
    # there is one; median time and otherwise worst of the repeats.
    outcomes: tuple[SolveOutcome, ...]

    @property
    def expected(self) -> Literal["solved", "infeasible"]:
        """The correct verdict."""
        return "solved" if self.instance.is_feasible else "infeasible"

    @property
    def is_correct(self) -> bool:
        """True where every outcome is the correct one, and proven."""
        return all(outcome.verdict == self.expected for outcome in self.outcomes)


def measure_solvers(
    plan: ComparisonPlan,
    rng: Generator,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Measurement]:
    """Measure every solver on every problem that it supports.

    Solvers run in processes of their own, one at a time. A solver that takes longer than the
    patience of the plan is skipped from then on in that family, at that size and tolerance and at
    larger or tighter ones; a solve that takes ten times as long by the wall clock is ended and
    counts as crashed. The order of the solvers is drawn anew for each repeat. Progress is called
    after each family and tolerance, with the number of these that are done, and of all.
    """
    place_sockets()
    workers = [SolverProcess(solver, plan.patience) for solver in plan.solvers]
    measurements: list[Measurement] = []
    rounds = [(family, tolerance) for family in plan.families for tolerance in plan.tolerances]
    try:
        for done, (family, tolerance) in enumerate(rounds, start=1):
            able = [worker for worker in workers if not refusal(worker.solver, family)]
            measurements += _measure_in_turn(able, family, tolerance, plan.repeats, rng)
            progress(done, len(rounds))
    finally:
        for worker in workers:
            worker.close()
    return measurements


def _measure_in_turn(
    workers: list["SolverProcess"], family: Family, tolerance: float, repeats: int, rng: Generator
) -> Iterator[Measurement]:
    Solves = tuple[list[SolveOutcome], list[SolveOutcome]]  # first and second ones
    found: dict[tuple[SolverProcess, Instance], Solves]
    found = {(worker, instance): ([], []) for worker in workers for instance in family.instances}
    for i, instance in enumerate(family.instances):
        others = family.instances[i + 1 :] + family.instances[:i]
        same = [other for other in others if other.problem.A is instance.problem.A]
        pair = [instance, *same[:1]]
        for k in np.concatenate([rng.permutation(len(workers)) for _ in range(repeats)]):
            outcomes = workers[k].solve(family, tolerance, pair)
            for order, solved in enumerate(pair):
                found[workers[k], solved][order].append(outcomes[order])
    for (worker, instance), solves in found.items():
        combined = tuple(_combine_repeats(some) for some in solves if some)
        yield Measurement(worker.solver.name, family, instance, tolerance, combined)


def _combine_repeats(outcomes: list[SolveOutcome]) -> SolveOutcome:
    worst = max(outcomes, key=lambda outcome: SEVERITY.index(outcome.verdict))
    times = [outcome.seconds for outcome in outcomes if outcome.seconds == outcome.seconds]
    return worst._replace(seconds=median(times)) if times else worst


class SolverProcess:
    """Solver in a process, which starts with the first request and again after every end.

    A pool of Pebble in its place takes as much code: it keeps no session from the first solve to
    the second, and does not tell how a process ended that had nothing to do.
    """

    def __init__(self, solver: SolverAdapter, patience: float) -> None:
        """Choose a solver; no process starts yet."""
        self.solver, self.patience = solver, patience
        self._process: Any = None
        self._connection: Any = None  # to the process
        self._exceeded: dict[tuple[str, float], str] = {}  # where: family and tolerance

    def solve(self, family: Family, tolerance: float, pair: list[Instance]) -> list[SolveOutcome]:
        """Solve instances that differ in b alone; the end of the process is an outcome too.

        A new process solves them twice, so that no time includes what a library does only once.
        """
        for (name, known), reason in self._exceeded.items():
            if name == family.name and known >= tolerance:  # sizes are in ascending order
                return [SolveOutcome("skipped", reason) for _ in pair]
        limit = HANG_FACTOR * self.patience
        if self._process is None:
            self._connection, remote = CONTEXT.Pipe()
            self._process = CONTEXT.Process(target=_serve, args=(remote, self.solver), daemon=True)
            self._process.start()
            remote.close()
            outcomes = self._request(pair, tolerance, max(WARM_UP_TIMEOUT, limit))
        if self._process is not None:
            outcomes = self._request(pair, tolerance, limit)
        if any(outcome.seconds > self.patience for outcome in outcomes):
            at = f"{family.size}, {format_tolerance(tolerance)}"
            reason = f"it took more than {self.patience:g} s at {at}"
            self._exceeded.setdefault((family.name, tolerance), reason)
        return outcomes

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._connection.close()
            self._process.kill()
            self._process.join()
            self._process = None

    def _request(self, pair: list[Instance], tolerance: float, limit: float) -> list[SolveOutcome]:
        outcomes: list[SolveOutcome] = []
        end = SolveOutcome("crashed", f"no answer within {limit:g} s", limit)
        try:
            self._connection.send((pair, tolerance))
            while len(outcomes) < len(pair) and self._connection.poll(limit):
                outcomes.append(self._connection.recv())
        except (EOFError, ConnectionError):
            self._process.join()
            end = SolveOutcome("crashed", describe_exit(self._process.exitcode))
        if missing := len(pair) - len(outcomes):
            self.close()
        # A solver that did not reach the second solve is not correct there either.
        return outcomes + missing * [end]


def _serve(connection: Connection, solver: SolverAdapter) -> None:
    """Solve requests one by one, and send back verdicts and times."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process ends this one
    discarded = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):  # libraries in C write to these, not to sys.stdout
        os.dup2(discarded, descriptor)
    import_module(solver.module)
    threadpool_limits(1)
    while True:
        pair, tolerance = connection.recv()
        session = None
        for instance in pair:
            began = process_time()
            try:
                # Not `open_session`: the plan has checked that the solver supports the problem.
                session = session or solver.session_factory(instance.problem, tolerance)
                result = session.solve(instance.problem.b)
                outcome = _evaluate(instance, result, tolerance, process_time() - began)
            except Exception as error:  # whatever a solver raises is its failure, and is told
                outcome = SolveOutcome("crashed", f"{type(error).__name__}: {error}")
            connection.send(outcome)  # before the next solve, which may crash


def _evaluate(
    instance: Instance, result: SolverResult, tolerance: float, seconds: float
) -> SolveOutcome:
    verdict, solution, reason, _ = verify(instance.problem, result, tolerance)
    if result.status == "infeasible" and verdict != "infeasible":
        # Without a proof, it depends on what is known whether the claim is wrong.
        verdict = "wrong claim" if instance.is_feasible else "unproven"
    outcome = SolveOutcome(verdict, reason, seconds, result.iterations)
    if solution is None:
        return outcome
    error = abs(instance.problem.cost(solution.x) - instance.reference_cost)
    _, _, *residuals = solution
    return SolveOutcome(*outcome[:4], error / instance.cost_scale, *residuals)
