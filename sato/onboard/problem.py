"""Transfer problem of fixed size for one agent of a scenario."""

from typing import NamedTuple

import numpy as np

from dynamics.discretize import discretize_zoh
from problems.convexify import AvoidanceHorizon
from problems.fixed_size_avoidance import FixedSizeAvoidanceProblem
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import make_horizon
from sato.reconfiguration.solo_trajectories import TIE_BREAK_RISE
from sato.scenario.file import read


class OnboardProblem(NamedTuple):
    """Transfer problem of an agent, with its origin."""

    scenario: str
    neighbors: int  # for which the program has room
    horizon: AvoidanceHorizon  # pieces of trajectory, with a half-space per control point
    program: FixedSizeAvoidanceProblem


def build_problem(scenario: str, neighbors: int, steps: int | None = None) -> OnboardProblem:
    """Build the transfer problem of one agent of a scenario, with arguments as of `export_c`."""
    file = read(scenario)
    # Only the model and the limits matter here, so any random start will do.
    mission = file.draw(np.random.default_rng(0))
    if not isinstance(mission, Reconfiguration):
        reason = f"{file.name}: agents of the system {file.system} solve no transfer"
        raise ValueError(f"{reason}; a scenario of the system reconfiguration would do")
    if mission.nonlinear_model is not None or not mission.linear_model.is_time_invariant:
        changes = "its model changes with time or with the trajectory"
        cure = "of models in orbit, clohessy_wiltshire and schweighart_sedwick would do"
        reason = f"{changes}, and exported code has constant matrices"
        raise ValueError(f"{file.name}: {reason}; {cure}")
    mission.require_equal_vehicles("exported code")
    T = mission.legs[0].steps if steps is None else steps
    model = discretize_zoh(mission.linear_model, mission.step, T)
    transfer = mission.make_transfer(model, 0, tie_break_rise=TIE_BREAK_RISE)
    horizon = make_horizon(mission, 0.0, T)
    # One half-space for each neighbor and control point of a step.
    _, pieces, points, *_ = horizon.control_point_maps[0].shape
    rows = neighbors * pieces * points
    program = FixedSizeAvoidanceProblem(transfer, min(T, horizon.steps), rows)
    return OnboardProblem(file.name, neighbors, horizon, program)
