"""What one vehicle measures, tells and hears: the only place where the truth is looked at."""

from typing import no_type_check

import numba
import numpy as np


@no_type_check
@numba.njit
def measure_own_position(state, frames, rng):
    """Each vehicle's own position in its own frame, drifted and noisy: all it knows of itself."""
    for i in range(len(state.position)):
        e = state.measured_position[i]
        p = complex(
            state.position[i, 0] - frames.origin[i, 0], state.position[i, 1] - frames.origin[i, 1]
        )
        p *= np.conj(frames.rotation[i])
        e[0], e[1], e[2] = p.real, p.imag, state.position[i, 2] - frames.origin[i, 2]
        for a in range(3):
            e[a] += state.drift[i, a]
            if frames.noise > 0:
                e[a] += frames.noise * rng.standard_normal()


@no_type_check
@numba.njit
def exchange_positions(state, roles, swarm, message, rng):
    """Everybody tells its position; each hears those who hold its neighbouring points."""
    ring, pace = len(state.sent), swarm.timing
    state.sent[message % ring] = state.measured_position
    told = state.sent[(message - pace.message_delay) % ring]
    for i in range(len(state.position)):
        for point in swarm.formation.neighbors[roles.assignment[i]]:
            if point < 0:
                break
            if pace.message_loss == 0 or rng.random() >= pace.message_loss:
                j = roles.holder[i, point]
                for a in range(3):
                    state.received[i, j, a] = told[j, a]


@no_type_check
@numba.njit
def locate_neighbors(i, state, roles, swarm, sees, near):
    """Where vehicle i has the holders of its neighbouring points, from itself, in its own frame.

    It takes their own reckoning, by the pose of their frames in its own, which it knows.
    """
    frames, me, k = swarm.coordinate_frames, state.measured_position[i], 0
    own = np.conj(frames.rotation[i])
    for point in swarm.formation.neighbors[roles.assignment[i]]:
        if point < 0:
            break
        j = roles.holder[i, point]
        told = state.received[i, j]
        if j == i or np.isnan(told[0]):
            continue
        o_x = frames.origin[j, 0] - frames.origin[i, 0]
        o_y = frames.origin[j, 1] - frames.origin[i, 1]
        flat = own * (frames.rotation[j] * complex(told[0], told[1]) + complex(o_x, o_y))
        sees[point, 0], sees[point, 1] = flat.real - me[0], flat.imag - me[1]
        sees[point, 2] = told[2] + frames.origin[j, 2] - frames.origin[i, 2] - me[2]
        near[k] = point
        k += 1
    return k


@no_type_check
@numba.njit
def sense_nearby(i, state, swarm, others, rng):
    """Those near vehicle i, as it sees them itself, in its own frame; nothing drifts here."""
    frames, notice, count = swarm.coordinate_frames, swarm.avoidance.avoidance_range, 0
    own, nearest = np.conj(frames.rotation[i]), np.inf
    for j in range(len(state.position)):
        x = state.position[j, 0] - state.position[i, 0]
        y = state.position[j, 1] - state.position[i, 1]
        square = x * x + y * y
        if j == i:
            continue
        nearest = min(nearest, square)
        if square < notice * notice:
            flat = own * complex(x, y)
            others[count, 0], others[count, 1] = flat.real, flat.imag
            if frames.noise > 0:
                others[count, 0] += frames.noise * rng.standard_normal()
                others[count, 1] += frames.noise * rng.standard_normal()
            count += 1
    state.min_separation[i] = min(state.min_separation[i], np.sqrt(nearest))
    return count
