"""First commitments: how vehicles can stop before they have decided anything.

Vehicles that start at rest stay where they are. Those that start in motion stop at once, or, where
two of them would come too close, in ways that are found one after another. All initial states are
known before the flight; a mission without such a set is refused. A vehicle that joins waits until
it can stop clear of all others, or does not join.
"""

from functools import lru_cache
from math import inf
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.doors import checked
from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import is_path_clear
from problems.path_separation import are_hulls_separated, are_paths_separated, enclosing_balls
from sato.reconfiguration import stopping
from sato.reconfiguration.evasion import EvasionReport, find_evasions
from sato.reconfiguration.free_motion import simulate
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import divide_horizon
from sato.reconfiguration.surroundings import Surroundings, find_surroundings
from sato.scenario.errors import InputError, join_names, round_down, round_up
from sato.scp.planner import PASSING_SIDES

MAX_SWEEPS = 4  # in which each vehicle that meets another looks for another way to stop
SLOWER = 2  # times the time of the slowest stop, in which all come to rest


@checked
@lru_cache(maxsize=2)  # asked for when a mission is drawn, and when it is flown
def find_first_commitments(mission: Reconfiguration) -> stopping.Commitments:
    """Find stopping trajectories, clear of each other, for all that are there at the start.

    Args:
        mission: A drawn mission.

    Returns:
        Commitment of each; none where all are at rest, or the mission is in orbit.

    Raises:
        InputError: Two cannot stop clear of each other, or the mission is not drawn.
    """
    agents, d = np.flatnonzero(mission.alive), mission.axes
    start = mission.initial_states[agents]
    around = find_surroundings(mission)
    is_still = not start[:, d:].any() and (around is None or not around.state[:, d:].any())
    if not mission.is_point_mass or is_still:
        return {}
    if not mission.has_margin:
        raise InputError("mission", "must be drawn; mission.draw(rng) would do")
    around = around and around.seen_from(mission, mission.initial_states)
    escapes = [around.escape_steps(mission, i) for i in agents.tolist()] if around else []
    steps = max(escapes, default=0)
    horizon, u, _, paths = _fly_on(mission, agents, start, {}, 0, steps)
    clearance = mission.own_clearances(horizon.clearance, agents)
    flown = around and around.fly(mission, horizon)
    obstacles = [
        around and around.known_to(mission, i, flown, horizon.clearance) for i in agents.tolist()
    ]

    def find_met() -> set[int]:
        return {a for a, own in enumerate(obstacles) if not is_path_clear(paths[a], own)}

    meeting, met = _find_meeting(paths, clearance), find_met()
    for _ in range(MAX_SWEEPS):
        if not (len(meeting) or met):
            break
        for a in sorted(met.union(meeting.flatten().tolist())):
            near = _find_near(mission, horizon.scale_points(start[a, :d]), a, paths, clearance)
            radius = (clearance[near] + clearance[a]) / 2
            avoided = stopping.Avoided(paths[near], radius, obstacles[a])
            rest = np.concatenate([horizon.unscale_points(paths[a, -1, -1]), np.zeros(d)])
            aim = int(agents[a]), start[a], rest, horizon.steps - 1
            for side in PASSING_SIDES[d]:
                found = stopping.find_stop(mission, horizon, *aim, paths[a], avoided, side=side)
                if found is not None and stopping.stays_within_reach(mission, horizon, *found[1:]):
                    u[a], _, paths[a] = found
                    break
        meeting, met = _find_meeting(paths, clearance), find_met()
    if met and not len(meeting):
        each = zip(agents.tolist(), start, u, paths, clearance.tolist(), obstacles, strict=True)
        reports = [
            EvasionReport(i, (0.0, 0.0, i), x, own, path, kept, ((0, known),))
            for i, x, own, path, kept, known in each
        ]
        for i, report in find_evasions(mission, horizon, reports).items():
            a = int(np.flatnonzero(agents == i)[0])
            u[a], paths[a] = report.u, report.path
        met = find_met()
    if met:
        a = min(met)
        raise InputError(
            "obstacle",
            f"one comes to the start of agent {agents[a]} within {steps * mission.step:.4g} s, and "
            "no way is found out of its way; another start, an obstacle that comes later or more "
            "slowly, or a larger model.max_control_m_s2 would do",
        )
    if not len(meeting):
        return {i: stopping.Commitment(0, own) for i, own in zip(agents.tolist(), u, strict=True)}
    i, j = meeting[0]
    speeds = np.linalg.norm(start[[i, j], d:], axis=1)
    raise InputError(
        "swarm.start",
        f"agents {agents[i]} and {agents[j]} start at {speeds[0]:.3g} and {speeds[1]:.3g} m/s, and "
        f"no way is found for all to stop {(clearance[i] + clearance[j]) / 2:.3g} m apart; slower "
        "starts, starts farther apart, or a larger model.max_control_m_s2 would do",
    )


