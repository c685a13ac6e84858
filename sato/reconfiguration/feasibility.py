"""Feasibility of a mission: what can be refused before anything is flown."""

from collections.abc import Sequence
from functools import lru_cache
from math import degrees, floor, inf, pi
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csc_array

from problems.conic import ConicProgram
from problems.solvers import SolverAdapter, list_able, load_adapters
from sato.reconfiguration import link_feasibility
from sato.reconfiguration.leg import Join, Leg, Loss
from sato.reconfiguration.models import PlantSettings
from sato.scenario.definition import is_auto
from sato.scenario.errors import InputError, closest_name, join_names, round_down, round_up
from sato.scenario.ranges import doubt_long, machine_memory

if TYPE_CHECKING:
    from sato.reconfiguration.mission import Reconfiguration

MAX_POINTING_ERROR = pi / 6  # standard deviation beyond which directions mean nothing [rad]
SHORTEST_ORBIT = 3600.0  # at the surface of a body of 11,000 kg/m³ [s]
MAX_ORBITS = 15.0  # of drift: about a day in low orbits
PAIR_TABLES = 30  # numbers that a flight keeps for each pair of agent and target, at most


def check(mission: "Reconfiguration") -> None:
    """Refuse fields that contradict each other, and legs without targets enough."""
    _check_periods(mission)
    link_feasibility.check(mission)
    _check_printed(mission)
    _check_solver(mission)
    _check_noise(mission)
    _check_detectable(mission)
    _check_axes(mission)
    _check_surroundings(mission)
    _check_passive_safety(mission)
    _check_legs(mission)


def _check_periods(mission: "Reconfiguration") -> None:
    horizon, replan, auction = mission.horizon_steps, mission.replan_steps, mission.auction_steps
    if mission.step > (period := mission.orbital_period or inf):
        reason = f"{mission.step:g} is longer than an orbit, which takes {period:.4g} s"
        raise InputError("plan.step_s", f"{reason}; a hundredth of it is usual")
    if mission.epsilon == 0:
        raise InputError("plan.epsilon", 'must be positive, or "auto", got 0')
    if replan > horizon:
        reason = f"{replan} is more than horizon_steps = {horizon}; at most {horizon} would do"
        raise InputError("plan.replan_steps", reason)
    most = horizon // replan * replan
    if auction > horizon:
        reason = f"{auction} is more than horizon_steps = {horizon}; {most} would do"
        raise InputError("plan.auction_steps", reason)
    if auction % replan:
        reason = f"{auction} is no multiple of replan_steps = {replan}; {most} would do"
        raise InputError("plan.auction_steps", reason)
    if mission.bargains and mission.orders == 1:
        reason = f"{mission.bargains} sweeps need orders of 2 or more"
        raise InputError("plan.bargains", reason)
    for number, leg in enumerate(mission.legs):
        if not is_auto(leg.steps) and mission.freeze_steps > leg.steps:
            reason = f"{mission.freeze_steps} is more than the {leg.steps} steps of leg {number}"
            raise InputError("plan.freeze_steps", f"{reason}; at most {leg.steps} would do")


def _check_printed(mission: "Reconfiguration") -> None:
    """Refuse what the printed methods do not have."""
    if not mission.printed:
        return
    coasts = any(loss.body == "coast" for leg in mission.legs for loss in leg.losses)
    joins = any(leg.joins for leg in mission.legs)
    lacking = {
        "obstacle": bool(mission.obstacles),
        "model.box_m": mission.box is not None,
        "plan.passive_safety_m": mission.passive_safety is not None,
        "plan.assignment": mission.assignment != "auction",
        "plan.orders": mission.orders > 1,
        "plan.foresight_steps": bool(mission.foresight_steps),
        "leg.lose.body": coasts,
        "leg.join": joins,
    }
    for key, is_asked in lacking.items():
        if is_asked:
            reason = "is not in the printed methods, which plan.printed = true runs"
            raise InputError(key, f"{reason}; leave one of the two out")


