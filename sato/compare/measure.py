"""Everybody in turn, over and over: times that the same neighbours have disturbed."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from statistics import median
from typing import Literal, NamedTuple

import numpy as np

from problems.families import SIZES, Family, Instance
from problems.solvers import load_adapters
from sato.compare.plan import ComparisonPlan, format_tolerance, next_with_same_matrix
from sato.compare.worker import (
    SolveOutcome,
    SolveReply,
    SolveRequest,
    SolverLookup,
    Worker,
    WorkerError,
)

SEVERITY = ("solved", "infeasible", "unproven", "failed", "wrong claim", "crashed")
HANG_FACTOR = (
    10.0  # times the patience, by the clock on the wall: others may keep the processor busy
)
WARM_UP_TIMEOUT = 60.0  # for each solve of a warm-up, in which some libraries compile [s]

ProgressCallback = Callable[[int, int], None]  # how many were asked, of how many


class Measurement(NamedTuple):
    """What became of a solver, an instance and a tolerance."""

    solver: str
    family: str
    size: str
    instance: Instance
    tolerance: float
    first: (
        SolveOutcome  # read and solved; times are medians of the repeats, the rest is of the worst
    )
    second: (
        SolveOutcome | None
    )  # solved by who had read the instance before; none where no two share A
    memory_growth: float  # by which the process grew with one instance of the family and size [MiB]

    @property
    def outcomes(self) -> tuple[SolveOutcome, ...]:
        """Of the first solve, and of the second where there is one."""
        return (self.first,) if self.second is None else (self.first, self.second)

    @property
    def expected(self) -> Literal["solved", "infeasible"]:
        """The verdict that is right."""
        return "solved" if self.instance.is_feasible else "infeasible"

    @property
    def is_correct(self) -> bool:
        """Whether everything that was said of it is right, and proven."""
        return all(outcome.verdict == self.expected for outcome in self.outcomes)

    @property
    def last(self) -> SolveOutcome:
        """Of the second solve, or of the first where there is no other."""
        return self.second or self.first


def measure_solvers(
    plan: ComparisonPlan,
    rng: np.random.Generator,
    patience: float,
    progress: ProgressCallback = lambda done, total: None,
    solvers: SolverLookup = load_adapters,
) -> list[Measurement]:
    """Ask every solver every question it can take.

    Solvers live in processes of their own and are asked one at a time. A solver that took longer
    than the patience is asked no more in that family at that size and tolerance, nor for what is
    larger or tighter; a solve that takes ten times as long by the clock on the wall is ended, and
    counts as crashed.

    Args:
        plan: Who is asked what.
        rng: For the order of the solvers, drawn anew for each repeat.
        patience: With one solve [s].
        progress: Told after each question.
        find: The solvers that there are; must be known to another process by its name.
    """
    field = _MeasurementRun(plan, rng, _TimeLimit(patience), progress, solvers)
    return [measurement for family in plan.families for measurement in field.measure_family(family)]


class _TimeLimit:
    """Who took too long, and where."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._exceeded: dict[tuple[str, str], list[tuple[int, float]]] = {}

    def record(self, name: str, family: Family, tolerance: float, reply: SolveReply) -> None:
        """Take note of how long a solver took."""
        again = reply.second.seconds if reply.second else 0.0
        if reply.first.seconds > self.seconds or again > self.seconds:
            where = SIZES.index(family.size), tolerance
            self._exceeded.setdefault((name, family.name), []).append(where)

    def skip_reason(self, name: str, family: Family, tolerance: float) -> str:
        """Why a solver is not asked, or nothing."""
        for size, known in self._exceeded.get((name, family.name), ()):
            if size <= SIZES.index(family.size) and known >= tolerance:
                return f"it took more than {self.seconds:g} s at {SIZES[size]}, {format_tolerance(known)}"
        return ""


