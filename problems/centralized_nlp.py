"""Nonlinear program of `CentralizedProblem` for CasADi and IPOPT, sparse with exact derivatives.

Multiple shooting: states and controls are variables, and the dynamics are equations of each
step. Positions are in units of R, velocities of R/Δt, controls of U.
"""

from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import block_diag, csc_matrix, eye_array, hstack

from dynamics import DiscreteModel
from problems.convexify import AvoidanceHorizon
from problems.transfer import TransferProblem

NORM_INITIAL_SLACK = 0.1  # of U, initial slack of the variable that bounds ‖u‖₂
IPOPT_OPTIONS: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-9,
    "constr_viol_tol": 1e-9,
    "bound_relax_factor": 0.0,
    "max_iter": 1000,
    "mu_strategy": "adaptive",
}

# From a nearly feasible point: a low initial barrier keeps the solution near it.
WARM_START_OPTIONS = IPOPT_OPTIONS | {
    "mu_strategy": "monotone",
    "mu_init": 1e-4,
    "bound_push": 1e-5,
    "bound_frac": 1e-5,
}
PROXIMAL_WEIGHT = 1e-3  # of ‖(u − u₀)/U‖² to the last solution u₀; an optimum u₀ stays optimal

AgentStates = Float[Array, "agents n"]
Ends = tuple[AgentStates, AgentStates]
InitialGuess = tuple[Float[Array, "agents instants n"], Float[Array, "agents T m"]]


class SeparationConstraints(NamedTuple):
    """Instants at which two agents keep a distance, one a row."""

    pair: Int[Array, "rows 2"]
    piece: Int[Array, " rows"]
    fraction: Float[Array, " rows"]  # of the piece, in [0, 1]
    min_distance: Float[Array, " rows"]  # in units of R

    def concatenate(self, more: "SeparationConstraints") -> "SeparationConstraints":
        """Append other constraints."""
        return SeparationConstraints(*map(np.concatenate, zip(self, more, strict=True)))

    @property
    def time(self) -> Float[Array, " rows"]:
        """Time since the start in units of a piece."""
        return np.asarray(self.piece + self.fraction)

    def shift(self, by: float, last: int) -> "SeparationConstraints":
        """Move the instants by a number of pieces, clipped to the first and the last piece."""
        time = np.clip(self.time + by, 0, last + 1)
        piece = np.minimum(time.astype(int), last)
        return self._replace(piece=piece, fraction=time - piece)

    def enlarge_distance(
        self, where: "SeparationConstraints", by: Float[Array, " others"], span: float
    ) -> "SeparationConstraints":
        """Enlarge the distance of the same pairs within a span of pieces of other constraints."""
        same = (self.pair[:, None] == where.pair).all(axis=-1)
        near = same & (np.abs(self.time[:, None] - where.time) <= span)
        added = np.where(near, by, 0.0).max(axis=1, initial=0.0)
        return self._replace(min_distance=self.min_distance + added)


class NonlinearProgram(NamedTuple):
    """Variables, objective and bounded constraints as CasADi expressions."""

    variables: Any  # z: states, u⁺ and u⁻ or u, ‖u‖₂ if fuel, relative positions
    objective: Any  # fuel in units of U Δt
    constraints: Any  # g(z)
    lower: Float[Array, " rows"]  # ≤ g(z)
    upper: Float[Array, " rows"]  # ≥ g(z)

    @property
    def to_casadi(self) -> dict[str, Any]:
        """Return the program under the names of CasADi."""
        return {"x": self.variables, "f": self.objective, "g": self.constraints}


def state_units(transfer: TransferProblem, horizon: AvoidanceHorizon) -> Float[Array, " n"]:
    """Return the scale of each state: R for positions, R/Δt for velocities."""
    R = horizon.clearance
    return np.repeat([R, R / transfer.model.dt], transfer.model.axes)


