"""Sensors and messages of the agents: own positions, those of neighbors, and those nearby.

Compiled functions of one agent or of all; they alone read the true state, for their measurements.
"""

import numba
import numpy as np


def compute_track_gains(noise: float, acceleration: float, step: float) -> tuple[float, float]:
    """Compute the gains of the steady Kalman filter of a motion at random accelerations.

    The filter of [Kalata1984]: a position is predicted, and corrected by α of what the measurement
    differs, the velocity by β of that over a step.

    Args:
        noise: Standard deviation of a measured coordinate [m].
        acceleration: Standard deviation of an acceleration, held for a step [m/s²].
        step: Time between two measurements [s].

    Returns:
        α and β, which is at most 1, as for differences of positions without noise.
    """
    if noise == 0:
        return 1.0, 1.0
    index = acceleration * step**2 / noise
    root = (4 + index - (8 * index + index**2) ** 0.5) / 4
    return 1 - root**2, min(1.0, 2 * (1 + root**2) - 4 * root)


@numba.njit
def measure_own_position(state, swarm, rng):
    """Measure each agent's position in its own frame, with odometry drift and noise."""
    frames, measured = swarm.coordinate_frames, state.measured_position
    offset = state.position - frames.origin
    flat = (offset[:, 0] + 1j * offset[:, 1]) * np.conj(frames.rotation)
    measured[:, 0], measured[:, 1], measured[:, 2] = flat.real, flat.imag, offset[:, 2]
    measured += state.drift
    if swarm.noise > 0:
        measured += swarm.noise * rng.standard_normal(measured.shape)


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
                state.received[i, j] = arriving[j]


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
def _is_in_range(i, j, state, swarm):
    """Tell whether agent i senses agent j."""
    x = state.position[j, 0] - state.position[i, 0]
    y = state.position[j, 1] - state.position[i, 1]
    reach = swarm.avoidance.avoidance_range
    return j != i and x * x + y * y < reach * reach


@numba.njit
def _measure_relative(i, j, state, swarm, measured, rng):
    """Measure agent j relative to agent i, in its own frame; odometry does not matter here."""
    x = state.position[j, 0] - state.position[i, 0]
    y = state.position[j, 1] - state.position[i, 1]
    flat = np.conj(swarm.coordinate_frames.rotation[i]) * complex(x, y)
    measured[0], measured[1] = flat.real, flat.imag
    if swarm.noise > 0:
        measured[0] += swarm.noise * rng.standard_normal()
        measured[1] += swarm.noise * rng.standard_normal()


@numba.njit
def sense_nearby(i, state, swarm, others, rng):
    """Measure the agents within range of agent i.

    Returns:
        Number of agents sensed; the first so many rows of `others` are their positions.
    """
    count = 0
    for j in range(len(state.position)):
        if _is_in_range(i, j, state, swarm):
            _measure_relative(i, j, state, swarm, others[count], rng)
            count += 1
    return count


@numba.njit
def track_nearby(i, v, state, swarm, others, rng):
    """Track the agents within range of agent i, in its own frame, by positions that it measures.

    Args:
        i: The agent.
        v: Its own velocity, in its own frame [m/s].
        state: A `FormationState`, whose tracks are changed in place.
        swarm: Constants, `KernelParameters`.
        others: Filled with relative positions and velocities of those within range.
        rng: Generator for noise.

    Returns:
        Number of agents within range.
    """
    on_position, on_velocity = swarm.track_gains
    count, h = 0, swarm.step
    for j in range(len(state.position)):
        track, measured = state.tracks[i, j], others[count]
        if not _is_in_range(i, j, state, swarm):
            track[0] = np.nan
            continue
        _measure_relative(i, j, state, swarm, measured, rng)
        is_new = np.isnan(track[0])
        for a in range(2):
            if is_new:
                track[a], track[2 + a] = measured[a], 0.0
                continue
            predicted = track[a] + h * (track[2 + a] - v[a])
            track[a] = predicted + on_position * (measured[a] - predicted)
            track[2 + a] += on_velocity / h * (measured[a] - predicted)
        others[count] = track
        count += 1
    return count
