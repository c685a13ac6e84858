"""Links of reconfigurations: what is refused, and whether decisions can end in time."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from sato.network.channel import NEVER, Channel
from sato.network.graph import CommunicationGraph
from sato.network.link import MOST_ROUNDS, Link
from sato.network.synchronizer import Synchronizer
from sato.scenario.definition import is_auto
from sato.scenario.errors import InputError, join_names, round_down, round_up

if TYPE_CHECKING:
    from sato.reconfiguration.mission import Reconfiguration

MEASURED_ROUNDS = 100  # synchronous rounds over which the time of one is averaged
LEAST_SHARE, BISECTIONS = 0.01, 8  # of a time, from which on one is looked for that would do
SLOW_SHARE = 0.9  # of the full speed, below which plans are slow
NO_CURE = "far fewer losses and outages, and far shorter rounds"
# Synchronous rounds of a decision with an auction, a D + b + min(c N, d), of which the last is for
# paths in conflict. Measured at most: 26 in `crossing` (N = 2), 121 and 206 in `random` (N = 50 and
# 200, D = 8 and 15), 402 in `uiuc` (D = 31), 73 among 50 agents in crowded letters with D = 1.
LIKELY_ROUNDS = 12, 10, 2, 50


def check(mission: "Reconfiguration") -> None:
    """Refuse links that a mission cannot have, and those over which nothing can be agreed."""
    link = mission.link
    link.require_none(period_steps="agents send a message in every round, which takes link.round_s")
    if link.outage and not link.round:
        reason = f"is 0, and outages of {link.outage:g} s are counted in rounds"
        raise InputError("link.round_s", f"{reason}; a time that rounds take would do")
    if link.round or link.skew:
        _check_supported(mission)
        _check_skew(mission)
    if link.round:
        _check_late(mission)
        _check_rounds(mission)


def _check_supported(mission: "Reconfiguration") -> None:
    for key, is_asked, reason in (
        ("plan.printed", mission.printed, "the printed methods have instant messages; printed ="
         " false would do"),
        ("plan.assignment", mission.assignment == "central", "with all data in one place there are"
         ' no messages; "auction" would do'),
        ("plan.orders", mission.orders > 1, "plans that are tried in several orders are not kept;"
         " orders = 1 would do"),
        ("plan.passive_safety_m", mission.passive_safety is not None, "is for orbits, where plans"
         " are not kept while messages are on their way; leave it out"),
        ("model.kind", not mission.is_point_mass, "vehicles that cannot stop at once cannot keep"
         ' what they have while messages are on their way; "double_integrator" would do'),
        ("plant", not mission.keeps_plans, "vehicles that do not fly as modeled cannot keep plans"
         ' while messages are on their way; "model" would do'),
    ):  # fmt: skip
        if is_asked:
            raise InputError(key, f"over a [link] that takes time, {reason}")


def _check_skew(mission: "Reconfiguration") -> None:
    skew, period = mission.link.skew, mission.replan_steps * mission.step
    if skew > period * (1 + 1e-9):
        raise InputError(
            "link.skew_s",
            f"{skew:g} is more than the replanning period of {period:g} s, so that agents would "
            f"decide on different periods; at most {period:g} would do",
        )
    if not skew:
        return
    moves = any(obstacle.drift.any() for obstacle in mission.obstacles)
    coasts = any(loss.body == "coast" for leg in mission.legs for loss in leg.losses)
    for where, is_asked in (("obstacle", moves), ("leg.lose.body", coasts)):
        if is_asked:
            reason = "what moves is met at other times by vehicles whose clocks are behind"
            raise InputError(where, f"{reason}; link.skew_s = 0 would do")


def check_starts(mission: "Reconfiguration") -> None:
    """Refuse starts in motion of a drawn mission whose clocks differ."""
    velocity = mission.initial_states[:, mission.axes :]
    if mission.link.skew and velocity.any():
        i = int(velocity.any(axis=1).argmax())
        where = "swarm.start" if mission.alive[i] else "leg.join.start"
        reason = f"agent {i} starts in motion, and its clock may be behind"
        raise InputError(where, f"{reason}; a start at rest, or link.skew_s = 0, would do")


def _check_late(mission: "Reconfiguration") -> None:
    late = mission.link.late * mission.link.round
    for number, leg in enumerate(mission.legs):
        if is_auto(leg.steps) or late < leg.steps * mission.step:
            continue
        reason = f"messages may come {late:g} s late, and leg {number} takes "
        cures = _list_cures(mission) or [NO_CURE]
        reason += f"{leg.steps * mission.step:g} s; {join_names(cures)} would do"
        raise InputError("link.late", reason)


def _check_rounds(mission: "Reconfiguration") -> None:
    """Refuse periods in which not even two agents agree."""
    link, steps = mission.link, mission.replan_steps
    if is_enough(mission, link, steps):
        return
    has = count_rounds(mission, link, steps)
    needed, lost = needed_rounds(mission, link, has), {"link.skew_s": link.skew}
    lost |= {"plan.compute_s": mission.compute}
    less = "".join(f" less {key} = {time:g}" for key, time in lost.items() if time)
    cures = _list_cures(mission) or [NO_CURE]
    raise InputError(
        "link.round_s",
        f"{link.round:g} s leave {has} rounds of messages for a decision, in replan_steps = "
        f"{steps} of {mission.step:g} s{less}, and it takes at least {needed:.0f}: "
        f"{link.silent_rounds} to hear all neighbors, and {least_rounds(mission)} to agree, "
        f"each repeated until it is heard; {join_names(cures)} may do",
    )


def count_rounds(mission: "Reconfiguration", link: Link, steps: int) -> int:
    """Count the rounds of messages that a decision has, in a replanning period of so many steps.

    Agents listen longer for those whose clocks may be behind.
    """
    return int(link.count_rounds(max(steps * mission.step - mission.compute - link.skew, 0.0)))


def is_enough(mission: "Reconfiguration", link: Link, steps: int) -> bool:
    """Tell whether the least decision of two agents ends in time, on average."""
    has = min(count_rounds(mission, link, steps), MOST_ROUNDS)
    return has >= needed_rounds(mission, link, has)


def needed_rounds(mission: "Reconfiguration", link: Link, has: int) -> float:
    """Estimate the rounds of messages that the least decision of two agents takes.

    Where they are more than it has even if each synchronous round takes one, that is the estimate.
    """
    least = link.silent_rounds + least_rounds(mission)
    if has < least or mission.vehicle_count == 1:
        return least
    return link.silent_rounds + _measure_pair(link) * least_rounds(mission)


def least_rounds(mission: "Reconfiguration") -> int:
    """Count the synchronous rounds that no decision is without, with D = 1, or 0 if alone.

    The census takes 3 D + 1; an auction, where there is one, 2 D + 2 with its terms; the
    trajectories 2 D + 5, the choice and its reports 2 D + 1; the confirmation 1.
    """
    D = min(mission.vehicle_count - 1, 1)
    auction = 0 if mission.assignment == "given" else 2 * D + 2
    return (3 * D + 1) + auction + (2 * D + 5) + (2 * D + 1) + 1


@lru_cache(maxsize=64)
def _measure_pair(link: Link) -> float:
    return measure_round(link, CommunicationGraph(~np.eye(2, dtype=bool), np.ones(2, dtype=bool)))


def measure_round(link: Link, graph: CommunicationGraph) -> float:
    """Measure how many rounds of messages a synchronous round takes, on average.

    It is infinite where they are far more than can be of use.
    """
    if not (link.late or link.loses_messages):
        return 1.0
    count = len(graph.alive)
    channel = Channel(link, graph, np.random.default_rng(0))
    synchronizer = Synchronizer(channel, np.full(count, MOST_ROUNDS))
    start = np.zeros(count, dtype=int)
    last = int(synchronizer.advance(start, start + MEASURED_ROUNDS)[graph.alive].max())
    return last / MEASURED_ROUNDS if last < NEVER else inf


def _list_cures(mission: "Reconfiguration") -> list[str]:
    """List values with which the least decision ends in time, one of each key that has one."""
    link, steps = mission.link, mission.replan_steps

    def does(**changes: Any) -> bool:
        return is_enough(mission, replace(link, **changes), steps)

    cures = []
    if (late := _find_most(lambda late: does(late=int(late)), link.late, 0.5)) is not None:
        cures.append(f"link.late = {int(late)}")
    least = LEAST_SHARE * link.round
    if (time := _find_most(lambda time: does(round=time), link.round, least)) is not None:
        cures.append(f"link.round_s = {round_down(time)}")
    longer = [
        k for k in range(steps + 1, mission.horizon_steps + 1) if not mission.auction_steps % k
    ]
    if found := next((k for k in longer if is_enough(mission, link, k)), None):
        cures.append(f"plan.replan_steps = {found}")
    return cures


def _find_most(does: Callable[[float], bool], most: float, least: float) -> float | None:
    # The largest value up to one with which it does, by bisection; none if that is below another.
    low = most
    while not does(low):
        low /= 2
        if low < least:
            return None
    high = min(2 * low, most)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if does(middle) else (low, middle)
    return low


def list_doubts(mission: "Reconfiguration") -> list[str]:
    """List doubts about the link of a drawn mission, a sentence each."""
    link, doubts = mission.link, list[str]()
    if link.is_ideal:
        if mission.compute and not mission.lag_steps:
            idle = f"plan.compute_s = {mission.compute:g} changes nothing"
            doubts.append(f"{idle}, for decisions are flown at once")
        return doubts
    if not link.round and (link.late or link.loses_messages):
        doubts.append(
            "messages that are lost or late change nothing, for link.round_s is 0 and decisions "
            "wait for all; a time that rounds take would do"
        )
    fastest, slow = float(mission.top_speeds.max()), mission.slow_speed
    if (link.round or link.skew) and slow is not None and slow < SLOW_SHARE * fastest:
        radius = mission.radius_for_full_speed
        cure = f"; {mission.reaching_key} = {round_up(radius)} would do" if radius < inf else ""
        doubts.append(
            f"over this [link] vehicles plan to fly at {slow:.3g} m/s, from which they stop before "
            f"they meet others unheard, and not at {fastest:.3g}{cure}"
        )
    return doubts + (_doubt_rounds(mission) if link.round else [])


def _doubt_rounds(mission: "Reconfiguration") -> list[str]:
    d, link = mission.axes, mission.link
    places = {"start": mission.initial_states[mission.alive, :d]}
    places |= {f"meet in leg {n}": leg.targets[:, :d] for n, leg in enumerate(mission.legs)}
    networks = [(*_largest_network(mission, some), where) for where, some in places.items()]
    rounds, agents, graph, where = max(networks, key=lambda network: network[0])
    likely = link.silent_rounds + measure_round(link, graph) * rounds
    # Agents listen longer for those behind, which begin as much later.
    period = mission.replan_steps * mission.step - mission.compute
    left, spare = period - 2 * link.skew, period - likely * link.round
    if left >= likely * link.round:
        return []
    cures = [f"link.round_s = {round_down(left / likely)}"] if left > 0 else []
    cures += [f"link.skew_s = {round_down(spare / 2)}"] if link.skew and spare > 0 else []
    cure = f"; {join_names(cures)} may do" if cures else ""
    has = int(link.count_rounds(max(left, 0.0)))
    return [
        f"a decision has {has} rounds of messages, and an auction of the {agents} agents that "
        f"{where} in one network is likely to take {likely:.0f}; those that do not end in time "
        f"keep what they have{cure}"
    ]


def _largest_network(
    mission: "Reconfiguration", places: Array
) -> tuple[int, int, CommunicationGraph]:
    """Return the largest network among places, its agents, and the rounds that these may take."""
    everyone = np.ones(len(places), dtype=bool)
    graph = CommunicationGraph.from_positions(places, mission.comm_radius, everyone)
    sizes = np.bincount(graph.component)
    largest = graph.subgraph(graph.component == sizes.argmax())
    agents, D = min(int(sizes.max()), mission.vehicle_count), int(largest.diameter.max())
    a, b, c, d = LIKELY_ROUNDS
    return a * D + b + min(c * agents, d), agents, largest
