"""Load of a radio link: bits that positions and auctions take.

Payload alone is counted: no headers, no contention. A vehicle receives `localization_rate` and
the bits of its auctions from each neighbor, and sends as much. The figures of [Lusk2020,
sec. V-B] follow:

- 5.2 kbit/s a neighbor for positions; 0.064 n d (n + 1) kbit a neighbor and auction.
- 6 vehicles on their sparse graphs, of diameter 2, with an auction every 1.2 s: 5.20 kbit/s of
  positions and 4.48 of auctions from a neighbor, 9.68 together; the paper says "approximately 9".
- 30 vehicles, 13.5 edges short of complete on average (28.1 neighbors, diameter 2), with an
  auction every 2 s: 1,819 kbit/s a vehicle. The paper measured 2,161. The messages of its code have
  a ROS header, 16 bytes where the frame has no name, and each list of a bid 4 bytes of length:
  6.4 kbit/s more from each neighbor for positions and 5.76 for bids, 2,160 in all.
- At most 800 vehicles on "mid-grade WiFi" with an auction every 30 s: the paper states neither
  capacity, degree nor diameter. Each neighbor and each hop of diameter then cost a vehicle
  1.37 Mbit/s. So 800 comes out of the nominal 54 Mbit/s of 802.11g where degree × diameter is 39,
  as with 13 neighbors and diameter 3. These 54 Mbit/s are each vehicle's own: one channel for all
  would have to carry 3.3 Gbit/s, each message sent once and heard by all neighbors. And 8 bits
  cannot number 800 vehicles.
"""

from dataclasses import dataclass
from math import ceil
from typing import Annotated

from annotated_types import Lt

from dynamics.units import Time, Unit
from sato.scenario.definition import Count, Definition, Key, NotNegative, Positive

WORD_BITS = 32  # bits of a coordinate, a price, a winner, the number of an auction and of a round


@dataclass(frozen=True, eq=False, repr=False)
class Radio(Definition):
    """Radio by which messages between neighbors travel, one in every period 1 / rate."""

    message_rate: Annotated[
        float, Unit("hz"), Key("rate"), Positive, "messages of each kind a second"
    ] = 50.0
    loss_probability: Annotated[
        float, Key("loss"), NotNegative, Lt(1), "probability that a message is lost"
    ] = 0.0
    delay: Annotated[Time, NotNegative, "delay of a message"] = 0.0
    id_bits: Annotated[int, Positive, "bits of a vehicle's number"] = 8

    @property
    def delay_rounds(self) -> int:
        """Delay of a message in rounds of an auction, rounded up."""
        return ceil(self.delay * self.message_rate - 1e-9)  # 0.14 · 50 is 7.000000000000001

    def rounds_within(self, time: Annotated[float, NotNegative]) -> int:
        """Count the whole rounds of an auction in a time [s]."""
        return int(time * self.message_rate + 1e-9)

    @property
    def localization_rate(self) -> float:
        """Rate of the position of a neighbor: three coordinates and a number [bit/s]."""
        return (3 * WORD_BITS + self.id_bits) * self.message_rate

    def count_auction_bits(self, vehicles: Count, rounds: Count) -> int:
        """Count the bits that an auction takes from one neighbor.

        A message holds the numbers of the auction and of the round, and the price and the winner
        of each point. Rounds are vehicles × diameter where none can know the end.
        """
        return 2 * WORD_BITS * (vehicles + 1) * rounds
