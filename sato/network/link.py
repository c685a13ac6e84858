"""Radio link between two agents: losses, delays, outages, and the time that a round takes."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import Annotated

import numpy as np
from annotated_types import Lt
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.units import Time
from sato.scenario.definition import Definition, Key, NotNegative, Positive, errors_in, fields_of
from sato.scenario.errors import InputError

UNHEARD_PROBABILITY = 1e-9  # that all repetitions of a message are lost
MANY_ROUNDS = 1e18  # more than any time has, and an integer
MOST_ROUNDS = 20_000  # of repetitions, beyond which no link is of use


@dataclass(frozen=True, eq=False, repr=False)
class Link(Definition):
    """Link between two agents within hearing; without loss and instant by default.

    Time is counted in rounds: in each, every agent sends one message, which its neighbors have in
    the next round, or as many rounds later as it is late.
    """

    period_steps: Annotated[int, Key("every"), Positive, "control steps between two messages"] = 1
    late: Annotated[int, NotNegative, "rounds by which a message comes late, at most"] = 0
    loss_probability: Annotated[
        float, Key("loss"), NotNegative, Lt(1), "probability that a message is lost"
    ] = 0.0
    outage: Annotated[Time, NotNegative, "longest outage of a link"] = 0.0
    outage_share: Annotated[
        float, NotNegative, Lt(1), "share of the time in which a link is down"
    ] = 0.0
    skew: Annotated[Time, NotNegative, "largest difference between two clocks"] = 0.0
    round: Annotated[Time, NotNegative, "time that a round of messages takes"] = 0.0

    def over(self, round: float) -> "Link":
        """Return the link where a round takes so long [s]."""
        with errors_in("link"):
            return replace(self, round=round)

    def require_none(self, **reasons: str) -> None:
        """Refuse what has no meaning in a system, by the names of fields."""
        for field in fields_of(Link):
            if field.name in reasons and getattr(self, field.name) != field.default:
                raise InputError(f"link.{field.key}", f"{reasons[field.name]}; leave it out")

    def check(self) -> None:
        """Refuse outages without a length, or without time between two of them."""
        if (self.outage > 0) != (self.outage_share > 0):
            keys = "outage_s", "outage_share"
            lacks, has = keys[::-1] if self.outage else keys
            raise InputError(lacks, f"is 0, and {has} is not: give both, or neither")
        if self.outage > 0 and self.round > 0 and self.mean_up_rounds < 1 - 1e-9:
            mean, share = (self.outage_rounds + 1) / 2, self.outage_share
            least = ceil(2 * share / (1 - share) - 1 - 1e-9) * self.round
            outages = f"outages of {mean:g} rounds"
            reason = f"{share:g} with {outages} leaves less than a round between two"
            cure = f"at most {mean / (mean + 1):.3g}, or outage_s = {least:.3g} would do"
            raise InputError("outage_share", f"{reason}; {cure}")

    @property
    def is_ideal(self) -> bool:
        """True where every message arrives at once."""
        return not any((self.late, self.loss_probability, self.outage, self.skew, self.round))

    @property
    def loses_messages(self) -> bool:
        """True where some messages never arrive."""
        return self.loss_probability > 0 or self.outage > 0

    @property
    def outage_rounds(self) -> int:
        """Rounds of the longest outage; 0 where rounds take no time."""
        return ceil(self.outage / self.round - 1e-9) if self.outage and self.round else 0

    @property
    def mean_up_rounds(self) -> float:
        """Mean number of rounds between two outages."""
        down = (self.outage_rounds + 1) / 2
        return down * (1 - self.outage_share) / self.outage_share

    def count_rounds(self, time: float | Float[Array, " k"]) -> Int[Array, "*k"]:
        """Return how many whole rounds there are in a time, or several [s]."""
        rounds = np.floor(np.asarray(time) / self.round + 1e-9)
        return np.asarray(np.minimum(rounds, MANY_ROUNDS), dtype=int)

    @cached_property
    def silent_rounds(self) -> int:
        """Rounds within which an agent within hearing is heard, but for one case in 10⁹.

        Outages begin and end meanwhile as those of a `Channel`.
        """
        most, share, rounds = self.outage_rounds, self.outage_share, 0
        if most >= MOST_ROUNDS:
            return most + 1 + self.late
        # Probabilities that nothing was heard, and that the link is up, or down for 1, 2 … rounds.
        ages = np.arange(most, 0, -1.0)
        up, down = 1 - share, share * ages / max(1.0, ages.sum())
        begins = 1 / self.mean_up_rounds if most else 0.0
        while up + down.sum() > UNHEARD_PROBABILITY and rounds < MOST_ROUNDS:
            up, rounds = up * self.loss_probability, rounds + 1
            if most:
                later = np.append(down[1:], 0.0) + up * begins / most
                up, down = up * (1 - begins) + down[0], later
        return rounds + self.late

    @property
    def discovery_rounds(self) -> int:
        """Rounds in which an agent hears all others within hearing, whose clocks may be behind."""
        behind = ceil(self.skew / self.round - 1e-9) if self.round else 0
        return self.silent_rounds + behind
