"""Purposes of the messages of a decision."""

from typing import Any

from sato.network.flooding import CensusMessage
from sato.reconfiguration.agent_stages import (
    AuctionTerms,
    BiddingMessage,
    ExchangeMessage,
)
from sato.reconfiguration.halfway_stages import BendingMessage
from sato.scp.planner import TrajectoryMessage

OF_AUCTION = AuctionTerms, BiddingMessage
OF_TRAJECTORIES = BendingMessage, TrajectoryMessage, ExchangeMessage


def purpose_of(content: Any) -> str:
    """Return the purpose of a message, one of `network.load.PURPOSES`, from its content."""
    kind = next(iter(content)) if isinstance(content, frozenset) else content
    if isinstance(kind, CensusMessage):
        return "census"
    if isinstance(kind, OF_AUCTION):
        return "auction"
    return "trajectories" if isinstance(kind, OF_TRAJECTORIES) else "commitment"
