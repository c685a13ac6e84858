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
    def rate(self, t: float, x: Float[Array, " n"], u: Float[Array, " m"]) -> Float[Array, " n"]:
        """Rate of change of the state."""


class LinearModel(Model):
    """ẋ = A(t) x + B u + z(t), with the input u entering as an acceleration.

    To add a linear model, write its axes and A, and z where the model is affine.
    Discretisation, problems and simulations then accept it as it is.
    """

    constant: ClassVar[bool] = False  # whether A, B and z are the same at all times

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

    def rate(self, t: float, x: Float[Array, " n"], u: Float[Array, " m"]) -> Float[Array, " n"]:
        """Rate of change of the state."""
        return np.asarray(self.A(t) @ x + self.B(t) @ u + self.z(t))


@dataclass(frozen=True, eq=False)
class SymbolicModel(Model):
    """A model written in CasADi's symbols, so that it can be linearised exactly.

    Args:
        axes: Axes of space.
        formula: (t, x, u) ↦ ẋ, written with operations that CasADi overloads.
    """

    axes: int
    formula: Callable[[Any, Any, Any], Any]

    def rate(self, t: float, x: Float[Array, " n"], u: Float[Array, " m"]) -> Float[Array, " n"]:
        """Rate of change of the state."""
        return np.asarray(self._functions[0](t, x, u), dtype=float).ravel()

    def jacobian(
        self, t: float, x: Float[Array, " n"], u: Float[Array, " m"]
    ) -> tuple[Float[Array, "n n"], Float[Array, "n m"]]:
        """∂f/∂x and ∂f/∂u, by algorithmic differentiation."""
        A, B = self._functions[1](t, x, u)
        return np.asarray(A, dtype=float), np.asarray(B, dtype=float)

    @cached_property
    def _functions(self) -> tuple[Any, Any]:
        import casadi

        n, m = 2 * self.axes, self.axes
        t, x, u = casadi.SX.sym("t"), casadi.SX.sym("x", n), casadi.SX.sym("u", m)
        f = self.formula(t, x, u)
        derivatives = [casadi.jacobian(f, x), casadi.jacobian(f, u)]
        return (
            casadi.Function("rate", [t, x, u], [f]),
            casadi.Function("jacobian", [t, x, u], derivatives),
        )


@dataclass(frozen=True, eq=False)
class Linearised(LinearModel):
    """A nonlinear model about a nominal path [Morgan2016, eqs. 7 and 8].

        A(t) = ∂f/∂x,  B(t) = ∂f/∂u,  z(t) = f − A x̄ − B ū,  all on the nominal.

    The error is of second order in the distance from the nominal.
    """

    model: SymbolicModel
    nominal: Callable[[float], tuple[Array, Array]]  # t ↦ (x̄, ū)

    def __post_init__(self) -> None:
        """Live in the same space as the model."""
        object.__setattr__(self, "axes", self.model.axes)

    def A(self, t: float) -> Float[Array, "n n"]:
        """State matrix on the nominal."""
        return self.model.jacobian(t, *self.nominal(t))[0]

    def B(self, t: float) -> Float[Array, "n m"]:
        """Input matrix on the nominal."""
        return self.model.jacobian(t, *self.nominal(t))[1]

    def z(self, t: float) -> Float[Array, " n"]:
        """What the linear terms leave of the rate on the nominal."""
        x, u = self.nominal(t)
        A, B = self.model.jacobian(t, x, u)
        return np.asarray(self.model.rate(t, x, u) - A @ x - B @ u)