def _check_solver(mission: "Reconfiguration") -> None:
    if mission.solver == "clarabel":  # the default, which takes all
        return
    name, known = mission.solver, load_adapters()
    if name not in known:
        close = closest_name(name, known)
        hint = f"; did you mean {close}?" if close else f"; there are {join_names(known, 'and')}"
        raise InputError("plan.solver", f'there is no solver "{name}"{hint}')
    if not isinstance(known[name], SolverAdapter):
        got = type(known[name]).__name__
        raise InputError("plan.solver", f'"{name}" must be a SolverAdapter, got {got}')
    # A program with the cones and the cost that the mission's may have.
    is_energy, norms = mission.objective == "energy", {mission.control_norm, mission.fuel_norm}
    if np.isfinite(mission.top_speeds).any():
        norms |= {mission.speed_norm}
    P = csc_array(np.eye(1)) if is_energy else None

    def program(cones: tuple[int, ...]) -> ConicProgram:
        A = csc_array((sum(cones), 1))
        return ConicProgram(np.zeros(1), A, np.zeros(sum(cones)), 0, 0, cones, P=P)

    asked = program((2,) if 2 in norms else ())
    if reason := known[name].refusal(asked):
        cures = list(list_able(asked)) if known[name].is_installed else []
        is_speed = mission.control_norm != 2 and (is_energy or mission.fuel_norm != 2)
        if 2 in norms and is_speed and not known[name].refusal(program(())):
            cures.append('model.speed_norm = "inf"')
        raise InputError(
            "plan.solver", reason + (f"; {join_names(cures)} would do" if cures else "")
        )


def _check_noise(mission: "Reconfiguration") -> None:
    noise, thrust, pointing = mission.position_noise, mission.thrust_error, mission.pointing_error
    radius = mission.least_separation
    if noise >= radius:
        raise InputError(
            "disturbance.position_m",
            f"{noise:g} is not less than swarm.collision_radius_m = {radius:g}; "
            f"{round_down(radius / 50)} would do",
        )
    if thrust >= 1:
        reason = f"{thrust:g} is {100 * thrust:g} % of the thrust"
        raise InputError("disturbance.thrust", f"{reason}; {thrust / 100:g} would be {thrust:g} %")
    if pointing > MAX_POINTING_ERROR:
        most = f"at most pointing_deg = {degrees(MAX_POINTING_ERROR):.0f} would do"
        reason = f"{pointing:.4g} is {degrees(pointing):.4g} degrees; {most}"
        raise InputError("disturbance.pointing_rad", reason)


def _check_surroundings(mission: "Reconfiguration") -> None:
    """Refuse obstacles and bounds of other axes than the model's, and what is not supported."""
    d, box = mission.axes, mission.box
    if box is not None:
        if box.shape != (2, d):
            reason = f"needs a lowest and a highest corner with {d} coordinates each"
            raise InputError("model.box_m", f"{reason}, got shape {box.shape}")
        if not (box[0] < box[1]).all():
            raise InputError("model.box_m", "must have a lowest corner below the highest one")
    for number, obstacle in enumerate(mission.obstacles):
        if obstacle.axes != d:
            reason = f"has {obstacle.axes} coordinates, and the model has {d} axes"
            raise InputError(f"obstacle.{number}", reason)
    if mission.has_surroundings and mission.bargains:
        reason = "in a negotiation vehicles keep clear of each other alone"
        raise InputError("plan.bargains", f"{reason}; bargains = 0 would do among obstacles")
    if mission.sensing_radius is not None and not mission.has_unseen:
        reason = "has no effect where all is known, and no lost vehicle coasts; leave it out"
        raise InputError("swarm.sensing_radius_m", reason)


def is_detectable(mission: "Reconfiguration") -> bool:
    """Tell whether two agents that could meet within the horizon hear each other at its start.

        R_comm ≥ 2 V_max T_H Δt + R_col

    [Morgan2016, Proposition 9].
    """
    return mission.comm_radius >= _least_comm_radius(mission) * (1 - 1e-12)


