"""Where robots with cameras start, and which way they look."""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from pydantic import Field, NonNegativeFloat, PositiveFloat
from scipy.spatial.distance import pdist, squareform

from problems.interaction_graph import Camera, algebraic_connectivity, interaction_graph
from sato.connectivity.mission import component_members
from sato.former.refusal import Refusal, listed
from sato.former.units import Table
from sato.shapes.random_points import NoRoomError, sample_separated_points

DRAWINGS = 500  # of a whole swarm, before its connectivity is given up
SIX = (8.0, 8.0, 3.0)  # box for six robots; for others it grows with their number [m]


class Posted(NamedTuple):
    """Where everybody is, and looks."""

    position: Float[Array, "agents 3"]  # [m]
    yaw: Float[Array, " agents"]  # [rad]


class Scattered(Table):
    """Drawn from a box, looking anywhere, until they hang together well enough."""

    kind: Literal["random"]
    box_m: list[PositiveFloat] | None = None  # sides; without it, as much room for each as six have
    height_m: float = 3.0  # of its floor
    separation_m: PositiveFloat = 1.8
    lambda2: NonNegativeFloat = 0.05  # more than that

    def posted(self, agents: int, sight: Camera, rng: np.random.Generator) -> Posted:
        """Draw until λ₂ is large enough.

        Raises:
            Refusal: There is no room, or no such graph in many drawings.
        """
        box = np.array(self.box_m or np.array(SIX) * (agents / 6) ** (1 / 3))
        if len(box) != 3:
            raise Refusal("box_m", f"needs 3 sides, got {len(box)}")
        floor, best = np.array([0.0, 0.0, self.height_m]), 0.0
        for _ in range(DRAWINGS):
            try:
                position = sample_separated_points(
                    lambda: floor + rng.uniform(0, 1, 3) * box,
                    agents,
                    self.separation_m,
                    np.empty((0, 3)),
                    3,
                )
            except NoRoomError as full:
                raise Refusal(
                    "box_m",
                    f"a box of {_by(box)} m is full after {full.placed_count} of {agents} robots "
                    f"{self.separation_m:g} m apart; {_by(1.5 * box)}, or fewer robots, or a "
                    "smaller separation_m, would do",
                ) from full
            yaw = rng.uniform(-np.pi, np.pi, agents)
            found = float(
                algebraic_connectivity(interaction_graph(position, yaw, sight).weights).lambda2
            )
            if found > self.lambda2:
                return Posted(position, yaw)
            best = max(best, found)
        less = f"lambda2 = {best / 2:.3g}, or " if best > 0 else ""
        raise Refusal(
            "lambda2",
            f"none of {DRAWINGS} drawings in a box of {_by(box)} m comes to {self.lambda2:g}, the "
            f"best to {best:.3g}; {less}a box between separation_m = {self.separation_m:g} and "
            f"the cameras' range of {sight.d_max:g} m would do",
        )


class Placed(Table):
    """Given one by one."""

    kind: Literal["points"]
    positions_m: list[list[float]]
    yaw_rad: list[float]

    def posted(self, agents: int, sight: Camera, rng: np.random.Generator) -> Posted:
        """As they are listed.

        Raises:
            Refusal: There are more or fewer than agents, or not in space.
        """
        if len(self.positions_m) != agents or any(len(p) != 3 for p in self.positions_m):
            raise Refusal("positions_m", f"needs {agents} rows of 3 coordinates, one for each")
        if len(self.yaw_rad) != agents:
            raise Refusal("yaw_rad", f"needs {agents} angles, got {len(self.yaw_rad)}")
        return Posted(np.array(self.positions_m, dtype=float), np.array(self.yaw_rad, dtype=float))


AnyStart = Annotated[Scattered | Placed, Field(discriminator="kind")]


def check_start(posted: Posted, sight: Camera, least: float, nearest: float) -> None:
    """Robots start apart, and hang together.

    Args:
        posted: Where they start.
        sight: The cameras.
        least: λ₂^min.
        nearest: Distance at which they push each other away without limit [m].

    Raises:
        Refusal: They do not.
    """
    away = squareform(pdist(posted.position))
    np.fill_diagonal(away, np.inf)
    if away.min() <= nearest:
        i, j = sorted(int(k) for k in np.unravel_index(away.argmin(), away.shape))
        raise Refusal(
            "",
            f"robots {i} and {j} start {away.min():.4g} m apart, and repulsion.nearest_m = "
            f"{nearest:g} is where they push without limit; move one of them",
        )
    weight = interaction_graph(posted.position, posted.yaw, sight).weights
    lambda2, parts = float(algebraic_connectivity(weight).lambda2), component_members(weight)
    if len(parts) > 1:
        each = listed(("{" + ", ".join(map(str, part)) + "}" for part in parts), "and")
        raise Refusal(
            "",
            f"the swarm does not hang together, λ₂ is 0: robots {each} do not see each other; "
            f"turn or move one until it is in the view of another, {sight.d_near:g} to "
            f"{sight.d_far:g} m away",
        )
    if lambda2 <= least:
        raise Refusal(
            "",
            f"the swarm hardly hangs together, λ₂ is {lambda2:.3g}, and must be above "
            f"potential.lambda2_min = {least:g}; robots {sight.d_near:g} to {sight.d_far:g} m "
            "apart that look at each other would do",
        )


def _by(sides: Float[Array, " 3"]) -> str:
    return " × ".join(f"{side:.3g}" for side in sides)
