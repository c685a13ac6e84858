"""All vehicles for some control steps: what each measures, hears, wants, may do, and does.

The loop over vehicles calls what one vehicle does (`wanted`, `steer_clear`) with what that
vehicle has measured or was told, in its own frame; the truth is touched only where a sensor
looks and where the vehicle moves.
"""

from pathlib import Path
from typing import Any, NamedTuple, no_type_check
from zlib import crc32

import numba
import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy import ndarray as Array

from sato.formation.avoidance import CollisionAvoidance, avoid_collisions, limit_approach
from sato.formation.control_law import ControlLaw, compute_velocity_command
from sato.formation.sensors import (
    exchange_positions,
    locate_neighbors,
    measure_own_position,
    sense_nearby,
)

BLOCKED_SPEED_SHARE = 0.2  # of the largest speed: who wants more and goes slower is stopped


class FormationLimits(NamedTuple):
    """What a vehicle can do."""

    speed: float = 0.5  # largest in the plane [m/s]
    climb: float = 0.3  # largest up and down [m/s]
    acceleration: float = 0.5  # largest in the plane [m/s²]
    climb_acceleration: float = 0.8  # largest up and down [m/s²]
    per_axis: bool = (
        False  # the acceleration in the plane is limited on each axis, as in [Lusk2020]'s code
    )


class CoordinateFrames(NamedTuple):
    """The frame in which each vehicle reckons, and how it errs."""

    rotation: Complex[Array, " agents"]  # of its axes: e^(j yaw)
    origin: Float[Array, "agents 3"]  # of its origin [m]
    drift_rate: Float[Array, "agents 3"]  # of its reckoning, for each metre flown, in its own axes
    noise: float  # standard deviation of every measured coordinate [m]


class FormationData(NamedTuple):
    """What every vehicle was told of the shape: its own row is what it uses."""

    gains_xy: Complex[Array, "points points"]  # gains [1/s]
    gains_z: Float[Array, "points points"]  # gains [1/s]
    points: Float[Array, "points 3"]  # [m]
    neighbors: Int[Array, "points most"]  # of each point, padded with −1
    size_weights: Float[Array, "points points"]  # of the size control


class Timing(NamedTuple):
    """The beat of control and messages."""

    step: float  # of control [s]
    steps_per_message: int  # control steps between two position messages
    message_delay: int  # how many messages later a message arrives
    message_loss: float  # share of messages that are lost


class KernelParameters(NamedTuple):
    """What stays while a shape is flown to."""

    formation: FormationData
    coordinate_frames: CoordinateFrames
    control_law: ControlLaw
    avoidance: CollisionAvoidance
    limits: FormationLimits
    timing: Timing


class Roles(NamedTuple):
    """Who does what now."""

    assignment: Int[Array, " agents"]  # that each vehicle holds
    holder: Int[Array, "agents points"]  # of each point, as each vehicle has it
    is_active: Bool[Array, " agents"]  # the law; who does not hovers
    commanded_agent: int  # the vehicle that an operator steers; −1 none
    operator_velocity: Float[Array, " 3"]  # the velocity asked of it, in its own frame [m/s]


class FormationState(NamedTuple):
    """Where everything is; changed in place from step to step."""

    position: Float[Array, "agents 3"]  # true [m]
    velocity: Float[Array, "agents 3"]  # true [m/s]
    drift: Float[Array, "agents 3"]  # error of the reckoning, in the own frame [m]
    measured_position: Float[
        Array, "agents 3"
    ]  # own position in the own frame, as measured now [m]
    sent: Float[Array, "ring agents 3"]  # the last positions told, each in its teller's frame
    received: Float[Array, "agents agents 3"]  # [i, j]: the last of j's that reached i; NaN none
    velocity_command: Float[Array, "agents 3"]  # wanted by the law, in the own frame [m/s]
    avoiding: Bool[Array, " agents"]
    blocked_time: Float[Array, " agents"]  # for so long; negative: so long it still wanders [s]
    wander_direction: Complex[Array, " agents"]  # where it wanders, in the own frame
    path_length: Float[Array, " agents"]  # length of the path in the plane [m]
    min_separation: Float[Array, " agents"]  # anybody ever was to it in the plane, in truth [m]

    @classmethod
    def at_rest(cls, position: Float[Array, "agents 3"], message_delay: int) -> "FormationState":
        """Everybody at rest, and nothing told yet."""
        n = len(position)
        still = np.zeros((n, 3))
        return cls(
            position.copy(), still.copy(), still.copy(), still.copy(),
            np.full((message_delay + 1, n, 3), np.nan), np.full((n, n, 3), np.nan),
            still, np.zeros(n, dtype=bool), np.zeros(n), np.ones(n, dtype=complex),
            np.zeros(n), np.full(n, np.inf),
        )  # fmt: skip