def _least_comm_radius(mission: "Reconfiguration") -> float:
    closing = _closing_speed(mission) * mission.horizon_steps * mission.step
    return closing + mission.largest_separation


def _closing_speed(mission: "Reconfiguration") -> float:
    # Of the two fastest.
    return float(2 * np.sort(mission.top_speeds)[-2:].mean())


def _check_detectable(mission: "Reconfiguration") -> None:
    if mission.allow_undetectable or is_detectable(mission):
        return
    needed, closing = _least_comm_radius(mission), _closing_speed(mission)
    room = mission.comm_radius - mission.largest_separation
    cures = []
    if closing < inf:
        cures.append(f"swarm.comm_radius_m = {round_up(needed)}")
    if room > 0 and not isinstance(mission.max_speed, tuple) and mission.speed_norm == 2:
        slower = room / (2 * mission.horizon_steps * mission.step)
        begun = getattr(mission.start, "velocities", None)
        if begun is None or np.linalg.norm(begun, axis=1).max() <= slower:
            cures.append(f"model.max_speed_m_s = {round_down(slower)}")
    shorter = floor(room / (closing * mission.step) + 1e-9)
    if closing < inf and shorter >= mission.auction_steps:
        cures.append(f"plan.horizon_steps = {shorter}")
    cures = cures or ["a larger comm_radius_m with a model.max_speed_m_s"]
    limit = f"{needed:.4g} m" if closing < inf else "infinite, for there is no model.max_speed_m_s"
    raise InputError(
        "swarm.comm_radius_m",
        f"{mission.comm_radius:g} is less than 2 V_max T_H Δt + R_col, which is {limit}, so two "
        "agents could meet within the horizon unseen (Proposition 9); "
        f"{join_names(cures)} would do, and plan.allow_undetectable = true flies it all the same",
    )


def _check_axes(mission: "Reconfiguration") -> None:
    shapes: dict[str, Any] = {"swarm.start": mission.start}
    for number, leg in enumerate(mission.legs):
        shapes[f"leg.{number}.shape"] = leg.shape
        shapes |= {f"leg.{number}.join.{k}.start": join.start for k, join in enumerate(leg.joins)}
    for where, shape in shapes.items():
        points = getattr(shape, "positions", None)
        if points is not None and points.shape[1] != mission.axes:
            found = f"has {points.shape[1]} coordinates per point"
            raise InputError(where, f"{found}, and the model has {mission.axes} axes")


def _check_passive_safety(mission: "Reconfiguration") -> None:
    """Refuse passive safety where drifts cannot be foreseen for as long as it takes."""
    if mission.passive_safety is None:
        if mission.passive_safety_time is not None:
            reason = "has no effect without plan.passive_safety_m; give both, or none"
            raise InputError("plan.passive_safety_min", reason)
        return
    period, duration = mission.orbital_period, mission.passive_safety_time
    is_too_long = duration is not None and duration > MAX_ORBITS * (period or inf)
    is_foreseen = mission.flies_model
    if mission.nonlinear_model is not None:
        is_foreseen = isinstance(mission.plant, PlantSettings) and mission.plant.ballistic is None
    for is_so, reason in (
        (mission.orbital_period is None, "is for orbits, where nothing can stop; leave it out"),
        (mission.has_noise, "needs a flight without [disturbance]: in two orbits an error of 1 mm/s"
         " becomes 30 m"),
        (not is_foreseen, 'needs the motion that is flown: model.kind = "j2" with neither'
         ' drag nor a plant of your own, or plant = "model"'),
        (is_too_long, f"is for drifts of up to {MAX_ORBITS:g} orbits; a shorter"
         " plan.passive_safety_min would do"),
        (mission.orders > 1, "knows one order of priority; plan.orders = 1 would do"),
    ):  # fmt: skip
        if is_so:
            raise InputError("plan.passive_safety_m", reason)


