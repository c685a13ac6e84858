"""Control steps of all agents: measure, communicate, command, avoid, move.

Agents are computed side by side, a row each, from what each measured or received, in its own
frame. Only the sensors and the equations of motion use the true state.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy import ndarray as Array
from numpy.random import Generator

from sato.formation.avoidance import SPEED_SIDES, avoid_all
from sato.formation.control_law import FormationData, compute_velocity_commands
from sato.formation.mission import Formation
from sato.formation.sectors import turn_out_of_sectors
from sato.formation.sensing import (
    NeighborLocations,
    Neighbors,
    as_complex,
    as_pairs,
    compute_track_gains,
    exchange_positions,
    locate_neighbors,
    measure_own_positions,
    sense_nearby,
    track_nearby,
)
from sato.formation.settings import BLOCKED_SPEED_SHARE
from sato.network.outages import PairOutages

MAX_WANDERS = 8  # after which wandering takes no longer


class StepParameters(NamedTuple):
    """Constants of the flight to one formation."""

    mission: Formation  # drawn
    formation: FormationData
    track_gains: tuple[float, float]  # of position and of velocity, see `compute_track_gains`
    steps_per_message: int  # control steps between two position messages

    @classmethod
    def for_leg(cls, mission: Formation, leg: int) -> "StepParameters":
        """Collect the constants of a leg of a drawn mission."""
        step, noise = mission.step, mission.frames.noise
        track_gains = compute_track_gains(noise, mission.max_acceleration, step)
        steps_per_message = max(1, round(mission.timed_link.round / step))
        formation = FormationData.from_gains(mission.gains[leg])
        return cls(mission, formation, track_gains, steps_per_message)


class Roles(NamedTuple):
    """Assignment and commands that hold between two control steps."""

    assignment: Int[Array, " agents"]  # point that each agent holds
    holder: Int[Array, "agents points"]  # of each point, as each agent knows it
    is_active: Bool[Array, " agents"]  # True where the control law is on; else the agent hovers
    commanded_agent: int  # agent that an operator steers; −1 none
    operator_velocity: Float[Array, " 3"]  # commanded velocity, in that agent's frame [m/s]

    def find_neighbors(self, swarm: StepParameters) -> Neighbors:
        """Return the holders of the points beside each agent's own, as each agent knows them."""
        points = swarm.formation.neighbors[self.assignment]
        holder = self.holder[np.arange(len(points))[:, None], points]
        return Neighbors.of(holder, points >= 0, swarm.mission.coordinate_frames)


class FormationState(NamedTuple):
    """State of all agents, changed in place from step to step."""

    position: Float[Array, "agents 3"]  # true [m]
    velocity: Float[Array, "agents 3"]  # true [m/s]
    drift: Float[Array, "agents 3"]  # odometry error, in the own frame [m]
    measured_position: Float[Array, "agents 3"]  # in the own frame [m]
    sent: Float[Array, "ring agents 3"]  # last positions sent, each in the sender's frame [m]
    received_flat: Complex[Array, "agents agents"]  # [i, j]: last of j's to reach i; NaN none [m]
    received_height: Float[Array, "agents agents"]  # of the same [m]
    velocity_command: Float[Array, "agents 3"]  # of the control law, in the own frame [m/s]
    tracks: Float[Array, "agents agents 4"]  # [i, j]: j as i tracks it; NaN out of range [m, m/s]
    avoiding: Bool[Array, " agents"]
    blocked_time: Float[Array, " agents"]  # stopped so long; negative: still wanders so long [s]
    wander_direction: Complex[Array, " agents"]  # in the own frame
    wander_count: Int[Array, " agents"]  # times that the agent has wandered on its way

    @classmethod
    def at_rest(cls, position: Float[Array, "agents 3"], message_delay: int) -> "FormationState":
        """Return all agents at rest, before any message."""
        n = len(position)
        velocity, drift, measured, command = np.zeros((4, n, 3))
        return cls(
            position=position.copy(),
            velocity=velocity,
            drift=drift,
            measured_position=measured,
            sent=np.full((message_delay + 1, n, 3), np.nan),
            received_flat=np.full((n, n), complex(np.nan, np.nan)),
            received_height=np.full((n, n), np.nan),
            velocity_command=command,
            tracks=np.full((n, n, 4), np.nan),
            avoiding=np.zeros(n, dtype=bool),
            blocked_time=np.zeros(n),
            wander_direction=np.ones(n, dtype=complex),
            wander_count=np.zeros(n, dtype=np.int64),
        )

    def heard(self, i: Int[Array, "*#k"], j: Int[Array, "*#k"]) -> Float[Array, "*#k 3"]:
        """Return the last positions of agents j that reached agents i; NaN where none did [m]."""
        flat = self.received_flat[i, j]
        return np.stack([flat.real, flat.imag, self.received_height[i, j]], axis=-1)

    def begin_way(self, agents: Int[Array, " k"]) -> None:
        """Let agents forget that others have blocked them, as they hold other points now."""
        self.blocked_time[agents], self.wander_count[agents] = 0.0, 0