class Traffic(NamedTuple):
    """All that is there at an instant, where vehicles may join."""

    mission: Reconfiguration  # drawn
    x: Float[Array, "agents n"]  # states of all; of those that join, the ones with which they do
    alive: Bool[Array, " agents"]  # True for those that are there
    committed: stopping.Commitments  # what these have committed to
    instant: int  # steps since the start of the mission
    around: Surroundings | None  # at this instant, of which those that join need not know

    def admit(self, waiting: list[int]) -> list[int]:
        """Return those of the vehicles that wait to join that have room, one after another."""
        alive, joined = self.alive.copy(), list[int]()
        for i in waiting:
            if self._replace(alive=alive).has_room(i):
                alive[i] = True
                joined.append(i)
        return joined

    def has_room(self, agent: int) -> bool:
        """Tell whether one that joins is clear of what others have committed to, and all else.

        That is, if it stops at once or, in orbit, drifts for T_H steps.
        """
        mission, around = self.mission, self.around
        agents = np.append(np.flatnonzero(self.alive), agent)
        if around is not None:
            around = around._replace(is_known=np.ones_like(around.is_known))
        if mission.is_point_mass:
            escape = around.escape_steps(mission, agent) if around else 0
            own = self.committed, self.instant, escape
            horizon, *_, paths = _fly_on(mission, agents, self.x[agents], *own)
        else:
            T, t = mission.horizon_steps, self.instant * mission.step
            flown = self.committed, self.instant
            held = [stopping.committed_controls(mission, i, *flown)[:T] for i in agents.tolist()]
            u, horizon = stopping.pad_controls(held, T), divide_horizon(mission, t, T)
            paths = horizon.control_points(simulate(mission, self.x[agents], u, t, mission.step), u)
        if around is not None:
            known = around.known_to(mission, agent, around.fly(mission, horizon), horizon.clearance)
            if not is_path_clear(paths[-1], known):
                return False
        clearance = mission.own_clearances(horizon.clearance, agents)
        radius = (clearance[:-1] + clearance[-1]) / 2
        return bool(are_hulls_separated(paths[:-1] - paths[-1], radius).all())


def check_room(mission: Reconfiguration) -> None:
    """Refuse a drawn mission in which a vehicle that would not wait has no room at the start."""
    due = [i for agents, at_step in mission.joining(0) if at_step == 0 for i in agents]
    if mission.waits[due].all():
        return
    committed, around = find_first_commitments(mission), find_surroundings(mission)
    start = Traffic(mission, mission.initial_states, mission.alive, committed, 0, around)
    joined = start.admit(due)
    for i in due:
        if i not in joined and not mission.waits[i]:
            reason = f'agent {i} cannot join and stop clear of all others, and room = "refuse"'
            cures = 'another start, a later at_step, or room = "wait" would do'
            raise InputError("leg.0.join", f"{reason}; {cures}")


def _fly_on(
    mission: Reconfiguration,
    agents: Int[Array, " agents"],
    state: Float[Array, "agents n"],
    committed: stopping.Commitments,
    instant: int,
    least: int = 0,
) -> tuple[AvoidanceHorizon, Array, Array, Array]:
    """Return the horizon, controls, states and control points of agents that decide no more.

    Over so many steps at least.
    """
    each, length = stopping.held_controls(
        mission, agents, state[:, mission.axes :], committed, instant
    )
    steps = SLOWER * int(length.max()) + mission.horizon_steps
    u = stopping.add_steps(each, max(steps, least))
    horizon = stopping.stopping_horizon(mission, u.shape[1])
    x = horizon.discrete_model.simulate(state, u)
    return horizon, u, x, horizon.control_points(x, u)


def check_reach(mission: Reconfiguration) -> None:
    """Refuse a drawn mission without reach, or a start too fast to stop within reach."""
    state, reach = mission.initial_states, mission.reach_unheard(mission.margin)
    kept = mission.largest_separation * mission.widest_axis
    if mission.is_point_mass and mission.has_unseen and mission.sight - kept <= 0:
        raise InputError(
            "swarm.sensing_radius_m",
            f"{mission.sight:g} is no more than the {kept:.4g} m that vehicles keep, so none could "
            "stop before it meets what it sees; several times as much would do",
        )
    if mission.is_point_mass and mission.vehicle_count > 1 and reach <= 0:
        least = mission.distance_unheard(mission.margin)
        cures = _wider(mission, mission.radius_for_full_speed) or ["several times as much"]
        raise InputError(
            "swarm.comm_radius_m",
            f"{mission.comm_radius:g} is no more than the {least:.4g} m that two keep, margins "
            f"included, so none could move without meeting others unheard; {cures[0]} would do",
        )
    for some, where in ((mission.alive, "swarm.start"), (~mission.alive, "leg.join.start")):
        check_stops(mission, np.flatnonzero(some), state[some], where)
        _check_speeds(mission, np.flatnonzero(some), state[some], where)


