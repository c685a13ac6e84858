"""What the vehicles really do, as opposed to what a plan thinks they do."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.model import LinearModel
from dynamics.orbit import Orbit


class Plant(ABC):
    """What the vehicles really do.

    A plant remembers nothing: the same call gives the same states, bit for bit, whatever
    was asked before. Rows of NaN are vehicles that are not there; they stay NaN.
    """

    @abstractmethod
    def propagate(
        self,
        x: Float[Array, "agents n"],
        u: Float[Array, "agents m"],
        t: float,
        dt: float,
        substeps: int = 1,
    ) -> Float[Array, "{substeps}+1 agents n"]:
        """States at equal instants from t to t + dt, the first of them x itself.

        Args:
            x: States at t; in orbit, in the chief's frame.
            u: Accelerations, held in the same axes [m/s²].
            t: When the flight begins [s].
            dt: How long it takes [s].
            pieces: Into how many parts the instants divide it.

        Raises:
            ValueError: The states or the inputs are not what this plant flies.
        """

    @abstractmethod
    def chief_elements(self, t: float) -> Float[Array, " 6"] | None:
        """The six numbers of the chief's orbit at a time, or None where there is no orbit."""


@dataclass(frozen=True, eq=False)
class LinearPlant(Plant):
    """Vehicles that do exactly what a linear model says."""

    model: LinearModel
    chief_orbit: Orbit | None = None  # that of the chief, where there is one

    def propagate(
        self,
        x: Float[Array, "agents n"],
        u: Float[Array, "agents m"],
        t: float,
        dt: float,
        substeps: int = 1,
    ) -> Float[Array, "{substeps}+1 agents n"]:
        """States at equal instants from t to t + dt, the first of them x itself."""
        validate_propagation(x, u, dt, substeps, self.model.axes)
        steps = discretize_zoh(self.model, dt / substeps, substeps, t)
        held = np.repeat(u[:, None], substeps, axis=1)
        return np.moveaxis(steps.simulate(x, held), 1, 0)

    def chief_elements(self, t: float) -> Float[Array, " 6"] | None:
        """The six numbers of the chief's orbit at a time, or None where there is no orbit."""
        return None if self.chief_orbit is None else self.chief_orbit.elements_at(t)


def validate_propagation(x: Array, u: Array, dt: float, substeps: int, axes: int) -> None:
    """Refuse a flight that means nothing in a space of so many axes.

    Raises:
        ValueError: Shapes do not fit, the time is not positive, there are no pieces, or a
            vehicle that is there has an input that is not finite.
    """
    if x.ndim != 2 or x.shape[1] != 2 * axes or u.shape != (len(x), axes):
        raise ValueError(
            f"vehicles in {axes} axes have states of shape (agents, {2 * axes}) and accelerations "
            f"of shape (agents, {axes}), got {x.shape} and {u.shape}"
        )
    if not 0 < dt < np.inf or substeps < 1:
        raise ValueError(
            "a flight takes some time and has at least one piece, got "
            f"dt = {dt} s, pieces = {substeps}"
        )
    lost = np.flatnonzero(is_present(x) & ~np.isfinite(u).all(axis=1))
    if len(lost):
        raise ValueError(f"vehicle {lost[0]} is there, but its acceleration is {u[lost[0]]}")


def is_present(x: Float[Array, "agents n"]) -> Array:
    """Which vehicles are there: those whose state has no NaN."""
    return np.asarray(np.isfinite(x).all(axis=1))
