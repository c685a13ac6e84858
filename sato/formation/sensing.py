"""Sensors and messages of the agents: own positions, those of neighbors, and those nearby.

Agents are computed side by side, a row each. These functions alone read the true state, for their
measurements.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy import ndarray as Array
from numpy.random import Generator

if TYPE_CHECKING:
    from sato.formation.control_step import FormationState, StepParameters
    from sato.formation.settings import CoordinateFrames
    from sato.network.outages import PairOutages


class Neighbors(NamedTuple):
    """Holders of the points beside those that agents hold, and poses of frames, which all know."""

    holder: Int[Array, "agents most"]
    is_there: Bool[Array, "agents most"]  # False beyond the last neighbor
    is_other: Bool[Array, "agents most"]  # False also where the agent itself is the holder
    pair: Int[Array, "agents most"]  # of the agent and the holder, counted row by row
    rotation: Complex[Array, "agents most"]  # of the holder's frame in the own
    offset: Complex[Array, "agents most"]  # of the origin of the holder's frame, in the own [m]
    rise: Float[Array, "agents most"]  # of this origin above the own [m]

    @classmethod
    def of(
        cls,
        holder: Int[Array, "agents most"],
        is_there: Bool[Array, "agents most"],
        frames: "CoordinateFrames",
    ) -> "Neighbors":
        """Collect what does not change while agents hold their points."""
        agents = np.arange(len(holder))[:, None]
        offset = frames.origin[holder] - frames.origin[:, None]
        turn = np.conj(frames.rotation)[:, None]
        return cls(
            holder,
            is_there,
            is_other=is_there & (holder != agents),
            pair=agents * len(holder) + holder,
            rotation=turn * frames.rotation[holder],
            offset=turn * as_complex(offset),
            rise=offset[..., 2],
        )


class NeighborLocations(NamedTuple):
    """Holders of neighboring points relative to each agent, in its own frame."""

    flat: Complex[Array, "agents most"]  # in the plane [m]
    rise: Float[Array, "agents most"]  # [m]
    is_known: Bool[Array, "agents most"]  # True where there is a neighbor that was heard


def compute_track_gains(noise: float, acceleration: float, step: float) -> tuple[float, float]:
    """Compute the gains α, β of the steady Kalman filter of a motion at random accelerations.

    The filter of [Kalata1984]: a position is predicted, and corrected by α of what the measurement
    differs, the velocity by β of that over a step [s]. Noise is the standard deviation of a
    measured coordinate [m], and acceleration that of one held for a step [m/s²]. β is at most 1,
    as for differences of positions without noise.
    """
    if noise == 0:
        return 1.0, 1.0
    index = acceleration * step**2 / noise
    root = (4 + index - (8 * index + index**2) ** 0.5) / 4
    return 1 - root**2, min(1.0, 2 * (1 + root**2) - 4 * root)


def measure_own_positions(state: "FormationState", swarm: "StepParameters", rng: Generator) -> None:
    """Measure each agent's position in its own frame, with odometry drift and noise."""
    frames, noise = swarm.mission.coordinate_frames, swarm.mission.frames.noise
    measured = state.measured_position
    offset = state.position - frames.origin
    measured[:, :2] = as_pairs(as_complex(offset) * np.conj(frames.rotation))
    measured[:, 2] = offset[:, 2]
    measured += state.drift
    if noise > 0:
        measured += noise * rng.standard_normal(measured.shape)


def exchange_positions(
    state: "FormationState",
    neighbors: Neighbors,
    swarm: "StepParameters",
    message: int,
    rng: Generator,
    outages: "PairOutages | None" = None,
) -> None:
    """Send each agent's position to the agents that hold the neighboring points."""
    link, ring = swarm.mission.timed_link, len(state.sent)
    state.sent[message % ring] = state.measured_position
    arriving = state.sent[(message - link.late) % ring]
    is_heard = neighbors.is_there
    if link.loss_probability > 0:
        is_heard = is_heard & (rng.random(is_heard.shape) >= link.loss_probability)
    if outages is not None:
        is_heard = is_heard & ~outages.advance().ravel()[neighbors.pair]
    pair, j = neighbors.pair[is_heard], neighbors.holder[is_heard]
    state.received_flat.ravel()[pair] = as_complex(arriving)[j]
    state.received_height.ravel()[pair] = arriving[j, 2]


