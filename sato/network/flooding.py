"""Flooding by one agent: it learns all reports of its component, and the diameter.

A report is a frozen value with the number of its `agent`. Each agent passes on all reports that it
knows, so that each travels one hop a round.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from dynamics.doors import checked

Reports = frozenset[Any]  # at most one of each agent


@checked
class CensusMessage(NamedTuple):
    """Message of an agent that measures its component."""

    reports: Reports  # of the agents heard of, its own included
    max_eccentricity: int = -1  # largest eccentricity heard of; −1 for none


@checked
class Census(NamedTuple):
    """Memory of an agent that measures its component: members, reports and diameter."""

    message: CensusMessage
    round: int = 0
    eccentricity: int = -1  # hops to the farthest agent; −1 while not known

    def update(self, inbox: Sequence[CensusMessage]) -> "Census":
        """Pass on the reports of all agents, and note when no new one arrives.

        After r rounds an agent has heard of exactly those within r hops. A shortest path to its
        farthest agent, e hops away, passes through every distance below e, so something new
        arrives in each of the rounds 1 … e and nothing in round e + 1: then it knows e, its
        eccentricity, and that the diameter D is at most 2 e.

        Agents learn their e at different times, and gossip the largest they know from then on.
        Agent i may stop after 2 e_i further rounds, at its round 3 e_i + 1, since agent j knows
        e_j in round e_j + 1, and i, at most e_i hops away, hears it by round e_j + 1 + e_i,
        which is at most D + 1 + e_i ≤ 3 e_i + 1. By then it has heard of all, and the largest
        is D. Since e_i ≤ D, all are through by round 3 D + 1, which every one of them can
        compute: what follows can begin there in step.
        """
        reports = self.message.reports.union(*(message.reports for message in inbox))
        eccentricity = self.eccentricity
        if eccentricity < 0 and len(reports) == len(self.message.reports):
            eccentricity = self.round
        received = [message.max_eccentricity for message in inbox]
        largest = max([self.message.max_eccentricity, eccentricity, *received])
        return Census(CensusMessage(reports, largest), self.round + 1, eccentricity)

    @property
    def knows_diameter(self) -> bool:
        """True once the largest eccentricity that it knows is the diameter."""
        return self.eccentricity >= 0 and self.round >= census_rounds(self.eccentricity)

    @property
    def is_finished(self) -> bool:
        """True once all agents of the component know the diameter; in the same round for all."""
        return self.knows_diameter and self.round >= census_rounds(self.message.max_eccentricity)


def census_rounds(diameter: Any) -> Any:
    """Return the rounds in which agents learn their component: of a number, or of each agent's."""
    return 3 * diameter + 1


@checked
class Flood(NamedTuple):
    """Memory of an agent that hears one report of every agent of its component.

    Reports tell the `round` in which they were made.
    """

    member_count: int
    diameter: int
    message: Reports = frozenset()
    round: int = 0

    def update(self, inbox: Sequence[Reports]) -> "Flood":
        """Pass on all reports."""
        return self._replace(message=self.message.union(*inbox), round=self.round + 1)

    @property
    def is_finished(self) -> bool:
        """True once all agents know all reports; in the same round for all."""
        is_complete = len(self.message) == self.member_count
        return is_complete and self.round >= self.diameter + max(r.round for r in self.message)
