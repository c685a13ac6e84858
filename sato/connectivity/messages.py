"""Messages between agents of which one sees the other."""

from collections import deque
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from annotated_types import Lt
from jaxtyping import Bool
from numpy import ndarray as Array

from dynamics.units import Key
from sato.connectivity.state import AdjacencyRows, AgentEstimates, Inbox, Measurements, Message
from sato.scenario.definition import NotNegative, Positive

if TYPE_CHECKING:
    from sato.connectivity.mission import Connectivity


class CommunicationLink(NamedTuple):
    """Period, delay and loss of messages."""

    period_steps: Annotated[int, Key("every"), Positive, "control steps between two messages"] = 1
    delay_messages: Annotated[
        int, Key("late"), NotNegative, "messages that are sent before one arrives"
    ] = 0
    loss_probability: Annotated[
        float, Key("loss"), NotNegative, Lt(1), "probability that a message is lost"
    ] = 0.0


def exchange_messages(
    measurements: Measurements,
    estimates: AgentEstimates,
    on_their_way: deque[Message],
    inbox: Inbox,
    mission: "Connectivity",
    number: int,
    rng: np.random.Generator,
) -> AgentEstimates:
    """Send what every agent measures and estimates; some messages are lost or delayed.

    Args:
        measurements: Content of messages, and visibility.
        estimates: Content of messages.
        on_their_way: Messages that have not arrived, changed in place.
        inbox: Last messages of each agent, changed in place.
        mission: Drawn mission.
        number: Number of the control step.
        rng: Draws losses.

    Returns:
        Estimates, with the newest rows of the adjacency matrix of those known and received.
    """
    link = mission.link
    inbox.is_new[:] = False
    if number % link.period_steps != 0:
        return estimates
    twist = np.column_stack([measurements.velocity, measurements.yaw_rate])
    on_their_way.append(
        Message(
            twist, measurements.relative_position, estimates.relative_yaw, estimates.is_mutual,
            estimates.adjacency,
        )
    )  # fmt: skip
    if len(on_their_way) <= link.delay_messages:
        return estimates
    message = on_their_way.popleft()
    hears = measurements.visibility | measurements.visibility.T
    if link.loss_probability > 0:
        hears[hears] = rng.random(hears.sum()) >= link.loss_probability
    i, j = np.nonzero(hears)
    inbox.time[i, j] = (number - link.delay_messages * link.period_steps) * mission.step
    inbox.is_new[i, j] = True
    inbox.twist[i, j] = message.twist[j]
    inbox.relative_position[i, j] = message.relative_position[j, i]
    inbox.own_relative_position[i, j] = message.relative_position[i, j]
    inbox.relative_yaw[i, j] = message.relative_yaw[j]
    inbox.is_mutual[i, j] = message.is_mutual[j]
    merged = merge_rows(estimates.adjacency, message.adjacency, hears)
    return estimates._replace(adjacency=merged)


def merge_rows(
    known: AdjacencyRows, sent: AdjacencyRows, hears: Bool[Array, "n n"]
) -> AdjacencyRows:
    """Take over the rows that others have newer.

    Args:
        known: Rows known to agent i.
        sent: Rows that agent j sent.
        hears: True where agent i hears agent j.
    """
    offered = np.where(hears[..., None], sent.time, -np.inf)  # [i, j, k]: row k, by agent j
    sender, k = offered.argmax(axis=1), np.arange(len(hears))
    newest = offered.max(axis=1)
    is_newer = newest > known.time
    weight = np.where(is_newer[..., None], sent.weight[sender, k], known.weight)
    return AdjacencyRows(weight, np.where(is_newer, newest, known.time))
