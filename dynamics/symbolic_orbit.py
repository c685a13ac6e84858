"""Orbit of the chief at symbolic times: a CasADi function that integrates, with derivatives."""

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import casadi
import numpy as np
from jaxtyping import Shaped
from numpy import ndarray as Array

from dynamics.orbit import Orbit, polar_nodal_rates
from dynamics.symbols import to_array, to_casadi


class ElementsFunction(casadi.Callback):
    """t ↦ polar-nodal elements; their derivative is that of the equations of motion."""

    def __init__(self, orbit: Orbit) -> None:
        casadi.Callback.__init__(self)
        self.orbit = orbit
        self.construct("elements_at", {})

    def get_sparsity_out(self, i: int) -> Any:
        """Return the shape of the elements."""
        return casadi.Sparsity.dense(6, 1)

    def eval(self, arguments: Sequence[Any]) -> list[Any]:
        """Return the elements at a time."""
        return [_elements_at(self.orbit, float(arguments[0]))]

    def has_jacobian(self) -> bool:
        """Return True: the derivative is known."""
        return True

    def get_jacobian(
        self, name: str, inputs: Sequence[str], outputs: Sequence[str], options: Any
    ) -> Any:
        """Return the rates of the elements, as a function of the time and of the elements."""
        t, elements = casadi.SX.sym("t"), casadi.SX.sym("elements", 6)
        chief = to_array(elements)[:, 0]
        rates = to_casadi(polar_nodal_rates(chief, self.orbit.mu, self.orbit.k_J2))
        return casadi.Function(name, [t, elements], [rates], inputs, outputs, options)


@lru_cache(maxsize=4096)  # solvers ask for the same times again and again
def _elements_at(orbit: Orbit, t: float) -> Any:
    return casadi.DM(orbit.elements_at(t))


# Without limit: CasADi does not keep the object alive that its function belongs to.
_elements_function = cache(ElementsFunction)


def symbolic_elements(orbit: Orbit, times: Shaped[Array, "*k"]) -> Shaped[Array, "*k 6"]:
    """Return the polar-nodal elements at symbolic times [s]."""
    function = _elements_function(orbit)
    found = [to_array(function(t.expression))[:, 0] for t in times.ravel()]
    return np.array(found).reshape(*times.shape, 6)
