"""Everybody in turn, over and over: times that the same neighbours have disturbed."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from statistics import median
from typing import Literal, NamedTuple

import numpy as np

from problems.conic import TOLERANCE
from problems.families import SIZES, Family, Instance
from problems.solvers import adapters
from sato.compare.plan import Plan, followers, power
from sato.compare.worker import Find, Gone, Outcome, Question, Reply, Worker

SEVERITY = ("solved", "infeasible", "unproven", "failed", "wrong claim", "crashed")
HANGS = 10.0  # times the patience, after which a process is ended

Progress = Callable[[int, int], None]  # how many were asked, of how many


class Measurement(NamedTuple):
    """What became of a solver, an instance and a tolerance."""

    solver: str
    family: str
    size: str
    instance: Instance
    tolerance: float
    first: Outcome  # read and solved; times are medians of the repeats, the rest is of the worst
    again: Outcome | None  # solved by who had read the instance before; none where no two share A
    memory: float  # by which the process grew with one instance of the family and size [MiB]

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """Of the first solve, and of the second where there is one."""
        return (self.first,) if self.again is None else (self.first, self.again)

    @property
    def wanted(self) -> Literal["solved", "infeasible"]:
        """The verdict that is right."""
        return "solved" if self.instance.feasible else "infeasible"

    @property
    def right(self) -> bool:
        """Whether everything that was said of it is right, and proven."""
        return all(outcome.verdict == self.wanted for outcome in self.outcomes)

    @property
    def last(self) -> Outcome:
        """Of the second solve, or of the first where there is no other."""
        return self.again or self.first


def measure(
    plan: Plan,
    rng: np.random.Generator,
    patience: float,
    progress: Progress = lambda done, total: None,
    find: Find = adapters,
) -> list[Measurement]:
    """Ask every solver every question it can take.

    Solvers live in processes of their own and are asked one at a time. What took longer than the
    patience is not repeated, and nothing larger or tighter of that family is asked of that solver;
    what takes ten times as long is ended, and counts as crashed.

    Args:
        plan: Who is asked what.
        rng: For the order of the solvers, drawn anew for each repeat.
        patience: With one solve [s].
        progress: Told after each question.
        find: The solvers that there are; must be known to another process by its name.
    """
    field = _Field(plan, rng, patience, progress, find)
    return [measurement for family in plan.families for measurement in field.family(family)]


class _Field:
    """The solvers, and who has lost our patience where."""

    def __init__(
        self,
        plan: Plan,
        rng: np.random.Generator,
        patience: float,
        progress: Progress,
        find: Find,
    ) -> None:
        self.plan, self.rng, self.patience, self.find = plan, rng, patience, find
        self.progress, self.done = progress, 0
        self.workers: dict[str, Worker] = {}
        self.slow: dict[tuple[str, str], list[tuple[int, float]]] = {}

    def family(self, family: Family) -> Iterator[Measurement]:
        """All that is asked of a family."""
        memory: dict[str, float] = {}
        with ExitStack() as stack:
            for solver in self.plan.able(family):
                if not self.given_up(solver.name, family, max(self.plan.tolerances)):
                    worker = self.workers[solver.name] = Worker(self.find, solver.name)
                    stack.callback(worker.close)
                    memory[solver.name] = self.memory(solver.name, family)
            for tolerance in self.plan.tolerances:
                yield from self.cell(family, tolerance, memory)

    def memory(self, name: str, family: Family) -> float:
        """What the first instance takes in a process that has done nothing else [MiB].

        What a library does once in its life is then done, and no part of a time.
        """
        tolerance = min(self.plan.tolerances, key=lambda t: abs(np.log(t / TOLERANCE)))
        # Who crashes here will again where it is measured.
        return self.ask(name, Question(family.instances[0], None, tolerance)).memory

    def cell(
        self, family: Family, tolerance: float, memory: dict[str, float]
    ) -> Iterator[Measurement]:
        """A family of a size at a tolerance."""
        names = [solver.name for solver in self.plan.able(family)]
        out = {name: self.given_up(name, family, tolerance) for name in names}
        firsts: dict[tuple[str, str], list[Outcome]] = {}
        agains: dict[tuple[str, str], list[Outcome]] = {}
        for instance, after in zip(family.instances, followers(family), strict=True):
            question = Question(instance, after, tolerance)
            tired: set[str] = set()
            for _ in range(self.plan.repeats):
                for k in self.rng.permutation(len(names)):
                    name = names[k]
                    if not out[name] and name not in tired:
                        reply = self.ask(name, question)
                        firsts.setdefault((name, instance.name), []).append(reply.first)
                        if after is not None and reply.again is not None:
                            agains.setdefault((name, after.name), []).append(reply.again)
                        slow = self.too_slow(reply)
                        if slow:
                            here = SIZES.index(family.size), tolerance
                            self.slow.setdefault((name, family.name), []).append(here)
                        if slow or reply.first.verdict == "crashed":
                            tired.add(name)
                    self.done += 1
                    self.progress(self.done, self.plan.asks)
        for name in names:
            for instance in family.instances:
                key = name, instance.name
                first = _whole(firsts[key]) if key in firsts else Outcome("skipped", out[name])
                again = _whole(agains[key]) if key in agains else None
                yield Measurement(
                    name, family.name, family.size, instance, tolerance, first, again,
                    memory.get(name, float("nan")),
                )  # fmt: skip

    def ask(self, name: str, question: Question) -> Reply:
        """Ask one, and make the end of its process an outcome like others."""
        try:
            return self.workers[name].ask(question, HANGS * self.patience)
        except Gone as end:
            return Reply(Outcome("crashed", str(end), end.seconds), None, float("nan"))

    def too_slow(self, reply: Reply) -> bool:
        """Whether what is larger or tighter had better not be asked."""
        outcomes = [reply.first, *([reply.again] if reply.again else [])]
        return max(outcome.seconds for outcome in outcomes) > self.patience

    def given_up(self, name: str, family: Family, tolerance: float) -> str:
        """Why a solver is not asked, or nothing."""
        size = SIZES.index(family.size)
        for known_size, known in self.slow.get((name, family.name), ()):
            if (
                known_size <= size
                and known >= tolerance
                and (known_size, known)
                != (
                    size,
                    tolerance,
                )
            ):
                return (
                    f"it took more than {self.patience:g} s at {SIZES[known_size]}, {power(known)}"
                )
        return ""


def _whole(outcomes: list[Outcome]) -> Outcome:
    worst = max(outcomes, key=lambda outcome: SEVERITY.index(outcome.verdict))
    times = [outcome.seconds for outcome in outcomes if outcome.seconds == outcome.seconds]
    return worst._replace(seconds=median(times)) if times else worst
