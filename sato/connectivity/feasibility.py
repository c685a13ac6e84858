"""Checks of a mission across its fields; each error names a value that would do."""

from math import hypot, pi
from typing import TYPE_CHECKING

import numpy as np

from problems.interaction_graph import algebraic_connectivity, interaction_graph
from sato.connectivity.obstacles import Obstacles, Plane, obstacle_distances
from sato.connectivity.power_iteration import spectral_radius
from sato.connectivity.settings import MAX_MESSAGE_AGE, PowerIterationGains, complete_gains
from sato.connectivity.stick import RecordedStick, WaypointStick
from sato.network.graph import label_components
from sato.scenario.definition import errors_in, fields_of
from sato.scenario.errors import InputError, join_names
from sato.scenario.ranges import MANY_SHORT_STEPS, doubt_long

if TYPE_CHECKING:
    from sato.connectivity.mission import Connectivity

FAST_TURN = 4 * pi  # rate beyond which it is likely given in degrees [rad/s]
MAX_POWER_STEP = 2.5e-3  # distance flown per exchange of power_pi at which 50 runs held [m]


def check_settings(mission: "Connectivity") -> None:
    """Refuse limits that are not in order."""
    camera, tracking = mission.camera, mission.tracking
    near, far = mission.repulsion.min_distance, mission.repulsion.max_distance
    least, most = mission.potential.lambda2_min, mission.potential.lambda2_max
    for key, low, other, high, share in (
        ("camera.d_near_m", camera.d_near, "d_far_m", camera.d_far, 1 / 2),
        ("camera.d_min_m", camera.d_min, "d_near_m", camera.d_near, 1 / 3),
        ("camera.d_far_m", camera.d_far, "d_max_m", camera.d_max, 4 / 5),
        ("camera.a_min", camera.a_min, "a_max", camera.a_max, 1 / 3),
        ("potential.lambda2_min", least, "lambda2_max", most, 1 / 300),
        ("repulsion.nearest_m", near, "farthest_m", far, 1 / 3),
        ("tracking.slow_m_s", tracking.min_speed, "fast_m_s", tracking.max_speed, 1 / 3),
    ):
        if not low < high:
            cure = share * high if high > 0 else high - 0.5
            text = f"{low:g} is not less than {other} = {high:g}; {cure:.3g} would do"
            raise InputError(key, text)
    if mission.estimator == "power_pi" and mission.potential.of == "spectrum":
        raise InputError("potential.of", 'power_pi estimates λ₂ alone; "lambda2" would do')
    if len(camera.optical_axis) != 3 or not 1e-6 < hypot(*camera.optical_axis) < 1e6:
        raise InputError("camera.axis", "needs 3 coordinates, not all 0; [1, 1, 0] would do")


def memory_demand(mission: "Connectivity", agents: int) -> float:
    """Estimate the memory that a flight of so many agents takes [byte].

    Every robot has the rows of all others in its memory; the run has three matrices an instant.
    Measured with 50 to 200 robots.
    """
    return 80.0 * agents**3 + 20.0 * agents**2 * mission.duration / mission.step


def check_sampling(mission: "Connectivity") -> None:
    """Refuse gains and messages that do not suit the control step."""
    tracking, link, step = mission.tracking, mission.link, mission.step
    if round(mission.duration / step) < 1:
        reason = f"{mission.duration:g} is less than a step; {step:g} or more would do"
        raise InputError("run.duration_s", reason)
    # In discrete time a factor 1 − gain × step of an error is left after each step.
    gains = {"k2 + closure": tracking.k2 + tracking.closure_gain, "k3": tracking.k3}
    for terms, gain in gains.items():
        if gain * step >= 2:
            raise InputError(
                f"tracking.{terms[:2]}",
                f"{terms} = {gain:g} /s is unstable at a control step of {step:g} s: an error "
                f"becomes {1 - gain * step:.3g} times as large in each; "
                f"{terms} = {0.2 / step:.3g} would do",
            )
    link.require_none(
        round="a round takes every × run.step_s here",
        skew="the ages of messages are told by one clock here",
    )
    oldest = (link.late + 1) * mission.timed_link.round
    if oldest > MAX_MESSAGE_AGE * (1 + 1e-9):
        most = max(1, int(MAX_MESSAGE_AGE / step))
        raise InputError(
            "link.late" if link.late else "link.every",
            f"messages are {oldest:.3g} s old before the next one comes, and may be "
            f"{MAX_MESSAGE_AGE:g} s; every = 1 and late = {most - 1} would do",
        )
    if mission.estimator == "power_pi":
        _check_power_iteration(mission)


def _check_power_iteration(mission: "Connectivity") -> None:
    period, step, agents = mission.power_iteration.exchange_period, mission.step, mission.agents
    exchanges = max(1, round(step / period))
    if abs(step - exchanges * period) > 1e-6 * step:
        raise InputError(
            "estimator.exchange_s",
            f"{period:g} does not divide the control step of {step:g} s; "
            f"{step / exchanges:.6g} would do",
        )
    radius = spectral_radius(mission.gains, agents)
    if radius >= 1:
        suited = complete_gains(PowerIterationGains(period), agents)
        cures = (f"{f.key} = {getattr(suited, f.name):.4g}" for f in fields_of(type(suited))[1:])
        raise InputError(
            "estimator",
            f"the iteration of {agents} robots is unstable with these gains: the spectral radius "
            f"is {radius:.4g}, and must be below 1; {join_names(cures, 'and')} would do, and are "
            "taken where none are given",
        )


