"""What a scenario asks of the code on board: one agent's programme, of fixed size."""

from typing import NamedTuple

import numpy as np

from dynamics.discretize import discretize_zoh
from problems.convexify import AvoidanceHorizon
from problems.fixed_size_avoidance import FixedSizeAvoidanceProblem
from problems.transfer import TransferProblem
from sato.former import read
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import make_horizon
from sato.reconfiguration.solo_trajectories import TIE_BREAK_RISE

CONTROL_POINTS_PER_PIECE = 4  # of a piece of path: a half-space keeps each of them


class OnboardProblem(NamedTuple):
    """A programme and where it comes from."""

    scenario: str
    neighbors: int
    horizon: (
        AvoidanceHorizon  # pieces of path, each with a half-space a control point and neighbour
    )
    program: FixedSizeAvoidanceProblem


def build_onboard_problem(
    scenario: str, neighbors: int, steps: int | None = None
) -> OnboardProblem:
    """The programme that an agent of a scenario solves among its neighbours.

    Args:
        scenario: Built in, or a file.
        neighbours: For how many there is room.
        steps: That the flight has left; those of the first leg if None.

    Raises:
        ValueError: There is no such scenario, or its programme cannot be written once for
            all times.
    """
    file = read(scenario)
    # Only the model and the limits count here, so any start will do.
    mission = file.build(np.random.default_rng(0))
    if not isinstance(mission, Reconfiguration):
        raise ValueError(
            f"{file.name}: agents of the system {file.system} solve no transfer; a scenario of "
            "the system reconfiguration would do"
        )
    if mission.nonlinear_model is not None or not mission.linear_model.is_time_invariant:
        raise ValueError(
            f"{file.name}: its model changes with the time or with the path, and code that is "
            "written once knows neither; of models in orbit, clohessy_wiltshire and "
            "schweighart_sedwick would do"
        )
    T = mission.legs[0].steps if steps is None else steps
    limits = mission.max_control, mission.max_speed
    norms = mission.fuel_norm, mission.control_norm
    transfer = TransferProblem(
        discretize_zoh(mission.linear_model, mission.step, T), *limits, *norms, TIE_BREAK_RISE
    )
    ahead = make_horizon(mission, 0.0, T)
    rows = neighbors * ahead.pieces_per_step * CONTROL_POINTS_PER_PIECE
    programme = FixedSizeAvoidanceProblem(transfer, min(T, ahead.steps), rows)
    return OnboardProblem(file.name, neighbors, ahead, programme)
