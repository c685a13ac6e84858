"""Discretization: from equations of motion in continuous time to steps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import isfinite
from typing import Annotated, Any

import numpy as np
import scipy
from annotated_types import Ge, Gt, Le
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.doors import MAY_BE_NAN, checked
from dynamics.inputs import InputError
from dynamics.model import FlownControls, FlownStates, LinearModel, NonlinearModel, StateSamples

RTOL, ATOL = 1e-11, 1e-11  # of a step's matrices, in SI units
LINEARIZATION_BATCH = 256  # states, so few that they stay in the processor's cache
BLOCK_STEPS = 16  # that are integrated at once
ON_GRID = 1e-10  # of a step, within which it begins at a multiple of its length
SAME_MODEL = 1e-12  # relative difference of matrices that are the same but for rounding
MAX_STEPS = 10**6  # of which the matrices fit in memory
SAME_STEP = 1e-10  # relative difference of matrices that are the same but for rounding

Duration = Annotated[float, Gt(0)]
Count = Annotated[int, Ge(0), Le(MAX_STEPS)]


@checked
@dataclass(frozen=True, eq=False)
class DiscreteModel:
    """x[k+1] = A[k] x[k] + B[k] u[k] + z[k],  k = 0 … T−1  [Morgan2016, eq. 10].

    Matrices are always stacked over time, also those of a time-invariant model. Where
    every agent has matrices of its own (`linearize_along`), the agent axes come before
    that of time, and `for_agent` takes those of one agent.
    """

    A: Float[Array, "*agents T n n"]
    B: Float[Array, "*agents T n m"]
    z: Float[Array, "*agents T n"]
    dt: Duration  # [s]

    def __len__(self) -> int:
        return int(self.A.shape[-3])

    @property
    def axes(self) -> int:
        """Dimension of space."""
        return int(self.B.shape[-1])

    @property
    def array_sizes(self) -> dict[str, Any]:
        """Sizes of the axes of states and controls, and of agents with matrices of their own."""
        (*agents, _, n, m) = self.B.shape
        return {"n": n, "m": m} | ({"*agents": tuple(agents)} if agents else {})

    @cached_property
    def is_double_integrator(self) -> bool:
        """True for positions and velocities on axes of their own, with a zero-order hold.

        A drift, as that of a constant force, may be in the model.
        """
        (n, m), dt = self.B.shape[-2:], self.dt
        if n != 2 * m:
            return False
        eye = np.eye(m)
        unit = np.repeat([1.0, 1 / dt], m)[:, None]  # makes entries comparable
        A, B = self.A * unit.T / unit, self.B / unit / dt**2
        off = A - np.block([[eye, eye], [0 * eye, eye]]), B - np.vstack([eye / 2, eye])
        return all(bool((np.abs(part) <= SAME_MODEL).all()) for part in off)

    def __getitem__(self, window: slice) -> "DiscreteModel":
        A, B, z = self.A[..., window, :, :], self.B[..., window, :, :], self.z[..., window, :]
        return DiscreteModel(A, B, z, self.dt)

    def for_agent(self, agent: int) -> "DiscreteModel":
        """Take the steps of one of many agents."""
        count = len(self.A) if self.A.ndim > 3 else 0
        if not 0 <= agent < count:
            raise InputError("agent", f"must be that of one of {count} with own matrices")
        return DiscreteModel(self.A[agent], self.B[agent], self.z[agent], self.dt)

    def respond(self, shares: Float[Array, " m"] | float = 1.0) -> Float[Array, "instants n Tm"]:
        """Return the matrices that take all controls, in units of shares, to changes of states."""
        if self.B.ndim > 3:
            raise InputError("agent", "each agent has matrices; for_agent(i).respond() would do")
        T, n, m = self.B.shape
        R = np.zeros((T + 1, n, T * m))
        for k in range(T):
            R[k + 1] = self.A[k] @ R[k]
            R[k + 1, :, k * m : (k + 1) * m] += self.B[k] * shares
        return R

    def simulate(
        self,
        x: Annotated[Float[Array, "*#agents n"], MAY_BE_NAN],
        u: Annotated[Float[Array, "*#agents T m"], MAY_BE_NAN],
    ) -> StateSamples:
        """Return the states from x on, of one agent or of many, with the same matrices or own."""
        if u.shape[-2] > len(self):
            raise InputError("u", f"must have {len(self)} steps at most, got {u.shape[-2]}")
        count, states = u.shape[-2], [x]
        if self.B.ndim == 3:
            for k, held in enumerate(np.moveaxis(u, -2, 0)):
                states.append(states[-1] @ self.A[k].T + held @ self.B[k].T + self.z[k])
        else:
            push = _matvec(self.B[..., :count, :, :], u) + self.z[..., :count, :]
            for k in range(count):
                states.append(_matvec(self.A[..., k, :, :], states[-1]) + push[..., k, :])
        states[0] = np.broadcast_to(x, states[-1].shape)
        return np.stack(states, axis=-2)

    def coast_to_end(
        self, x: Annotated[Float[Array, "agents n"], MAY_BE_NAN]
    ) -> Float[Array, "agents n"]:
        """Return the last states of the free motion from x on."""
        return self.simulate(x, np.zeros((len(x), len(self), self.axes)))[:, -1]


@checked
def discretize_zoh(
    model: LinearModel, dt: Duration, count: Count, t0: float = 0.0
) -> DiscreteModel:
    """Discretize with a zero-order hold: the control is constant over each step.

    Exact for a time-invariant model [Morgan2016, eq. 11]. The equations of other models
    are integrated over each step, to eleven digits, and not frozen as in eq. 11. That takes
    time: for a model that is a frozen, hashable dataclass, steps that begin at a multiple of their
    length are kept and reused. They are computed in blocks, which begin up to 15 steps before the
    first and end up to 15 after the last.

    Args:
        model: The model, of any class derived from `LinearModel`.
        dt: Length of a step [s].
        count: Number of steps.
        t0: Start of the first step [s].

    Raises:
        ValueError: The step is not positive and finite, or the count is negative.
    """
    if model.is_time_invariant:
        return _discretize_time_invariant(model, dt, count)
    is_on_grid = isfinite(t0 / dt) and abs(t0 / dt - round(t0 / dt)) <= ON_GRID
    if not (count and is_on_grid and _is_immutable(model)):
        return _discretize_time_varying(model, dt, count, t0)
    first = round(t0 / dt)
    numbers = range(first // BLOCK_STEPS, (first + count - 1) // BLOCK_STEPS + 1)
    blocks = [_discretize_block(model, dt, number) for number in numbers]
    A, B, z = (np.concatenate([getattr(block, name) for block in blocks]) for name in "ABz")
    begin = first - numbers[0] * BLOCK_STEPS
    return DiscreteModel(A, B, z, dt)[begin : begin + count]


@checked
def linearize_along(
    model: NonlinearModel, x: FlownStates, u: FlownControls, dt: Duration, t0: float = 0.0
) -> DiscreteModel:
    """Linearize and discretize about each agent's nominal trajectory.

    Each step is linearized about the motion that begins at its nominal state under its
    nominal control [Morgan2016, eqs. 7 to 10], so it is exact there. The error is of second
    order in the distance from the nominal; discretization adds none.

    Args:
        model: The model.
        x: Nominal positions [m] and velocities [m/s] at the starts of the steps; a last one, at
            the end, is not used.
        u: Nominal accelerations, held over each step [m/s²].
        dt: Length of a step [s].
        t0: Start of the first step [s].

    Returns:
        A[k], B[k] and z[k] of every agent, with the agent axes before that of time.

    Raises:
        ValueError: The step is not positive and finite.
    """
    T, n, m = u.shape[-2], x.shape[-1], u.shape[-1]
    if x.shape[-2] not in (T, T + 1):
        raise InputError("x", f"must have {T} or {T + 1} instants for {T} steps, got {x.shape[-2]}")
    size = max(1, LINEARIZATION_BATCH // max(1, T))
    if u.ndim > 2 and len(u) > size:
        parts = [slice(a, a + size) for a in range(0, len(u), size)]
        steps = [linearize_along(model, x[part], u[part], dt, t0) for part in parts]
        A, B, z = (np.concatenate([getattr(few, name) for few in steps]) for name in "ABz")
        return DiscreteModel(A, B, z, dt)
    x0, times = x[..., :T, :], t0 + dt * np.arange(T)
    lead = x0.shape[:-1]

    def rate(t: float, y: Array) -> Array:
        state = y.reshape(*lead, n, 1 + n + m)
        A, B = model.jacobian(times + t, state[..., 0], u)
        change = A @ state
        change[..., 0] = model.rate(times + t, state[..., 0], u)
        change[..., 1 + n :] += B
        return np.asarray(change.ravel())

    start = np.zeros((*lead, n, 1 + n + m))
    start[..., 0], start[..., 1 : 1 + n] = x0, np.eye(n)
    end = _integrate(rate, start.ravel(), dt).reshape(start.shape)
    A, B = end[..., 1 : 1 + n], end[..., 1 + n :]
    z = end[..., 0] - _matvec(A, x0) - _matvec(B, u)
    return DiscreteModel(A, B, z, dt)


def have_equal_steps(
    one: LinearModel, other: LinearModel, dt: float, times: Sequence[float]
) -> bool:
    """Tell whether two models are the same over a step [s] from each of some times [s].

    Rounding is no difference. One step stands for all of two time-invariant models.
    """
    if one is other or one.axes != other.axes:
        return one is other
    is_fixed = one.is_time_invariant and other.is_time_invariant
    unit = np.repeat([1.0, dt], one.axes)  # makes positions of velocities
    for t in times[:1] if is_fixed else times:
        first, second = (discretize_zoh(model, dt, 1, t) for model in (one, other))
        for a, b, scale in (
            (first.A, second.A, unit[:, None] / unit),
            (first.B, second.B, unit[:, None] / dt**2),
            (first.z, second.z, unit),
        ):
            if np.abs(scale * (a - b)).max() > SAME_STEP * np.abs(scale * a).max():
                return False
    return True


def _discretize_time_invariant(model: LinearModel, dt: float, count: int) -> DiscreteModel:
    # exp([[A, B, z], [0, 0, 0]] dt) = [[A_d, B_d, z_d], [0, I]]  [VanLoan1978]
    A, B, z = model.A(0.0), model.B(0.0), model.z(0.0)
    n, m = B.shape
    M = np.zeros((n + m + 1, n + m + 1))
    M[:n, :n], M[:n, n : n + m], M[:n, -1] = A, B, z
    E = _exponential((dt * M).tobytes(), len(M))
    parts = E[:n, :n], E[:n, n : n + m], E[:n, -1]
    A, B, z = (np.repeat(part[None], count, axis=0) for part in parts)
    return DiscreteModel(A, B, z, dt)


@lru_cache(maxsize=64)  # by its entries: a model may change, or not be hashable
def _exponential(entries: bytes, size: int) -> Array:
    return np.asarray(scipy.linalg.expm(np.frombuffer(entries).reshape(size, size)))


def _is_immutable(model: LinearModel) -> bool:
    declared = vars(type(model)).get("__dataclass_params__")
    if declared is None or not (declared.frozen and declared.eq):
        return False
    try:
        hash(model)
    except TypeError:  # a field, such as an array, can be changed in place
        return False
    return True


@lru_cache(maxsize=4096)  # planning asks for the same steps again and again
def _discretize_block(model: LinearModel, dt: float, number: int) -> DiscreteModel:
    return _discretize_time_varying(model, dt, BLOCK_STEPS, number * BLOCK_STEPS * dt)


def _discretize_time_varying(model: LinearModel, dt: float, count: int, t0: float) -> DiscreteModel:
    n, m = 2 * model.axes, model.axes
    times = t0 + dt * np.arange(count)

    def rate(t: float, y: Array) -> Array:
        A, B, z = model.matrices(times + t)
        change = A @ y.reshape(count, n, n + m + 1)
        change[:, :, n : n + m] += B
        change[:, :, -1] += z
        return np.asarray(change.ravel())

    start = np.broadcast_to(np.eye(n, n + m + 1), (count, n, n + m + 1))
    end = _integrate(rate, start.ravel(), dt).reshape(start.shape)
    return DiscreteModel(end[..., :n], end[..., n : n + m], end[..., -1], dt)


def _integrate(rate: Callable[[float, Array], Array], start: Array, dt: float) -> Array:
    # One step of an eighth-order method is enough for most control steps.
    if not start.size:
        return start
    found = scipy.integrate.solve_ivp(
        rate, (0.0, dt), start, "DOP853", first_step=dt, rtol=RTOL, atol=ATOL
    )
    return np.asarray(found.y[:, -1])


def _matvec(matrix: Array, vector: Array) -> Array:
    return np.asarray((matrix @ vector[..., None])[..., 0])  # einsum takes thrice as long