def check_obstacles(mission: "Connectivity") -> None:
    """Refuse obstacles that are flat, move, or are not known beforehand."""
    for number, obstacle in enumerate(mission.obstacles):
        if isinstance(obstacle, Plane):
            continue
        with errors_in(f"obstacle.{number}"):
            if obstacle.axes != 3:
                raise InputError("", f"has {obstacle.axes} coordinates, and space has 3")
            if obstacle.drift.any():
                raise InputError("velocity_m_s", "obstacles rest in this system; leave it out")
            if not obstacle.known:
                raise InputError("known", "robots see all obstacles in range; leave it out")


def check_start(mission: "Connectivity") -> None:
    """Refuse initial poses that are too close to each other or an obstacle, or not connected."""
    positions, agents = mission.initial_position, mission.agents
    if positions.shape != (agents, 3):
        raise InputError(
            "swarm.start.positions_m",
            f"needs {agents} rows of 3 coordinates, one for each, got shape {positions.shape}",
        )
    if mission.yaw is None or len(mission.yaw) != agents:
        given = "none" if mission.yaw is None else len(mission.yaw)
        raise InputError("swarm.start.yaw_rad", f"needs {agents} angles, got {given}")
    nearest = mission.repulsion.min_distance
    cure = f"and repulsion is infinite at repulsion.nearest_m = {nearest:g}; move one of them"
    gap = np.linalg.norm(positions[:, None] - positions, axis=2)
    gap += np.diag(np.full(agents, np.inf))
    if gap.min() <= nearest:
        i, j = np.argwhere(gap == gap.min())[0]
        text = f"robots {i} and {j} start {gap.min():.4g} m apart, {cure}"
        raise InputError("swarm.start", text)
    camera, least = mission.camera, mission.potential.lambda2_min
    weights = interaction_graph(positions, mission.yaw, camera).weights
    lambda2 = float(algebraic_connectivity(weights).lambda2)
    label = label_components(weights > 0, np.ones(agents, dtype=bool))
    if label.max() > 0 or lambda2 <= least:
        parts = [np.flatnonzero(label == k).tolist() for k in range(label.max() + 1)]
        robots = join_names((f"{{{', '.join(map(str, part))}}}" for part in parts), "and")
        raise InputError(
            "swarm.start",
            f"λ₂ is {abs(lambda2):.3g} with robots {robots} connected, and must be above "
            f"potential.lambda2_min = {least:g}; robots {camera.d_near:g} to {camera.d_far:g} m "
            "apart that look at each other would do",
        )
    for number, obstacle in enumerate(mission.obstacles):
        distance = obstacle_distances(positions, Obstacles.of([obstacle]))[:, 0]
        agent, least = int(distance.argmin()), float(distance.min())
        if least <= nearest:
            where = f"{least:.3g} m from" if least >= 0 else "inside of"
            text = f"robot {agent} starts {where} this {obstacle.kind}, {cure}"
            raise InputError(f"obstacle.{number}", text)


def check_losses(mission: "Connectivity") -> None:
    """Refuse losses of robots that are not there, and of all but one."""
    agents, losses = mission.agents, mission.losses
    if losses and agents - len(losses) < 2:
        raise InputError("death", f"{len(losses)} of {agents} robots are lost; two must be left")
    left = list(range(agents))
    for number, loss in enumerate(losses):
        if loss.agent in left:
            left.remove(loss.agent)
        elif loss.agent is not None:
            names = ", ".join(map(str, left))
            raise InputError(f"death.{number}.robot", f"must be one of {names}, got {loss.agent}")


def doubts(mission: "Connectivity") -> list[str]:
    """List doubts about a drawn mission: a fast leader, a stick that ends, a late loss."""
    speed, commanded = mission.limits.speed, mission.stick.speed
    period = mission.power_iteration.exchange_period
    steps, unit = mission.duration / mission.step, "; are run.step_s and run.duration_s in s?"
    found = doubt_long("run", steps, mission.step, f"as it says{unit}", MANY_SHORT_STEPS)
    if isinstance(mission.stick, RecordedStick):
        found += mission.stick.doubt_end(mission.duration, mission.step)
    if (rate := mission.limits.yaw_rate) > FAST_TURN:
        turns = f"{rate / 2 / pi:.3g} turns a second; is it in rad/s?"
        found.append(f"limits.turn_rad_s = {rate:g} is {turns}")
    end = f"and the flight ends at {mission.duration:g} s"
    first_held = mission.stick.start_time if type(mission.stick) is WaypointStick else 0.0
    if first_held >= mission.duration:
        found.append(f"the stick is first held at {first_held:g} s, {end}")
    late = [loss.time for loss in mission.losses if loss.time and loss.time > mission.duration]
    found += [f"a robot is to be lost at {time:g} s, {end}" for time in late]
    if commanded >= speed:
        found.append(
            f"the stick asks for {commanded:g} m/s, and limits.speed_m_s = {speed:g} is all that "
            "the robots answer it with: the leader may come too near to obstacles; "
            f"{2 / 3 * speed:.3g} m/s would do"
        )
    if mission.estimator == "power_pi" and speed * period > MAX_POWER_STEP:
        found.append(
            f"robots fly {1e3 * speed * period:.3g} mm from one exchange of power_pi to the next, "
            f"and beyond {1e3 * MAX_POWER_STEP:g} mm it was seen to lose connectivity; "
            f"limits.speed_m_s = {MAX_POWER_STEP / period:.3g} would do"
        )
    return found
