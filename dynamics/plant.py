"""Plants: the equations of motion that a run propagates."""

from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.callbacks import Callback, CallbackError, as_shape, guard
from dynamics.discretize import discretize_zoh
from dynamics.doors import check_methods, checked
from dynamics.inputs import InputError, read_array
from dynamics.model import Controls, LinearModel, NonlinearModel, States
from dynamics.orbit import MAX_TIME, Orbit

Samples = Float[Array, "{substeps}+1 agents n"]

RTOL = 1e-13  # of a step of `NonlinearPlant`, and in addition
ATOL = 1e-9, 1e-12  # of each agent's position and velocity [m, m/s]
MAX_ASKED = 20_000  # times that a rate is asked for between two returned instants
ROUNDING = 1e-9  # of the first states of a user's own plant, relative and in SI units


@check_methods
class Plant(ABC):
    """Motion of all agents under controls that are held.

    A plant is stateless: the same call returns the same states, bit for bit, whatever was
    propagated before. Rows of NaN are absent agents; they stay NaN.
    """

    chief_orbit: Orbit | None = None  # None where there is no orbit

    def __init_subclass__(cls) -> None:
        """Check methods of the user's own."""
        guard(cls, PLANT_CALLBACKS)

    @abstractmethod
    def propagate(self, x: States, u: Controls, t: float, dt: float, substeps: int = 1) -> Samples:
        """Return the states at equal instants from t to t + dt, the first of them x itself.

        Args:
            x: Positions [m] and velocities [m/s] at t; in orbit, in LVLH axes of the chief.
            u: Accelerations, constant in the same axes [m/s²].
            t: Initial time [s].
            dt: Duration [s].
            substeps: Number of intervals between the returned instants.

        Raises:
            ValueError: Shapes, controls or times do not fit this plant.
        """

    def chief_elements(self, t: float) -> Float[Array, " 6"] | None:
        """Return r [m], v_x [m/s], h [m²/s], Ω, i and θ [rad] of the chief; None without an orbit.

        Args:
            t: Time [s].
        """
        return None if self.chief_orbit is None else self.chief_orbit.elements_at(t)


def _as_states(plant: Plant, given: dict[str, Any], value: Any) -> Array:
    x, absent = given["x"], ~is_present(given["x"])
    shape = (given.get("substeps", 1) + 1, *x.shape)
    with suppress(InputError):
        if (array := read_array(value)).shape == shape:
            value = np.where(absent[:, None], 0.0, array)  # rows of absent agents may be anything
    states = as_shape(value, shape)
    for i in np.flatnonzero(~absent):
        if not np.allclose(states[0, i], x[i], ROUNDING, ROUNDING):
            begins = f"{states[0, i].tolist()} for {x[i].tolist()} of agent {i}"
            raise InputError("", f"must begin with the given states, got {begins}")
    states[0], states[:, absent] = x, np.nan
    return states


PLANT_CALLBACKS = {
    "propagate": Callback("x u t dt substeps", _as_states),
    "chief_elements": Callback("t", lambda p, given, v: None if v is None else as_shape(v, (6,))),
}


@checked
@dataclass(frozen=True, eq=False)
class LinearPlant(Plant):
    """Agents that move exactly as a linear model says.

    Args:
        model: Equations of motion.
        chief_orbit: Orbit of the chief, where there is one.
    """

    model: LinearModel
    chief_orbit: Orbit | None = None

    def propagate(self, x: States, u: Controls, t: float, dt: float, substeps: int = 1) -> Samples:
        """Return the states at equal instants from t to t + dt, the first of them x itself."""
        validate_propagation(x, u, dt, substeps, self.model.axes)
        steps = discretize_zoh(self.model, dt / substeps, substeps, t)
        return np.moveaxis(steps.simulate(x, np.repeat(u[:, None], substeps, axis=1)), 1, 0)


@checked
@dataclass(frozen=True, eq=False)
class NonlinearPlant(Plant):
    """Agents that move exactly as a nonlinear model says, all in one integration.

    The chief is that of the model, where it has an attribute `orbit`, as `J2` does.

    Args:
        model: Equations of motion.
    """

    model: NonlinearModel
    chief_orbit: Orbit | None = field(init=False)

    def __post_init__(self) -> None:
        """Take the orbit of the chief from the model."""
        object.__setattr__(self, "chief_orbit", getattr(self.model, "orbit", None))

    def propagate(self, x: States, u: Controls, t: float, dt: float, substeps: int = 1) -> Samples:
        """Return the states at equal instants from t to t + dt, the first of them x itself.

        Raises:
            ValueError: Shapes, controls or times do not fit this plant.
            CallbackError: The integrator fails, as at a singularity or a jump of the model.
        """
        validate_propagation(x, u, dt, substeps, self.model.axes)
        states = np.full((substeps + 1, *x.shape), np.nan)
        states[0] = x
        present = np.flatnonzero(is_present(x))
        if not len(present):
            return states
        # The integrator bounds the root mean square over all entries; divided by the root
        # of their number, the tolerance bounds each agent.
        atol = np.tile(np.repeat(ATOL, self.model.axes), len(present)) / np.sqrt(len(present))
        held, asked = u[present], count()

        def rate(s: float, y: Array) -> Array:
            if next(asked) > MAX_ASKED * substeps:
                reason = "its rate jumps, or has the digits of float32; a smooth one in doubles"
                raise CallbackError("", f"{failed} at t = {s:.6g} s: {reason} would do")
            return np.asarray(self.model.rate(s, y.reshape(len(present), -1), held).ravel())

        instants = t + np.linspace(0, dt, substeps + 1)
        y, failed = x[present].ravel(), f"{type(self.model).__name__} cannot be integrated"
        for k in range(substeps):
            span = (float(instants[k]), float(instants[k + 1]))
            solution = scipy.integrate.solve_ivp(rate, span, y, "DOP853", rtol=RTOL, atol=atol)
            if not solution.success:
                when = f"from t = {span[0]:.6g} to {span[1]:.6g} s"
                raise CallbackError("", f"{failed} {when}: {solution.message}")
            y = solution.y[:, -1]
            states[k + 1, present] = y.reshape(len(present), -1)
        return states


def validate_propagation(x: Array, u: Array, dt: float, substeps: int, axes: int) -> None:
    """Check the arguments of `Plant.propagate`."""
    if x.ndim != 2 or x.shape[1] != 2 * axes or u.shape != (len(x), axes):
        wanted = f"shape (agents, {2 * axes}) and accelerations of shape (agents, {axes})"
        got = f"got {x.shape} and {u.shape}"
        raise ValueError(f"agents in {axes} axes have states of {wanted}, {got}")
    if not 0 < dt <= MAX_TIME or substeps < 1:
        wanted = f"positive and at most {MAX_TIME:.0e} s, with at least one substep"
        got = f"dt = {dt} s and substeps = {substeps}"
        raise ValueError(f"the duration must be {wanted}, got {got}")
    wrong = np.flatnonzero(is_present(x) & ~np.isfinite(u).all(axis=1))
    if len(wrong):
        raise ValueError(f"agent {wrong[0]} is present, but its acceleration is {u[wrong[0]]}")


def is_present(x: Float[Array, "agents n"]) -> Array:
    """Return True for agents that are present: all entries of their state are finite."""
    return np.asarray(np.isfinite(x).all(axis=1))