def solve_nlp(
    transfer: TransferProblem,
    horizon: AvoidanceHorizon,
    ends: Ends,
    guess: InitialGuess,
    constraints: SeparationConstraints,
    is_warm_start: bool = False,
) -> tuple[Array, Array, str]:
    """Solve the program from an initial guess.

    Args:
        transfer: Dynamics, limits and norms.
        horizon: Control points of the pieces between samples.
        ends: Initial and terminal states.
        guess: States and controls, not necessarily consistent.
        constraints: Instants and distances of pairs.
        is_warm_start: True for a nearly feasible guess, to stay near.

    Returns:
        States, controls and the status that IPOPT reports, which is not verified.
    """
    import casadi

    unit, U = state_units(transfer, horizon), transfer.max_control
    x, u = guess[0] / unit, guess[1] / U
    program = build_nlp(transfer, horizon, len(x), constraints, u if is_warm_start else None)
    lower, upper = np.full((2, *x.shape), np.inf)
    lower *= -1
    for side in (lower, upper):
        side[:, 0], side[:, -1] = ends[0] / unit, ends[1] / unit
    Dx, Du = relative_position_maps(horizon, unit, U, len(x), constraints)
    relative = Dx @ x.ravel() + Du @ u.ravel()
    size = np.linalg.norm(u, axis=-1).ravel() + NORM_INITIAL_SLACK
    size = size if transfer.fuel_norm == 2 else np.zeros(0)
    signs = (1, -1)[: _variables_per_control(transfer)]
    controls = np.stack([np.maximum(sign * u, 0) for sign in signs] if len(signs) == 2 else [u])
    least = 0.0 if len(signs) == 2 else -1.0
    free = np.full(len(size) + len(relative), np.inf)
    below = np.concatenate([np.zeros(len(size)), -free[len(size) :]])
    options = WARM_START_OPTIONS if is_warm_start else IPOPT_OPTIONS
    settings: dict[str, Any] = {"ipopt": options, "print_time": False}
    solver = casadi.nlpsol("central", "ipopt", program.to_casadi, settings)
    found = solver(
        x0=np.concatenate([x.ravel(), controls.ravel(), size, relative]),
        lbx=np.concatenate([lower.ravel(), np.full(controls.size, least), below]),
        ubx=np.concatenate([upper.ravel(), np.ones(controls.size), free]),
        lbg=program.lower,
        ubg=program.upper,
    )
    z = np.asarray(found["x"]).ravel()
    answer = z[x.size : x.size + controls.size].reshape(controls.shape)
    u = U * np.tensordot(signs, answer, 1)
    return z[: x.size].reshape(x.shape) * unit, u, _format_status(solver.stats())


def _variables_per_control(transfer: TransferProblem) -> int:
    """Return the number of variables per control: u⁺ and u⁻ where a 1-norm needs them."""
    return 2 if 1 in (transfer.fuel_norm, transfer.control_norm) else 1


def build_nlp(
    transfer: TransferProblem,
    horizon: AvoidanceHorizon,
    agents: int,
    constraints: SeparationConstraints,
    u0: Float[Array, "agents T m"] | None = None,
) -> NonlinearProgram:
    """Build the program, with a proximal term towards given controls u₀ in units of U."""
    import casadi

    steps, unit, U = transfer.model, state_units(transfer, horizon), transfer.max_control
    T, n, m = steps.B.shape
    x = casadi.MX.sym("x", (T + 1) * n, agents)
    names = ("plus", "minus")[: _variables_per_control(transfer)]
    parts = [casadi.MX.sym(name, T * m, agents) for name in names]
    u = parts[0] - parts[1] if len(parts) == 2 else parts[0]
    on_x, on_u, drift = dynamics_equations(steps, unit, U)
    rows = [casadi.vec(_to_dm(on_x) @ x + _to_dm(on_u) @ u)]
    bounds = [(np.tile(drift, agents),) * 2]

    if isfinite(transfer.max_speed) and T > 1:
        v = casadi.reshape(x, n, (T + 1) * agents)[m:, :]
        inside = [i * (T + 1) + k for i in range(agents) for k in range(1, T)]
        speed_limit = (transfer.max_speed / unit[-1]) ** 2
        rows.append(casadi.sum1(v[:, inside] ** 2).T)
        bounds.append((np.full(len(inside), -np.inf), np.full(len(inside), speed_limit)))

    squares = casadi.sum1(casadi.reshape(u, m, T * agents) ** 2).T
    sums = casadi.sum1(casadi.reshape(sum(parts), m, T * agents)).T
    if transfer.control_norm != "inf":
        rows.append(squares if transfer.control_norm == 2 else sums)
        bounds.append((np.full(T * agents, -np.inf), np.ones(T * agents)))

    # Relative positions as variables make second derivatives diagonal.
    relative = casadi.MX.sym("relative", transfer.model.axes, len(constraints.piece))
    if len(constraints.piece):
        Dx, Du = map(_to_dm, relative_position_maps(horizon, unit, U, agents, constraints))
        rows.append(Dx @ casadi.vec(x) + Du @ casadi.vec(u) - casadi.vec(relative))
        bounds.append((np.zeros(relative.numel()),) * 2)
        rows.append(casadi.sum1(relative**2).T)
        far = np.full(len(constraints.piece), np.inf)
        bounds.append((constraints.min_distance**2, far))

    # The 2-norm has no derivative at 0: a variable σ ≥ 0 with σ² ≥ ‖u‖² replaces it.
    size = casadi.MX.sym("size", T * agents if transfer.fuel_norm == 2 else 0)
    if transfer.fuel_norm == 2:
        rows.append(squares - size**2)
        bounds.append((np.full(T * agents, -np.inf), np.zeros(T * agents)))
    lower, upper = (np.concatenate(side) for side in zip(*bounds, strict=True))
    unknown = casadi.vertcat(*(casadi.vec(part) for part in (x, *parts, size, relative)))
    cost = casadi.sum1(size if transfer.fuel_norm == 2 else sums)
    if u0 is not None:
        cost += PROXIMAL_WEIGHT * casadi.sumsqr(u - u0.reshape(agents, T * m).T)
    return NonlinearProgram(unknown, cost, casadi.vertcat(*rows), lower, upper)


