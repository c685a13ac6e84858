"""What the families are drawn from: runs of scenarios, and what their vehicles ask a solver."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from scipy.linalg import null_space
from scipy.sparse import csc_array, hstack

import sato
from dynamics import hold
from problems.avoidance import Avoidance, no_spaces
from problems.conic import Answer, Conic, Infeasible, triangle
from problems.conic import solve as solve_conic
from problems.convexify import Way, half_spaces, normals
from problems.formation import Formation
from problems.gain_question import Question
from problems.solvers import solve_highs
from problems.speed_cones import SpeedCones
from problems.transfer import Transfer
from sato.reconfiguration.flight import fly
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import look_ahead
from sato.reconfiguration.routes import SLOPE
from sato.shapes.random_formation import random_formation, thinned

COUNT = 10  # instances of a family and size
FEWER = {  # where so many would take much room
    ("avoidance-20", "medium"): 9,
    ("avoidance-20", "large"): 7,
    ("transfer-socp", "large"): 6,
    ("gain-sdp", "large"): 6,
}
SEED = 1
STEPS = {"small": 20, "medium": 50, "large": 100}
SPEED = 3.0  # the limit of transfer-socp, which some can just keep [m/s]
ORBIT = {"small": (24, 1.0), "medium": (48, 0.5), "large": (96, 0.25)}  # steps, and minutes each
CROWD = {"small": 20, "medium": 40, "large": 60}  # steps
CLOSE = (  # a crowd in which paths cross
    "leg.shape.spacing_m=1.5",
    "swarm.start.box_m=9.0",
    "swarm.collision_radius_m=0.75",
    "swarm.comm_radius_m=7.0",
    "model.max_speed_m_s=0.5",
    "plan.tie_break=0.0",
    "plan.horizon_steps=6",
)
VEHICLES = {"small": 6, "medium": 10, "large": 15}
HAIR = 1.001  # of the least control that reaches a goal: with more there is a way, with less none


class Drawn(NamedTuple):
    """Questions before they are answered."""

    source: str
    problems: list[Conic]
    feasible: bool = True


class Start(NamedTuple):
    """A leg as it begins, after its first auction."""

    mission: Reconfiguration
    states: np.ndarray
    goals: np.ndarray

    @classmethod
    def of(cls, scenario: str, *overrides: str, seed: int = SEED) -> "Start":
        """That of the first leg of a scenario."""
        rng = np.random.default_rng(seed)
        mission = sato.read(scenario, overrides).build(rng)
        frame = next(fly(mission, rng))
        states = np.concatenate([frame.position, frame.velocity], axis=1)
        return cls(mission, states, mission.legs[0].targets[frame.target])

    def farthest(self, count: int) -> "Start":
        """The agents with the longest ways to go."""
        way = np.linalg.norm((self.goals - self.states)[:, : self.mission.model.axes], axis=1)
        chosen = np.argsort(-way, kind="stable")[:count]
        return Start(self.mission, self.states[chosen], self.goals[chosen])

    def transfer(self, speed: float = np.inf) -> Transfer:
        """What all of them plan with."""
        mission = self.mission
        steps = hold(mission.model, mission.step, mission.legs[0].steps)
        return Transfer(steps, mission.max_control, speed, slope=SLOPE)


@contextmanager
def recorded(module: str) -> Iterator[list[Conic]]:
    """What a module of `problems` asks its solver."""
    asked: list[Conic] = []

    def note(problem: Conic, solver: Callable[[Conic], Answer]) -> Answer:
        asked.append(problem)
        return solve_conic(problem, solver)

    with patch(f"problems.{module}.solve", note):
        yield asked


def count(family: str, size: str) -> int:
    """How many instances are asked for."""
    return FEWER.get((family, size), COUNT)


def transfer_lp(size: str) -> Drawn:
    """Problem 6 with the states eliminated."""
    T = STEPS[size]
    problems = condensed(Start.of("random", f"leg.steps={T}").farthest(COUNT))
    source = f"the longest flights of the first leg of random, {T} steps, without the states"
    return Drawn(source, problems)


def condensed(start: Start) -> list[Conic]:
    """The programmes of agents that are alone, in the controls alone."""
    transfer = start.transfer()
    with recorded("avoidance") as asked:
        for state, goal in zip(start.states, start.goals, strict=True):
            Avoidance(transfer).solve(state, goal, no_spaces(transfer))
    return asked


def transfer_socp(size: str) -> Drawn:
    """Problem 6 with the states kept, for those who would be too fast without a limit."""
    T, step = ORBIT[size]
    start = Start.of("random_cw", "agents=48", f"leg.steps={T}", f"plan.step_min={step}")
    alone, limited = Avoidance(start.transfer()), SpeedCones(start.transfer(SPEED))
    problems: list[Conic] = []
    for state, goal in zip(start.states, start.goals, strict=True):
        free = alone.solve(state, goal, no_spaces(alone.transfer)).flight
        if np.linalg.norm(free.x[1:-1, 3:], axis=1).max() <= SPEED:
            continue
        with recorded("speed_cones") as asked, suppress(Infeasible):
            limited.solve(state, goal)
            problems += asked
    source = f"flights of random_cw with 48 vehicles, {T} steps of {step} min, at most {SPEED} m/s"
    return Drawn(source, problems[: count("transfer-socp", size)])


def j2(size: str) -> Drawn:
    """Problem 6 about a chief in orbit, with the states eliminated."""
    T, step = ORBIT[size]
    start = Start.of("orbit", f"leg.steps={T}", f"plan.step_min={step}").farthest(COUNT)
    problems = condensed(start)
    source = f"the longest flights of orbit, {T} steps of {step} min, J2 linear about the chief"
    return Drawn(source, problems)


def near_infeasible(size: str) -> Drawn:
    """Goals that are all but out of reach."""
    problems = [stretched(problem, 1 / HAIR) for problem in transfer_lp(size).problems]
    source = f"transfer-lp with its goals moved away until {HAIR} of the least control remains"
    return Drawn(source, problems)


def infeasible(size: str) -> Drawn:
    """Goals that are just out of reach, and agents that should pass on both sides at once."""
    far = [stretched(problem, HAIR) for problem in transfer_lp(size).problems[: COUNT // 2]]
    both = among(size, 5, ("near", "far"), COUNT // 2)
    source = f"transfer-lp with its goals {HAIR} times as far as can be reached, and avoidance-5 "
    source += "with the half-spaces of both sides of each neighbour"
    return Drawn(source, far + both, feasible=False)


def stretched(problem: Conic, share: float) -> Conic:
    """The same with the goal moved away from where the agent drifts to.

    Args:
        problem: A transfer without its states.
        share: Of the farthest goal on that line that can be reached.
    """
    reach = np.concatenate([problem.b[: problem.zero], np.zeros(problem.nonnegative)])
    limits = problem.b - reach
    q, A = np.append(np.zeros(len(problem.q)), -1.0), hstack([problem.A, -reach[:, None]])
    farther = Conic(q, csc_array(A), limits, problem.zero, problem.nonnegative)
    farthest = solve_conic(farther, solve_highs).x[-1]
    b = limits + share * farthest * reach
    return replace(problem, b=b)


def avoidance(neighbours: int) -> Callable[[str], Drawn]:
    """Problem 7 of agents whose flights would meet one of their neighbours."""

    def draw(size: str) -> Drawn:
        problems = among(size, neighbours, ("near",), count(f"avoidance-{neighbours}", size))
        source = (
            f"a crowd of random with {CROWD[size]} steps to go, seeds from {SEED} on: who would "
            f"meet one of the {neighbours} nearest, in the first exchange; half-spaces that no "
            "control could break are left out, and A is rounded to single precision"
        )
        return Drawn(source, problems)

    return draw


def among(size: str, neighbours: int, ways: tuple[Way, ...], wanted: int) -> list[Conic]:
    """Programmes among the half-spaces past the nearest neighbours, on all the ways given.

    Past them on one way there must be a flight, and on two at once there must be none.
    """
    found: list[Conic] = []
    for seed in range(SEED, SEED + 50):
        start = Start.of("random", f"leg.steps={CROWD[size]}", *CLOSE, seed=seed)
        mission, transfer = start.mission, start.transfer(start.mission.max_speed)
        programme, horizon = Avoidance(transfer), look_ahead(mission, 0.0, CROWD[size])
        ends = list(zip(start.states, start.goals, strict=True))
        free = [programme.solve(*end, no_spaces(transfer)).flight for end in ends]
        paths = np.stack([horizon.path(flight.x, flight.u) for flight in free])
        for i, flight in enumerate(free):
            away = np.linalg.norm(start.states - start.states[i], axis=1)
            others = paths[np.argsort(away, kind="stable")[1 : neighbours + 1]]
            normal = [normals(paths[i] - others, horizon.keep, way) for way in ways]
            theirs = np.concatenate([others] * len(ways))
            spaces = half_spaces(horizon, len(flight.u), theirs, np.concatenate(normal))
            if spaces.missing(flight.x, flight.u).max() <= 0:
                continue
            with recorded("avoidance") as asked:
                try:
                    programme.solve(*ends[i], spaces)
                    possible = True
                except Infeasible:
                    possible = False
            if possible == (len(ways) == 1):
                found.append(single(needed(asked[-1], len(spaces.least))))
            if len(found) == wanted:
                return found
    raise ValueError(f"fifty crowds have only {len(found)} such programmes, and not {wanted}")


def needed(problem: Conic, spaces: int) -> Conic:
    """The same without the half-spaces that no controls within their limits could break."""
    A, rows = problem.A.toarray(), np.arange(len(problem.b)) - problem.zero
    idle = np.maximum(A, 0).sum(axis=1) <= problem.b
    kept = ~(idle & (rows >= 0) & (rows < spaces))
    inequalities = problem.nonnegative - int((~kept).sum())
    b = problem.b[kept]
    return Conic(problem.q, csc_array(A[kept]), b, problem.zero, inequalities, problem.cones)


def single(problem: Conic) -> Conic:
    """The same with the entries of A in single precision: another programme, in half the room."""
    return replace(problem, A=csc_array(problem.A.astype(np.float32).astype(float)))


def gain_sdp(size: str) -> Drawn:
    """The fastest gains in the plane, with the matrix Z as the unknown."""
    rng, n, problems = np.random.default_rng(SEED), VEHICLES[size], []
    for _ in range(count("gain-sdp", size)):
        points = random_formation(n, (15.0, 15.0, 2.0), 2.0, rng)
        graph = thinned(n, n - 4, rng)
        problems.append(single(fastest(Question.of(Formation(points, graph), "xy"))))
    source = f"formations of {n} as the scenario formation draws them, with graphs as thinned as "
    source += "in the trials of [Lusk2020]; A is rounded to single precision"
    return Drawn(source, problems)


def fastest(question: Question) -> Conic:
    """Maximise t subject to Z − t I ⪰ 0, tr Z = m and zeros of Q Z Qᴴ at the non-edges.

    A Hermitian matrix is as definite as [[Re, −Im], [Im, Re]]; Z is in units of its entries.
    """
    m, Q = question.m, null_space(question.kernel.conj().T)
    i, j = np.nonzero(np.triu(~question.graph, 1))
    rows, traces, cone = [], [], []
    for E in hermitian(m):
        entries = (Q @ E @ Q.conj().T)[i, j]
        rows.append(np.concatenate([entries.real, entries.imag]))
        traces.append(E.trace().real)
        cone.append(triangle(np.block([[E.real, -E.imag], [E.imag, E.real]])))
    A = np.vstack([traces, np.array(rows).T, -np.array(cone).T])
    t = np.concatenate([np.zeros(1 + 2 * len(i)), triangle(np.eye(2 * m))])
    b = np.zeros(len(t))
    b[0] = m
    q = np.append(np.zeros(m * m), -1.0)
    return Conic(q, csc_array(np.column_stack([A, t])), b, 1 + 2 * len(i), 0, (), (2 * m,))


def hermitian(m: int) -> Iterator[np.ndarray]:
    """A basis of the Hermitian matrices of order m."""
    for row, column in zip(*np.tril_indices(m), strict=True):
        for unit in (1.0,) if row == column else (1.0, 1j):
            E = np.zeros((m, m), complex)
            E[row, column], E[column, row] = unit, np.conj(unit)
            yield E


FAMILIES: dict[str, Callable[[str], Drawn]] = {
    "transfer-lp": transfer_lp,
    "transfer-socp": transfer_socp,
    "j2": j2,
    "avoidance-5": avoidance(5),
    "avoidance-20": avoidance(20),
    "near-infeasible": near_infeasible,
    "infeasible": infeasible,
    "gain-sdp": gain_sdp,
}
