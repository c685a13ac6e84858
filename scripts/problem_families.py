"""Sources of the problem families: the problems that vehicles solve in runs of scenarios."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from scipy.linalg import block_diag, null_space
from scipy.sparse import block_array, csc_array, eye_array, hstack, kron

import sato
from dynamics import discretize_zoh
from problems.avoidance import AvoidanceProblem
from problems.conic import ConicProgram, Infeasible, SolverResult, svec
from problems.conic import solve as solve_conic
from problems.convexify import PassingSide, choose_normals, convexify
from problems.desired_formation import DesiredFormation
from problems.gain_problem import GainProblem
from problems.solvers import solve_clarabel, solve_highs
from problems.transfer import Objective, TransferProblem
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import make_horizon
from sato.reconfiguration.solo_trajectories import TIE_BREAK_RISE
from sato.shapes.formation_library import random_dense_graph
from sato.shapes.random_points import sample_formation

INSTANCE_COUNT = 10  # instances of a family and size
REDUCED_COUNTS = {  # where so many would take much room
    ("avoidance-20", "medium"): 9,
    ("avoidance-20", "large"): 7,
    ("avoidance-energy", "large"): 8,
    ("transfer-socp", "large"): 6,
    ("gain-sdp", "large"): 6,
}
SEED = 1
ENERGY_CONTROL = 0.75  # of the largest control without a limit; two thirds would just suffice
STEPS = {"small": 20, "medium": 50, "large": 100}
SPEED_LIMIT = 3.0  # the limit of transfer-socp, which some can just keep [m/s]
ORBIT_STEPS = {
    "small": (24, 1.0),
    "medium": (48, 0.5),
    "large": (96, 0.25),
}  # steps, and minutes each
CROWD_STEPS = {"small": 20, "medium": 40, "large": 60}  # steps
DENSE_OVERRIDES = (  # a crowd in which paths cross
    "leg.shape.spacing_m=1.5",
    "swarm.start.box_m=9.0",
    "swarm.collision_radius_m=0.75",
    "swarm.comm_radius_m=7.0",
    "model.max_speed_m_s=0.5",
    "plan.tie_break=0.0",
    "plan.horizon_steps=6",
)
AGENT_COUNTS = {"small": 6, "medium": 10, "large": 15}
REACH_FACTOR = (
    1.001  # of the least control that reaches a goal: with more there is a way, with less none
)


class UnsolvedFamily(NamedTuple):
    """Problems of a family before they are solved."""

    source: str
    problems: list[ConicProgram]
    is_feasible: bool = True


class LegStart(NamedTuple):
    """States and targets at the start of a leg, after its first auction."""

    mission: Reconfiguration
    states: np.ndarray
    targets: np.ndarray

    @classmethod
    def from_scenario(cls, scenario: str, *overrides: str, seed: int = SEED) -> "LegStart":
        """Return the start of the first leg of a scenario."""
        rng = np.random.default_rng(seed)
        mission = sato.read(scenario, overrides).draw(rng)
        frame = next(simulate(mission, rng))
        states = np.concatenate([frame.position, frame.velocity], axis=1)
        return cls(mission, states, mission.legs[0].targets[frame.target_index])

    def farthest(self, count: int) -> "LegStart":
        """Select the agents that are farthest from their targets."""
        way = np.linalg.norm(
            (self.targets - self.states)[:, : self.mission.linear_model.axes], axis=1
        )
        chosen = np.argsort(-way, kind="stable")[:count]
        return LegStart(self.mission, self.states[chosen], self.targets[chosen])

    def make_transfer(self, speed: float = np.inf) -> TransferProblem:
        """Return the transfer problem that all agents share."""
        mission = self.mission
        steps = discretize_zoh(mission.linear_model, mission.step, mission.legs[0].steps)
        return TransferProblem(steps, mission.max_control, speed, tie_break_rise=TIE_BREAK_RISE)


@contextmanager
def record_problems() -> Iterator[list[ConicProgram]]:
    """Record the programs of transfers and avoidance that are given to the default solver."""
    asked: list[ConicProgram] = []

    def note(problem: ConicProgram) -> SolverResult:
        asked.append(problem)
        return solve_clarabel(problem)

    conic = patch("problems.constraint_generation.can_generate", lambda *_: False)
    with conic, patch("problems.solvers.verified.solve_clarabel", note):
        yield asked


def instance_count(family: str, size: str) -> int:
    """Return the number of instances of a family."""
    return REDUCED_COUNTS.get((family, size), INSTANCE_COUNT)


def make_transfer_lp(size: str) -> UnsolvedFamily:
    """Make Problem 6 with the states eliminated."""
    T = STEPS[size]
    problems = condensed_transfers(
        LegStart.from_scenario("random", f"leg.steps={T}").farthest(INSTANCE_COUNT)
    )
    source = f"the longest flights of the first leg of random, {T} steps, without the states"
    return UnsolvedFamily(source, problems)


def condensed_transfers(start: LegStart) -> list[ConicProgram]:
    """Return the programs of agents without neighbors, in the controls alone."""
    transfer = start.make_transfer()
    with record_problems() as asked:
        for state, goal in zip(start.states, start.targets, strict=True):
            AvoidanceProblem.alone(transfer, state, goal).solve()
    return asked


@dataclass(frozen=True, eq=False)
class SparseTransfer:
    """`TransferProblem` with q = 1, r = ∞ and a speed limit, as programs that keep the states.

    Unknowns are u⁺ and u⁻ in units of U, and y[1] … y[T−1], the deviation of the states from
    the free motion, in units of V and of the distance covered at V: all are of the order of 1,
    and only the right-hand side depends on start and target.
    """

    transfer: TransferProblem

    def assemble(self, start: np.ndarray, target: np.ndarray) -> ConicProgram:
        """Assemble the program of one transfer; all share q and A."""
        transfer, first = self.transfer, self._program
        T, n, m = transfer.model.B.shape
        free, b = transfer.coast(start), first.b.copy()
        b[(T - 1) * n : T * n] = (target - free[T]) / self._state_scale
        b[first.linear :].reshape(T - 1, m + 1)[:, 1:] = free[1:T, m:] / transfer.max_speed
        return replace(first, b=b)

    @cached_property
    def _state_scale(self) -> np.ndarray:
        steps, V = self.transfer.model, self.transfer.max_speed
        return np.repeat([V * len(steps) * steps.dt, V], steps.axes)

    @cached_property
    def _program(self) -> ConicProgram:
        steps, U, scale = self.transfer.model, self.transfer.max_control, self._state_scale
        T, n, m = steps.B.shape
        controls, states = 2 * T * m, (T - 1) * n
        # A[k] y[k] + B[k] u[k] − y[k+1] = 0; y[0] = 0, and y[T] is on the right-hand side.
        response = block_diag(*(U * steps.B / scale[:, None]))
        motion = np.zeros((T, n, T - 1, n))
        for k in range(1, T):
            motion[k, :, k - 1] = steps.A[k] * scale / scale[:, None]
            motion[k - 1, :, k - 1] = -np.eye(n)
        motion = motion.reshape(T * n, states)
        speed = np.zeros((m + 1, n))
        speed[1:, m:] = -np.eye(m)
        A = block_array(
            [
                [csc_array(np.hstack([response, -response])), csc_array(motion)],
                [eye_array(controls), None],
                [-eye_array(controls), None],
                [None, kron(eye_array(T - 1), csc_array(speed))],
            ]
        )
        q = np.zeros(controls + states)
        q[:controls] = np.tile(U * steps.dt * np.repeat(self.transfer.weights, m), 2)
        tops = np.zeros((T - 1, m + 1))
        tops[:, 0] = 1
        b = np.concatenate([np.zeros(T * n), np.ones(controls), np.zeros(controls), tops.ravel()])
        return ConicProgram(q, csc_array(A), b, T * n, 2 * controls, (m + 1,) * (T - 1))


def make_transfer_socp(size: str) -> UnsolvedFamily:
    """Make Problem 6 with the states kept, for agents on which the speed limit binds."""
    T, step = ORBIT_STEPS[size]
    start = LegStart.from_scenario(
        "random_cw", "agents=48", f"leg.steps={T}", f"plan.step_min={step}"
    )
    alone, limited = start.make_transfer(), start.make_transfer(SPEED_LIMIT)
    sparse, problems = SparseTransfer(limited), list[ConicProgram]()
    for state, goal in zip(start.states, start.targets, strict=True):
        free = AvoidanceProblem.alone(alone, state, goal).solve().trajectory
        if limited.is_too_fast(free.x).any():
            with suppress(Infeasible):
                program = sparse.assemble(state, goal)
                solve_conic(program, solve_clarabel)
                problems.append(program)
    source = (
        f"flights of random_cw with 48 vehicles, {T} steps of {step} min, at most {SPEED_LIMIT} m/s"
    )
    return UnsolvedFamily(source, problems[: instance_count("transfer-socp", size)])


def make_transfer_energy(size: str) -> UnsolvedFamily:
    """Make transfers of least energy, on which the limit of the control is active."""
    T = STEPS[size]
    start = LegStart.from_scenario("random", f"leg.steps={T}").farthest(INSTANCE_COUNT)
    transfer = replace(start.make_transfer(), objective="energy")
    limited = replace(transfer, max_control=ENERGY_CONTROL * transfer.max_control)
    with record_problems() as asked:
        for state, goal in zip(start.states, start.targets, strict=True):
            _, u, _ = transfer.solve_without_limits(state, goal[None])
            drift = transfer.coast(state)[-1]
            farther = drift + transfer.max_control / np.abs(u).max() * (goal - drift)
            AvoidanceProblem.alone(limited, state, farther).solve()
    source = f"the longest flights of the first leg of random, {T} steps, for the least energy, "
    source += f"without the states, so far that the limit is {ENERGY_CONTROL} of the largest "
    source += "control without one"
    # Those that share their unit of energy, and with it P, follow each other.
    return UnsolvedFamily(source, sorted(asked, key=lambda program: program.P.data[0]))


def make_j2(size: str) -> UnsolvedFamily:
    """Make Problem 6 about a chief in orbit, with the states eliminated."""
    T, step = ORBIT_STEPS[size]
    start = LegStart.from_scenario("orbit", f"leg.steps={T}", f"plan.step_min={step}").farthest(
        INSTANCE_COUNT
    )
    problems = condensed_transfers(start)
    source = f"the longest flights of orbit, {T} steps of {step} min, J2 linear about the chief"
    return UnsolvedFamily(source, problems)


def make_near_infeasible(size: str) -> UnsolvedFamily:
    """Make transfers to goals that are barely reachable."""
    problems = [
        move_target(problem, 1 / REACH_FACTOR) for problem in make_transfer_lp(size).problems
    ]
    source = (
        f"transfer-lp with its goals moved away until {REACH_FACTOR} of the least control remains"
    )
    return UnsolvedFamily(source, problems)


def make_infeasible(size: str) -> UnsolvedFamily:
    """Make transfers to unreachable goals, and contradictory avoidance on both sides."""
    far = [
        move_target(problem, REACH_FACTOR)
        for problem in make_transfer_lp(size).problems[: INSTANCE_COUNT // 2]
    ]
    both = avoidance_problems(size, 5, ("same", "opposite"), INSTANCE_COUNT // 2)
    source = f"transfer-lp with its goals {REACH_FACTOR} times as far as can be reached, "
    source += "and avoidance-5 with the half-spaces of both sides of each neighbor"
    return UnsolvedFamily(source, far + both, is_feasible=False)


def move_target(problem: ConicProgram, share: float) -> ConicProgram:
    """Return the problem with the goal moved away from the end of the uncontrolled drift.

    Args:
        problem: A transfer without its states.
        share: Distance of the new goal, as a fraction of the farthest reachable one.
    """
    reach = np.concatenate([problem.b[: problem.zero], np.zeros(problem.nonnegative)])
    limits = problem.b - reach
    q, A = np.append(np.zeros(len(problem.q)), -1.0), hstack([problem.A, -reach[:, None]])
    farther = ConicProgram(q, csc_array(A), limits, problem.zero, problem.nonnegative)
    farthest = solve_conic(farther, solve_highs).x[-1]
    b = limits + share * farthest * reach
    return replace(problem, b=b)


def make_avoidance(
    neighbors: int, objective: Objective = "fuel"
) -> Callable[[str], UnsolvedFamily]:
    """Return a function that makes Problem 7 for agents in conflict with a neighbor."""

    def draw(size: str) -> UnsolvedFamily:
        name = "avoidance-energy" if objective == "energy" else f"avoidance-{neighbors}"
        count = instance_count(name, size)
        problems = avoidance_problems(size, neighbors, ("same",), count, objective)
        source = (
            f"a crowd of random with {CROWD_STEPS[size]} steps to go, seeds from {SEED} on: "
            f"who would meet one of the {neighbors} nearest, in the first exchange; half-spaces "
            "that no control could break are left out, and A is rounded to single precision"
        )
        return UnsolvedFamily(source, problems)

    return draw


def avoidance_problems(
    size: str,
    neighbors: int,
    ways: tuple[PassingSide, ...],
    wanted: int,
    objective: Objective = "fuel",
) -> list[ConicProgram]:
    """Return programs among the half-spaces of the nearest neighbors, on all given sides.

    With one side the programs are feasible, with two sides at once infeasible.
    """
    found: list[ConicProgram] = []
    for seed in range(SEED, SEED + 50):
        start = LegStart.from_scenario(
            "random", f"leg.steps={CROWD_STEPS[size]}", *DENSE_OVERRIDES, seed=seed
        )
        mission, transfer = start.mission, start.make_transfer(start.mission.max_speed)
        if objective == "energy":
            transfer = replace(transfer, objective=objective, max_speed=np.inf)
        horizon = make_horizon(mission, 0.0, CROWD_STEPS[size])
        ends = list(zip(start.states, start.targets, strict=True))
        free = [AvoidanceProblem.alone(transfer, *end).solve().trajectory for end in ends]
        paths = np.stack([horizon.control_points(flight.x, flight.u) for flight in free])
        for i, flight in enumerate(free):
            away = np.linalg.norm(start.states - start.states[i], axis=1)
            others = paths[np.argsort(away, kind="stable")[1 : neighbors + 1]]
            normal = [
                choose_normals(paths[i] - others, horizon.required_separation, way) for way in ways
            ]
            theirs = np.concatenate([others] * len(ways))
            spaces = convexify(horizon, len(flight.u), theirs, np.concatenate(normal))
            if spaces.violation(flight.x, flight.u).max() <= 0:
                continue
            with record_problems() as asked:
                try:
                    AvoidanceProblem(transfer, *ends[i], spaces).solve()
                    possible = True
                except Infeasible:
                    possible = False
            if possible == (len(ways) == 1):
                found.append(to_single_precision(asked[-1]))
            if len(found) == wanted:
                return found
    raise ValueError(f"fifty crowds have only {len(found)} such programs, and not {wanted}")


def to_single_precision(problem: ConicProgram) -> ConicProgram:
    """Round the entries of A to single precision, which halves the size of the file."""
    return replace(problem, A=csc_array(problem.A.astype(np.float32).astype(float)))


def make_gain_sdp(size: str) -> UnsolvedFamily:
    """Make the design of the fastest gains in the plane, with the matrix Z as the unknown."""
    rng, n, problems = np.random.default_rng(SEED), AGENT_COUNTS[size], []
    for _ in range(instance_count("gain-sdp", size)):
        points = sample_formation(n, (15.0, 15.0, 2.0), 2.0, rng)
        graph = random_dense_graph(n, n - 4, rng)
        problems.append(
            to_single_precision(
                gain_sdp_problem(GainProblem.from_formation(DesiredFormation(points, graph), "xy"))
            )
        )
    source = f"formations of {n} as the scenario formation draws them, with graphs as thinned as "
    source += "in the trials of [Lusk2020]; A is rounded to single precision"
    return UnsolvedFamily(source, problems)


def gain_sdp_problem(question: GainProblem) -> ConicProgram:
    """Maximize t subject to Z − t I ⪰ 0, tr Z = m and zeros of Q Z Qᴴ at the non-edges.

    A Hermitian matrix is as definite as [[Re, −Im], [Im, Re]]; Z is in units of its entries.
    """
    m, Q = question.m, null_space(question.kernel.conj().T)
    i, j = np.nonzero(np.triu(~question.graph, 1))
    rows, traces, cone = [], [], []
    for E in hermitian_basis(m):
        entries = (Q @ E @ Q.conj().T)[i, j]
        rows.append(np.concatenate([entries.real, entries.imag]))
        traces.append(E.trace().real)
        cone.append(svec(np.block([[E.real, -E.imag], [E.imag, E.real]])))
    A = np.vstack([traces, np.array(rows).T, -np.array(cone).T])
    t = np.concatenate([np.zeros(1 + 2 * len(i)), svec(np.eye(2 * m))])
    b = np.zeros(len(t))
    b[0] = m
    q = np.append(np.zeros(m * m), -1.0)
    return ConicProgram(q, csc_array(np.column_stack([A, t])), b, 1 + 2 * len(i), 0, (), (2 * m,))


def hermitian_basis(m: int) -> Iterator[np.ndarray]:
    """Yield a basis of the Hermitian matrices of order m."""
    for row, column in zip(*np.tril_indices(m), strict=True):
        for unit in (1.0,) if row == column else (1.0, 1j):
            E = np.zeros((m, m), complex)
            E[row, column], E[column, row] = unit, np.conj(unit)
            yield E


FAMILIES: dict[str, Callable[[str], UnsolvedFamily]] = {
    "transfer-lp": make_transfer_lp,
    "transfer-socp": make_transfer_socp,
    "j2": make_j2,
    "avoidance-5": make_avoidance(5),
    "avoidance-20": make_avoidance(20),
    "near-infeasible": make_near_infeasible,
    "infeasible": make_infeasible,
    "transfer-energy": make_transfer_energy,
    "avoidance-energy": make_avoidance(5, "energy"),
    "gain-sdp": make_gain_sdp,
}
