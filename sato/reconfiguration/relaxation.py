"""Constraints that plans do not satisfy, as events of the record."""

from collections.abc import Sequence

import numpy as np

from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import Event
from sato.scp import FEASIBILITY_TOLERANCE, Planner


def list_relaxations(
    mission: Reconfiguration, planners: dict[int, Planner], unreachable: Sequence[int]
) -> list[Event]:
    """List the agents for which constraints were relaxed, or whose targets are out of reach."""
    tolerance = FEASIBILITY_TOLERANCE * mission.least_separation
    slack = {i: p.slack for i, p in planners.items() if p.slack > tolerance}
    failed = [i for i, p in planners.items() if p.has_failed]
    missing = [i for i, p in planners.items() if _misses_target(mission, p)]
    astray = {*unreachable, *failed, *missing}
    beyond = "the target is out of reach in the time that is left"
    blocked = "no trajectory keeps clear of agents with priority"
    events: list[Event] = [
        {"kind": "slack", "agents": list(slack), "amount_m": list(slack.values())},
        {"kind": "braked", "agents": [i for i in planners if i in astray]},
        {"kind": "infeasible", "agents": [*unreachable], "what": beyond},
        {"kind": "infeasible", "agents": failed, "what": blocked},
    ]
    return [event for event in events if event["agents"]]


def _misses_target(mission: Reconfiguration, planner: Planner) -> bool:
    d, error = mission.axes, np.abs(planner.nominal.x[-1] - planner.target_state)
    is_far = (error[:d] > mission.position_tolerance).any()
    is_fast = (error[d:] > mission.velocity_tolerance).any()
    # A plan of no steps, made after the deadline, leads nowhere, and none was solved for.
    is_inexact = planner.terminal_error > 0 or len(planner.nominal.u) == 0
    return is_inexact and bool(is_far or is_fast)
