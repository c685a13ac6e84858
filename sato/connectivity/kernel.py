"""All robots for a control step: each senses, hears, reckons, decides and moves."""

from pathlib import Path
from typing import Any, NamedTuple, no_type_check
from zlib import crc32

import numba
import numpy as np

from dynamics.kinematic import KinematicVehicle, step_kinematic
from dynamics.quadrotor import Quadrotor, step_quadrotor
from problems.interaction_graph import Camera
from sato.connectivity.controller import CommandLimits, compute_command, estimate_edges
from sato.connectivity.flooding import (
    compute_lambda2_gradient,
    estimate_lambda2_from_rows,
    known_fiedler_vectors,
    smallest_eigenvalues,
)
from sato.connectivity.messages import CommunicationLink, exchange_messages
from sato.connectivity.obstacles import Obstacles
from sato.connectivity.potential import Potential, Repulsion
from sato.connectivity.power_iteration import (
    PowerIterationGains,
    estimate_lambda2_from_power,
    iterate_power,
)
from sato.connectivity.sensors import simulate_cameras, simulate_range_sensors
from sato.connectivity.yaw_estimator import YawTracking, rotate_about_z

EXACT, FLOOD, POWER = 0, 1, 2  # who tells λ₂
MAX_ROW_AGE = 1.0  # after which a row of the adjacency is no longer believed [s]


class SwarmParameters(NamedTuple):
    """What stays during a flight."""

    camera: Camera
    assumed_camera: Camera  # as the robots believe; wider where they are blind to the field of view
    potential: Potential
    repulsion: Repulsion
    tracking: YawTracking
    limits: CommandLimits
    link: CommunicationLink
    power_iteration: PowerIterationGains
    plant: KinematicVehicle
    quadrotor: Quadrotor
    is_quadrotor: bool  # it is the quadrotor that flies, and its camera tilts with it
    obstacles: Obstacles
    estimator: int  # EXACT, FLOOD or POWER
    camera_noise: float  # of every coordinate that a camera measures [m]
    occlusion: bool  # robots and obstacles stand in the line of sight
    body_radius: float  # radius of a robot that hides others [m]
    step: float  # [s]


@no_type_check
@numba.njit
def _sense_and_decide(state, team, number, rng):
    world, senses, mail, mind = state
    n, time = len(world.position), number * team.step
    simulate_cameras(world, senses, team, rng)
    simulate_range_sensors(world, senses, team)
    exchange_messages(
        senses, mail, mind, team.link, team.estimator == FLOOD, number, team.step, rng
    )
    for i in range(n):
        if world.alive[i]:
            estimate_edges(i, senses, mail, mind, team, time)
    now = np.where(world.alive, time, -np.inf)
    world.eigenvalues[0], world.eigenvalues[1] = smallest_eigenvalues(world.weight, now)
    if team.estimator == POWER:
        # Between the steps of control, and by themselves: neither lost nor late.
        linked = senses.visibility | senses.visibility.T
        iterate_power(
            mind.power_iteration,
            mind.weight,
            linked,
            team.power_iteration,
            round(team.step / team.power_iteration.exchange_period),
        )
    if team.estimator == EXACT:
        _estimate_centrally(world.alive, mind)
    for i in range(n):
        if world.alive[i]:
            if team.estimator == FLOOD:
                mind.lambda2[i] = estimate_lambda2_from_rows(
                    mind.adjacency_rows[i],
                    mind.row_time[i],
                    i,
                    time - MAX_ROW_AGE,
                    mind.eigenvector_guess[i],
                    mind.lambda2_gradient[i],
                )
            elif team.estimator == POWER:
                _estimate_by_power_iteration(i, mind, team)
            compute_command(i, senses, mind, team)


@no_type_check
@numba.njit
def _estimate_centrally(alive, mind):
    # From outside, of the weights that all robots have themselves.
    known = np.flatnonzero(alive)
    mind.lambda2[:], mind.lambda2_gradient[:] = np.nan, 0.0
    if len(known) > 1:
        lambda2, vectors = known_fiedler_vectors(
            mind.weight, known, mind.eigenvector_guess[known[0]]
        )
        for i in known:
            mind.lambda2[i] = lambda2
            compute_lambda2_gradient(vectors, known, i, mind.lambda2_gradient[i])


@no_type_check
@numba.njit
def _estimate_by_power_iteration(i, mind, team):
    # |v̂|² tends to N (1 − (e₂/e₃) λ₂); z₂ is its average. Who is left alone, or reports what
    # there cannot be, does not know, and goes on as it last did.
    found, size = (
        estimate_lambda2_from_power(mind.power_iteration, i, team.power_iteration),
        mind.power_iteration.average[i, 1],
    )
    if not 0 <= found <= 1.1 * team.potential.lambda2_max or size < 0.05:
        return
    n = len(mind.relative_yaw)
    mind.lambda2[i] = found
    for j in range(n):
        apart = mind.power_iteration.v[i] - mind.power_iteration.v[j]
        mind.lambda2_gradient[i, j] = apart * apart / (n * size)


@no_type_check
@numba.njit
def _move_agents(state, team, asked, rng):
    world, senses, u = state.truth, state.measurements, state.estimates.command
    v = np.zeros(3)
    if world.alive[0]:
        rotate_about_z(asked, -world.yaw[0], v)
        for a in range(3):
            u[0, a] += v[a]
    for i in range(len(world.position)):
        if not world.alive[i]:
            continue
        if team.is_quadrotor:
            rotate_about_z(senses.velocity[i], world.yaw[i], v)
            world.yaw[i], senses.yaw_rate[i] = step_quadrotor(
                world.position[i], world.yaw[i], v, senses.yaw_rate[i], world.acceleration[i],
                u[i], u[i, 3], team.quadrotor, team.step,
            )  # fmt: skip
            rotate_about_z(v, -world.yaw[i], senses.velocity[i])
        else:
            world.yaw[i], senses.yaw_rate[i] = step_kinematic(
                world.position[i], world.yaw[i], senses.velocity[i], senses.yaw_rate[i],
                u[i], u[i, 3], team.plant, team.step, rng,
            )  # fmt: skip


@no_type_check
@numba.njit
def _remove_lost(alive, state):
    # The dead rest, ask for nothing and know nothing.
    state.truth.alive[:] = alive
    for i in range(len(alive)):
        if not alive[i]:
            state.measurements.velocity[i], state.measurements.yaw_rate[i] = 0.0, 0.0
            state.estimates.command[i], state.estimates.lambda2[i] = 0.0, np.nan


def _compile_advance(stamp: int) -> Any:
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
                _move_agents(state, team, asked, rng)
            _remove_lost(alive, state)
            _sense_and_decide(state, team, number, rng)

    return advance


FOLDER = Path(__file__).parent
KERNEL_FILES = (
    *(
        FOLDER / f"{name}.py"
        for name in (
            "flooding",
            "messages",
            "controller",
            "obstacle_geometry",
            "potential",
            "power_iteration",
            "sensors",
            "kernel",
            "yaw_estimator",
        )
    ),
    *(FOLDER.parents[1] / "dynamics" / f"{name}.py" for name in ("kinematic", "quadrotor")),
    *(
        FOLDER.parents[1] / "problems" / f"{name}.py"
        for name in ("fiedler_tracking", "interaction_graph")
    ),
)
advance = _compile_advance(crc32(b"".join(file.read_bytes() for file in KERNEL_FILES)))