def _check_speeds(
    mission: Reconfiguration,
    agents: Int[Array, " agents"],
    state: Float[Array, "agents n"],
    where: str,
) -> None:
    if mission.link.is_ideal:
        return
    for i, v in zip(agents.tolist(), state[:, mission.axes :], strict=True):
        limit = mission.stop_speed_limit(i)
        if limit.is_exceeded(v):
            speed = float(np.linalg.norm(v))
            slower = speed * limit.most / float(limit.measure(v))
            cures = [f"a speed of {round_down(slower)} m/s"]
            cures += _wider(mission, mission.radius_for_full_speed)
            raise InputError(
                where,
                f"agent {i} starts at {speed:.4g} m/s, and over this [link] vehicles stop before "
                f"they meet others unheard from {slower:.4g} m/s; {join_names(cures)} would do",
            )


def _wider(mission: Reconfiguration, radius: float) -> list[str]:
    is_sight = mission.reaching_key == "swarm.sensing_radius_m"
    is_cure = (mission.sight if is_sight else mission.comm_radius) < radius < inf
    return [f"{mission.reaching_key} = {round_up(radius)}"] if is_cure else []


def check_stops(
    mission: Reconfiguration,
    agents: Int[Array, " agents"],
    state: Float[Array, "agents n"],
    where: str,
    committed: stopping.Commitments | None = None,
    instant: int = 0,
) -> None:
    """Refuse states from which vehicles that decide no more do not stop within reach.

    Args:
        mission: A drawn mission.
        agents: Numbers of the vehicles.
        state: States of the vehicles.
        where: Key of the states, for the error.
        committed: Their commitments; those without a commitment stop at once.
        instant: Steps since the start of the mission.

    Raises:
        InputError: One does not; says what would do.
    """
    d, reach = mission.axes, mission.reach_unheard(mission.margin)
    if not mission.is_point_mass or not state[:, d:].any():
        return
    horizon, _, x, paths = _fly_on(mission, agents, state, committed or {}, instant)
    far = np.flatnonzero(~stopping.stays_within_reach(mission, horizon, x, paths))
    if len(far):
        a = int(far[0])
        way = float(np.linalg.norm(x[a, -1, :d] - x[a, 0, :d]))
        # At a share of the speed it takes no more steps, so at most that share of the way.
        slower = float(np.linalg.norm(state[a, d:])) * max(reach, 0.0) / way
        cures = [f"a speed of {round_down(slower)} m/s"]
        cures += _wider(mission, mission.radius_for_way(way))
        is_sight = "sensing" in mission.reaching_key
        radius, verb = ("sensing", "see") if is_sight else ("communication", "hear")
        raise InputError(
            where,
            f"agent {agents[a]} needs {way:.4g} m to stop, and within {reach:.4g} m, all that "
            f"the {radius} radius leaves, it could meet what it does not {verb}; "
            f"{join_names(cures)} would do",
        )


def _find_near(
    mission: Reconfiguration,
    start: Float[Array, " d"],
    agent: int,
    paths: Float[Array, "agents pieces 4 d"],
    clearance: Float[Array, " agents"],
) -> Int[Array, " near"]:
    """Find the others that a vehicle could meet on any way on which it stays within reach."""
    middle, extent = enclosing_balls(paths)
    wide = max(mission.separation_scale or (1.0,))
    most = wide * stopping.longest_way(mission) + extent + (clearance + clearance[agent]) / 2
    near = np.flatnonzero(np.linalg.norm(middle - start, axis=1) <= most)
    return np.asarray(near[near != agent])


def _find_meeting(
    paths: Float[Array, "agents pieces 4 d"], clearance: Float[Array, " agents"]
) -> Int[Array, "pairs 2"]:
    """Find the pairs that are not clear of each other, in order."""
    middle, extent = enclosing_balls(paths)
    most = 2 * float(extent.max()) + float(clearance.max())
    pairs = scipy.spatial.cKDTree(middle).query_pairs(most, output_type="ndarray")
    i, j = pairs[np.lexsort(pairs.T[::-1])].T
    met = ~are_paths_separated(paths, i, j, (clearance[i] + clearance[j]) / 2)
    return np.stack([i[met], j[met]], axis=1)
