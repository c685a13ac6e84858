"""The whole swarm as one nonconvex programme: Problem 3 [Morgan2016, eq. 19], in CasADi.

What a distributed method gives away is seen against this, for few agents: nobody has priority,
and all know all. Local optima are many, so it is begun from several guesses, and what counts
is the best answer that stands when it is flown again from its controls alone. IPOPT is not
safe among threads: use processes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import ceil, inf, isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.bezier_kernels import closest_pair
from dynamics.trajectory_geometry import hull_distance, min_distance
from problems.centralized_nlp import InitialGuess, SeparationConstraints, solve_nlp, state_units
from problems.conic import Unsolved
from problems.convexify import SEPARATION_TOLERANCE, AvoidanceHorizon, are_balls_separated
from problems.transfer import TransferProblem, compute_fuel

FEASIBILITY_TOLERANCE = 1e-6  # of what recomputing shows, in the units of `Central.unit`
PROXIMITY_FACTOR = 2.0  # times R: who comes closer in the guess is kept apart there from the first,
CONSTRAINTS_PER_STEP = 4  # at this many in a step, or at the ends of its pieces
MAX_ITERATIONS = 12  # of solving again with the instants at which an answer comes too close
ITERATIONS_BEFORE_PADDING = 3  # after which more is kept than is asked, whatever was missing
MAX_PADDING = 1e-4  # of R, the most that is added in a round: who lacks less has it added at once


class SimulatedSolution(NamedTuple):
    """Controls of all agents, flown again, and what that shows."""

    x: Float[Array, "agents instants n"]
    u: Float[Array, "agents T m"]
    fuel: float  # Δt Σ Σ ‖u‖ [m/s]
    terminal_error: float  # distance from a goal at the end, in units of R and R/Δt
    control_violation: float  # above U, as a part of it
    speed_violation: float  # above V, as a part of it
    min_separation: float  # least along the continuous paths, as a part of R
    solver_message: str  # how the solver ended
    padding: float = 0.0  # most that it was made to keep beyond R (1 + HOLD), in units of R

    @property
    def max_violation(self) -> float:
        """The largest violation; NaN where one of them is."""
        broken = [
            self.terminal_error,
            self.control_violation,
            self.speed_violation,
            1 - self.min_separation,
            0.0,
        ]
        return float(np.max(np.array(broken)))

    @property
    def is_feasible(self) -> bool:
        """Whether it keeps everything."""
        return self.max_violation <= FEASIBILITY_TOLERANCE

    def __str__(self) -> str:
        """What was found."""
        return (
            f"{self.solver_message}: fuel {self.fuel:.6g} m/s, missed {self.terminal_error:.1e}, "
            f"thrust over {self.control_violation:.1e}, speed over {self.speed_violation:.1e}, "
            + _format_separation(self.min_separation)
        )


class NoFeasibleSolution(Unsolved):
    """No guess led to an answer that keeps everything. That proves nothing, but is evidence."""

    def __init__(self, problem: object, tried: tuple[SimulatedSolution, ...]) -> None:
        """Keep all that was tried."""
        least = min(tried, key=lambda t: t.max_violation if isfinite(t.max_violation) else inf)
        nearest = f"the nearest was {least}" if isfinite(least.max_violation) else "none is finite"
        why = f"none of {len(tried)} answers keeps everything; {nearest}"
        super().__init__(problem, why)
        self.solutions = tried


class CentralizedResult(NamedTuple):
    """The best that was found, and all that was tried."""

    best: SimulatedSolution
    solutions: tuple[SimulatedSolution, ...]  # the guesses themselves, and then what each led to


@dataclass(frozen=True, eq=False)
class CentralizedProblem:
    """Transfers of all agents at once that stay apart.

        minimise    Δt Σᵢ Σₖ ‖uᵢ[k]‖_q
        subject to  xᵢ[k+1] = A[k] xᵢ[k] + B[k] uᵢ[k] + z[k]     (10)
                    ‖uᵢ[k]‖_r ≤ U                                (12)
                    xᵢ[0] = startᵢ,  xᵢ[T] = goalᵢ               (14), (18)
                    ‖H xᵢ[k]‖₂ ≤ V,  k = 1 … T−1                 (66)
                    ‖pᵢ(t) − pⱼ(t)‖₂ ≥ R  for all t              (13)

    The distance is kept along the cubic pieces of the paths and not at samples alone: it is
    written for some instants, and for those at which an answer still comes too close, until it
    comes too close at none. Flights among the half-spaces of `convexify` keep it, so they are
    points of this programme; it allows more, because hulls are larger than paths.

    A slope in the weights of the transfer is left out.
    """

    transfer: TransferProblem
    horizon: AvoidanceHorizon  # as long as the transfer

    def __post_init__(self) -> None:
        """Refuse what is not written here."""
        self.transfer.require_steps()
        if self.transfer.fuel_norm == "inf":
            raise ValueError("fuel in the inf-norm is not written here: fuel_norm = 1 or 2 is")
        if self.horizon.steps != len(self.transfer.model):
            raise ValueError(
                f"distances are looked for over {self.horizon.steps} steps, "
                f"and the transfer takes {len(self.transfer.model)}"
            )

    @cached_property
    def state_units(self) -> Float[Array, " n"]:
        """Of each state: R for a place, R/Δt for a speed."""
        return state_units(self.transfer, self.horizon)

    def solve(
        self,
        start: Float[Array, "agents n"],
        goal: Float[Array, "agents n"],
        guesses: Sequence[InitialGuess],
    ) -> CentralizedResult:
        """The best of what the guesses are, where they stand already, and of what they lead to.

        Args:
            start: States at the beginning; apart.
            goal: States at the end; apart.
            guesses: Where to begin; states and controls need not belong together.

        Raises:
            NoneStands: No answer keeps everything, by recomputation.
            ValueError: Two starts or two goals are too close, or there is no guess, or one
                that is not finite.
        """
        self._validate(start, goal, guesses)
        tried = [self.simulate(start, goal, u, "a guess") for _, u in guesses]
        for guess in guesses:
            tried.append(self._solve_from(start, goal, guess, _least_fuel(tried)))
        standing = [t for t in tried if t.is_feasible]
        if not standing:
            raise NoFeasibleSolution(self, tuple(tried))
        return CentralizedResult(min(standing, key=lambda t: t.fuel), tuple(tried))

    def simulate(
        self,
        start: Float[Array, "agents n"],
        goal: Float[Array, "agents n"],
        u: Float[Array, "agents T m"],
        said: str,
    ) -> SimulatedSolution:
        """Recompute everything from the controls alone."""
        transfer, d = self.transfer, self.transfer.model.axes
        x = transfer.model.simulate(start, u)
        order = np.inf if transfer.control_norm == "inf" else transfer.control_norm
        thrust = np.linalg.norm(u, order, axis=-1).max(initial=0.0) / transfer.max_control
        speed = np.linalg.norm(x[:, 1:-1, d:], axis=-1).max(initial=0.0) / transfer.max_speed
        least = self._closest_approaches(x, u)[0].min(initial=np.inf)
        return SimulatedSolution(
            x,
            u,
            float(np.sum(compute_fuel(u, transfer.model.dt, transfer.fuel_norm))),
            float(np.abs((x[:, -1] - goal) / self.state_units).max()),
            float(thrust - 1),
            float(speed - 1),
            float(least / self.horizon.collision_radius),
            said,
        )

    def count_conflicts(
        self, x: Float[Array, "agents instants n"], u: Float[Array, "agents T m"]
    ) -> int:
        """How many pairs come too close on given flights."""
        return int(
            (self._closest_approaches(x, u)[0] < self.horizon.collision_radius).any(axis=1).sum()
        )

    def _validate(self, start: Array, goal: Array, guesses: Sequence[InitialGuess]) -> None:
        if not guesses:
            raise ValueError("there must be at least one guess to begin with")
        for number, guess in enumerate(guesses):
            if not all(np.isfinite(part).all() for part in guess):
                raise ValueError(f"guess {number} is not finite")
        for who, states in (("starts", start), ("goals", goal)):
            least = min_distance(states[:, : self.transfer.model.axes])
            if not least >= self.horizon.collision_radius:
                raise ValueError(
                    f"two {who} are {least:.6g} m apart, and {self.horizon.collision_radius:.6g} m are to "
                    "be kept"
                )

    def _solve_from(
        self, start: Array, goal: Array, guess: InitialGuess, cheapest: float
    ) -> SimulatedSolution:
        found, instants = self._refine_constraints(
            (start, goal), guess, self._initial_constraints(*guess), cheapest
        )
        if not found.is_feasible or found.padding <= MAX_PADDING:
            return found
        # The optimum of a tighter programme: begin there once more, with nothing padded.
        bare = instants._replace(
            min_distance=np.full(len(instants.min_distance), 1 + SEPARATION_TOLERANCE)
        )
        again, _ = self._refine_constraints(
            (start, goal), (found.x, found.u), bare, cheapest, nearby=True
        )
        return again if again.is_feasible and again.fuel < found.fuel else found

    def _refine_constraints(
        self,
        ends: tuple[Array, Array],
        guess: InitialGuess,
        instants: SeparationConstraints,
        cheapest: float,
        nearby: bool = False,
    ) -> tuple[SimulatedSolution, SeparationConstraints]:
        """Descend with ever more instants, until an answer comes too close at none.

        More instants mostly make an answer dearer, so one that costs more than what stands is left:
        in 26 instances of three to five agents that lost no more than 2e-6 of the best fuel.
        """
        pieces, last = (
            self.horizon.pieces_per_step,
            self.horizon.steps * self.horizon.pieces_per_step - 1,
        )
        for attempt in range(MAX_ITERATIONS):
            x, u, said = solve_nlp(self.transfer, self.horizon, ends, guess, instants, nearby)
            padding = float(
                instants.min_distance.max(initial=1 + SEPARATION_TOLERANCE)
                - (1 + SEPARATION_TOLERANCE)
            )
            found = self.simulate(*ends, u, said)._replace(padding=padding)
            more, missing = self._violated_constraints(found)
            if (
                not len(more.piece)
                or not found.terminal_error <= FEASIBILITY_TOLERANCE
                or found.fuel > cheapest
            ):
                break
            # Equal optima pass each other at other times, so instants alone might never do.
            small = (missing <= MAX_PADDING) | (attempt >= ITERATIONS_BEFORE_PADDING)
            raised = np.where(small, np.minimum(missing + MAX_PADDING / 10, MAX_PADDING), 0.0)
            instants = instants.enlarge_distance(more, raised, pieces).concatenate(more)
            for part in (1.0, 2.0 ** -(attempt + 1)):
                for side in (-1, 1):
                    beside = side * part * pieces / CONSTRAINTS_PER_STEP
                    instants = instants.concatenate(more.shift(beside, last))
            guess, nearby = (x, u), True
        return found, instants

    def _closest_approaches(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Least distance of every pair over every piece, where below NEAR R, and when it is."""
        path = self.horizon.control_points(x, u)
        pairs = _agent_pairs(len(x))
        relative = path[pairs[:, 0]] - path[pairs[:, 1]]
        distance, fraction = np.full(relative.shape[:2], np.inf), np.zeros(relative.shape[:2])
        near = ~are_balls_separated(relative, PROXIMITY_FACTOR * self.horizon.collision_radius)
        for a, p in np.argwhere(near):
            both = np.stack([np.zeros_like(relative[a, p]), relative[a, p]])
            distance[a, p], fraction[a, p], _ = closest_pair(both, np.array([[0, 1]]))
        return distance, fraction

    def _initial_constraints(self, x: Array, u: Array) -> SeparationConstraints:
        """Instants, a few in a step, of the pieces over which agents are near each other."""
        path = self.horizon.control_points(x, u)
        pairs = _agent_pairs(len(x))
        relative = path[pairs[:, 0]] - path[pairs[:, 1]]
        distance = hull_distance(relative)[0] if len(pairs) else np.zeros((0, 0))
        which, piece = np.nonzero(distance < PROXIMITY_FACTOR * self.horizon.collision_radius)
        count = ceil(CONSTRAINTS_PER_STEP / self.horizon.pieces_per_step)
        fraction = np.repeat(np.arange(1, count + 1) / count, len(piece))
        pair, keep = (
            np.tile(pairs[which], (count, 1)),
            np.full(len(fraction), 1 + SEPARATION_TOLERANCE),
        )
        return SeparationConstraints(pair, np.tile(piece, count), fraction, keep)

    def _violated_constraints(
        self, found: SimulatedSolution
    ) -> tuple[SeparationConstraints, Array]:
        """When agents come too close, and by how much, in units of R."""
        distance, fraction = self._closest_approaches(found.x, found.u)
        which, piece = np.nonzero(distance < self.horizon.collision_radius)
        missing = 1 - distance[which, piece] / self.horizon.collision_radius
        pair, keep = (
            _agent_pairs(len(found.x))[which],
            np.full(len(piece), 1 + SEPARATION_TOLERANCE),
        )
        return SeparationConstraints(pair, piece, fraction[which, piece], keep), missing


def displace_guess(guess: InitialGuess, dt: float, by: Float[Array, "agents d"]) -> InitialGuess:
    """A guess with every path bent aside: by so much half-way, and not at the ends.

    Args:
        guess: States and controls.
        dt: Length of a step [s].
        by: The largest displacement of each agent [m].
    """
    x, u = guess
    T = u.shape[1]
    phase = np.pi * np.arange(T + 1)[:, None] / T
    place = np.sin(phase) * by[:, None]
    speed = np.pi / (T * dt) * np.cos(phase) * by[:, None]
    return x + np.concatenate([place, speed], axis=-1), u


def _least_fuel(tried: Sequence[SimulatedSolution]) -> float:
    return min((t.fuel for t in tried if t.is_feasible), default=inf)


def _format_separation(separation: float) -> str:
    # Who is nowhere near another has no distance that was looked for.
    return (
        f"separation {separation:.6f} R"
        if isfinite(separation)
        else f"over {PROXIMITY_FACTOR:g} R apart"
    )


def _agent_pairs(count: int) -> Int[Array, "pairs 2"]:
    return np.array(list(combinations(range(count), 2)), dtype=int).reshape(-1, 2)
