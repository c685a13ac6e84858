"""Encoding of messages: the bytes of what a sender has not told before.

An agent tells all of its neighbors the same, and only what has changed since its last message of
the same purpose in the same decision; where nothing has, it is silent. A message has a header of
16 bytes, with the sender, the instant, the stage and the round. Numbers of agents and targets,
counts, steps and rounds take 2 bytes, flags 1, real numbers 8.

    content          bytes
    census           2 for the largest eccentricity; 4 for each new `Hello`, and once for all that
                     have the rest in common 16
    AuctionTerms     12 and the state; at first, once for all that have them in common, 4 for each
                     step in which targets were claimed, 4 for each claim and 2 for each blocked
                     target
    bids             12 for each price that has changed
    AuctionReport    7
    bending          2 for the last change; at first 17, the target and the trajectory; then 4, and
                     a point for each piece between the first and the last that have moved
    meeting          the trajectory, if it has changed
    exchange         1; at first 16 for the priority, and where there was no meeting 8 and the
                     trajectory; the trajectory, if it has changed
    ExchangeReport   4
    holding          8 and the trajectory
    choice           3; and where it is another the controls that are not those of the plan
    ChoiceReport     5, and 16 for the priority of a cautious agent
    turns            the controls, if they have changed
    EvasionReport    26, the trajectory, 2 for each look, and for each obstacle in it 2, its
                     place, velocity, radius and corners

A trajectory is told by its first state and the controls of all steps, a way around obstacles by a
point of each piece as well. Points that have moved by less than 10⁻⁹ of the distance that two keep
have not changed.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

UNMOVED = 1e-9  # of the distance that two keep: what has moved by less is not told again
HEADER = 16
REAL, INDEX, FLAG = 8, 2, 1
HELLO = INDEX + 2 * FLAG  # agent, flags, and with which others it has the rest in common
COMMON_HELLO = 16  # instant and checksum of the leg, clock, step of the last claim and checksum
CLAIM = 2 * INDEX
ECCENTRICITY = INDEX
TERMS = 2 * INDEX + REAL
BID = 2 * INDEX + REAL
AUCTION_REPORT = 3 * INDEX + FLAG
LAST_CHANGE = INDEX
FIRST_PATH = 2 * REAL + FLAG  # class of priority, clearance, and whether it is delayed
PRIORITY = 2 * REAL  # without the number of the agent
CLEARANCE = REAL
EXCHANGE_REPORT = 2 * INDEX
CHOICE = INDEX + FLAG  # choice and last change
CHOICE_REPORT = 2 * INDEX + FLAG
EVASION_REPORT = INDEX + PRIORITY + CLEARANCE


def measure_claims(steps: Sequence[int], blocked: int) -> int:
    """Return the bytes of claims of these steps, and of blocked targets."""
    return 2 * INDEX * len(set(steps)) + CLAIM * len(steps) + INDEX * blocked


def has_moved(before: Array, after: Array, clearance: float) -> Bool[Array, "..."]:
    """Tell which coordinates have moved by more than rounding of the distance that two keep."""
    return np.asarray(np.abs(after - before) > UNMOVED * clearance)


def measure_shift(
    before: Float[Array, "pieces d"], after: Float[Array, "pieces d"], clearance: float
) -> int:
    """Return the bytes that tell how a path was pushed aside; 0 where it was not."""
    (moved,) = np.nonzero(has_moved(before, after, clearance).any(axis=1))
    if not len(moved):
        return 0
    return 2 * INDEX + REAL * int(before.shape[1] * (moved[-1] - moved[0] + 1))