def dynamics_equations(
    steps: DiscreteModel, unit: Float[Array, " n"], U: float
) -> tuple[csc_matrix, csc_matrix, Float[Array, " rows"]]:
    """Build E, F and e of E x + F u = e, the scaled dynamics of one agent over all steps."""
    T, n = len(steps), len(unit)
    A = steps.A * unit / unit[:, None]
    before = hstack([block_diag(list(A)), csc_matrix((T * n, n))])
    on_x = eye_array(T * n, (T + 1) * n, k=n) - before
    on_u = -block_diag(list(steps.B * U / unit[:, None]))
    return csc_matrix(on_x), csc_matrix(on_u), (steps.z / unit).ravel()


def relative_position_maps(
    horizon: AvoidanceHorizon,
    unit: Float[Array, " n"],
    U: float,
    agents: int,
    constraints: SeparationConstraints,
) -> tuple[csc_matrix, csc_matrix]:
    """Build Dx and Du of the relative positions Dx x + Du u, in units of R.

    x and u are the scaled states and controls of all agents as columns, agent by agent.
    """
    P, Q, _ = horizon.control_point_maps  # r cancels in differences
    T, S, _, d, n = P.shape
    t, s = constraints.fraction, 1 - constraints.fraction
    bernstein = np.stack([s**3, 3 * s**2 * t, 3 * s * t**2, t**3], axis=1)
    step, part = np.divmod(constraints.piece, S)
    on_x = np.einsum("ki,kidn->kdn", bernstein, P[step, part]) * unit / horizon.clearance
    on_u = np.einsum("ki,kidm->kdm", bernstein, Q[step, part]) * U / horizon.clearance
    first_x = (constraints.pair * (T + 1) + step[:, None]) * n
    first_u = (constraints.pair * T + step[:, None]) * d
    return (
        _subtract_blocks(on_x, first_x, agents * (T + 1) * n),
        _subtract_blocks(on_u, first_u, agents * T * d),
    )


def _subtract_blocks(blocks: Float[Array, "k d w"], first: Array, columns: int) -> csc_matrix:
    """Place each block at its first column and its negative at the second."""
    k, d, w = blocks.shape
    row = np.broadcast_to(np.arange(k * d).reshape(k, d, 1), blocks.shape).ravel()

    def place(at: Array) -> csc_matrix:
        column = np.broadcast_to(at[:, None, None] + np.arange(w), blocks.shape).ravel()
        return csc_matrix((blocks.ravel(), (row, column)), (k * d, columns))

    return csc_matrix(place(first[:, 0]) - place(first[:, 1]))


def _to_dm(sparse: csc_matrix) -> Any:
    import casadi

    return casadi.DM(sparse)


def _format_status(stats: dict[str, Any]) -> str:
    return f"IPOPT reports {stats['return_status']} after {stats['iter_count']} iterations"
