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

from sato.formation.avoidance import Avoidance, hold_back, steer_clear
from sato.formation.law import Law, wanted
from sato.formation.senses import around, look, reckon, talk

SLOW = 0.2  # of the largest speed: who wants more and goes slower is stopped


class Limits(NamedTuple):
    """What a vehicle can do."""

    speed: float = 0.5  # largest in the plane [m/s]
    climb: float = 0.3  # largest up and down [m/s]
    acceleration: float = 0.5  # largest in the plane [m/s²]
    climb_acceleration: float = 0.8  # largest up and down [m/s²]
    each_axis: bool = (
        False  # the acceleration in the plane is limited on each axis, as in [Lusk2020]'s code
    )


class Frames(NamedTuple):
    """The frame in which each vehicle reckons, and how it errs."""

    heading: Complex[Array, " agents"]  # of its axes: e^(j yaw)
    offset: Float[Array, "agents 3"]  # of its origin [m]
    drift: Float[Array, "agents 3"]  # of its reckoning, for each metre flown, in its own axes
    noise: float  # standard deviation of every measured coordinate [m]


class Formed(NamedTuple):
    """What every vehicle was told of the shape: its own row is what it uses."""

    xy: Complex[Array, "points points"]  # gains [1/s]
    z: Float[Array, "points points"]  # gains [1/s]
    points: Float[Array, "points 3"]  # [m]
    neighbours: Int[Array, "points most"]  # of each point, padded with −1
    weight: Float[Array, "points points"]  # of the size control


class Pace(NamedTuple):
    """The beat of control and messages."""

    step: float  # of control [s]
    every: int  # control steps between two position messages
    late: int  # how many messages later a message arrives
    loss: float  # share of messages that are lost


class Swarm(NamedTuple):
    """What stays while a shape is flown to."""

    formed: Formed
    frames: Frames
    law: Law
    rules: Avoidance
    limits: Limits
    pace: Pace


class Roles(NamedTuple):
    """Who does what now."""

    point: Int[Array, " agents"]  # that each vehicle holds
    holder: Int[Array, "agents points"]  # of each point, as each vehicle has it
    follows: Bool[Array, " agents"]  # the law; who does not hovers
    pushed: int  # the vehicle that an operator steers; −1 none
    push: Float[Array, " 3"]  # the velocity asked of it, in its own frame [m/s]


class State(NamedTuple):
    """Where everything is; changed in place from step to step."""

    position: Float[Array, "agents 3"]  # true [m]
    velocity: Float[Array, "agents 3"]  # true [m/s]
    drifted: Float[Array, "agents 3"]  # error of the reckoning, in the own frame [m]
    reckoned: Float[Array, "agents 3"]  # own position in the own frame, as measured now [m]
    told: Float[Array, "ring agents 3"]  # the last positions told, each in its teller's frame
    heard: Float[Array, "agents agents 3"]  # [i, j]: the last of j's that reached i; NaN none
    command: Float[Array, "agents 3"]  # wanted by the law, in the own frame [m/s]
    avoiding: Bool[Array, " agents"]
    blocked: Float[Array, " agents"]  # for so long; negative: so long it still wanders [s]
    astray: Complex[Array, " agents"]  # where it wanders, in the own frame
    flown: Float[Array, " agents"]  # length of the path in the plane [m]
    nearest: Float[Array, " agents"]  # anybody ever was to it in the plane, in truth [m]

    @classmethod
    def resting(cls, position: Float[Array, "agents 3"], late: int) -> "State":
        """Everybody at rest, and nothing told yet."""
        n = len(position)
        still = np.zeros((n, 3))
        return cls(
            position.copy(), still.copy(), still.copy(), still.copy(),
            np.full((late + 1, n, 3), np.nan), np.full((n, n, 3), np.nan),
            still, np.zeros(n, dtype=bool), np.zeros(n), np.ones(n, dtype=complex),
            np.zeros(n), np.full(n, np.inf),
        )  # fmt: skip


