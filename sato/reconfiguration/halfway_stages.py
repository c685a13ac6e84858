"""Stages in which agents meet halfway, as one agent sees them."""

from collections.abc import Sequence
from typing import NamedTuple

from sato.scp.bending import PathMessage, bend, path_message
from sato.scp.halfway import MAX_BENDS, MEETINGS, solve_halfway
from sato.scp.planner import Planner, TrajectoryMessage
from sato.scp.spreading import spread_out


class BendingMessage(NamedTuple):
    """Message of an agent while paths push each other aside."""

    path: PathMessage
    last_change: int  # last round in which a path is known to have moved


class Bending(NamedTuple):
    """Memory of an agent while paths spread, in the first round, and push each other aside."""

    planner: Planner
    diameter: int
    round: int = 0
    last_change: int = 1  # paths spread in the first round

    @property
    def message(self) -> BendingMessage:
        """Message to the neighbors."""
        return BendingMessage(path_message(self.planner), self.last_change)

    @property
    def is_finished(self) -> bool:
        """True once all agents know that no path moves; in the same round for all."""
        return self.round > self.last_change + self.diameter

    def update(self, inbox: Sequence[BendingMessage]) -> "Bending":
        """Spread the path, or push it away from those that it is too near to."""
        round, last_change = self.round + 1, self.last_change
        last_change = max([last_change, *(message.last_change for message in inbox)])
        planner = self.planner
        if round <= 1 + MAX_BENDS:
            update = spread_out if round == 1 else bend
            planner = update(planner, [message.path for message in inbox])
        if planner is not self.planner:
            last_change = round
        return self._replace(planner=planner, round=round, last_change=last_change)


class Meeting(NamedTuple):
    """Memory of an agent while all solve for trajectories halfway to each other."""

    planner: Planner
    round: int = 0

    @property
    def message(self) -> TrajectoryMessage:
        """Message to the neighbors."""
        return self.planner.message

    @property
    def is_finished(self) -> bool:
        """True after as many rounds for all."""
        return self.round == MEETINGS

    def update(self, inbox: Sequence[TrajectoryMessage]) -> "Meeting":
        """Solve for a trajectory on the agent's side of the others."""
        return self._replace(planner=solve_halfway(self.planner, inbox), round=self.round + 1)
