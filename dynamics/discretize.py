"""From rates to steps."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import inf

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from dynamics.model import LinearModel, NonlinearModel

RTOL, ATOL = 1e-11, 1e-11  # of a step's matrices, in SI units


@dataclass(frozen=True, eq=False)
class DiscreteModel:
    """x[k+1] = A[k] x[k] + B[k] u[k] + z[k],  k = 0 … T−1  [Morgan2016, eq. 10].

    Matrices are always stacked over time, so nothing downstream asks whether the
    model was time-varying. Steps of many agents, each with its own, have the agents'
    axis before that of time; `of` picks one.
    """

    A: Float[Array, "*agents T n n"]
    B: Float[Array, "*agents T n m"]
    z: Float[Array, "*agents T n"]
    dt: float  # [s]

    def __len__(self) -> int:
        return int(self.A.shape[-3])

    @property
    def axes(self) -> int:
        """Axes of space."""
        return int(self.B.shape[-1])

    def __getitem__(self, window: slice) -> "DiscreteModel":
        return DiscreteModel(self.A[window], self.B[window], self.z[window], self.dt)

    def for_agent(self, agent: int) -> "DiscreteModel":
        """The steps of one of many agents."""
        return DiscreteModel(self.A[agent], self.B[agent], self.z[agent], self.dt)

    def simulate(
        self, x: Float[Array, "*agents n"], u: Float[Array, "*agents T m"]
    ) -> Float[Array, "*agents T+1 n"]:
        """States visited from x under the inputs u, for one agent or for many."""
        states = [x]
        for k in range(u.shape[-2]):
            states.append(states[-1] @ self.A[k].T + u[..., k, :] @ self.B[k].T + self.z[k])
        return np.stack(states, axis=-2)


def discretize_zoh(model: LinearModel, dt: float, count: int, t0: float = 0.0) -> DiscreteModel:
    """Discretise with the input held over each step [Morgan2016, eq. 11].

    Exact for a model whose matrices are constant. For others the linear equations are
    integrated over each step, to eleven digits; they are not frozen as in eq. 11.

    Args:
        model: The model.
        dt: Length of a step [s].
        count: Number of steps.
        start: Time at which the first step begins [s].

    Raises:
        ValueError: The step is not positive or the count negative.
    """
    _validate_steps(dt, count)
    if model.is_time_invariant:
        A, B, z = (
            np.repeat(part[None], count, axis=0) for part in _discretize_time_invariant(model, dt)
        )
        return DiscreteModel(A, B, z, dt)
    return _discretize_time_varying(model, dt, count, t0)


def linearize_along(
    model: NonlinearModel,
    x: Float[Array, "*agents instants n"],
    u: Float[Array, "*agents T m"],
    dt: float,
    t0: float = 0.0,
) -> DiscreteModel:
    """Discretise about each agent's own nominal path [Morgan2016, eqs. 7 to 10].

    Each step is linearised about the motion that begins at its own nominal state under
    its own nominal input, so it is exact there: what is left is of second order in the
    distance from the nominal, and none of it comes from the discretisation.

    Args:
        model: The model.
        x: Nominal states at the instants; the last one is not needed.
        u: Nominal inputs, held over each step.
        dt: Length of a step [s].
        start: Time of the first instant [s].

    Returns:
        A[k], B[k] and z[k] of every agent, with the agents' axes before that of time.

    Raises:
        ValueError: The step is not positive.
    """
    T, n, m = u.shape[-2], x.shape[-1], u.shape[-1]
    _validate_steps(dt, T)
    x0, times = x[..., :T, :], t0 + dt * np.arange(T)
    lead = x0.shape[:-1]

    def rate(t: float, y: Array) -> Array:
        state = y.reshape(*lead, n, 1 + n + m)
        A, B = model.jacobian(times + t, state[..., 0], u)
        moved = A @ state
        moved[..., 0] = model.rate(times + t, state[..., 0], u)
        moved[..., 1 + n :] += B
        return np.asarray(moved.ravel())

    begin = np.zeros((*lead, n, 1 + n + m))
    begin[..., 0], begin[..., 1 : 1 + n] = x0, np.eye(n)
    end = _integrate(rate, begin.ravel(), dt).reshape(begin.shape)
    A, B = end[..., 1 : 1 + n], end[..., 1 + n :]
    z = end[..., 0] - _matvec(A, x0) - _matvec(B, u)
    return DiscreteModel(A, B, z, dt)


def _validate_steps(dt: float, count: int) -> None:
    if not 0 < dt < inf or count < 0:
        raise ValueError(
            f"a step must be positive and finite and a count not negative, got {dt} and {count}"
        )


@lru_cache(maxsize=64)
def _discretize_time_invariant(model: LinearModel, dt: float) -> tuple[Array, Array, Array]:
    return _van_loan(model, 0.0, dt)


@lru_cache(maxsize=64)  # a plan asks for the same steps again and again
def _discretize_time_varying(
    model: LinearModel, dt: float, count: int, start: float
) -> DiscreteModel:
    n, m = 2 * model.axes, model.axes
    times = start + dt * np.arange(count)

    def rate(t: float, y: Array) -> Array:
        A, B, z = model.matrices(times + t)
        moved = A @ y.reshape(count, n, n + m + 1)
        moved[:, :, n : n + m] += B
        moved[:, :, -1] += z
        return np.asarray(moved.ravel())

    begin = np.broadcast_to(np.eye(n, n + m + 1), (count, n, n + m + 1))
    end = _integrate(rate, begin.ravel(), dt).reshape(begin.shape)
    return DiscreteModel(end[..., :n], end[..., n : n + m], end[..., -1], dt)


def _integrate(rate: Callable[[float, Array], Array], begin: Array, dt: float) -> Array:
    # One step of an eighth-order method is what a control step mostly takes.
    if not begin.size:
        return begin
    found = solve_ivp(rate, (0.0, dt), begin, "DOP853", first_step=dt, rtol=RTOL, atol=ATOL)
    return np.asarray(found.y[:, -1])


def _matvec(matrix: Array, vector: Array) -> Array:
    return np.asarray(np.einsum("...ab,...b->...a", matrix, vector))


def _van_loan(model: LinearModel, t: float, dt: float) -> tuple[Array, Array, Array]:
    # exp([[A, B, z], [0, 0, 0]] dt) = [[A_d, B_d, z_d], [0, I]]  [VanLoan1978]
    A, B, z = model.A(t), model.B(t), model.z(t)
    n, m = B.shape
    M = np.zeros((n + m + 1, n + m + 1))
    M[:n, :n], M[:n, n : n + m], M[:n, -1] = A, B, z
    E = expm(dt * M)
    return E[:n, :n], E[:n, n : n + m], E[:n, -1]