@no_type_check
@numba.njit
def _obey(i, state, swarm, others, room, rng):
    # From what is wanted to what is flown: the limits of speed, then the others around, then
    # the limits of acceleration.
    limits, rules, heading = swarm.limits, swarm.rules, swarm.frames.heading[i]
    u = state.command[i].copy()
    _slow_down(u, limits.speed)
    u[2] = min(max(u[2], -limits.climb), limits.climb)
    wanders = not rules.printed and _wander(i, u, state, swarm, rng)
    count = around(i, state, swarm, others, rng)
    state.avoiding[i] = steer_clear(u, others, count, rules, room[0], room[1]) or wanders
    true = state.velocity[i]
    flat = np.conj(heading) * complex(true[0], true[1])
    v = np.array([flat.real, flat.imag])
    most = limits.acceleration * swarm.pace.step
    if limits.each_axis:
        for a in range(2):
            v[a] += min(max(u[a] - v[a], -most), most)
    else:
        w = v.copy()
        _towards(w, u, most)
        # While the velocity turns, others must not be approached too fast either.
        if not rules.printed and hold_back(w, others, count, rules):
            u[0], u[1] = w[0], w[1]
        _slow_down(u, limits.speed)  # also who has to part from others
        _towards(v, u, most)
    flat = heading * complex(v[0], v[1])
    true[0], true[1] = flat.real, flat.imag
    most = limits.climb_acceleration * swarm.pace.step
    true[2] += min(max(u[2] - true[2], -most), most)


@no_type_check
@numba.njit
def _wander(i, u, state, swarm, rng):
    # Rules that are the same for all can stop all for good, each for another's sake. Who wants
    # to go and has been stopped for a while goes anywhere for a moment.
    v, limits, step = state.velocity[i], swarm.limits, swarm.pace.step
    wants, goes = np.sqrt(u[0] ** 2 + u[1] ** 2), np.sqrt(v[0] ** 2 + v[1] ** 2)
    if state.blocked[i] < 0:
        state.blocked[i] = min(0.0, state.blocked[i] + step)
        u[0] = limits.speed * state.astray[i].real
        u[1] = limits.speed * state.astray[i].imag
        return True
    stopped = state.avoiding[i] and wants > SLOW * limits.speed > goes
    state.blocked[i] = state.blocked[i] + step if stopped else 0.0
    if state.blocked[i] > swarm.rules.patience:
        angle = 2 * np.pi * rng.random()
        state.astray[i] = complex(np.cos(angle), np.sin(angle))
        state.blocked[i] = -swarm.rules.wander
    return False


@no_type_check
@numba.njit
def _slow_down(u, most):
    speed = np.sqrt(u[0] * u[0] + u[1] * u[1])
    if speed > most:
        u[0], u[1] = u[0] * most / speed, u[1] * most / speed


@no_type_check
@numba.njit
def _towards(v, u, most):
    change = np.sqrt((u[0] - v[0]) ** 2 + (u[1] - v[1]) ** 2)
    share = min(1.0, most / change) if change > 0 else 1.0
    v[0] += share * (u[0] - v[0])
    v[1] += share * (u[1] - v[1])


@no_type_check
@numba.njit
def _move(i, state, swarm):
    v, step = state.velocity[i], swarm.pace.step
    flat = v[0] * v[0] + v[1] * v[1]
    state.flown[i] += np.sqrt(flat) * step
    far = np.sqrt(flat + v[2] * v[2]) * step
    for a in range(3):
        state.position[i, a] += v[a] * step
        state.drifted[i, a] += far * swarm.frames.drift[i, a]


def _kernel(stamp: int) -> Any:
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
            reckon(state, swarm.frames, rng)
            if number % swarm.pace.every == 0:
                talk(state, roles, swarm, number // swarm.pace.every, rng)
            for i in range(n):
                u = state.command[i]
                u[:] = 0.0
                if i == roles.pushed:
                    u[:] = roles.push
                elif roles.follows[i]:
                    me = roles.point[i]
                    k = look(i, state, roles, swarm, sees, near)
                    formed = swarm.formed
                    wanted(me, sees, near[:k], formed.xy[me], formed.z[me], formed.points,
                           formed.weight[me], swarm.law, u)  # fmt: skip
            for i in range(n):
                _obey(i, state, swarm, others, room, rng)
            for i in range(n):
                _move(i, state, swarm)

    return fly


FILES = ("avoidance", "law", "senses", "swarm")
_SOURCES = (Path(__file__).with_name(f"{name}.py").read_bytes() for name in FILES)
fly = _kernel(crc32(b"".join(_SOURCES)))