class _MeasurementRun:
    """The solvers in their processes, and the questions one after another."""

    def __init__(
        self,
        plan: ComparisonPlan,
        rng: np.random.Generator,
        patience: _TimeLimit,
        progress: ProgressCallback,
        find: SolverLookup,
    ) -> None:
        self.plan, self.rng, self.patience, self.find = plan, rng, patience, find
        self.progress, self.done, self.all = progress, 0, plan.solve_count
        self.workers: dict[str, Worker] = {}

    def measure_family(self, family: Family) -> Iterator[Measurement]:
        """All that is asked of a family of a size."""
        warm_up = SolveRequest(
            family.instances[0], next_with_same_matrix(family)[0], self.plan.tolerances[0]
        )
        seconds = max(WARM_UP_TIMEOUT, HANG_FACTOR * self.patience.seconds)
        with ExitStack() as stack:
            for solver in self.plan.capable_solvers(family):
                worker = Worker(self.find, solver.name, warm_up, seconds)
                self.workers[solver.name] = worker
                stack.callback(worker.close)
            memory = self.measure_memory(family)
            for tolerance in self.plan.tolerances:
                yield from self.measure_at_tolerance(family, tolerance, memory)

    def measure_memory(self, family: Family) -> dict[str, float]:
        """What the first instance takes, in processes that have done nothing else [MiB].

        Only who does not end it has lost the patience.
        """
        loosest, found = self.plan.tolerances[0], dict[str, float]()
        for solver in self.plan.capable_solvers(family):
            if self.patience.skip_reason(solver.name, family, loosest):
                continue
            worker = self.workers[solver.name]
            try:
                worker.start()
            except WorkerError as end:
                ended = SolveReply(end.outcome, None, worker.memory_growth)
                self.patience.record(solver.name, family, loosest, ended)
            found[solver.name] = worker.memory_growth
        return found

    def measure_at_tolerance(
        self, family: Family, tolerance: float, memory: dict[str, float]
    ) -> Iterator[Measurement]:
        """A family of a size at a tolerance."""
        names = [solver.name for solver in self.plan.capable_solvers(family)]
        firsts: dict[tuple[str, str], list[SolveOutcome]] = {}
        agains: dict[tuple[str, str], list[SolveOutcome]] = {}
        for instance, after in zip(family.instances, next_with_same_matrix(family), strict=True):
            question, crashed = SolveRequest(instance, after, tolerance), set[str]()
            for _ in range(self.plan.repeats):
                for name in self.rng.permutation(names):
                    self.done += 1
                    if name in crashed or self.patience.skip_reason(name, family, tolerance):
                        continue
                    reply = self.solve_and_record(name, family, question)
                    first, again, _ = reply
                    firsts.setdefault((name, instance.name), []).append(first)
                    if after is not None and again is not None:
                        agains.setdefault((name, after.name), []).append(again)
                    if reply.crashed:
                        crashed.add(name)
                self.progress(self.done, self.all)
        for name in names:
            for instance in family.instances:
                key = name, instance.name
                first = SolveOutcome("skipped", self.patience.skip_reason(name, family, tolerance))
                yield Measurement(
                    name,
                    family.name,
                    family.size,
                    instance,
                    tolerance,
                    _combine_repeats(firsts[key]) if key in firsts else first,
                    _combine_repeats(agains[key]) if key in agains else None,
                    memory.get(name, float("nan")),
                )

    def solve_and_record(self, name: str, family: Family, question: SolveRequest) -> SolveReply:
        """Ask one, and take note of how long it took."""
        reply = self.solve(name, question)
        self.patience.record(name, family, question.tolerance, reply)
        return reply

    def solve(self, name: str, question: SolveRequest) -> SolveReply:
        """Ask one, and make the end of its process an outcome like others."""
        try:
            return self.workers[name].solve(question, HANG_FACTOR * self.patience.seconds)
        except WorkerError as end:
            # Who did not come as far as the second solve has nothing right there either.
            again = SolveOutcome("crashed", str(end)) if question.next_instance else None
            return SolveReply(end.outcome, again, float("nan"))


def _combine_repeats(outcomes: list[SolveOutcome]) -> SolveOutcome:
    worst = max(outcomes, key=lambda outcome: SEVERITY.index(outcome.verdict))
    times = [outcome.seconds for outcome in outcomes if outcome.seconds == outcome.seconds]
    return worst._replace(seconds=median(times)) if times else worst
