"""Messages between agents of which one sees the other."""

from typing import Annotated, NamedTuple, no_type_check

import numba
import numpy as np
from annotated_types import Lt

from dynamics.units import Key
from sato.connectivity.flooding import merge_rows
from sato.scenario.definition import NotNegative, Positive


class CommunicationLink(NamedTuple):
    """Period, delay and loss of messages."""

    period_steps: Annotated[int, Key("every"), Positive, "control steps between two messages"] = 1
    delay_messages: Annotated[
        int, Key("late"), NotNegative, "messages that are sent before one arrives"
    ] = 0
    loss_probability: Annotated[
        float, Key("loss"), NotNegative, Lt(1), "probability that a message is lost"
    ] = 0.0


@no_type_check
@numba.njit
def exchange_messages(measurements, messages, estimates, link, is_flooding, number, step, rng):
    """Send what every agent measures and estimates; some messages are lost or delayed.

    Args:
        measurements: Content of messages, and visibility.
        messages: Buffers, changed in place.
        estimates: Content of messages; receives rows of the adjacency matrix.
        link: Period, delay and loss.
        is_flooding: True where rows of the adjacency matrix are relayed.
        number: Number of the control step.
        step: Control step [s].
        rng: Draws losses.
    """
    messages.is_new[:] = False
    if number % link.period_steps != 0:
        return
    n, ring = len(messages.received_time), len(messages.sent_visibility)
    message = number // link.period_steps
    sent, arriving = message % ring, (message - link.delay_messages) % ring
    messages.sent_relative_position[sent] = measurements.relative_position
    messages.sent_visibility[sent] = measurements.visibility
    messages.sent_relative_yaw[sent] = estimates.relative_yaw
    messages.sent_is_mutual[sent] = estimates.is_mutual
    messages.sent_twist[sent, :, :3] = measurements.velocity
    messages.sent_twist[sent, :, 3] = measurements.yaw_rate
    if is_flooding:
        messages.sent_rows[sent] = estimates.adjacency_rows
        messages.sent_row_time[sent] = estimates.row_time
    if message < link.delay_messages:
        return
    time = (number - link.delay_messages * link.period_steps) * step
    for i in range(n):
        for j in range(n):
            if not (measurements.visibility[i, j] or measurements.visibility[j, i]):
                continue
            if link.loss_probability > 0 and rng.random() < link.loss_probability:
                continue
            messages.received_time[i, j] = time
            messages.is_new[i, j] = True
            messages.received_visibility[i, j] = messages.sent_visibility[arriving, j, i]
            own = messages.sent_relative_position[arriving, i, j]
            for a in range(3):
                messages.received_relative_position[i, j, a] = messages.sent_relative_position[
                    arriving, j, i, a
                ]
                messages.relative_position_when_sent[i, j, a] = (
                    own[a] if messages.sent_visibility[arriving, i, j] else np.nan
                )
            messages.received_twist[i, j] = messages.sent_twist[arriving, j]
            messages.received_relative_yaw[i, j] = messages.sent_relative_yaw[arriving, j]
            messages.received_is_mutual[i, j] = messages.sent_is_mutual[arriving, j]
            if is_flooding:
                merge_rows(
                    estimates.adjacency_rows[i],
                    estimates.row_time[i],
                    messages.sent_rows[arriving, j],
                    messages.sent_row_time[arriving, j],
                )