@no_type_check
@numba.njit
def _update_velocity(i, state, swarm, others, room, rng):
    # From what is wanted to what is flown: the limits of speed, then the others around, then
    # the limits of acceleration.
    limits, rules, heading = swarm.limits, swarm.avoidance, swarm.coordinate_frames.rotation[i]
    u = state.velocity_command[i].copy()
    _clip_speed(u, limits.speed)
    u[2] = min(max(u[2], -limits.climb), limits.climb)
    wanders = not rules.legacy and _wander(i, u, state, swarm, rng)
    count = sense_nearby(i, state, swarm, others, rng)
    state.avoiding[i] = avoid_collisions(u, others, count, rules, room[0], room[1]) or wanders
    true = state.velocity[i]
    flat = np.conj(heading) * complex(true[0], true[1])
    v = np.array([flat.real, flat.imag])
    most = limits.acceleration * swarm.timing.step
    if limits.per_axis:
        for a in range(2):
            v[a] += min(max(u[a] - v[a], -most), most)
    else:
        w = v.copy()
        _step_towards(w, u, most)
        # While the velocity turns, others must not be approached too fast either.
        if not rules.legacy and limit_approach(w, others, count, rules):
            u[0], u[1] = w[0], w[1]
        _clip_speed(u, limits.speed)  # also who has to part from others
        _step_towards(v, u, most)
    flat = heading * complex(v[0], v[1])
    true[0], true[1] = flat.real, flat.imag
    most = limits.climb_acceleration * swarm.timing.step
    true[2] += min(max(u[2] - true[2], -most), most)


@no_type_check
@numba.njit
def _wander(i, u, state, swarm, rng):
    # Rules that are the same for all can stop all for good, each for another's sake. Who wants
    # to go and has been stopped for a while goes anywhere for a moment.
    v, limits, step = state.velocity[i], swarm.limits, swarm.timing.step
    wants, goes = np.sqrt(u[0] ** 2 + u[1] ** 2), np.sqrt(v[0] ** 2 + v[1] ** 2)
    if state.blocked_time[i] < 0:
        state.blocked_time[i] = min(0.0, state.blocked_time[i] + step)
        u[0] = limits.speed * state.wander_direction[i].real
        u[1] = limits.speed * state.wander_direction[i].imag
        return True
    stopped = state.avoiding[i] and wants > BLOCKED_SPEED_SHARE * limits.speed > goes
    state.blocked_time[i] = state.blocked_time[i] + step if stopped else 0.0
    if state.blocked_time[i] > swarm.avoidance.blocked_time:
        angle = 2 * np.pi * rng.random()
        state.wander_direction[i] = complex(np.cos(angle), np.sin(angle))
        state.blocked_time[i] = -swarm.avoidance.wander_time
    return False


@no_type_check
@numba.njit
def _clip_speed(u, most):
    speed = np.sqrt(u[0] * u[0] + u[1] * u[1])
    if speed > most:
        u[0], u[1] = u[0] * most / speed, u[1] * most / speed


@no_type_check
@numba.njit
def _step_towards(v, u, most):
    change = np.sqrt((u[0] - v[0]) ** 2 + (u[1] - v[1]) ** 2)
    share = min(1.0, most / change) if change > 0 else 1.0
    v[0] += share * (u[0] - v[0])
    v[1] += share * (u[1] - v[1])


@no_type_check
@numba.njit
def _integrate(i, state, swarm):
    v, step = state.velocity[i], swarm.timing.step
    flat = v[0] * v[0] + v[1] * v[1]
    state.path_length[i] += np.sqrt(flat) * step
    far = np.sqrt(flat + v[2] * v[2]) * step
    for a in range(3):
        state.position[i, a] += v[a] * step
        state.drift[i, a] += far * swarm.coordinate_frames.drift_rate[i, a]


def _compile_kernel(stamp: int) -> Any:
    # Numba compiles anew when the file of a function changes, or what it closes over. The
    # stamp is of all the files that are compiled into this one function.
    @numba.njit(cache=True)
    @no_type_check
    def fly(state, roles, swarm, first, steps, rng):
        """Fly some control steps.

        Args:
            state: Where everything is; changed in place.
            roles: Who does what.
            swarm: Laws, limits, frames and shape.
            first: Number of the first of these control steps.
            steps: How many.
            rng: Draws noise and losses.
        """
        n = len(state.position) if stamp >= 0 else 0
        sees, others, room = np.zeros((n, 3)), np.zeros((n, 2)), np.zeros((2, n))
        near = np.zeros(n, dtype=np.int64)
        for number in range(first, first + steps):
            measure_own_position(state, swarm.coordinate_frames, rng)
            if number % swarm.timing.steps_per_message == 0:
                exchange_positions(
                    state, roles, swarm, number // swarm.timing.steps_per_message, rng
                )
            for i in range(n):
                u = state.velocity_command[i]
                u[:] = 0.0
                if i == roles.commanded_agent:
                    u[:] = roles.operator_velocity
                elif roles.is_active[i]:
                    me = roles.assignment[i]
                    k = locate_neighbors(i, state, roles, swarm, sees, near)
                    formed = swarm.formation
                    compute_velocity_command(me, sees, near[:k], formed.gains_xy[me], formed.gains_z[me], formed.points,
                           formed.size_weights[me], swarm.control_law, u)  # fmt: skip
            for i in range(n):
                _update_velocity(i, state, swarm, others, room, rng)
            for i in range(n):
                _integrate(i, state, swarm)

    return fly


KERNEL_FILES = ("avoidance", "control_law", "kernel", "sensors")
_SOURCES = (Path(__file__).with_name(f"{name}.py").read_bytes() for name in KERNEL_FILES)
simulate_steps = _compile_kernel(crc32(b"".join(_SOURCES)))
