"""What robots tell each other, while one of them has the other in sight."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np

from sato.connectivity.flood import relay


class Link(NamedTuple):
    """How messages travel."""

    every: int = 1  # control steps between two messages
    late: int = 0  # how many messages later one arrives
    loss: float = 0.0  # share that is lost


@no_type_check
@numba.njit
def talk(senses, mail, mind, link, relays, number, step, rng):
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
    mail.news[:] = False
    if number % link.every != 0:
        return
    ring, n, message = len(mail.p), len(mail.when), number // link.every
    now, then = message % ring, (message - link.late) % ring
    mail.p[now], mail.sees[now] = senses.p, senses.sees
    mail.turned[now], mail.close[now] = mind.turned, mind.close
    mail.motion[now, :, :3], mail.motion[now, :, 3] = senses.velocity, senses.rate
    if relays:
        mail.rows[now], mail.stamp[now] = mind.rows, mind.stamp
    if message < link.late:
        return
    for i in range(n):
        for j in range(n):
            if not (senses.sees[i, j] or senses.sees[j, i]):
                continue
            if link.loss > 0 and rng.random() < link.loss:
                continue
            mail.when[i, j] = (number - link.late * link.every) * step
            mail.news[i, j] = True
            mail.his_sees[i, j] = mail.sees[then, j, i]
            for a in range(3):
                mail.his_p[i, j, a] = mail.p[then, j, i, a]
                mail.p_then[i, j, a] = mail.p[then, i, j, a] if mail.sees[then, i, j] else np.nan
            for a in range(4):
                mail.his_motion[i, j, a] = mail.motion[then, j, a]
            for k in range(n):
                mail.his_turned[i, j, k] = mail.turned[then, j, k]
                mail.his_close[i, j, k] = mail.close[then, j, k]
            if relays:
                relay(mind.rows[i], mind.stamp[i], mail.rows[then, j], mail.stamp[then, j])