def locate_neighbors(state: "FormationState", neighbors: Neighbors) -> NeighborLocations:
    """Locate the holders of neighboring points relative to each agent, in its own frame.

    Their own estimates are used, and the poses of their frames in its own, which it knows.
    """
    heard, height = (
        np.take(part, neighbors.pair) for part in (state.received_flat, state.received_height)
    )
    own = state.measured_position
    flat = neighbors.rotation * heard + (neighbors.offset - as_complex(own)[:, None])
    rise = height + (neighbors.rise - own[:, 2:])
    return NeighborLocations(flat, rise, neighbors.is_other & ~np.isnan(height))


class Nearby(NamedTuple):
    """Agents within range of others, those of one agent after those of another."""

    i: Int[Array, " pairs"]  # agent
    j: Int[Array, " pairs"]  # the other, which it senses
    start: Int[Array, " agents+1"]  # first pair of each agent
    measured: Float[Array, "pairs 2"]  # position of j relative to i, in the frame of i [m]


def sense_nearby(state: "FormationState", swarm: "StepParameters", rng: Generator) -> Nearby:
    """Measure those within range of each agent, in its own frame; odometry does not matter here."""
    mission, flat = swarm.mission, as_complex(state.position)
    apart = flat - flat[:, None]
    is_near = apart.real**2 + apart.imag**2 < mission.avoidance.avoidance_range**2
    np.fill_diagonal(is_near, False)
    i, j = np.nonzero(is_near)
    measured = as_pairs(np.conj(mission.coordinate_frames.rotation)[i] * apart[i, j])
    if mission.frames.noise > 0:
        measured = measured + mission.frames.noise * rng.standard_normal(measured.shape)
    start = np.zeros(len(flat) + 1, dtype=np.int64)
    np.cumsum(is_near.sum(axis=1), out=start[1:])
    return Nearby(i, j, start, measured)


def track_nearby(
    state: "FormationState",
    swarm: "StepParameters",
    velocity: Float[Array, "agents 2"],
    nearby: Nearby,
) -> Float[Array, "pairs 4"]:
    """Track those within range, by positions that each agent measures in its own frame.

    Args:
        state: State, whose tracks are changed in place.
        swarm: Constants.
        velocity: Each agent's own velocity, in its own frame [m/s].
        nearby: Those within range.

    Returns:
        Relative positions and velocities of those within range [m, m/s].
    """
    i, j, _, measured = nearby
    (on_position, on_velocity), h = swarm.track_gains, swarm.mission.step
    track = np.asarray(state.tracks[i, j])
    position, speed = track[:, :2], track[:, 2:]
    is_new = np.isnan(position[:, 0])
    predicted = position + h * (speed - velocity[i])
    error = measured - predicted
    position[:], speed[:] = predicted + on_position * error, speed + on_velocity / h * error
    position[is_new], speed[is_new] = measured[is_new], 0.0
    state.tracks[:] = np.nan
    state.tracks[i, j] = track
    return track


def as_complex(vectors: Float[Array, "*k axes"]) -> Complex[Array, "*k"]:
    """Return the horizontal parts of vectors as complex numbers."""
    flat = np.ascontiguousarray(vectors[..., :2], dtype=float).view(complex)
    return np.asarray(flat[..., 0])


def as_pairs(flat: Complex[Array, "*k"]) -> Float[Array, "*k 2"]:
    """Return complex numbers as pairs of coordinates."""
    return np.asarray(np.ascontiguousarray(flat).view(float).reshape(*flat.shape, 2))
