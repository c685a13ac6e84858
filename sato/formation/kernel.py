"""Control steps of all agents, compiled: measure, communicate, command, avoid, move.

The loop over agents calls the functions of one agent (`compute_velocity_command`,
`avoid_collisions`) with what that agent measured or received, in its own frame. Only the
sensors and the equations of motion use the true state.
"""

from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numba
import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy import ndarray as Array

from sato.formation.avoidance import SPEED_SIDES, avoid_collisions, limit_approach
from sato.formation.control_law import FormationData, compute_velocity_command
from sato.formation.mission import Formation
from sato.formation.sectors import leave_sectors
from sato.formation.sensing import (
    compute_track_gains,
    exchange_positions,
    locate_neighbors,
    measure_own_position,
    sense_nearby,
    track_nearby,
)
from sato.formation.settings import (
    BLOCKED_SPEED_SHARE,
    CollisionAvoidance,
    ControlLaw,
    CoordinateFrames,
)

MAX_WANDERS = 8  # after which wandering takes no longer


class KernelParameters(NamedTuple):
    """Constants of the flight to one formation."""

    formation: FormationData
    # By the names that they have in the mission:
    coordinate_frames: CoordinateFrames
    control_law: ControlLaw
    avoidance: CollisionAvoidance
    keep_out: float  # [m]
    max_speed: float  # [m/s]
    max_climb: float  # [m/s]
    max_acceleration: float  # [m/s²]
    max_climb_acceleration: float  # [m/s²]
    step: float  # of control [s]

    noise: float  # standard deviation of a measured coordinate [m]
    track_gains: tuple[float, float]  # of position and of velocity, see `compute_track_gains`
    steps_per_message: int  # control steps between two position messages
    message_delay: int  # messages by which a message arrives late
    message_loss: float  # probability that a message is lost

    @classmethod
    def for_leg(cls, mission: Formation, leg: int) -> "KernelParameters":
        """Collect the constants of a leg of a drawn mission."""
        radio = mission.radio
        same = {name: getattr(mission, name) for name in cls._fields[1:10]}
        return cls(
            FormationData.from_gains(mission.gains[leg]),
            **same,
            noise=mission.frames.noise,
            track_gains=compute_track_gains(
                mission.frames.noise, mission.max_acceleration, mission.step
            ),
            steps_per_message=max(1, round(1 / (radio.message_rate * mission.step))),
            message_delay=radio.delay_rounds,
            message_loss=radio.loss_probability,
        )


class Roles(NamedTuple):
    """Assignment and commands that hold between two control steps."""

    assignment: Int[Array, " agents"]  # point that each agent holds
    holder: Int[Array, "agents points"]  # of each point, as each agent knows it
    is_active: Bool[Array, " agents"]  # True where the control law is on; else the agent hovers
    commanded_agent: int  # agent that an operator steers; −1 none
    operator_velocity: Float[Array, " 3"]  # commanded velocity, in that agent's frame [m/s]


class FormationState(NamedTuple):
    """State of all agents, changed in place from step to step."""

    position: Float[Array, "agents 3"]  # true [m]
    velocity: Float[Array, "agents 3"]  # true [m/s]
    drift: Float[Array, "agents 3"]  # odometry error, in the own frame [m]
    measured_position: Float[Array, "agents 3"]  # in the own frame [m]
    sent: Float[Array, "ring agents 3"]  # last positions sent, each in the sender's frame [m]
    received: Float[Array, "agents agents 3"]  # [i, j]: last of j's to reach i; NaN none [m]
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
            received=np.full((n, n, 3), np.nan),
            velocity_command=command,
            tracks=np.full((n, n, 4), np.nan),
            avoiding=np.zeros(n, dtype=bool),
            blocked_time=np.zeros(n),
            wander_direction=np.ones(n, dtype=complex),
            wander_count=np.zeros(n, dtype=np.int64),
        )

    def begin_way(self, agents: Int[Array, " k"]) -> None:
        """Let agents forget that others have blocked them, as they hold other points now."""
        self.blocked_time[agents], self.wander_count[agents] = 0.0, 0


@numba.njit
def _update_velocity(i, state, swarm, others, planes, rng):
    # Limits of speed, then avoidance, then limits of acceleration.
    rules, keep_out = swarm.avoidance, swarm.keep_out
    heading = swarm.coordinate_frames.rotation[i]
    u = state.velocity_command[i].copy()
    _clip_speed(u, swarm.max_speed)
    u[2] = min(max(u[2], -swarm.max_climb), swarm.max_climb)
    true = state.velocity[i]
    flat = np.conj(heading) * complex(true[0], true[1])
    v = np.array([flat.real, flat.imag])
    most = swarm.max_acceleration * swarm.step
    if rules.legacy:
        count = sense_nearby(i, state, swarm, others, rng)
        state.avoiding[i] = leave_sectors(u, others, count, keep_out, rules, planes)
        for a in range(2):
            v[a] += min(max(u[a] - v[a], -most), most)
    else:
        wanders = _wander(i, u, state, swarm, rng)
        count = track_nearby(i, v, state, swarm, others, rng)
        own = v, others, count, keep_out, rules, swarm.max_speed, planes
        state.avoiding[i] = avoid_collisions(u, *own) or wanders
        w = v.copy()
        _step_towards(w, u, most)
        # While the velocity turns, others must not be approached too fast either.
        if limit_approach(w, others, count, keep_out, rules, planes):
            u[0], u[1] = w[0], w[1]
        _clip_speed(u, swarm.max_speed)  # also where an agent has to separate from others
        _step_towards(v, u, most)
    flat = heading * complex(v[0], v[1])
    true[0], true[1] = flat.real, flat.imag
    most = swarm.max_climb_acceleration * swarm.step
    true[2] += min(max(u[2] - true[2], -most), most)


