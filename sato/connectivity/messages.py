"""What robots tell each other, while one of them has the other in sight."""

from typing import Annotated, NamedTuple, no_type_check

import numba
import numpy as np
from annotated_types import Lt

from dynamics.units import Key
from sato.connectivity.flooding import merge_rows
from sato.scenario.definition import NotNegative, Positive


class CommunicationLink(NamedTuple):
    """How messages travel."""

    period_steps: Annotated[int, Key("every"), Positive, "control steps between two messages"] = 1
    delay_messages: Annotated[
        int, Key("late"), NotNegative, "messages that are sent before one arrives"
    ] = 0
    loss_probability: Annotated[
        float, Key("loss"), NotNegative, Lt(1), "probability that a message is lost"
    ] = 0.0


@no_type_check
@numba.njit
def exchange_messages(senses, mail, mind, link, is_flooding, number, step, rng):
    """Everybody tells what it sees and reckons; some of it is lost or late.

    Args:
        senses: What is told of, and who is in sight of whom.
        mail: Changed in place.
        mind: What is told of; takes over rows of the adjacency.
        link: How messages travel.
        relays: Whether rows of the adjacency are passed on.
        number: Of the control step.
        step: Its length [s].
        rng: Draws losses.
    """
    mail.is_new[:] = False
    if number % link.period_steps != 0:
        return
    ring, n, message = (
        len(mail.sent_relative_position),
        len(mail.received_time),
        number // link.period_steps,
    )
    now, then = message % ring, (message - link.delay_messages) % ring
    mail.sent_relative_position[now], mail.sent_visibility[now] = (
        senses.relative_position,
        senses.visibility,
    )
    mail.sent_relative_yaw[now], mail.sent_is_mutual[now] = mind.relative_yaw, mind.is_mutual
    mail.sent_twist[now, :, :3], mail.sent_twist[now, :, 3] = senses.velocity, senses.yaw_rate
    if is_flooding:
        mail.sent_rows[now], mail.sent_row_time[now] = mind.adjacency_rows, mind.row_time
    if message < link.delay_messages:
        return
    for i in range(n):
        for j in range(n):
            if not (senses.visibility[i, j] or senses.visibility[j, i]):
                continue
            if link.loss_probability > 0 and rng.random() < link.loss_probability:
                continue
            mail.received_time[i, j] = (number - link.delay_messages * link.period_steps) * step
            mail.is_new[i, j] = True
            mail.received_visibility[i, j] = mail.sent_visibility[then, j, i]
            for a in range(3):
                mail.received_relative_position[i, j, a] = mail.sent_relative_position[
                    then, j, i, a
                ]
                mail.relative_position_when_sent[i, j, a] = (
                    mail.sent_relative_position[then, i, j, a]
                    if mail.sent_visibility[then, i, j]
                    else np.nan
                )
            for a in range(4):
                mail.received_twist[i, j, a] = mail.sent_twist[then, j, a]
            for k in range(n):
                mail.received_relative_yaw[i, j, k] = mail.sent_relative_yaw[then, j, k]
                mail.received_is_mutual[i, j, k] = mail.sent_is_mutual[then, j, k]
            if is_flooding:
                merge_rows(
                    mind.adjacency_rows[i],
                    mind.row_time[i],
                    mail.sent_rows[then, j],
                    mail.sent_row_time[then, j],
                )