def simulate_steps(
    state: FormationState,
    roles: Roles,
    neighbors: Neighbors,
    swarm: StepParameters,
    first: int,
    steps: int,
    rng: Generator,
    outages: PairOutages | None = None,
) -> None:
    """Simulate some control steps.

    Args:
        state: State, changed in place.
        roles: Assignment and commands.
        neighbors: Those of the roles.
        swarm: Constants.
        first: Number of the first of these control steps.
        steps: Number of control steps.
        rng: Generator for noise, wandering and lost messages.
        outages: Those of the links, changed in place.
    """
    mission = swarm.mission
    for number in range(first, first + steps):
        measure_own_positions(state, swarm, rng)
        message, rest = divmod(number, swarm.steps_per_message)
        if rest == 0:
            exchange_positions(state, neighbors, swarm, message, rng, outages)
        _command(state, roles, neighbors, swarm)
        _update_velocities(state, swarm, rng)
        v = state.velocity
        state.position[:] += v * mission.step
        flown = np.linalg.norm(v, axis=1, keepdims=True) * mission.step
        state.drift[:] += flown * mission.coordinate_frames.drift_rate


def _command(
    state: FormationState, roles: Roles, neighbors: Neighbors, swarm: StepParameters
) -> None:
    u, active = state.velocity_command, roles.is_active
    u[:] = 0.0
    if active.any():
        seen = NeighborLocations(*(part[active] for part in locate_neighbors(state, neighbors)))
        rules = swarm.formation, swarm.mission.control_law, swarm.mission.avoidance.legacy
        u[active] = compute_velocity_commands(roles.assignment[active], seen, *rules)
    if roles.commanded_agent >= 0:
        u[roles.commanded_agent] = roles.operator_velocity
        state.blocked_time[roles.commanded_agent] = 0.0  # it does not wander


def _update_velocities(state: FormationState, swarm: StepParameters, rng: Generator) -> None:
    # Limits of speed, then avoidance, then limits of acceleration.
    mission, heading = swarm.mission, swarm.mission.coordinate_frames.rotation
    rules, keep_out = mission.avoidance, mission.keep_out
    u, most = state.velocity_command.copy(), mission.max_acceleration * mission.step
    u[:, :2] = _limit(u[:, :2], mission.max_speed)
    u[:, 2] = np.clip(u[:, 2], -mission.max_climb, mission.max_climb)
    v = as_pairs(np.conj(heading) * as_complex(state.velocity))
    if rules.legacy:
        nearby = sense_nearby(state, swarm, rng)
        turn_out_of_sectors(u, nearby.measured, nearby.start, keep_out, rules, state.avoiding)
        v += np.clip(u[:, :2] - v, -most, most)
    else:
        wanders = _wander(u, state, swarm, rng)
        nearby = sense_nearby(state, swarm, rng)
        others = track_nearby(state, swarm, v, nearby)
        planes = np.empty((2 * len(u) + SPEED_SIDES, 3))
        own = u, v, others, nearby.start, keep_out, rules, mission.max_speed, most
        avoid_all(*own, planes, state.avoiding)
        state.avoiding[wanders] = True
        # Also where an agent has to separate from others.
        flat = _limit(u[:, :2], mission.max_speed)
        v = v + _limit(flat - v, most)
    state.velocity[:, :2] = as_pairs(heading * as_complex(v))
    most = mission.max_climb_acceleration * mission.step
    state.velocity[:, 2] += np.clip(u[:, 2] - state.velocity[:, 2], -most, most)


def _wander(
    u: Float[Array, "agents 3"], state: FormationState, swarm: StepParameters, rng: Generator
) -> Bool[Array, " agents"]:
    """Return the agents that wander, after their commands were replaced.

    Rules that are the same for all agents can stop all of them for good, each because of
    another. An agent that has been stopped for a while flies anywhere for a moment.
    """
    max_speed, step, blocked_time = swarm.mission.max_speed, swarm.mission.step, state.blocked_time
    wanders = blocked_time < 0
    commanded, flown = (np.hypot(w[:, 0], w[:, 1]) for w in (u, state.velocity))
    is_slow = BLOCKED_SPEED_SHARE * max_speed > flown
    stopped = state.avoiding & (commanded > BLOCKED_SPEED_SHARE * max_speed) & is_slow
    u[wanders, :2] = max_speed * as_pairs(state.wander_direction[wanders])
    waited = np.where(stopped, blocked_time + step, 0.0)
    blocked_time[:] = np.where(wanders, np.minimum(0.0, blocked_time + step), waited)
    begins = np.flatnonzero(~wanders & (blocked_time > swarm.mission.avoidance.blocked_time))
    if len(begins):
        away = -np.nansum(as_complex(state.tracks[begins]), axis=1)  # from those that it tracks
        angle = np.angle(away) + np.pi / 2 * (rng.random(len(begins)) - 0.5)
        state.wander_direction[begins] = np.exp(1j * angle)
        state.wander_count[begins] = np.minimum(state.wander_count[begins] + 1, MAX_WANDERS)
        blocked_time[begins] = -swarm.mission.avoidance.wander_time * state.wander_count[begins]
    return wanders


def _limit(vectors: Float[Array, "agents 2"], most: float) -> Float[Array, "agents 2"]:
    """Shorten vectors to a length."""
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    share = np.divide(most, length, out=np.ones_like(length), where=length > most)
    return np.asarray(vectors * share[:, None])
