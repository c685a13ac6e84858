"""What it costs vehicles to tell each other where they are and what they bid, in bits.

A load counts the payload that a vehicle receives: no headers, no contention. On a graph of
neighbours it sends as much. The figures of [Lusk2020, sec. V-B] come out so:

- 5.2 kbit/s a neighbour for positions; 0.064 n d (n + 1) kbit a neighbour and auction.
- 6 vehicles on their sparse graphs, of diameter 2, with an auction every 1.2 s: 9.7 kbit/s a
  neighbour; the paper says "approximately 9".
- 30 vehicles, 13.5 edges short of complete on average (28.1 neighbours, diameter 2), with an
  auction every 2 s: 1.8 Mbit/s a vehicle. The paper measured 2.16; its messages had headers.
- At most 800 vehicles on "mid-grade WiFi" with an auction every 30 s: the paper states neither
  capacity, degree nor diameter. Each neighbour and each hop of diameter then cost a vehicle
  1.37 Mbit/s. So 800 comes out of the nominal 54 Mbit/s of 802.11g where degree × diameter is 39,
  as with 13 neighbours and diameter 3. These 54 Mbit/s are each vehicle's own: were it one channel
  for all, it would have to carry 3.3 Gbit/s, each message sent once and heard by all neighbours.
  And 8 bits do not tell 800 vehicles apart.
"""

from dataclasses import dataclass
from math import ceil, isqrt

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

WORD_BITS = 32  # bits of a coordinate, a price, a holder, the id of an auction and of a round


@dataclass(frozen=True)
class Radio:
    """How messages between neighbours travel. One message goes out in every period 1 / rate."""

    message_rate: float = 50.0  # messages of each kind [1/s]
    loss_probability: float = 0.0  # probability that a message is lost
    delay: float = 0.0  # by which a message comes late [s]
    id_bits: int = 8  # bits of a vehicle's number

    def __post_init__(self) -> None:
        if not (
            self.message_rate > 0
            and 0 <= self.loss_probability < 1
            and self.delay >= 0
            and self.id_bits > 0
        ):
            raise ValueError(
                f"{self}: the rate and the bits of a number must be positive, the loss in [0, 1), "
                "and the delay no less than 0 s"
            )

    @property
    def max_vehicles(self) -> int:
        """Number of vehicles that their numbers tell apart."""
        return 1 << self.id_bits

    @property
    def delay_rounds(self) -> int:
        """Whole rounds of an auction by which a message comes late."""
        return ceil(self.delay * self.message_rate - 1e-9)  # 0.14 · 50 is 7.000000000000001

    def rounds_within(self, time: float) -> int:
        """Whole rounds of an auction in that time [s]."""
        return int(time * self.message_rate + 1e-9)

    @property
    def localization_rate(self) -> float:
        """Bits a second to tell a neighbour where one is: three coordinates and a number."""
        return (3 * WORD_BITS + self.id_bits) * self.message_rate

    def count_auction_bits(self, vehicles: int, rounds: int) -> int:
        """Bits that an auction costs a neighbour.

        A book is the auction, the round, and the price and the holder of each point.

        Args:
            vehicles: As many as points.
            rounds: Played. Without a way to know the end: vehicles × diameter.
        """
        return 2 * WORD_BITS * (vehicles + 1) * rounds

    def compute_load(
        self, degree: Int[Array, " vehicles"], rounds: int, period: float
    ) -> Float[Array, " vehicles"]:
        """Bits a second that each vehicle receives.

        Args:
            degree: Neighbours of each vehicle.
            rounds: Of an auction.
            period: From one auction to the next [s].
        """
        if not period > 0:
            raise ValueError(f"there must be time between auctions, got {period} s")
        neighbour = self.localization_rate + self.count_auction_bits(len(degree), rounds) / period
        return np.asarray(degree * neighbour, dtype=np.float64)

    def max_swarm_size(self, capacity: float, degree: int, diameter: int, period: float) -> int:
        """Most vehicles with no more load than that, in auctions of vehicles × diameter rounds.

        Args:
            capacity: What a vehicle can receive [bit/s].
            degree: Neighbours of each vehicle.
            diameter: Of the network; so many hops and neighbours must admit the swarm.
            period: From one auction to the next [s].
        """
        if not (degree > 0 and diameter > 0 and period > 0):
            raise ValueError(
                f"{degree} neighbours, a diameter of {diameter}, {period} s between auctions: "
                "all must be positive"
            )
        spare = (capacity / degree - self.localization_rate) * period  # bits for an auction
        # Largest n with 2 · WORD · diameter · n (n + 1) ≤ spare.
        most = max(0, int(spare / (2 * WORD_BITS * diameter)))
        return min(self.max_vehicles, (isqrt(4 * most + 1) - 1) // 2)
