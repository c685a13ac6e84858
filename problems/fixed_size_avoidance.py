"""A transfer among half-spaces with room for a fixed number of them: for code written once.

`Avoidance` writes a programme as large as it must be, for each question anew. On board the
programme is compiled, so its size is fixed, and only numbers differ between questions.
"""

from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.transfer import TransferProblem


@dataclass(frozen=True, eq=False)
class FixedSizeAvoidanceProblem:
    """The statement of `Avoidance` for q = 1 and r = ∞, in units of the order of 1.

        minimise    Σ w[k] (u⁺ + u⁻)
        subject to  y[k+1] = A y[k] + B (u⁺[k] − u⁻[k]),  y[0] = 0,  y[T] = reach
                    u⁺, u⁻ ≥ 0,  u⁺ + u⁻ ≤ 1
                    ‖coasting[k] + H y[k]‖₂ ≤ 1,  k = 1 … T−1
                    on_state · y[k] + on_control · (u⁺[k] − u⁻[k]) ≤ room

    y is the distance of the states from the free motion, in `units`; u⁺ and u⁻ are in units
    of U, and speeds under the cones in units of V. A row of a half-space that is not needed
    is 0 ≤ 1. The lower-case words are the data.
    """

    transfer: TransferProblem  # whose steps are all alike
    horizon_steps: int  # steps with half-spaces
    rows_per_step: int  # half-spaces in each of these for which there is room

    def __post_init__(self) -> None:
        """Refuse what needs another programme."""
        t = self.transfer
        if (t.fuel_norm, t.control_norm) != (1, "inf"):
            raise ValueError(
                "this programme is for fuel norm 1 and control norm inf, got "
                f"{t.fuel_norm} and {t.control_norm}"
            )
        for name, matrices in (("A", t.model.A), ("B", t.model.B), ("z", t.model.z)):
            if not np.array_equal(matrices, np.broadcast_to(matrices[:1], matrices.shape)):
                raise ValueError(f"{name} must be the same at every step, for code knows no time")
        if (
            len(t.model) < 2
            or not 1 <= self.horizon_steps <= len(t.model)
            or self.rows_per_step < 1
        ):
            raise ValueError(
                "there must be two steps or more, half-spaces in one of them to all, and room for "
                f"one or more in each, got {len(t.model)}, {self.horizon_steps} and {self.rows_per_step}"
            )

    @property
    def has_speed_limit(self) -> bool:
        """Whether there is a speed limit."""
        return isfinite(self.transfer.max_speed)

    @cached_property
    def state_units(self) -> Float[Array, " n"]:
        """Of y: a speed that can be reached, and what it covers in the time [m, m/s]."""
        steps = self.transfer.model
        duration = len(steps) * steps.dt
        speed = min(self.transfer.max_speed, self.transfer.max_control * duration)
        return np.repeat([speed * duration, speed], steps.axes)

    @cached_property
    def row_steps(self) -> Int[Array, " rows_per_step"]:
        """The step of each row."""
        return np.repeat(np.arange(self.horizon_steps), self.rows_per_step)

    def to_cvxpy(self) -> Any:
        """The programme in CVXPY, the data its parameters; vectors are columns."""
        import cvxpy as cp

        transfer, units, step = self.transfer, self.state_units, self.row_steps
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

        kept = cp.sum(cp.multiply(on_state, y[:, step]), axis=0) + cp.sum(
            cp.multiply(on_control, u[:, step]), axis=0
        )
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