def _check_legs(mission: "Reconfiguration") -> None:
    if not mission.legs:
        raise InputError("leg", "needs at least 1 entry, got 0")
    if mission.agents is None:
        raise InputError("swarm.agents", "is missing, and has no default")
    if mission.target_count is not None and all(map(mission.uses_all_targets, mission.legs)):
        reason = "has no meaning where agents choose among all targets, or have them given"
        raise InputError("swarm.believed", f"{reason}; leave it out")
    known, listed = mission.agents, getattr(mission.start, "positions", None)
    if listed is not None and len(listed) != known:
        reason = f"lists {len(listed)} positions for {known} agents; agents=None would count them"
        raise InputError("swarm.start.positions_m", reason)
    for number, (leg, enough) in enumerate(zip(mission.legs, target_demand(mission), strict=True)):
        known += sum(join.size for join in leg.joins)
        lost = max((i for loss in leg.losses for i in loss.agents), default=0)
        if lost >= known:
            reason = f"there is no agent {lost}; they are 0 to {known - 1}"
            raise InputError(f"leg.{number}.lose.agents", reason)
        joined = {i: step for agents, step in mission.joining(number) for i in agents}
        for i, at in ((i, loss.at_step) for loss in leg.losses for i in loss.agents):
            if at <= joined.get(i, -1):
                reason = f"{at} is not after agent {i} joins; {joined[i] + 1} or more would do"
                raise InputError(f"leg.{number}.lose.at_step", reason)
        if mission.assignment == "given":
            _check_given(f"leg.{number}", leg, enough)
        if leg.count is not None and leg.count < enough:
            which = "there may be" if leg.is_free else "may be believed in"
            reason = f"{leg.count} is less than the {enough} agents that {which}"
            raise InputError(f"leg.{number}.targets", f"{reason}; {enough} or more would do")
        listed, asked = getattr(leg.shape, "positions", None), leg.count or enough
        if listed is not None and len(listed) < asked:
            reason = f"lists {len(listed)} points, fewer than the {asked} asked for"
            raise InputError(f"leg.{number}.shape.positions_m", reason)


def _check_given(where: str, leg: Leg, agents: int) -> None:
    listed = getattr(leg.shape, "positions", None)
    if leg.recount:
        raise InputError(f"{where}.recount", "has no meaning where targets are given")
    if listed is not None and not (leg.is_free or getattr(leg.shape, "keep_order", True)):
        reason = '"prefix" reorders a list, and its targets are given in order'
        raise InputError(f"{where}.choose", f"{reason}; shape.keep_order = true would do")
    for key, count in (
        ("targets", leg.count),
        ("shape.positions_m", None if listed is None else len(listed)),
    ):
        if count not in (None, agents):
            reason = f"{count} targets are given to {agents} agents, those that join included"
            raise InputError(f"{where}.{key}", f"{reason}; one each would do")


def memory_demand(mission: "Reconfiguration", agents: int) -> float:
    """Estimate the memory that a flight of so many agents takes [byte].

    Most are tables of all pairs of agent and target. Measured with 1,000 and 3,000 agents.
    """
    demand = frames = 0.0
    for leg in mission.legs:
        agents += sum(join.size for join in leg.joins)
        steps = 1 if is_auto(leg.steps) else leg.steps
        demand = max(demand, 8.0 * PAIR_TABLES * agents * max(agents, leg.count or 0))
        frames += 300.0 * steps * agents
    return demand + frames


def check_programs(d: int, legs: "Sequence[Leg]") -> None:
    """Refuse legs, of so many axes, that are too long for the programs of their transfers.

    Their matrices have a row for each state of each step, and a column for each control.
    """
    limit = machine_memory()
    for number, leg in enumerate(legs):
        demand = 8.0 * 2 * d * d * float(leg.steps) ** 2
        if demand > limit:
            fits = int((limit / demand) ** 0.5 * leg.steps)
            raise InputError(
                f"leg.{number}.steps",
                f"a transfer of {leg.steps:,} steps takes about {demand / 1e9:,.0f} GB of memory, "
                f"and there are {limit / 1e9:,.0f} GB; {fits} steps or fewer would do, a longer "
                "plan.step_s, or limits in m/s and m/s² for positions in m",
            )


