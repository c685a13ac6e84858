"""From rates to steps."""

from dataclasses import dataclass
from functools import lru_cache
from math import inf

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.linalg import expm

from dynamics.model import LinearModel


@dataclass(frozen=True, eq=False)
class Steps:
    """x[k+1] = A[k] x[k] + B[k] u[k] + z[k],  k = 0 … T−1  [Morgan2016, eq. 10].

    Matrices are always stacked over time, so nothing downstream asks whether the
    model was time-varying.
    """

    A: Float[Array, "T n n"]
    B: Float[Array, "T n m"]
    z: Float[Array, "T n"]
    dt: float  # [s]

    def __len__(self) -> int:
        return len(self.A)

    @property
    def axes(self) -> int:
        """Axes of space."""
        return int(self.B.shape[2])

    def __getitem__(self, window: slice) -> "Steps":
        return Steps(self.A[window], self.B[window], self.z[window], self.dt)

    def roll(
        self, x: Float[Array, "*agents n"], u: Float[Array, "*agents T m"]
    ) -> Float[Array, "*agents T+1 n"]:
        """States visited from x under the inputs u, for one agent or for many."""
        states = [x]
        for k in range(u.shape[-2]):
            states.append(states[-1] @ self.A[k].T + u[..., k, :] @ self.B[k].T + self.z[k])
        return np.stack(states, axis=-2)


def hold(model: LinearModel, dt: float, count: int, start: float = 0.0) -> Steps:
    """Discretise with the input held over each step [Morgan2016, eq. 11].

    Exact for a model whose matrices are constant. Others are frozen at the middle
    of each step, which is accurate to second order in dt.

    Args:
        model: The model.
        dt: Length of a step [s].
        count: Number of steps.
        start: Time at which the first step begins [s].

    Raises:
        ValueError: The step is not positive or the count negative.
    """
    if not 0 < dt < inf or count < 0:
        raise ValueError(
            f"a step must be positive and finite and a count not negative, got {dt} and {count}"
        )
    if model.constant:
        return _stack([_hold_always(model, dt)] * count, model, dt)
    return _stack([_hold(model, start + (k + 0.5) * dt, dt) for k in range(count)], model, dt)


def _stack(parts: list[tuple[Array, Array, Array]], model: LinearModel, dt: float) -> Steps:
    n, m = 2 * model.axes, model.axes
    A = np.array([p[0] for p in parts]).reshape(-1, n, n)
    B = np.array([p[1] for p in parts]).reshape(-1, n, m)
    z = np.array([p[2] for p in parts]).reshape(-1, n)
    return Steps(A, B, z, dt)


@lru_cache(maxsize=64)
def _hold_always(model: LinearModel, dt: float) -> tuple[Array, Array, Array]:
    return _hold(model, 0.0, dt)


def _hold(model: LinearModel, t: float, dt: float) -> tuple[Array, Array, Array]:
    # exp([[A, B, z], [0, 0, 0]] dt) = [[A_d, B_d, z_d], [0, I]]  [VanLoan1978]
    A, B, z = model.A(t), model.B(t), model.z(t)
    n, m = B.shape
    M = np.zeros((n + m + 1, n + m + 1))
    M[:n, :n], M[:n, n : n + m], M[:n, -1] = A, B, z
    E = expm(dt * M)
    return E[:n, :n], E[:n, n : n + m], E[:n, -1]
