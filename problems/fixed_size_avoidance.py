"""Avoidance problem of fixed size, for compiled code.

`AvoidanceProblem` assembles a program of the size that each case needs. On board the program
is compiled, so its size is fixed, and only its parameters change.
"""

from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.doors import checked
from problems.transfer import TransferProblem


@checked
@dataclass(frozen=True, eq=False)
class FixedSizeAvoidanceProblem:
    """`AvoidanceProblem` for q = 1 and r = ∞, scaled to the order of 1.

        minimize    Σ w[k] (u⁺ + u⁻)
        subject to  y[k+1] = A y[k] + B (u⁺[k] − u⁻[k]),  y[0] = 0,  y[T] = reach
                    u⁺, u⁻ ≥ 0,  u⁺ + u⁻ ≤ 1
                    ‖coasting[k] + H y[k]‖₂ ≤ 1,  k = 1 … T−1
                    on_state · y[k] + on_control · (u⁺[k] − u⁻[k]) ≤ room

    y is the deviation of the states from the free motion in `state_units`; u⁺ and u⁻ are in
    units of U, and speeds in the cones in units of V. An unused row is 0 ≤ 1. The words in
    lower case are the parameters.
    """

    transfer: TransferProblem  # with the same matrices at every step
    horizon_steps: Annotated[int, Ge(0)]  # steps with half-spaces
    rows_per_step: Annotated[int, Ge(0)]  # largest number of half-spaces in each of these

    def __post_init__(self) -> None:
        """Refuse other norms and time-varying matrices."""
        transfer, model = self.transfer, self.transfer.model
        norms = transfer.fuel_norm, transfer.control_norm, transfer.speed_norm
        limits = transfer.max_control, transfer.max_speed
        if norms != (1, "inf", 2) or any(map(np.ndim, limits)):
            raise ValueError(
                'compiled code has fuel_norm 1, control_norm "inf", speed_norm 2 and limits that '
                f"are numbers, got {norms} with {limits[0]} and {limits[1]}"
            )
        if any(np.ptp(matrices, axis=0).any() for matrices in (model.A, model.B, model.z)):
            raise ValueError("compiled code has matrices that are the same at every step")

    @property
    def has_speed_limit(self) -> bool:
        """True where the transfer has a speed limit."""
        return isfinite(self.transfer.max_speed)

    @cached_property
    def state_units(self) -> Float[Array, " n"]:
        """Units of y: a reachable speed and the distance that it covers in the time [m, m/s]."""
        steps = self.transfer.model
        duration = len(steps) * steps.dt
        speed = min(self.transfer.max_speed, self.transfer.max_control * duration)
        return np.repeat([speed * duration, speed], steps.axes)

    def to_cvxpy(self) -> Any:
        """Express the program in CVXPY with its parameters; vectors are columns."""
        import cvxpy as cp

        transfer, units = self.transfer, self.state_units
        step = np.repeat(np.arange(self.horizon_steps), self.rows_per_step)  # of each row
        T, n, m = transfer.model.B.shape
        A = transfer.model.A[0] * units / units[:, None]
        B = transfer.model.B[0] * transfer.max_control / units[:, None]

        plus = cp.Variable((m, T), name="plus", nonneg=True)
        minus = cp.Variable((m, T), name="minus", nonneg=True)
        y = cp.Variable((n, T + 1), name="states")
        u = plus - minus
        reach = cp.Parameter(n, name="reach")
        on_state = cp.Parameter((n, len(step)), name="on_state")
        on_control = cp.Parameter((m, len(step)), name="on_control")
        room = cp.Parameter(len(step), name="room")

        on_y, on_u = cp.multiply(on_state, y[:, step]), cp.multiply(on_control, u[:, step])
        kept = cp.sum(on_y, axis=0) + cp.sum(on_u, axis=0)
        limits = [
            y[:, 1:] == A @ y[:, :-1] + B @ u,
            y[:, 0] == 0,
            y[:, T] == reach,
            plus + minus <= 1,
            kept <= room,
        ]
        if self.has_speed_limit:
            coasting = cp.Parameter((m, T - 1), name="coasting")
            share = units[m] / transfer.max_speed
            limits.append(cp.SOC(np.ones(T - 1), coasting + share * y[m:, 1:T], axis=0))
        return cp.Problem(cp.Minimize(cp.sum((plus + minus) @ transfer.weights)), limits)