def list_doubts(mission: "Reconfiguration") -> list[str]:
    """List numbers of a drawn mission that are likely in another unit, and losses of nobody."""
    doubts, before = list[str](), mission.initial_states[:, : mission.axes]
    gone = set[int]()
    if (period := mission.orbital_period or inf) < SHORTEST_ORBIT:
        reason = f"takes {period:.3g} s, and any about a planet an hour or more"
        doubts.append(f"model: an orbit {reason}; is the mean motion in rad/s?")
    for number, leg in enumerate(mission.legs):
        places = leg.targets[:, : mission.axes]
        far = float(np.ptp(np.vstack([before, places]), axis=0).max())
        speed, control = mission.top_speeds.max(), mission.largest_control.max()
        reason = f"for up to {far:.4g} m at up to {speed:.3g} m/s and {control:.3g} m/s²"
        reason += "; are the positions in m, and the limits in m/s and m/s²?"
        doubts += doubt_long(f"leg.{number}", leg.steps, mission.step, reason)
        before, most = places, len(mission.initial_states)
        if leg.recount and not number:
            doubts.append("leg.0.recount: there is no leg before, whose bids would count")
        for i in (i for loss in leg.losses for i in loss.agents):
            doubts += [f"leg.{number}.lose.agents: agent {i} is lost before"] if i in gone else []
            gone.add(i)
        for share in (loss.share for loss in leg.losses if loss.share):
            if round(share * most) == 0:
                doubts.append(f"leg.{number}.lose.share: {share:g} of {most} agents is nobody")
    return doubts


def _list_events(leg: Leg) -> list[Join | Loss]:
    # At one step agents join before others are lost, as in the flight.
    return sorted([*leg.joins, *leg.losses], key=lambda event: event.at_step)


@lru_cache(maxsize=2)  # asked for by each leg of a mission
def target_demand(mission: "Reconfiguration") -> tuple[int, ...]:
    """Return the fewest targets that each leg must have, whatever is drawn.

    That is the most that any agent may believe in, or the most agents where they choose among
    all; and the number of all agents that there have been where targets are given.
    """
    most: list[int] = []
    live = ever = peak = mission.agent_count
    believed = mission.target_count or live
    known_lost: set[int] | None = set()  # indices; nothing is known after a loss by share
    for leg in mission.legs:
        if leg.recount:  # of bids before late losses
            believed = peak
        peak = 0
        for event in _list_events(leg):
            if event.at_step > 0:
                peak = max(peak, live)
            if isinstance(event, Join):
                live, ever = live + event.size, ever + event.size
            elif event.share is not None and event.kind != "agents":
                live -= floor(event.share * live)
                known_lost = None
            elif known_lost is not None:
                lost = {i for i in event.agents if i < ever} - known_lost
                live -= len(lost)
                known_lost |= lost
        peak = max(peak, live)
        believed = max(believed, peak)
        most.append(ever if mission.assignment == "given" else peak if leg.is_free else believed)
    return tuple(most)


@lru_cache(maxsize=2)  # asked for by each leg of a mission
def fewest_agents(mission: "Reconfiguration") -> tuple[int, ...]:
    """Return the fewest agents that fly each leg from its first step to its end."""
    fewest: list[int] = []
    live, known_lost = mission.agent_count, set[int]()
    for leg in mission.legs:
        staying = live
        for event in _list_events(leg):
            if isinstance(event, Join):
                live += event.size
                staying += event.size if event.at_step == 0 else 0
                continue
            lost = set(event.agents) - known_lost
            count = len(lost) if event.kind == "agents" else round((event.share or 0.0) * live)
            known_lost |= lost
            live, staying = live - count, staying - count
        fewest.append(max(staying, 0))
    return tuple(fewest)
