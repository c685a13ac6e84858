"""Messages between agents of which one sees the other."""

from collections import deque

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from sato.connectivity.mission import Connectivity
from sato.connectivity.settings import MAX_MESSAGE_AGE
from sato.connectivity.state import AdjacencyRows, Knowledge, Message
from sato.network.outages import PairOutages


def exchange_messages(
    known: Knowledge,
    on_their_way: deque[Message],
    mission: Connectivity,
    number: int,
    rng: np.random.Generator,
    outages: PairOutages | None = None,
) -> Knowledge:
    """Send what every agent measures and estimates; some messages are lost or delayed.

    Args:
        known: Content of messages; the inbox is changed in place.
        on_their_way: Messages that have not arrived, changed in place.
        mission: Drawn mission.
        number: Number of the control step.
        rng: Draws losses.
        outages: Pairs between which messages are lost; changed in place.

    Returns:
        What is known, with the newest rows of the adjacency matrix of those known and received.
    """
    measurements, inbox, estimates = known
    link, now = mission.link, number * mission.step
    delay_steps = (link.late + 1) * link.period_steps - 1
    is_old = inbox.time < now - MAX_MESSAGE_AGE - delay_steps * mission.step
    inbox.time[is_old], inbox.relative_position[is_old] = -np.inf, np.nan
    inbox.is_new[:] = False
    if number % link.period_steps != 0:
        return known
    twist = np.column_stack([measurements.velocity, measurements.yaw_rate])
    estimated = estimates.relative_yaw, estimates.is_mutual, estimates.adjacency
    on_their_way.append(Message(twist, measurements.relative_position, *estimated))
    if len(on_their_way) <= link.late:
        return known
    message = on_their_way.popleft()
    hears = measurements.visibility | measurements.visibility.T
    if link.loss_probability > 0:
        hears[hears] = rng.random(hears.sum()) >= link.loss_probability
    if outages is not None:
        hears &= ~outages.advance()
    i, j = np.nonzero(hears)
    inbox.time[i, j] = (number - link.late * link.period_steps) * mission.step
    inbox.is_new[i, j] = True
    inbox.twist[i, j] = message.twist[j]
    inbox.relative_position[i, j] = message.relative_position[j, i]
    inbox.own_relative_position[i, j] = message.relative_position[i, j]
    inbox.relative_yaw[i, j] = message.relative_yaw[j]
    inbox.is_mutual[i, j] = message.is_mutual[j]
    if mission.estimator != "flood":
        return known
    merged = merge_rows(estimates.adjacency, message.adjacency, hears)
    return known._replace(estimates=estimates._replace(adjacency=merged))


def merge_rows(own: AdjacencyRows, sent: AdjacencyRows, hears: Bool[Array, "n n"]) -> AdjacencyRows:
    """Take over the rows that agents know newer by those that they hear."""
    offered = np.where(hears[..., None], sent.time, -np.inf)  # [i, j, k]: row k, by agent j
    sender, k = offered.argmax(axis=1), np.arange(len(hears))
    newest = offered.max(axis=1)
    is_newer = newest > own.time
    weight = np.where(is_newer[..., None], sent.weight[sender, k], own.weight)
    return AdjacencyRows(weight, np.where(is_newer, newest, own.time))
