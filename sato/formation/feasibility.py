"""Feasibility of a formation flight: what can be refused before it, and what is doubtful."""

from itertools import pairwise
from typing import TYPE_CHECKING

from sato.scenario.errors import InputError, round_up
from sato.shapes import Points

if TYPE_CHECKING:
    from sato.formation.mission import Formation


def check_swarm(mission: "Formation") -> None:
    """Refuse a swarm that is too small, starts in motion or has no legs.

    Raises:
        InputError: It is one of these.
    """
    if not mission.legs:
        raise InputError("leg", "needs at least 1 entry, got 0")
    if mission.agents is None:
        raise InputError("swarm.agents", "is missing, and has no default")
    if mission.agents < 3:
        raise InputError("swarm.agents", f"must be at least 3, got {mission.agents}")
    start = mission.start
    if isinstance(start, Points) and start.velocities is not None:
        raise InputError("swarm.start.velocities_m_s", "vehicles start at rest; drop it")
    if isinstance(start, Points) and start.positions is not None:
        if len(start.positions) != mission.agents:
            raise InputError(
                "swarm.start.positions_m",
                f"lists {len(start.positions)} positions for {mission.agents} agents",
            )


def check_clearance(mission: "Formation") -> None:
    """Refuse an avoidance that begins when it is too late to stop.

    Raises:
        InputError: It does; says which range or deceleration would do.
    """
    avoidance, keep_out = mission.avoidance, mission.keep_out
    if avoidance.legacy:
        if mission.control_law.upright:
            raise InputError(
                "control.upright",
                "the paper's control law cannot tell a formation from its mirror image; "
                "upright = false, or legacy_avoidance = false, would do",
            )
        return
    if avoidance.braking > mission.max_acceleration:
        raise InputError(
            "avoidance.brake_m_s2",
            f"{avoidance.braking:g} is more than max_acceleration_m_s2 = "
            f"{mission.max_acceleration:g}, so no vehicle could brake as it counts on; half of "
            "that would do",
        )
    least = keep_out + avoidance.margin + mission.max_speed**2 / avoidance.braking
    if avoidance.avoidance_range < least * (1 - 1e-12):
        raise InputError(
            "avoidance.notice_m",
            f"{avoidance.avoidance_range:g} is too near to stop before keep_out_m = "
            f"{keep_out:g} from {mission.max_speed:g} m/s; {round_up(least)} would do",
        )


def check_messages(mission: "Formation") -> None:
    """Refuse messages between control steps, and an auction that lost messages would not end.

    Raises:
        InputError: It is one of these.
    """
    rate, loss, step = mission.radio.message_rate, mission.radio.loss_probability, mission.step
    steps = 1 / (rate * step)
    whole = max(1, round(steps))
    if abs(steps - whole) > 1e-6 * whole:
        raise InputError(
            "radio.rate_hz",
            f"{rate:g} messages a second do not fall on control steps of {step:g} s; "
            f"{1 / (whole * step):.6g} would do",
        )
    if mission.assignment.method == "vsdaa" and loss > 0:
        raise InputError(
            "assignment.kind",
            '"vsdaa" ends when nothing new is heard, which needs every message, and a share of '
            f'{loss:g} is lost; "cbaa" repeats its messages and would do',
        )


def check_operator_commands(mission: "Formation") -> None:
    """Refuse commands to vehicles that do not exist, and two commands at a time.

    Raises:
        InputError: There is one.
    """
    commands = mission.operator_commands
    for number, command in enumerate(commands):
        if command.agent >= mission.agents:
            raise InputError(
                f"push.{number}.vehicle",
                f"there is no vehicle {command.agent}; they are 0 to {mission.agents - 1}",
            )
    order = sorted(range(len(commands)), key=lambda k: commands[k].start)
    for before, after in pairwise(order):
        if commands[after].start < commands[before].end:
            raise InputError(
                f"push.{after}.start_s",
                f"{commands[after].start:g} is before push {before} ends, and the operator "
                f"steers one vehicle at a time; {commands[before].end:g} would do",
            )


def separation_doubts(mission: "Formation") -> list[str]:
    """List doubts about whether avoidance keeps vehicles apart, the first that applies."""
    avoidance, noise, step = mission.avoidance, mission.frames.noise, mission.step
    if avoidance.legacy:
        return [
            "legacy_avoidance does not keep vehicles apart: it reproduces the paper's code, and "
            "`sato check` tells how close they came"
        ]
    if avoidance.margin < 2 * noise:
        return [
            f"avoidance.margin_m = {avoidance.margin:g} is less than twice frames.noise_m = "
            f"{noise:g}, so two vehicles may come closer than keep_out_m by as much; "
            f"{2.5 * noise:g} would do"
        ]
    if avoidance.braking > mission.max_acceleration / 2:
        return [
            f"avoidance.brake_m_s2 = {avoidance.braking:g} is more than half of "
            f"max_acceleration_m_s2 = {mission.max_acceleration:g}, which leaves too little for "
            "turning: vehicles may come some centimeters too close"
        ]
    if mission.max_speed * step > avoidance.margin:
        return [
            f"in a control step of {step:g} s a vehicle flies {mission.max_speed * step:g} m, "
            f"farther than avoidance.margin_m = {avoidance.margin:g}: two may come closer than "
            "keep_out_m by as much"
        ]
    return []
