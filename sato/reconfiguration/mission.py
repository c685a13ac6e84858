"""What a swarm is asked to do: a frozen value, complete at construction. SI units."""

from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.model import LinearModel, NonlinearModel
from dynamics.plant import LinearPlant, Plant
from dynamics.trajectory_geometry import min_distance

Norm = Literal[1, 2, "inf"]


@dataclass(frozen=True)
class Loss:
    """Agents that fall silent and vanish."""

    kind: Literal["middle", "random", "agents"]  # nearest the centre, drawn, or named
    share: float = 0.0  # of the live agents, for "middle" and "random"
    agents: tuple[int, ...] = ()  # for "agents"
    at_step: int = 0  # control steps after the start of the leg; 0 is before it


@dataclass(frozen=True)
class Join:
    """Agents that come in: rows of `Reconfiguration.start` that were not alive before."""

    agents: tuple[int, ...]
    at_step: int = 0


@dataclass(frozen=True, eq=False)
class Leg:
    """One reconfiguration: a shape to take up and the time to do it in."""

    targets: Float[Array, "targets n"]  # states, ordered so that every prefix keeps the shape
    steps: int
    losses: tuple[Loss, ...] = ()
    joins: tuple[Join, ...] = ()
    recount: bool = False  # m from the bids of the leg before [Morgan2016, Method 1, line 31]


@dataclass(frozen=True, eq=False)
class Reconfiguration:
    """A swarm that takes up one shape after another [Morgan2016, Method 3]."""

    linear_model: LinearModel  # shared by all agents: what auctions price by
    initial_states: Float[Array, "agents n"]  # states; a joining agent's is where it comes in
    alive: Bool[Array, " agents"]  # who is there at the start
    legs: tuple[Leg, ...]
    step: float  # Δt [s]
    comm_radius: float  # [m]
    collision_radius: float  # [m]
    max_control: float  # [m/s²], in the control norm
    max_speed: float = inf  # [m/s]
    fuel_norm: Norm = 1
    control_norm: Norm = "inf"
    horizon_steps: int = 4  # avoidance looks this far
    foresight_steps: int = 0  # and this far among agents in earshot, if that is further
    orders: int = 1  # of priority that each plan tries
    bargains: int = 0  # sweeps in which those who are in each other's way then plan in pairs
    replan_steps: int = 4
    auction_steps: int = 4
    target_count: int = 0  # m of every agent before the first leg; 0 means as many as are alive
    cost: Literal["fuel", "distance"] = "fuel"  # what the auction minimises, before the tie-break
    tie_break: float = 0.2  # w; 0 is the printed method
    epsilon: float | None = None  # bid increment on the scale of the cost; None is ½ w s²
    bidder_ids: bool = True  # false is the printed method
    reset: Literal["change", "need"] = "change"  # of a clock: where the number of bids changed, or
    # only where somebody cannot make it in the time that is left
    freeze_steps: int = 0  # from which on, before the end, an agent keeps to its plan
    margin: float = 0.0  # beyond the collision radius that plans keep: for what models miss [m]
    nonlinear_model: NonlinearModel | None = (
        None  # re-linearised by each agent about its own nominal
    )
    plant: Plant | None = None  # what flies; None is the shared model itself
    disturbance: float = 0.0  # standard deviation of an acceleration held over a step [m/s²]
    position_noise: float = 0.0  # of what an agent believes of its state [m]
    velocity_noise: float = 0.0  # [m/s]
    thrust_error: float = 0.0  # standard deviation of a thrust's size, relative
    pointing_error: float = 0.0  # standard deviation of a thrust's direction [rad]
    position_tolerance: float = 1e-6  # within which a target counts as reached [m]
    velocity_tolerance: float = 1e-6  # [m/s]

    def __post_init__(self) -> None:
        """Refuse what no flight could mean."""
        if not self.legs or any(leg.steps < 1 for leg in self.legs):
            raise ValueError("a mission needs at least one leg, and each leg at least one step")
        if (
            self.alive.shape != self.initial_states.shape[:1]
            or not np.isfinite(self.initial_states).all()
        ):
            raise ValueError("every agent needs a finite start and a word on whether it is there")
        if not (self.step > 0 and self.comm_radius > 0 and self.collision_radius > 0):
            raise ValueError(
                "the step, the communication and the collision radius must be positive"
            )
        if min(self.horizon_steps, self.replan_steps, self.auction_steps) < 1:
            raise ValueError("the horizon and the periods must be at least one step long")
        if self.orders < 1:
            raise ValueError(f"a plan needs at least one order of priority, got {self.orders}")
        if self.bargains < 0 or (self.bargains and self.orders == 1):
            raise ValueError(
                f"bargains = {self.bargains} with orders = {self.orders}: sweeps cannot be fewer "
                "than none, and only with orders of 2 or more is what was agreed on a candidate "
                "at the next plan"
            )
        if self.replan_steps > self.horizon_steps or self.auction_steps > self.horizon_steps:
            raise ValueError(
                f"replan_steps = {self.replan_steps} and auction_steps = {self.auction_steps} must "
                f"not exceed horizon_steps = {self.horizon_steps}: agents that claim one target "
                "must bid against each other before they can meet"
            )
        if self.margin < 0 or self.freeze_steps < 0:
            raise ValueError("a margin and the steps at the end cannot be negative")
        if self.auction_steps % self.replan_steps:
            raise ValueError(
                f"auction_steps = {self.auction_steps} must be a multiple of "
                f"replan_steps = {self.replan_steps}: an auction is followed by a plan"
            )

    @cached_property
    def flown_plant(self) -> Plant:
        """What the vehicles really do."""
        return self.plant or LinearPlant(self.linear_model)

    @property
    def target_spacing(self) -> float:
        """Least distance between two targets of a leg [m]."""
        d = self.linear_model.axes
        return min(min_distance(leg.targets[:, :d]) for leg in self.legs)
