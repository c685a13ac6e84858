"""Measurements and messages of the agents: the only functions that read the true state."""

import numba
import numpy as np


@numba.njit
def measure_own_position(state, swarm, rng):
    """Measure each agent's position in its own frame, with odometry drift and noise."""
    frames, noise = swarm.coordinate_frames, swarm.noise
    for i in range(len(state.position)):
        e = state.measured_position[i]
        p = complex(
            state.position[i, 0] - frames.origin[i, 0], state.position[i, 1] - frames.origin[i, 1]
        )
        p *= np.conj(frames.rotation[i])
        e[0], e[1], e[2] = p.real, p.imag, state.position[i, 2] - frames.origin[i, 2]
        for a in range(3):
            e[a] += state.drift[i, a]
            if noise > 0:
                e[a] += noise * rng.standard_normal()


@numba.njit
def exchange_positions(state, roles, swarm, message, rng):
    """Send each agent's position to the agents that hold the neighboring points."""
    ring = len(state.sent)
    state.sent[message % ring] = state.measured_position
    arriving = state.sent[(message - swarm.message_delay) % ring]
    for i in range(len(state.position)):
        for point in swarm.formation.neighbors[roles.assignment[i]]:
            if point < 0:
                break
            if swarm.message_loss == 0 or rng.random() >= swarm.message_loss:
                j = roles.holder[i, point]
                for a in range(3):
                    state.received[i, j, a] = arriving[j, a]


@numba.njit
def locate_neighbors(i, state, roles, swarm, relative, near):
    """Locate the holders of neighboring points relative to agent i, in its own frame.

    Their own estimates are used, and the poses of their frames in its own, which it knows.

    Returns:
        Number of neighbors heard; the first so many of `near` are their points.
    """
    frames, own_position, k = swarm.coordinate_frames, state.measured_position[i], 0
    own = np.conj(frames.rotation[i])
    for point in swarm.formation.neighbors[roles.assignment[i]]:
        if point < 0:
            break
        j = roles.holder[i, point]
        heard = state.received[i, j]
        if j == i or np.isnan(heard[0]):
            continue
        o_x = frames.origin[j, 0] - frames.origin[i, 0]
        o_y = frames.origin[j, 1] - frames.origin[i, 1]
        flat = own * (frames.rotation[j] * complex(heard[0], heard[1]) + complex(o_x, o_y))
        relative[point, 0] = flat.real - own_position[0]
        relative[point, 1] = flat.imag - own_position[1]
        relative[point, 2] = heard[2] + frames.origin[j, 2] - frames.origin[i, 2] - own_position[2]
        near[k] = point
        k += 1
    return k


@numba.njit
def sense_nearby(i, state, swarm, others, rng):
    """Sense the agents within range of agent i, in its own frame; odometry does not matter here.

    Returns:
        Number of agents sensed; the first so many rows of `others` are their positions.
    """
    frames, noise, count = swarm.coordinate_frames, swarm.noise, 0
    reach, own = swarm.avoidance.avoidance_range, np.conj(frames.rotation[i])
    for j in range(len(state.position)):
        x = state.position[j, 0] - state.position[i, 0]
        y = state.position[j, 1] - state.position[i, 1]
        if j != i and x * x + y * y < reach * reach:
            flat = own * complex(x, y)
            others[count, 0], others[count, 1] = flat.real, flat.imag
            if noise > 0:
                others[count, 0] += noise * rng.standard_normal()
                others[count, 1] += noise * rng.standard_normal()
            count += 1
    return count
