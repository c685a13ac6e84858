"""Purposes and sizes of messages, measured from their contents: a second opinion on loads."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from sato.network import encoding
from sato.network.encoding import REAL
from sato.network.flooding import CensusMessage, Reports
from sato.reconfiguration import evasion
from sato.reconfiguration.agent_stages import (
    AuctionReport,
    AuctionTerms,
    BiddingMessage,
    ChoiceReport,
    CommittedMessage,
    ExchangeMessage,
    ExchangeReport,
    OfferMessage,
)
from sato.reconfiguration.halfway_stages import BendingMessage
from sato.scp.planner import TrajectoryMessage

OF_AUCTION = AuctionTerms, BiddingMessage
OF_TRAJECTORIES = BendingMessage, TrajectoryMessage, ExchangeMessage
NOTHING: Reports = frozenset()


def purpose_of(content: Any) -> str:
    """Return the purpose of a message, one of `network.load.PURPOSES`, from its content."""
    kind = next(iter(content)) if isinstance(content, frozenset) else content
    if isinstance(kind, CensusMessage):
        return "census"
    if isinstance(kind, OF_AUCTION):
        return "auction"
    return "trajectories" if isinstance(kind, OF_TRAJECTORIES) else "commitment"


def measure(previous: Any, now: Any) -> int:
    """Return the bytes of a message without its header; 0 where it says nothing new.

    The previous content is that of the last message of the same sender, purpose and decision,
    which it may not have sent either; None before the first.
    """
    if isinstance(now, frozenset):
        told = previous if isinstance(previous, frozenset) else NOTHING
        return _measure_reports(now - told) + _measure_claims(told, now)
    if isinstance(now, CensusMessage):
        return _measure_census(previous or CensusMessage(NOTHING), now)
    if isinstance(now, BiddingMessage):
        # All know with which prices an auction opens, which is what the first message says.
        is_first = not isinstance(previous, BiddingMessage)
        return _measure_bids(now._replace(reports=NOTHING) if is_first else previous, now)
    if isinstance(now, BendingMessage):
        return _measure_bending(previous, now)
    if isinstance(now, TrajectoryMessage):
        is_told = isinstance(previous, BendingMessage) or _is_same_path(previous, now)
        return 0 if is_told else REAL * now.number_count
    if isinstance(now, ExchangeMessage):
        return _measure_exchange(previous, now)
    if isinstance(now, OfferMessage):
        return _measure_offer(previous, now)
    return _measure_committed(previous, now)


def _measure_reports(reports: Iterable[Any]) -> int:
    return sum(measure_report(report) for report in reports)


def _measure_claims(told: Iterable[Any], now: Iterable[Any]) -> int:
    known, parts = (
        {(terms.claims, terms.blocked) for terms in some if isinstance(terms, AuctionTerms)}
        for some in (told, now)
    )
    return sum(
        encoding.measure_claims([step for _, step, _ in claims], len(blocked))
        for claims, blocked in parts - known
    )


def measure_report(report: Any) -> int:
    """Return the bytes of a report other than `Hello`."""
    if isinstance(report, AuctionTerms):
        return encoding.TERMS + encoding.REAL * len(report.state)
    if isinstance(report, AuctionReport):
        return encoding.AUCTION_REPORT
    if isinstance(report, ExchangeReport):
        return encoding.EXCHANGE_REPORT
    if isinstance(report, ChoiceReport):
        return encoding.CHOICE_REPORT + (encoding.PRIORITY if report.priority else 0)
    return evasion.measure_report(report)


def _measure_census(previous: CensusMessage, now: CensusMessage) -> int:
    new = now.reports - previous.reports
    if not new and now.max_eccentricity == previous.max_eccentricity:
        return 0
    told, parts = (
        {(hello.leg, hello.clock, hello.claim_step, hello.together) for hello in some}
        for some in (previous.reports, new)
    )
    size = encoding.ECCENTRICITY + encoding.HELLO * len(new)
    return size + encoding.COMMON_HELLO * len(parts - told)


def _measure_bids(previous: BiddingMessage, now: BiddingMessage) -> int:
    is_new = [a != b for a, b in zip(previous.bids, now.bids, strict=True)]
    size = encoding.BID * int(np.logical_or(*is_new).sum())
    return size + _measure_reports(now.reports - previous.reports)


def _measure_bending(previous: BendingMessage | None, now: BendingMessage) -> int:
    path = now.path
    if previous is None:
        first = encoding.LAST_CHANGE + encoding.FIRST_PATH
        return first + REAL * (path.target.size + path.number_count)
    shift = encoding.measure_shift(previous.path.path, path.path, path.clearance)
    return encoding.LAST_CHANGE + shift if shift or now.last_change > previous.last_change else 0


def _is_same_path(previous: TrajectoryMessage, now: TrajectoryMessage) -> bool:
    paths = previous.control_points, now.control_points
    return not encoding.has_moved(*paths, now.clearance).any()


def _measure_exchange(previous: Any, now: ExchangeMessage) -> int:
    trajectory, reports, size = now.trajectory, now.reports, encoding.FLAG
    if previous is None:
        size += encoding.PRIORITY + encoding.CLEARANCE + REAL * trajectory.number_count
        return size + _measure_reports(reports)
    if isinstance(previous, TrajectoryMessage):
        size, told, is_new = size + encoding.PRIORITY, previous, True
    else:
        told, reports = previous.trajectory, reports - previous.reports
        is_new = told.is_final != trajectory.is_final or bool(reports)
    if not _is_same_path(told, trajectory):
        size, is_new = size + REAL * trajectory.number_count, True
    return size + _measure_reports(reports) if is_new else 0


def _measure_offer(previous: Any, now: OfferMessage) -> int:
    d = now.path.shape[-1]
    if not isinstance(previous, OfferMessage) or previous.choice != now.choice:
        return encoding.CHOICE + REAL * int(d * now.step_count)
    return encoding.CHOICE if now.last_change > previous.last_change else 0


def _measure_committed(previous: Any, now: CommittedMessage) -> int:
    d = now.path.shape[-1]
    if previous is None:
        return encoding.CLEARANCE + REAL * int(d * (2 + now.step_count))
    is_told = not isinstance(previous, CommittedMessage) or previous.path is now.path
    return 0 if is_told else REAL * int(d * now.step_count)
