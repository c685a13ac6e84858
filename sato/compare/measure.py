"""Measurement of solvers in turn, so that disturbances on the machine affect all alike."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from statistics import median
from typing import Literal, NamedTuple

import numpy as np

from problems.families import SIZES, Family, Instance
from problems.solvers import load_adapters
from sato.compare.plan import (
    ComparisonPlan,
    capable_solvers,
    format_tolerance,
    next_with_same_matrix,
)
from sato.compare.worker import (
    SolveOutcome,
    SolveReply,
    SolveRequest,
    SolverLookup,
    Worker,
    WorkerError,
)

SEVERITY = ("solved", "infeasible", "unproven", "failed", "wrong claim", "crashed")
# Limit in wall-clock time, relative to the patience: other processes may keep the processor busy.
HANG_FACTOR = 10.0
WARM_UP_TIMEOUT = 60.0  # for each solve of a warm-up, in which some libraries compile [s]

ProgressCallback = Callable[[int, int], None]  # number of requests made, and of all


class Measurement(NamedTuple):
    """Result of a solver on an instance at a tolerance."""

    solver: str
    family: str
    size: str
    instance: Instance
    tolerance: float
    first: SolveOutcome  # set-up and solve; median time and otherwise worst of the repeats
    second: SolveOutcome | None  # re-solve after another instance; None where no other has this A
    memory_growth: float  # of the process with one instance of the family and size [MiB]

    @property
    def outcomes(self) -> tuple[SolveOutcome, ...]:
        """Outcomes of the first solve, and of the second where there is one."""
        return (self.first,) if self.second is None else (self.first, self.second)

    @property
    def expected(self) -> Literal["solved", "infeasible"]:
        """The correct verdict."""
        return "solved" if self.instance.is_feasible else "infeasible"

    @property
    def is_correct(self) -> bool:
        """True where every outcome is the correct one, and proven."""
        return all(outcome.verdict == self.expected for outcome in self.outcomes)

    @property
    def last(self) -> SolveOutcome:
        """Outcome of the second solve, or of the first where there is no second."""
        return self.second or self.first


def measure_solvers(
    plan: ComparisonPlan,
    rng: np.random.Generator,
    progress: ProgressCallback = lambda done, total: None,
    lookup: SolverLookup = load_adapters,
) -> list[Measurement]:
    """Measure every solver on every problem that it supports.

    Solvers run in processes of their own, one at a time. A solver that takes longer than the
    patience of the plan is skipped from then on in that family, at that size and tolerance and at
    larger or tighter ones; a solve that takes ten times as long by the wall clock is ended and
    counts as crashed.

    Args:
        plan: Problems, solvers and settings.
        rng: Generator for the order of the solvers, drawn anew for each repeat.
        progress: Function called after each instance.
        lookup: Function that returns the adapters; another process must be able to import it.
    """
    run = _MeasurementRun(plan, rng, progress, lookup)
    return [measurement for family in plan.families for measurement in run.measure_family(family)]


@dataclass(eq=False)
class _MeasurementRun:
    """Solvers in their processes, and the problems one after another."""

    plan: ComparisonPlan
    rng: np.random.Generator
    progress: ProgressCallback
    lookup: SolverLookup
    workers: dict[str, Worker] = field(default_factory=dict)
    done: int = 0
    # Sizes and tolerances at which a solver exceeded the patience, by its name and the family's.
    exceeded: dict[tuple[str, str], list[tuple[int, float]]] = field(default_factory=dict)

    def record_time(self, name: str, family: Family, tolerance: float, reply: SolveReply) -> None:
        """Record a solver that exceeded the patience."""
        second = reply.second.seconds if reply.second else 0.0
        if reply.first.seconds > self.plan.patience or second > self.plan.patience:
            problem = SIZES.index(family.size), tolerance
            self.exceeded.setdefault((name, family.name), []).append(problem)

    def skip_reason(self, name: str, family: Family, tolerance: float) -> str:
        """Return why a solver is skipped, or an empty text."""
        for size, known in self.exceeded.get((name, family.name), ()):
            if size <= SIZES.index(family.size) and known >= tolerance:
                at = f"{SIZES[size]}, {format_tolerance(known)}"
                return f"it took more than {self.plan.patience:g} s at {at}"
        return ""

    def measure_family(self, family: Family) -> Iterator[Measurement]:
        """Measure all solvers on a family of a size."""
        following = next_with_same_matrix(family)[0]
        warm_up = SolveRequest(family.instances[0], following, self.plan.tolerances[0])
        timeout = max(WARM_UP_TIMEOUT, HANG_FACTOR * self.plan.patience)
        names = [solver.name for solver in capable_solvers(self.plan.solvers, family)]
        with ExitStack() as stack:
            for name in names:
                self.workers[name] = Worker(self.lookup, name, warm_up, timeout)
                stack.callback(self.workers[name].close)
            memory = self.measure_memory(family, names)
            for tolerance in self.plan.tolerances:
                yield from self.measure_at_tolerance(family, names, tolerance, memory)

    def measure_memory(self, family: Family, names: list[str]) -> dict[str, float]:
        """Return the memory that the first instance takes in a new process [MiB].

        A solver that does not finish it counts as too slow.
        """
        loosest, growth = self.plan.tolerances[0], dict[str, float]()
        for name in names:
            if not self.skip_reason(name, family, loosest):
                worker = self.workers[name]
                try:
                    worker.start()
                except WorkerError as end:
                    self.record_time(name, family, loosest, SolveReply(end.outcome))
                growth[name] = worker.memory_growth
        return growth

    def measure_at_tolerance(
        self, family: Family, names: list[str], tolerance: float, memory: dict[str, float]
    ) -> Iterator[Measurement]:
        """Measure all solvers on a family of a size at a tolerance."""
        firsts: dict[tuple[str, str], list[SolveOutcome]] = {}
        seconds: dict[tuple[str, str], list[SolveOutcome]] = {}
        followers = next_with_same_matrix(family)
        for instance, following in zip(family.instances, followers, strict=True):
            request, crashed = SolveRequest(instance, following, tolerance), set[str]()
            for _ in range(self.plan.repeats):
                for name in self.rng.permutation(names):
                    self.done += 1
                    if name in crashed or self.skip_reason(name, family, tolerance):
                        continue
                    reply = self.solve(name, family, request)
                    firsts.setdefault((name, instance.name), []).append(reply.first)
                    if following is not None and reply.second is not None:
                        seconds.setdefault((name, following.name), []).append(reply.second)
                    if reply.crashed:
                        crashed.add(name)
                self.progress(self.done, self.plan.solve_count)
        for name in names:
            skipped = SolveOutcome("skipped", self.skip_reason(name, family, tolerance))
            for instance in family.instances:
                key = name, instance.name
                yield Measurement(
                    name,
                    family.name,
                    family.size,
                    instance,
                    tolerance,
                    _combine_repeats(firsts[key]) if key in firsts else skipped,
                    _combine_repeats(seconds[key]) if key in seconds else None,
                    memory.get(name, float("nan")),
                )

    def solve(self, name: str, family: Family, request: SolveRequest) -> SolveReply:
        """Make a request; the end of the process is an outcome too."""
        try:
            reply = self.workers[name].solve(request, HANG_FACTOR * self.plan.patience)
        except WorkerError as end:
            # A solver that did not reach the second solve is not correct there either.
            second = SolveOutcome("crashed", str(end)) if request.next_instance else None
            reply = SolveReply(end.outcome, second)
        self.record_time(name, family, request.tolerance, reply)
        return reply


def _combine_repeats(outcomes: list[SolveOutcome]) -> SolveOutcome:
    worst = max(outcomes, key=lambda outcome: SEVERITY.index(outcome.verdict))
    times = [outcome.seconds for outcome in outcomes if outcome.seconds == outcome.seconds]
    return worst._replace(seconds=median(times)) if times else worst
