"""Legs of a reconfiguration: targets, time, and agents that are lost or join on the way."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Lt
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.callbacks import freeze
from dynamics.units import Key
from sato.reconfiguration.start import Start
from sato.scenario.definition import (
    LATER,
    Amount,
    Axes,
    Convert,
    Count,
    Definition,
    NotNegative,
    Positive,
    is_auto,
)
from sato.scenario.errors import InputError
from sato.shapes import Lattice, Picture, Points, Polygon, Ring, Text
from sato.shapes.shape import as_points

MAX_LEG_FACTOR = 20  # times its steps after which a leg is given up


def longest_leg(steps: int, lag_steps: int) -> int:
    """Return the steps after which a leg is given up.

    All give up at a multiple of the steps until a decision is flown, if these are not 0.
    """
    most = MAX_LEG_FACTOR * steps
    return most + -most % lag_steps if lag_steps else most


if TYPE_CHECKING:
    Duration = int  # once the mission is drawn
else:
    Duration = Amount | Literal["auto"]
Indices = tuple[Count, ...]
Targets = Points | Text | Ring | Lattice | Polygon | Picture


@dataclass(frozen=True, eq=False, repr=False)
class Loss(Definition):
    """Agents that fall silent, and vanish or fly on without control."""

    kind: Annotated[
        Literal["middle", "random", "agents"], "nearest the center, drawn, or named one by one"
    ]
    share: Annotated[float | None, Positive, Lt(1), "share of the live agents"] = None
    agents: Annotated[Indices, "indices, for kind agents"] = ()
    at_step: Annotated[Count, "control steps after the start of the leg"] = 0
    body: Annotated[
        Literal["vanish", "coast"], "a lost agent is gone, or flies on without control"
    ] = "vanish"

    def check(self) -> None:
        """Refuse a loss of no agents, and one of agents that are named and drawn."""
        needed, other = ("agents", "share") if self.kind == "agents" else ("share", "agents")
        if not getattr(self, needed):
            raise InputError(needed, "is missing, and has no default")
        if getattr(self, other):
            reason = f'has no effect with kind = "{self.kind}"'
            raise InputError(other, f"{reason}; leave it out, or {needed} and choose another kind")


@dataclass(frozen=True, eq=False, repr=False)
class Join(Definition):
    """Agents that join the swarm."""

    agents: Annotated[int | None, Positive, "how many; as many as the start lists, if absent"] = (
        LATER
    )
    start: Annotated[Start, Convert(as_points), "positions, or states, at which they join"] = LATER
    at_step: Annotated[Count, "control steps after the start of the leg"] = 0
    room: Annotated[
        Literal["wait", "refuse"], "without room, join as soon as there is some, or not at all"
    ] = "wait"

    def completed(self) -> dict[str, Any]:
        """Return how many agents the start lists, where it is not given."""
        if self.agents is None and isinstance(self.start, Points):
            return {"agents": len(self.start.listed)}
        return {}

    def check(self) -> None:
        """Refuse a missing start, and an unknown number of agents."""
        for key in ("start", "agents"):
            if getattr(self, key) is None:
                raise InputError(key, "is missing, and has no default")

    @property
    def size(self) -> int:
        """Number of agents that join."""
        assert self.agents is not None
        return self.agents


@dataclass(frozen=True, eq=False, repr=False)
class Leg(Definition):
    """One reconfiguration: targets, and the time to reach them.

    Args:
        shape: A shape, or an array of targets: (M, d) positions or (M, 2 d) states.
        steps: Control steps until the deadline, or "auto": `time_factor` times the least in which
            each agent can arrive without regard to others.
        count: Number of targets M of the shape; as many as the agents may be, if absent.
        recount: Take the number of targets from the bids of the leg before
            [Morgan2016, Method 1, line 31].
        losses: Agents that are lost in this leg.
        joins: Agents that join in this leg.
        choose: Targets that the auction assigns: the first m, or "nearest", any of all M.
            "nearest" by default for a list of points without `keep_order`.
        time_factor: Steps over the least, where they are automatic; 1.5 by default.
    """

    shape: Annotated[Targets, Convert(as_points), "targets"]
    steps: Annotated[
        Duration,
        "control steps until the deadline; auto: time_factor times the least, and past all events",
    ]
    count: Annotated[int | None, Key("targets"), Positive, "number of targets, M"] = None
    recount: Annotated[bool, "count the agents by the bids of the leg before"] = False
    losses: Annotated[tuple[Loss, ...], Key("lose"), "agents that are lost"] = ()
    joins: Annotated[tuple[Join, ...], Key("join"), "agents that join"] = ()
    choose: Annotated[
        Literal["prefix", "nearest"] | None,
        "bid on the first m targets, or on all M; nearest for a list without keep_order, if absent",
    ] = LATER
    time_factor: Annotated[
        float | None, Ge(1), "with steps auto: ratio of steps to the least; 1.5 if absent"
    ] = None

    def check(self) -> None:
        """Refuse contradictions in the choice of targets; losses and joins after the deadline."""
        if self.is_free and getattr(self.shape, "keep_order", False):
            reason = 'has no meaning with choose = "nearest", where the order is that of the list'
            raise InputError("shape.keep_order", f"{reason}; leave one of the two out")
        if self.is_free and self.recount:
            reason = 'has no meaning with choose = "nearest", where agents bid on all targets'
            raise InputError("recount", f'{reason}; leave it out, or choose = "prefix" would do')
        if self.time_factor is not None and not is_auto(self.steps):
            reason = f"{self.time_factor:g} has no effect beside steps = {self.steps}"
            raise InputError("time_factor", f'{reason}; leave it out, or steps = "auto" would do')
        for name, events in (("lose", self.losses), ("join", self.joins)):
            late = max((event.at_step for event in events), default=0)
            if not is_auto(self.steps) and late >= self.steps:
                most = f"the leg's {self.steps} steps; at most {self.steps - 1} would do"
                raise InputError(f"{name}.at_step", f"{late} is after {most}")

    @property
    def is_free(self) -> bool:
        """True where agents bid on all targets, and not on the first m."""
        is_list = isinstance(self.shape, Points) and not self.shape.keep_order
        return self.choose == "nearest" if self.choose else is_list

    @cached_property
    def targets(self) -> Float[Array, "targets n"]:
        """States to reach, in SI units, in an array that cannot be written to; known once drawn.

        Unless the choice is free, every prefix keeps the shape.
        """
        return freeze(states_of(self.shape))

    def place(
        self, demand: Amount, axes: Axes, min_distance: Annotated[float, NotNegative] = 0.0
    ) -> Points:
        """Return the targets as points in their order.

        Args:
            demand: Number of targets of a shape without a count.
            axes: Dimension of space.
            min_distance: Least distance of two targets [m].

        Raises:
            InputError: The shape does not fit the count, the distance or the model.
        """
        shape, count = self.shape, self.count or demand
        if self.is_free and isinstance(shape, Points):
            shape = replace(shape, keep_order=True)
            count = self.count or max(len(shape.listed), demand)
        placed = shape.place(count, axes, min_distance)
        return Points(placed, shape.place_velocities(count, axes), keep_order=not self.is_free)


def states_of(points: Any) -> Float[Array, "k n"]:
    """Return drawn points as states, at rest where no velocities are given."""
    if not isinstance(points, Points) or points.positions is None:
        kind = type(points).__name__
        raise ValueError(f"{kind} has positions once the mission is drawn: mission.draw(rng)")
    still = np.zeros_like(points.positions)
    return np.hstack([points.positions, still if points.velocities is None else points.velocities])
