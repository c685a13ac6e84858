"""What a scenario asks of the code on board: one agent's programme, of fixed size."""

from typing import NamedTuple

import numpy as np

from dynamics.discretise import hold
from problems.convexify import Horizon
from problems.fixed_avoidance import FixedAvoidance
from problems.transfer import Transfer
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import look_ahead
from sato.reconfiguration.routes import SLOPE
from sato.scenario import read

CONTROL_POINTS = 4  # of a piece of path: a half-space keeps each of them


class Asked(NamedTuple):
    """A programme and where it comes from."""

    scenario: str
    neighbours: int
    horizon: Horizon  # pieces of path, each with a half-space a control point and neighbour
    programme: FixedAvoidance


def asked(scenario: str, neighbours: int, steps: int | None = None) -> Asked:
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
    if mission.nonlinear is not None or not mission.model.constant:
        raise ValueError(
            f"{file.name}: its model changes with the time or with the path, and code that is "
            "written once knows neither; of models in orbit, clohessy_wiltshire and "
            "schweighart_sedwick would do"
        )
    T = mission.legs[0].steps if steps is None else steps
    limits = mission.max_control, mission.max_speed
    norms = mission.fuel_norm, mission.control_norm
    transfer = Transfer(hold(mission.model, mission.step, T), *limits, *norms, SLOPE)
    ahead = look_ahead(mission, 0.0, T)
    rows = neighbours * ahead.pieces * CONTROL_POINTS
    programme = FixedAvoidance(transfer, min(T, ahead.steps), rows)
    return Asked(file.name, neighbours, ahead, programme)
