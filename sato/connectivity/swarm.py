"""All robots for a control step: each senses, hears, reckons, decides and moves."""

from pathlib import Path
from typing import Any, NamedTuple, no_type_check
from zlib import crc32

import numba
import numpy as np

from dynamics.kinematic import Kinematic, drive
from dynamics.quadrotor import Quadrotor, fly
from problems.graph import Sight
from sato.connectivity.flood import eigen, eigenvectors, feel_edges, two_least
from sato.connectivity.mail import Link, talk
from sato.connectivity.mind import decide, reckon
from sato.connectivity.obstacles import Obstacles
from sato.connectivity.potential import Potential, Repulsion
from sato.connectivity.power import Power, estimate, exchange
from sato.connectivity.senses import feel, look
from sato.connectivity.yaw import Tracking, revolve

EXACT, FLOOD, POWER = 0, 1, 2  # who tells λ₂
FORGET = 1.0  # after which a row of the adjacency is no longer believed [s]


class Limits(NamedTuple):
    """What a robot asks of itself at most, on top of the operator's command."""

    speed: float = 3.0  # [m/s]
    turn: float = 1.5  # [rad/s]


class Team(NamedTuple):
    """What stays during a flight."""

    camera: Sight
    sight: Sight  # as the robots believe; wider where they are blind to the field of view
    potential: Potential
    repulsion: Repulsion
    tracking: Tracking
    limits: Limits
    link: Link
    power: Power
    plant: Kinematic
    quadrotor: Quadrotor
    tilts: bool  # it is the quadrotor that flies, and its camera tilts with it
    obstacles: Obstacles
    estimator: int  # EXACT, FLOOD or POWER
    noise: float  # of every coordinate that a camera measures [m]
    occlusion: bool  # robots and obstacles stand in the line of sight
    body: float  # radius of a robot that hides others [m]
    step: float  # [s]


@no_type_check
@numba.njit
def _think(state, team, number, rng):
    world, senses, mail, mind = state
    n, time = len(world.position), number * team.step
    look(world, senses, team, rng)
    feel(world, senses, team)
    talk(senses, mail, mind, team.link, team.estimator == FLOOD, number, team.step, rng)
    for i in range(n):
        if world.alive[i]:
            reckon(i, senses, mail, mind, team, time)
    now = np.where(world.alive, time, -np.inf)
    world.lambdas[0], world.lambdas[1] = two_least(world.weight, now)
    if team.estimator == POWER:
        # Between the steps of control, and by themselves: neither lost nor late.
        linked = senses.sees | senses.sees.T
        exchange(
            mind.iterate, mind.weight, linked, team.power, round(team.step / team.power.exchange)
        )
    if team.estimator == EXACT:
        _told(world.alive, mind)
    for i in range(n):
        if world.alive[i]:
            if team.estimator == FLOOD:
                mind.lambda2[i] = eigen(
                    mind.rows[i], mind.stamp[i], i, time - FORGET, mind.modes[i], mind.felt[i]
                )
            elif team.estimator == POWER:
                _of_power(i, mind, team)
            decide(i, senses, mind, team)


@no_type_check
@numba.njit
def _told(alive, mind):
    # From outside, of the weights that all robots have themselves.
    known = np.flatnonzero(alive)
    mind.lambda2[:], mind.felt[:] = np.nan, 0.0
    if len(known) > 1:
        lambda2, vectors = eigenvectors(mind.weight, known, mind.modes[known[0]])
        for i in known:
            mind.lambda2[i] = lambda2
            feel_edges(vectors, known, i, mind.felt[i])


@no_type_check
@numba.njit
def _of_power(i, mind, team):
    # |v̂|² tends to N (1 − (e₂/e₃) λ₂); z₂ is its average. Who is left alone, or reports what
    # there cannot be, does not know, and goes on as it last did.
    found, size = estimate(mind.iterate, i, team.power), mind.iterate.mean[i, 1]
    if not 0 <= found <= 1.1 * team.potential.most or size < 0.05:
        return
    n = len(mind.turned)
    mind.lambda2[i] = found
    for j in range(n):
        apart = mind.iterate.v[i] - mind.iterate.v[j]
        mind.felt[i, j] = apart * apart / (n * size)


@no_type_check
@numba.njit
def _move(state, team, asked, rng):
    world, senses, u = state.world, state.senses, state.mind.command
    v = np.zeros(3)
    if world.alive[0]:
        revolve(asked, -world.yaw[0], v)
        for a in range(3):
            u[0, a] += v[a]
    for i in range(len(world.position)):
        if not world.alive[i]:
            continue
        if team.tilts:
            revolve(senses.velocity[i], world.yaw[i], v)
            world.yaw[i], senses.rate[i] = fly(
                world.position[i], world.yaw[i], v, senses.rate[i], world.push[i],
                u[i], u[i, 3], team.quadrotor, team.step,
            )  # fmt: skip
            revolve(v, -world.yaw[i], senses.velocity[i])
        else:
            world.yaw[i], senses.rate[i] = drive(
                world.position[i], world.yaw[i], senses.velocity[i], senses.rate[i],
                u[i], u[i, 3], team.plant, team.step, rng,
            )  # fmt: skip


@no_type_check
@numba.njit
def _bury(alive, state):
    # The dead rest, ask for nothing and know nothing.
    state.world.alive[:] = alive
    for i in range(len(alive)):
        if not alive[i]:
            state.senses.velocity[i], state.senses.rate[i] = 0.0, 0.0
            state.mind.command[i], state.mind.lambda2[i] = 0.0, np.nan


def _kernel(stamp: int) -> Any:
    # Numba compiles anew when the file of a function changes, or what it closes over. The
    # stamp is of all the files that are compiled into this function. It is one, for numba
    # takes longer to read the state than six robots to decide.
    @no_type_check
    @numba.njit(cache=True)
    def advance(state, team, asked, alive, number, moves, rng):
        """Everybody moves as it decided a step ago; then senses, talks, reckons and decides.

        Args:
            state: Changed in place.
            team: What stays.
            asked: Velocity that the operator asks of the leader, in the world frame, (3,) [m/s].
            alive: Who is there from then on, (n,).
            number: Of the control step.
            moves: False: nobody moves yet.
            rng: Draws noise and losses.
        """
        if stamp >= 0:
            if moves:
                _move(state, team, asked, rng)
            _bury(alive, state)
            _think(state, team, number, rng)

    return advance


HERE = Path(__file__).parent
FILES = (
    *(
        HERE / f"{name}.py"
        for name in (
            "flood",
            "mail",
            "mind",
            "obstacles",
            "potential",
            "power",
            "senses",
            "swarm",
            "yaw",
        )
    ),
    *(HERE.parents[1] / "dynamics" / f"{name}.py" for name in ("kinematic", "quadrotor")),
    *(HERE.parents[1] / "problems" / f"{name}.py" for name in ("fiedler", "graph")),
)
advance = _kernel(crc32(b"".join(file.read_bytes() for file in FILES)))
