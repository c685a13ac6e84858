"""Centralized reconfiguration of a swarm: Problem 3 [Morgan2016, eq. 19], nonconvex, in CasADi.

A reference for distributed methods with few agents: it has no priorities and full information.
Local optima are many, so the program is solved from several initial guesses, and the result is
the best solution that is feasible when simulated from its controls alone. IPOPT is not
thread-safe: use processes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, inf
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.closest_approach import closest_approaches
from dynamics.discretize import MAX_STEPS, discretize_zoh
from dynamics.doors import checked
from dynamics.inputs import InputError
from dynamics.model import LinearModel
from dynamics.trajectory_geometry import hull_distance
from problems.centralized_nlp import (
    MIN_DISTANCE,
    AgentStates,
    Ends,
    InitialGuess,
    NonlinearProgram,
    SeparationConstraints,
    SwarmProgram,
)
from problems.centralized_solution import (
    FEASIBILITY_TOLERANCE,
    CentralizedResult,
    NoFeasibleSolution,
    SimulatedSolution,
)
from problems.convexify import AvoidanceHorizon
from problems.path_separation import are_balls_separated
from problems.transfer import Objective, TransferProblem, compute_energy, compute_fuel

PROXIMITY_FACTOR = 2.0  # times R: pairs that come closer in the guess get constraints at once,
CONSTRAINTS_PER_STEP = 4  # at so many instants a step, or at the ends of its pieces
MAX_ITERATIONS = 12  # solutions with additional instants of too small a separation
ITERATIONS_BEFORE_PADDING = 3  # after which the required distance is padded for any violation
MAX_PADDING = 1e-4  # of R, largest increase per iteration; smaller violations are padded at once


Positive = Annotated[float, Gt(0)]
AgentControls = Float[Array, "agents T m"]


@checked
@dataclass(frozen=True, eq=False)
class CentralizedProblem:
    """Joint transfers of all agents without collisions.

        minimize    Δt Σᵢ Σₖ ‖uᵢ[k]‖_q,  or  Δt Σᵢ Σₖ ‖uᵢ[k]‖₂²
        subject to  xᵢ[k+1] = A[k] xᵢ[k] + B[k] uᵢ[k] + z[k]     (10)
                    ‖uᵢ[k] / Uᵢ‖_r ≤ 1                           (12)
                    xᵢ[0] = startᵢ,  xᵢ[T] = goalᵢ               (14), (18)
                    ‖H xᵢ[k] / Vᵢ‖_s ≤ 1,  k = 1 … T−1           (66)
                    ‖pᵢ(t) − pⱼ(t)‖₂ ≥ (Rᵢ + Rⱼ)/2  for all t    (13)

    The distance holds along the cubic pieces of the trajectories, not only at samples: it is
    imposed at some instants, then at those where a solution still comes too close, until there
    are none. Trajectories among the half-spaces of `convexify` are feasible points of this
    program, which admits more, because hulls are larger than trajectories.

    The tie-break weights of the transfer are ignored. The fuel has q = 1 or ∞: with q = 2 it has
    no derivative where a control is 0, as most are.

    Args:
        transfer: Steps, limits and norms of all agents.
        horizon: Pieces of the steps, of the same length, and R.
        own_transfers: Transfer of each agent, where limits differ.
        clearances: R of each agent, where they differ [m].

    Raises:
        ValueError: The transfer has no steps, another length than the horizon, or fuel with q = 2;
            or transfers of the agents differ in more than limits.
    """

    transfer: TransferProblem
    horizon: AvoidanceHorizon
    own_transfers: tuple[TransferProblem, ...] = ()
    clearances: Annotated[Float[Array, " agents"], Gt(0)] | None = None

    def __post_init__(self) -> None:
        """Refuse fuel without derivatives, and what is inconsistent."""
        self.transfer.require_steps()
        if self.transfer.objective == "fuel" and self.transfer.fuel_norm == 2:
            raise ValueError(
                "fuel_norm must be 1 or inf in the joint program, got 2, of which the fuel has no "
                'derivative where a control is 0; fuel_norm = 1, "inf" or objective = "energy" '
                "would do"
            )
        count = len(self.own_transfers)
        if self.clearances is not None and len(self.clearances) != (count or len(self.clearances)):
            raise InputError("clearances", f"must be {count}, as own_transfers")
        shared = _shared_by_agents(self.transfer)
        for i, own in enumerate(self.own_transfers):
            if own.model is not self.transfer.model or _shared_by_agents(own) != shared:
                raise ValueError(
                    f"transfer {i} of own_transfers differs in more than limits: give all agents "
                    "the same model, objective and fuel_norm as the transfer"
                )
        if self.horizon.steps != len(self.transfer.model):
            reason = f"the horizon must be as long as the transfer: got {self.horizon.steps} steps"
            raise ValueError(f"{reason} and {len(self.transfer.model)}")

    @property
    def array_sizes(self) -> dict[str, Any]:
        """Sizes of the axes of states, controls, steps and, where they differ, agents."""
        agents = self.own_transfers or self.clearances
        return self.transfer.array_sizes | ({} if agents is None else {"agents": len(agents)})

    @classmethod
    def from_model(
        cls,
        model: LinearModel,
        step: Positive,
        steps: Annotated[int, Ge(1), Le(MAX_STEPS)],
        collision_radius: Positive,
        max_control: Positive,
        max_speed: Positive = inf,
        objective: Objective = "fuel",
        pieces: Annotated[int, Ge(1), Le(1000)] = 4,
    ) -> "CentralizedProblem":
        """Discretize a model from time 0 on.

        Args:
            model: Equations of motion of every agent.
            step: Δt [s].
            steps: T.
            collision_radius: R [m].
            max_control: U, on each axis [m/s²].
            max_speed: V [m/s].
            objective: Fuel or energy.
            pieces: Cubic pieces of the trajectories between samples.
        """
        coarse = discretize_zoh(model, step, steps)
        fine = discretize_zoh(model, step / pieces, pieces * steps)
        transfer = TransferProblem(coarse, max_control, max_speed, objective=objective)
        return cls(transfer, AvoidanceHorizon(coarse, fine, collision_radius))

    @cached_property
    def _program(self) -> SwarmProgram:
        return SwarmProgram(self.transfer, self.horizon, self.own_transfers, self.clearances)

    def solve(
        self, start: AgentStates, goal: AgentStates, guesses: Sequence[InitialGuess]
    ) -> CentralizedResult:
        """Solve from each guess and return the best feasible solution, guesses included.

        Args:
            start: Initial states without collisions.
            goal: Terminal states without collisions.
            guesses: At least one; states and controls need not be consistent.

        Raises:
            NoFeasibleSolution: No simulated solution satisfies all constraints.
            ValueError: Two starts or two goals are too close.
        """
        self._check_ends(start, goal)
        if not guesses:
            raise ValueError("guesses must have at least one entry: states and controls")
        tried = [self.simulate(start, goal, u, "initial guess") for _, u in guesses]
        for guess in guesses:
            cheapest = min((t.cost for t in tried if t.is_feasible), default=inf)
            tried.append(self._solve_from((start, goal), guess, cheapest))
        feasible = [t for t in tried if t.is_feasible]
        if not feasible:
            raise NoFeasibleSolution(self, tuple(tried))
        return CentralizedResult(min(feasible, key=lambda t: t.cost), tuple(tried))

    def nonlinear_program(
        self, start: AgentStates, goal: AgentStates, guess: InitialGuess | None = None
    ) -> NonlinearProgram:
        """Build the program with the distance of all pairs at a few instants of every step.

        Between these instants a solution may be closer by little, which `simulate` tells.

        Args:
            start: Initial states without collisions.
            goal: Terminal states without collisions.
            guess: States and controls; least energy of each agent alone if absent.

        Raises:
            ValueError: Two starts or two goals are too close.
        """
        self._check_ends(start, goal)
        if guess is None:
            each = zip(start, goal[:, None], strict=True)
            alone = [self.transfer.solve_without_limits(*ends)[:2] for ends in each]
            x, u = map(np.concatenate, zip(*alone, strict=True))
            guess = x, u
        pairs, pieces = _agent_pairs(len(start)), len(self.horizon.fine_model)
        everywhere = np.ones((len(pairs), pieces), dtype=bool)
        instants = SeparationConstraints.place(pairs, everywhere, self._instants_per_piece)
        return self._program.build((start, goal), guess, instants)

    def simulate(
        self, start: AgentStates, goal: AgentStates, u: AgentControls, solver_message: str
    ) -> SimulatedSolution:
        """Simulate the controls and compute all violations.

        Args:
            start: Positions [m] and velocities [m/s].
            goal: Positions [m] and velocities [m/s].
            u: Accelerations, held over each step [m/s²].
            solver_message: Kept with the result.
        """
        transfer, d = self.transfer, self.transfer.model.axes
        x = transfer.model.simulate(start, u)
        each = [self._program.transfer_of(i) for i in range(len(x))]
        thrust = max(own.control_limit.excess(part) for own, part in zip(each, u, strict=True))
        speeds = zip(each, x[:, 1:-1, d:], strict=True)
        speed = max(own.speed_limit.excess(part) for own, part in speeds)
        distance, _ = self._closest_approaches(x, u)
        apart = float((distance / self._clearances_of(len(x))).min(initial=PROXIMITY_FACTOR))
        is_fuel, dt, norm = transfer.objective == "fuel", transfer.model.dt, transfer.fuel_norm
        cost = float(np.sum(compute_fuel(u, dt, norm) if is_fuel else compute_energy(u, dt)))
        error = float(np.abs((x[:, -1] - goal) / self._program.state_units).max())
        return SimulatedSolution(x, u, cost, error, thrust, speed, apart, solver_message)

    def _solve_from(self, ends: Ends, guess: InitialGuess, cheapest: float) -> SimulatedSolution:
        first = self._initial_constraints(*guess)
        found, instants = self._refine_constraints(ends, guess, first, cheapest)
        if not found.is_feasible or found.padding <= MAX_PADDING:
            return found
        # This is an optimum of the padded program: solve once more from there without padding.
        bare = instants._replace(min_distance=np.full(len(instants.time), MIN_DISTANCE))
        again, _ = self._refine_constraints(ends, (found.x, found.u), bare, cheapest, nearby=True)
        return again if again.is_feasible and again.cost < found.cost else found

    def _refine_constraints(
        self,
        ends: Ends,
        guess: InitialGuess,
        instants: SeparationConstraints,
        cheapest: float,
        nearby: bool = False,
    ) -> tuple[SimulatedSolution, SeparationConstraints]:
        """Add instants until a solution comes too close at none.

        More constraints mostly cost fuel, so a solution that costs more than the best feasible
        one is abandoned: in 26 instances of three to five agents that lost at most 2e-6 of the
        best fuel.
        """
        pieces = self.horizon.pieces_per_step
        for attempt in range(MAX_ITERATIONS):
            x, u, message = self._program.solve(ends, guess, instants, nearby)
            padding = instants.min_distance.max(initial=MIN_DISTANCE) - MIN_DISTANCE
            found = self.simulate(*ends, u, message)._replace(padding=float(padding))
            more, violation = self._violations(found)
            is_astray = not found.terminal_error <= FEASIBILITY_TOLERANCE
            if not len(more.time) or is_astray or found.cost > cheapest:
                break
            # Equal optima differ in the time of closest approach, so that new instants alone
            # might never suffice.
            is_small = (violation <= MAX_PADDING) | (attempt >= ITERATIONS_BEFORE_PADDING)
            padding_added = np.minimum(violation + MAX_PADDING / 10, MAX_PADDING) * is_small
            instants = instants.enlarge_distance(more, padding_added, pieces).concatenate(more)
            for part in (1.0, 2.0 ** -(attempt + 1)):
                for side in (-1, 1):
                    beside = more.time + side * part * pieces / CONSTRAINTS_PER_STEP
                    beside = np.clip(beside, 0, self.horizon.steps * pieces)
                    instants = instants.concatenate(more._replace(time=beside))
            guess, nearby = (x, u), True
        return found, instants

    def _closest_approaches(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Find the least distance of every pair over every piece, where near, and its instant."""
        relative = self._relative_control_points(x, u)
        distance, fraction = np.full(relative.shape[:2], np.inf), np.zeros(relative.shape[:2])
        near = ~are_balls_separated(relative, PROXIMITY_FACTOR * self._clearances_of(len(x))[:, 0])
        each = np.arange(np.count_nonzero(near))
        distance[near], fraction[near] = closest_approaches(relative[near], each)
        return distance, fraction

    def _relative_control_points(self, x: Array, u: Array) -> Array:
        points, pairs = self.horizon.control_points(x, u), _agent_pairs(len(x))
        return np.asarray(points[pairs[:, 0]] - points[pairs[:, 1]])

    def _initial_constraints(self, x: Array, u: Array) -> SeparationConstraints:
        """Place constraints at a few instants a step on the pieces of nearby agents."""
        relative = self._relative_control_points(x, u)
        distance = hull_distance(relative)[0] if len(relative) else np.zeros((0, 0))
        near = distance < PROXIMITY_FACTOR * self._clearances_of(len(x))
        return SeparationConstraints.place(_agent_pairs(len(x)), near, self._instants_per_piece)

    @property
    def _instants_per_piece(self) -> int:
        return ceil(CONSTRAINTS_PER_STEP / self.horizon.pieces_per_step)

    def _check_ends(self, start: AgentStates, goal: AgentStates) -> None:
        pairs, d = _agent_pairs(len(start)), self.transfer.model.axes
        clear = self._program.pair_clearances(pairs)
        for name, states in (("starts", start), ("goals", goal)):
            apart = np.linalg.norm(states[pairs[:, 0], :d] - states[pairs[:, 1], :d], axis=1)
            for a in np.argsort(apart / clear)[:1].tolist():
                if not apart[a] >= clear[a]:
                    needed = f"at least {clear[a]:.6g} m are needed"
                    raise ValueError(f"two {name} are {apart[a]:.6g} m apart, {needed}")

    def _clearances_of(self, agents: int) -> Float[Array, "pairs 1"]:
        return self._program.pair_clearances(_agent_pairs(agents))[:, None]

    def _violations(self, found: SimulatedSolution) -> tuple[SeparationConstraints, Array]:
        """Find the instants of too small a separation and the violations in units of R."""
        distance, fraction = self._closest_approaches(found.x, found.u)
        clear = self._clearances_of(len(found.x))
        pair, piece = np.nonzero(distance < clear)
        violation = 1 - distance[pair, piece] / clear[pair, 0]
        pairs, time = _agent_pairs(len(found.x))[pair], piece + fraction[pair, piece]
        return SeparationConstraints(pairs, time, np.full(len(time), MIN_DISTANCE)), violation


def _shared_by_agents(transfer: TransferProblem) -> tuple[object, ...]:
    return transfer.objective, transfer.objective == "fuel" and transfer.fuel_norm


def _agent_pairs(count: int) -> Int[Array, "pairs 2"]:
    return np.stack(np.triu_indices(count, 1), axis=1)
