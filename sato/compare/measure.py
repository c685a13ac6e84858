"""Everybody in turn, over and over: times that the same neighbours have disturbed."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from statistics import median
from typing import Literal, NamedTuple

import numpy as np

from problems.families import SIZES, Family, Instance
from problems.solvers import adapters
from sato.compare.plan import Plan, followers, power
from sato.compare.worker import Find, Gone, Outcome, Question, Reply, Worker

SEVERITY = ("solved", "infeasible", "unproven", "failed", "wrong claim", "crashed")
HANGS = 10.0  # times the patience, by the clock on the wall: others may keep the processor busy
WARMS = 60.0  # for each solve of a warm-up, in which some libraries compile [s]

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
    field = _Field(plan, rng, _Patience(patience), progress, find)
    return [measurement for family in plan.families for measurement in field.family(family)]


class _Patience:
    """Who took too long, and where."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._lost: dict[tuple[str, str], list[tuple[int, float]]] = {}

    def watch(self, name: str, family: Family, tolerance: float, reply: Reply) -> None:
        """Take note of how long a solver took."""
        again = reply.again.seconds if reply.again else 0.0
        if reply.first.seconds > self.seconds or again > self.seconds:
            where = SIZES.index(family.size), tolerance
            self._lost.setdefault((name, family.name), []).append(where)

    def lost(self, name: str, family: Family, tolerance: float) -> str:
        """Why a solver is not asked, or nothing."""
        for size, known in self._lost.get((name, family.name), ()):
            if size <= SIZES.index(family.size) and known >= tolerance:
                return f"it took more than {self.seconds:g} s at {SIZES[size]}, {power(known)}"
        return ""


class _Field:
    """The solvers in their processes, and the questions one after another."""

    def __init__(
        self,
        plan: Plan,
        rng: np.random.Generator,
        patience: _Patience,
        progress: Progress,
        find: Find,
    ) -> None:
        self.plan, self.rng, self.patience, self.find = plan, rng, patience, find
        self.progress, self.done, self.all = progress, 0, plan.asks
        self.workers: dict[str, Worker] = {}

    def family(self, family: Family) -> Iterator[Measurement]:
        """All that is asked of a family of a size."""
        warm_up = Question(family.instances[0], followers(family)[0], self.plan.tolerances[0])
        seconds = max(WARMS, HANGS * self.patience.seconds)
        with ExitStack() as stack:
            for solver in self.plan.able(family):
                worker = Worker(self.find, solver.name, warm_up, seconds)
                self.workers[solver.name] = worker
                stack.callback(worker.close)
            memory = self.memory(family)
            for tolerance in self.plan.tolerances:
                yield from self.cell(family, tolerance, memory)

    def memory(self, family: Family) -> dict[str, float]:
        """What the first instance takes, in processes that have done nothing else [MiB].

        Only who does not end it has lost the patience.
        """
        loosest, found = self.plan.tolerances[0], dict[str, float]()
        for solver in self.plan.able(family):
            if self.patience.lost(solver.name, family, loosest):
                continue
            worker = self.workers[solver.name]
            try:
                worker.begin()
            except Gone as end:
                ended = Reply(end.outcome, None, worker.grown)
                self.patience.watch(solver.name, family, loosest, ended)
            found[solver.name] = worker.grown
        return found

    def cell(
        self, family: Family, tolerance: float, memory: dict[str, float]
    ) -> Iterator[Measurement]:
        """A family of a size at a tolerance."""
        names = [solver.name for solver in self.plan.able(family)]
        firsts: dict[tuple[str, str], list[Outcome]] = {}
        agains: dict[tuple[str, str], list[Outcome]] = {}
        for instance, after in zip(family.instances, followers(family), strict=True):
            question, crashed = Question(instance, after, tolerance), set[str]()
            for _ in range(self.plan.repeats):
                for name in self.rng.permutation(names):
                    self.done += 1
                    if name in crashed or self.patience.lost(name, family, tolerance):
                        continue
                    reply = self.ask(name, family, question)
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
                first = Outcome("skipped", self.patience.lost(name, family, tolerance))
                yield Measurement(
                    name,
                    family.name,
                    family.size,
                    instance,
                    tolerance,
                    _whole(firsts[key]) if key in firsts else first,
                    _whole(agains[key]) if key in agains else None,
                    memory.get(name, float("nan")),
                )

    def ask(self, name: str, family: Family, question: Question) -> Reply:
        """Ask one, and take note of how long it took."""
        reply = self.reply(name, question)
        self.patience.watch(name, family, question.tolerance, reply)
        return reply

    def reply(self, name: str, question: Question) -> Reply:
        """Ask one, and make the end of its process an outcome like others."""
        try:
            return self.workers[name].ask(question, HANGS * self.patience.seconds)
        except Gone as end:
            # Who did not come as far as the second solve has nothing right there either.
            again = Outcome("crashed", str(end)) if question.after else None
            return Reply(end.outcome, again, float("nan"))


def _whole(outcomes: list[Outcome]) -> Outcome:
    worst = max(outcomes, key=lambda outcome: SEVERITY.index(outcome.verdict))
    times = [outcome.seconds for outcome in outcomes if outcome.seconds == outcome.seconds]
    return worst._replace(seconds=median(times)) if times else worst
