"""Feasibility of a formation flight: what can be refused before it, and what is doubtful."""

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sato.scenario.errors import InputError, round_up
from sato.scenario.ranges import MANY_SHORT_STEPS, doubt_long
from sato.shapes import Points

if TYPE_CHECKING:
    from sato.formation.mission import Formation


def check_swarm(mission: "Formation") -> None:
    """Refuse a swarm that starts in motion, has no legs or another number of agents."""
    if not mission.legs:
        raise InputError("leg", "needs at least 1 entry, got 0")
    if mission.agents is None:
        raise InputError("swarm.agents", "is missing, and has no default")
    if not isinstance(mission.start, Points):
        return
    if mission.start.velocities is not None:
        raise InputError("swarm.start.velocities_m_s", "vehicles start at rest; drop it")
    given = mission.start.positions
    if given is not None and len(given) != mission.agents:
        reason = f"lists {len(given)} positions for {mission.agents} agents"
        raise InputError("swarm.start.positions_m", f"{reason}; agents=None would count them")


def memory_demand(mission: "Formation", agents: int) -> float:
    """Estimate the memory that a flight of so many agents takes, measured up to 800 [byte]."""
    return 400.0 * agents**2 + 100.0 * agents * mission.supervision.time_limit / mission.step


def duration_doubts(mission: "Formation") -> list[str]:
    """List doubts about a flight that may take far more steps than others, and late pushes."""
    longest, step = mission.supervision.time_limit, mission.step
    hovering = mission.supervision.hover_time * (len(mission.legs) + 1)
    reason = f"up to its limit of {longest:g} s, hovering left out; are these times in s?"
    late = [push.start for push in mission.operator_commands if push.start >= longest]
    end = f"and the flight ends at {longest:g} s at the latest"
    found = [f"a push is to begin at {start:g} s, {end}" for start in late]
    pushes = [np.asarray(push.velocity, dtype=float) for push in mission.operator_commands]
    level = max((float(np.linalg.norm(push[:2])) for push in pushes), default=0.0)
    climb = max((abs(float(push[2])) for push in pushes), default=0.0)
    for asked, key, way in (
        (level, "max_speed", "in the plane"),
        (climb, "max_climb", "up or down"),
    ):
        if asked > (most := getattr(mission, key)):
            limit = f"swarm.{key}_m_s = {most:g} is all that it is given"
            found.append(f"a push asks for {asked:g} m/s {way}, and {limit}")
    if (round_time := 1 / mission.radio.message_rate) > mission.assignment.period:
        others = f"auctions are held every {mission.assignment.period:g} s"
        found.append(f"a round of messages takes {round_time:g} s, and {others}")
    steps = (longest + hovering) / step
    return found + doubt_long("a flight", steps, step, reason, MANY_SHORT_STEPS)


def check_clearance(mission: "Formation") -> None:
    """Refuse an avoidance that begins when it is too late to stop."""
    avoidance, keep_out, speed = mission.avoidance, mission.keep_out, mission.max_speed
    if avoidance.legacy:
        if mission.control_law.upright:
            text = "the paper's law cannot tell a mirror image; upright = false would do"
            raise InputError("control.upright", text)
        return
    brake, most = avoidance.braking, mission.max_acceleration
    if brake > most:
        text = f"{brake:g} is more than max_acceleration_m_s2 = {most:g}; half of that would do"
        raise InputError("avoidance.brake_m_s2", text)
    least = keep_out + avoidance.margin + speed**2 / brake
    if avoidance.avoidance_range < least * (1 - 1e-12):
        text = f"{avoidance.avoidance_range:g} is too near to stop before keep_out_m = {keep_out:g}"
        text += f" from {speed:g} m/s; {round_up(least)} would do"
        raise InputError("avoidance.notice_m", text)


def check_messages(mission: "Formation") -> None:
    """Refuse messages between control steps, and an auction that lost messages would not end."""
    radio, link, step = mission.radio, mission.link, mission.step
    rate = radio.message_rate
    link.require_none(
        period_steps="radio.rate_hz says how often messages are sent here",
        round="a round takes 1 / radio.rate_hz here",
        skew="no clock is compared with another here",
    )
    for key, same, is_twice in (
        ("loss", "loss", link.loss_probability > 0 and radio.loss_probability > 0),
        ("late", "delay_s", link.late > 0 and radio.delay > 0),
    ):
        if is_twice:
            reason = f"is given beside radio.{same}, which says the same; one of the two is enough"
            raise InputError(f"link.{key}", reason)
    steps = 1 / (rate * step)
    whole = max(1, round(steps))
    if abs(steps - whole) > 1e-6 * whole:
        text = f"{rate:g} messages a second do not fall on control steps of {step:g} s"
        raise InputError("radio.rate_hz", f"{text}; {1 / (whole * step):.9g} would do")
    if mission.assignment.period < (least := mission.frame_period):
        text = f"{mission.assignment.period:g} is less than an observation takes"
        raise InputError("assignment.period_s", f"{text}; {least:g} would do")
    if mission.assignment.method == "vsdaa" and mission.timed_link.loses_messages:
        loss, share = mission.timed_link.loss_probability, link.outage_share
        lost = 1 - (1 - loss) * (1 - share)
        text = f'"vsdaa" needs every message, and a share of {lost:g} is lost; "cbaa" would do'
        raise InputError("assignment.kind", text)


def check_operator_commands(mission: "Formation") -> None:
    """Refuse commands to vehicles that do not exist, and two commands at a time."""
    commands = mission.operator_commands
    for number, command in enumerate(commands):
        if command.agent >= mission.agents:
            text = f"there is no vehicle {command.agent}; they are 0 to {mission.agents - 1}"
            raise InputError(f"push.{number}.vehicle", text)
    order = sorted(range(len(commands)), key=lambda k: commands[k].start)
    for before, after in pairwise(order):
        start, end = commands[after].start, commands[before].end
        if start < end:
            text = f"{start:g} is before push {before} ends; {end:g} would do"
            raise InputError(f"push.{after}.start_s", f"one vehicle at a time: {text}")


def separation_doubts(mission: "Formation") -> list[str]:
    """List doubts about whether avoidance keeps vehicles apart, the first that applies."""
    avoidance, noise, step = mission.avoidance, mission.frames.noise, mission.step
    brake, margin, most = avoidance.braking, avoidance.margin, mission.max_acceleration
    if avoidance.legacy:
        return ["legacy_avoidance does not keep vehicles apart; `sato check` tells how close"]
    too_near = "so two vehicles may come closer than keep_out_m"
    if margin < 2 * noise:
        noisy = f"less than twice frames.noise_m = {noise:g}, {too_near}"
        return [f"avoidance.margin_m = {margin:g} is {noisy}; {2.5 * noise:g} would do"]
    if brake > most / 2:
        share = f"more than half of max_acceleration_m_s2 = {most:g}, {too_near}"
        return [f"avoidance.brake_m_s2 = {brake:g} is {share}"]
    if mission.max_speed * step > margin:
        far = f"{mission.max_speed * step:g} m, farther than avoidance.margin_m = {margin:g}"
        return [f"a control step of {step:g} s is {far}, {too_near}"]
    return []
