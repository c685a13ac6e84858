"""The model of a scenario: what plans move by, and the limits that they keep."""

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PositiveFloat

from dynamics import ClohessyWiltshire, LinearizedModel, LinearModel
from dynamics.j2 import J2
from dynamics.orbit import Orbit
from dynamics.schweighart_sedwick import SchweighartSedwick
from dynamics.tschauner_hempel import TschaunerHempel
from sato.former.refusal import Refusal
from sato.former.units import Table

ABOUT: dict[str, Callable[[Orbit], LinearModel]] = {
    "clohessy_wiltshire": ClohessyWiltshire.from_orbit,
    "schweighart_sedwick": SchweighartSedwick.from_orbit,
    "eccentric": TschaunerHempel.from_orbit,
    "j2": lambda orbit: LinearizedModel.at_origin(J2(orbit)),
}


def _not_a_flag(value: Any) -> Any:
    # To Python, true is 1.
    if isinstance(value, bool):
        raise Refusal("", 'must be 1, 2 or "inf"')
    return value


Norm = Annotated[Literal[1, 2, "inf"], BeforeValidator(_not_a_flag)]


class _Model(Table):
    max_control_m_s2: PositiveFloat
    max_speed_m_s: PositiveFloat | None = None
    control_norm: Norm = "inf"
    fuel_norm: Norm = 1


class PointMasses(_Model):
    """r̈ = u."""

    kind: Literal["double_integrator"]
    dimension: Literal[2, 3] = 2

    @property
    def axes(self) -> int:
        """Axes of space."""
        return self.dimension


class Relative(_Model):
    """Motion relative to a chief in orbit; every kind has the same keys."""

    kind: Literal["clohessy_wiltshire", "schweighart_sedwick", "eccentric", "j2"]
    relinearise: bool = True  # of j2, about each agent's own path; the others are linear anyway

    @property
    def axes(self) -> int:
        """Axes of space."""
        return 3

    def about(self, orbit: Orbit) -> LinearModel:
        """The model that all agents share, about a chief's orbit."""
        return ABOUT[self.kind](orbit)


AnyModel = Annotated[PointMasses | Relative, Field(discriminator="kind")]
