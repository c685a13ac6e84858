"""Compiled control step of all agents: move, measure, exchange messages, estimate, command."""

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

EXACT, FLOOD, POWER = 0, 1, 2  # estimators of λ₂
MAX_ROW_AGE = 1.0  # age at which a row of the adjacency matrix is forgotten [s]


class SwarmParameters(NamedTuple):
    """Parameters of the kernels, constant during a simulation."""

    camera: Camera
    assumed_camera: Camera  # of the controllers; wider where they ignore the field of view
    potential: Potential
    repulsion: Repulsion
    tracking: YawTracking
    limits: CommandLimits
    link: CommunicationLink
    power_iteration: PowerIterationGains
    plant: KinematicVehicle
    quadrotor: Quadrotor
    is_quadrotor: bool  # True where quadrotors fly, whose cameras tilt
    obstacles: Obstacles
    estimator: int  # EXACT, FLOOD or POWER
    camera_noise: float  # standard deviation of each measured coordinate [m]
    occlusion: bool
    body_radius: float  # [m]
    step: float  # [s]


@no_type_check
@numba.njit
def _measure_and_command(state, parameters, number, rng):
    truth, measurements, messages, estimates = state
    n, time = len(truth.position), number * parameters.step
    simulate_cameras(truth, measurements, parameters, rng)
    simulate_range_sensors(truth, measurements, parameters)
    exchange_messages(
        measurements, messages, estimates, parameters.link, parameters.estimator == FLOOD, number,
        parameters.step, rng,
    )  # fmt: skip
    for i in range(n):
        if truth.alive[i]:
            estimate_edges(i, measurements, messages, estimates, parameters, time)
    row_time = np.where(truth.alive, time, -np.inf)
    truth.eigenvalues[0], truth.eigenvalues[1] = smallest_eigenvalues(truth.weight, row_time)
    if parameters.estimator == POWER:
        # Exchanged between control steps, without loss or delay.
        hears = measurements.visibility | measurements.visibility.T
        exchanges = round(parameters.step / parameters.power_iteration.exchange_period)
        iterate_power(
            estimates.power_iteration, estimates.weight, hears, parameters.power_iteration,
            exchanges,
        )  # fmt: skip
    if parameters.estimator == EXACT:
        _estimate_centrally(truth.alive, estimates)
    for i in range(n):
        if not truth.alive[i]:
            continue
        if parameters.estimator == FLOOD:
            estimates.lambda2[i] = estimate_lambda2_from_rows(
                estimates.adjacency_rows[i], estimates.row_time[i], i, time - MAX_ROW_AGE,
                estimates.eigenvector_guess[i], estimates.lambda2_gradient[i],
            )  # fmt: skip
        elif parameters.estimator == POWER:
            _estimate_by_power_iteration(i, estimates, parameters)
        compute_command(i, measurements, estimates, parameters)


@no_type_check
@numba.njit
def _estimate_centrally(alive, estimates):
    # Decomposes the matrix of the weights that the agents estimate.
    known = np.flatnonzero(alive)
    estimates.lambda2[:], estimates.lambda2_gradient[:] = np.nan, 0.0
    if len(known) > 1:
        guess = estimates.eigenvector_guess[known[0]]
        lambda2, vectors = known_fiedler_vectors(estimates.weight, known, guess)
        for i in known:
            estimates.lambda2[i] = lambda2
            compute_lambda2_gradient(vectors, known, i, estimates.lambda2_gradient[i])


@no_type_check
@numba.njit
def _estimate_by_power_iteration(i, estimates, parameters):
    # |v̂|² tends to N (1 − (e₂/e₃) λ₂), and z₂ is its mean. The estimate of an isolated agent
    # is out of range; the last one is then kept.
    iterates, n = estimates.power_iteration, len(estimates.relative_yaw)
    lambda2 = estimate_lambda2_from_power(iterates, i, parameters.power_iteration)
    size = iterates.average[i, 1]
    if not 0 <= lambda2 <= 1.1 * parameters.potential.lambda2_max or size < 0.05:
        return
    estimates.lambda2[i] = lambda2
    for j in range(n):
        difference = iterates.v[i] - iterates.v[j]
        estimates.lambda2_gradient[i, j] = difference * difference / (n * size)


@no_type_check
@numba.njit
def _move_agents(state, parameters, stick, rng):
    truth, measurements, u = state.truth, state.measurements, state.estimates.command
    v = np.zeros(3)
    if truth.alive[0]:
        rotate_about_z(stick, -truth.yaw[0], v)
        u[0, :3] += v
    for i in range(len(truth.position)):
        if not truth.alive[i]:
            continue
        if parameters.is_quadrotor:
            rotate_about_z(measurements.velocity[i], truth.yaw[i], v)
            truth.yaw[i], measurements.yaw_rate[i] = step_quadrotor(
                truth.position[i], truth.yaw[i], v, measurements.yaw_rate[i],
                truth.acceleration[i], u[i], u[i, 3], parameters.quadrotor, parameters.step,
            )  # fmt: skip
            rotate_about_z(v, -truth.yaw[i], measurements.velocity[i])
        else:
            truth.yaw[i], measurements.yaw_rate[i] = step_kinematic(
                truth.position[i], truth.yaw[i], measurements.velocity[i],
                measurements.yaw_rate[i], u[i], u[i, 3], parameters.plant, parameters.step, rng,
            )  # fmt: skip


@no_type_check
@numba.njit
def _remove_lost(alive, state):
    # Lost agents stop, command nothing and know nothing.
    state.truth.alive[:] = alive
    for i in range(len(alive)):
        if not alive[i]:
            state.measurements.velocity[i], state.measurements.yaw_rate[i] = 0.0, 0.0
            state.estimates.command[i], state.estimates.lambda2[i] = 0.0, np.nan


def _compile_advance(stamp: int) -> Any:
    # Numba compiles anew when the file of a function or a closed-over value changes, so the
    # stamp covers all files that are compiled into this one function. It is one function
    # because passing the state to numba takes longer than the commands of six agents.
    @no_type_check
    @numba.njit(cache=True)
    def advance(state, parameters, stick, alive, number, is_moving, rng):
        """Move as commanded a step ago; then measure, exchange messages and command.

        Args:
            state: State, changed in place.
            parameters: Parameters of the swarm.
            stick: Velocity that the operator commands to agent 0, world frame, (3,) [m/s].
            alive: True for agents that take part from now on, (n,).
            number: Number of the control step.
            is_moving: False while nothing moves yet.
            rng: Draws noise and message losses.
        """
        if stamp >= 0:
            if is_moving:
                _move_agents(state, parameters, stick, rng)
            _remove_lost(alive, state)
            _measure_and_command(state, parameters, number, rng)

    return advance


FOLDER = Path(__file__).parent
KERNEL_FILES = (
    *(FOLDER / f"{name}.py" for name in (
        "flooding", "messages", "controller", "obstacle_geometry", "potential",
        "power_iteration", "sensors", "kernel", "yaw_estimator",
    )),
    *(FOLDER.parents[1] / "dynamics" / f"{name}.py" for name in ("kinematic", "quadrotor")),
    *(FOLDER.parents[1] / "problems" / f"{name}.py"
      for name in ("fiedler_tracking", "interaction_graph")),
)  # fmt: skip
advance = _compile_advance(crc32(b"".join(file.read_bytes() for file in KERNEL_FILES)))
