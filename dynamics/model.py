"""What a model is: a state, an input and a rate."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array


class Model(ABC):
    """ẋ = f(t, x, u), with the state x = (position, velocity)."""

    axes: int  # axes of space, d: the state has 2 d entries, the input d

    @abstractmethod
    def rate(self, t: float, x: Float[Array, "*k n"], u: Float[Array, "*k m"]) -> Array:
        """Rate of change of the state, of one or of many."""


class NonlinearModel(Model):
    """A model that can be linearised about any of its states.

    Times, states and inputs may be stacked: their leading axes broadcast.
    """

    @abstractmethod
    def rate(
        self, t: float | Float[Array, "*#k"], x: Float[Array, "*#k n"], u: Float[Array, "*#k m"]
    ) -> Float[Array, "... n"]:
        """Rate of change of the state, of one or of many."""

    @abstractmethod
    def jacobian(
        self, t: float | Float[Array, "*#k"], x: Float[Array, "*#k n"], u: Float[Array, "*#k m"]
    ) -> tuple[Float[Array, "... n n"], Float[Array, "... n m"]]:
        """∂f/∂x and ∂f/∂u."""


class LinearModel(Model):
    """ẋ = A(t) x + B u + z(t), with the input u entering as an acceleration.

    To add a linear model, write its axes and A, and z where the model is affine.
    Discretisation, problems and simulations then accept it as it is.
    """

    is_time_invariant: ClassVar[bool] = False  # whether A, B and z are the same at all times

    @abstractmethod
    def A(self, t: float) -> Float[Array, "n n"]:
        """State matrix."""

    def B(self, t: float) -> Float[Array, "n m"]:
        """Input matrix: acceleration enters the velocity."""
        d = self.axes
        return np.vstack([np.zeros((d, d)), np.eye(d)])

    def z(self, t: float) -> Float[Array, " n"]:
        """Affine term."""
        return np.zeros(2 * self.axes)

    def matrices(
        self, times: Float[Array, " k"]
    ) -> tuple[Float[Array, "k n n"], Float[Array, "k n m"], Float[Array, "k n"]]:
        """A, B and z at many times; one by one, where a model knows nothing better."""
        each = [(self.A(t), self.B(t), self.z(t)) for t in times.tolist()]
        A, B, z = (np.array(part) for part in zip(*each, strict=True))
        return A, B, z

    def rate(self, t: float, x: Float[Array, "*k n"], u: Float[Array, "*k m"]) -> Array:
        """Rate of change of the state, of one or of many."""
        return np.asarray(x @ self.A(t).T + u @ self.B(t).T + self.z(t))


@dataclass(frozen=True, eq=False)
class SymbolicModel(NonlinearModel):
    """A model written in CasADi's symbols, so that it can be linearised exactly.

    Args:
        axes: Axes of space.
        formula: (t, x, u) ↦ ẋ, written with operations that CasADi overloads.
    """

    axes: int
    expression: Callable[[Any, Any, Any], Any]

    def rate(
        self, t: float | Float[Array, "*#k"], x: Float[Array, "*#k n"], u: Float[Array, "*#k m"]
    ) -> Float[Array, "... n"]:
        """Rate of change of the state, of one or of many."""
        (found,) = self._map_batch(self._casadi_functions[0], t, x, u)
        return found[..., 0]

    def jacobian(
        self, t: float | Float[Array, "*#k"], x: Float[Array, "*#k n"], u: Float[Array, "*#k m"]
    ) -> tuple[Float[Array, "... n n"], Float[Array, "... n m"]]:
        """∂f/∂x and ∂f/∂u, by algorithmic differentiation."""
        A, B = self._map_batch(self._casadi_functions[1], t, x, u)
        return A, B

    def _map_batch(self, function: Any, t: Any, x: Array, u: Array) -> list[Array]:
        lead = np.broadcast_shapes(np.shape(t), x.shape[:-1], u.shape[:-1])
        rows = zip(
            np.broadcast_to(t, lead).ravel(),
            np.broadcast_to(x, (*lead, x.shape[-1])).reshape(-1, x.shape[-1]),
            np.broadcast_to(u, (*lead, u.shape[-1])).reshape(-1, u.shape[-1]),
            strict=True,
        )
        found = [function.call([float(s), *row]) for s, *row in rows]
        stacked = [np.array(list(map(np.asarray, part))) for part in zip(*found, strict=True)]
        return [part.reshape(*lead, *part.shape[1:]) for part in stacked]

    @cached_property
    def _casadi_functions(self) -> tuple[Any, Any]:
        import casadi

        n, m = 2 * self.axes, self.axes
        t, x, u = casadi.SX.sym("t"), casadi.SX.sym("x", n), casadi.SX.sym("u", m)
        f = self.expression(t, x, u)
        derivatives = [casadi.jacobian(f, x), casadi.jacobian(f, u)]
        return (
            casadi.Function("rate", [t, x, u], [f]),
            casadi.Function("jacobian", [t, x, u], derivatives),
        )


@dataclass(frozen=True, eq=False)
class LinearizedModel(LinearModel):
    """A nonlinear model about a nominal path [Morgan2016, eqs. 7 and 8].

        A(t) = ∂f/∂x,  B(t) = ∂f/∂u,  z(t) = f − A x̄ − B ū,  all on the nominal.

    The error is of second order in the distance from the nominal.
    """

    model: NonlinearModel
    nominal: Callable[[float], tuple[Array, Array]]  # t ↦ (x̄, ū)

    @classmethod
    def at_origin(cls, model: NonlinearModel) -> "LinearizedModel":
        """About staying at the origin: in orbit, about the chief."""
        still = np.zeros(2 * model.axes), np.zeros(model.axes)
        return cls(model, lambda t: still)

    def __post_init__(self) -> None:
        """Live in the same space as the model."""
        object.__setattr__(self, "axes", self.model.axes)

    def A(self, t: float) -> Float[Array, "n n"]:
        """State matrix on the nominal."""
        return np.asarray(self.matrices(np.array([t]))[0][0])

    def B(self, t: float) -> Float[Array, "n m"]:
        """Input matrix on the nominal."""
        return np.asarray(self.matrices(np.array([t]))[1][0])

    def z(self, t: float) -> Float[Array, " n"]:
        """What the linear terms leave of the rate on the nominal."""
        return np.asarray(self.matrices(np.array([t]))[2][0])

    def matrices(
        self, times: Float[Array, " k"]
    ) -> tuple[Float[Array, "k n n"], Float[Array, "k n m"], Float[Array, "k n"]]:
        """A, B and z at many times."""
        x, u = (np.array(part) for part in zip(*map(self.nominal, times.tolist()), strict=True))
        A, B = self.model.jacobian(times, x, u)
        rest = np.einsum("kab,kb->ka", A, x) + np.einsum("kab,kb->ka", B, u)
        return A, B, self.model.rate(times, x, u) - rest