@numba.njit
def _wander(i, u, state, swarm, rng):
    # Rules that are the same for all agents can stop all of them for good, each because of
    # another. An agent that has been stopped for a while flies anywhere for a moment.
    v, max_speed, step = state.velocity[i], swarm.max_speed, swarm.step
    commanded, flown = np.sqrt(u[0] ** 2 + u[1] ** 2), np.sqrt(v[0] ** 2 + v[1] ** 2)
    if state.blocked_time[i] < 0:
        state.blocked_time[i] = min(0.0, state.blocked_time[i] + step)
        u[0] = max_speed * state.wander_direction[i].real
        u[1] = max_speed * state.wander_direction[i].imag
        return True
    stopped = state.avoiding[i] and commanded > BLOCKED_SPEED_SHARE * max_speed > flown
    state.blocked_time[i] = state.blocked_time[i] + step if stopped else 0.0
    if state.blocked_time[i] > swarm.avoidance.blocked_time:
        away = complex(0.0, 0.0)  # from the middle of those that it tracks
        for track in state.tracks[i]:
            if not np.isnan(track[0]):
                away -= complex(track[0], track[1])
        angle = np.angle(away) + np.pi / 2 * (rng.random() - 0.5)
        state.wander_direction[i] = complex(np.cos(angle), np.sin(angle))
        state.wander_count[i] = min(state.wander_count[i] + 1, MAX_WANDERS)
        state.blocked_time[i] = -swarm.avoidance.wander_time * state.wander_count[i]
    return False


@numba.njit
def _clip_speed(u, most):
    speed = np.sqrt(u[0] * u[0] + u[1] * u[1])
    if speed > most:
        u[0], u[1] = u[0] * most / speed, u[1] * most / speed


@numba.njit
def _step_towards(v, u, most):
    change = np.sqrt((u[0] - v[0]) ** 2 + (u[1] - v[1]) ** 2)
    share = min(1.0, most / change) if change > 0 else 1.0
    v[0] += share * (u[0] - v[0])
    v[1] += share * (u[1] - v[1])


def _compile_kernel(stamp: int) -> Any:
    # Numba compiles anew when the file of a function changes, or what it closes over. The
    # stamp covers all files that are compiled into this one function.
    @numba.njit(cache=True)
    def simulate_steps(state, roles, swarm, first, steps, rng):
        """Simulate some control steps.

        Args:
            state: A `FormationState`, changed in place.
            roles: Assignment and commands, `Roles`.
            swarm: Constants, `KernelParameters`.
            first: Number of the first of these control steps.
            steps: Number of control steps.
            rng: Generator for noise and lost messages.
        """
        n = len(state.position) if stamp >= 0 else 0
        relative, others = np.zeros((n, 3)), np.zeros((n, 4))
        planes = np.zeros((2 * n + SPEED_SIDES, 3))
        near = np.zeros(n, dtype=np.int64)
        formation, law, legacy = swarm.formation, swarm.control_law, swarm.avoidance.legacy
        for number in range(first, first + steps):
            measure_own_position(state, swarm, rng)
            message, rest = divmod(number, swarm.steps_per_message)
            if rest == 0:
                exchange_positions(state, roles, swarm, message, rng)
            for i in range(n):
                u = state.velocity_command[i]
                u[:] = 0.0
                if i == roles.commanded_agent:
                    u[:] = roles.operator_velocity
                    state.blocked_time[i] = 0.0  # it does not wander
                elif roles.is_active[i]:
                    me = roles.assignment[i]
                    k = locate_neighbors(i, state, roles, swarm, relative, near)
                    compute_velocity_command(me, relative, near[:k], formation, law, legacy, u)
            for i in range(n):
                _update_velocity(i, state, swarm, others, planes, rng)
            v = state.velocity
            length = np.sqrt(v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1] + v[:, 2] * v[:, 2])
            state.position[:] += v * swarm.step
            drift_rate = swarm.coordinate_frames.drift_rate
            state.drift[:] += np.expand_dims(length * swarm.step, 1) * drift_rate

    return simulate_steps


KERNEL_FILES = ("avoidance", "control_law", "kernel", "sectors", "sensing", "settings")
_SOURCES = (Path(__file__).with_name(f"{name}.py").read_bytes() for name in KERNEL_FILES)
simulate_steps = _compile_kernel(crc32(b"".join(_SOURCES)))
