"""Passive safety: which missions can have it, and which targets."""

from math import inf
from typing import TYPE_CHECKING

import numpy as np

from problems.drifts import KEPT_FACTOR
from problems.path_separation import find_meetings
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.models import PlantSettings
from sato.scenario.errors import InputError

if TYPE_CHECKING:
    from sato.reconfiguration.mission import Reconfiguration

MAX_ORBITS = 15.0  # of drift: about a day in low orbits


def check(mission: "Reconfiguration") -> None:
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


def check_targets(mission: "Reconfiguration") -> None:
    """Refuse targets that do not keep the distance themselves for as long as drifts are to."""
    if mission.passive_safety is None:
        return
    from sato.reconfiguration.passive_safety import follow_targets

    begun = 0
    for number, leg in enumerate(mission.legs):
        horizon, arrivals = follow_targets(mission, leg, begun * mission.step, leg.steps)
        begun += leg.steps
        i, j = np.triu_indices(len(arrivals), 1)
        met, _ = find_meetings(arrivals, i, j, np.full(len(i), KEPT_FACTOR * horizon.distance))
        if len(met):
            i, j = i[met.min()], j[met.min()]
            raise InputError(
                "plan.passive_safety_m",
                f"targets {i} and {j} of leg {number} come within "
                f"{mission.passive_safety:g} m of each other as they drift; a smaller distance, a "
                "wider shape or fewer targets would do",
            )


def check_network(mission: "Reconfiguration") -> None:
    """Refuse starts in several networks: a drift leads far, and nobody knows of another network."""
    if mission.passive_safety is None:
        return
    place, alive = mission.initial_states[:, : mission.axes], mission.alive
    graph = CommunicationGraph.from_positions(place, mission.comm_radius, alive)
    count = len(np.unique(graph.component[alive]))
    if count > 1:
        raise InputError(
            "plan.passive_safety_m",
            f"needs all vehicles in one network, and the starts form {count}; a larger "
            "swarm.comm_radius_m, more vehicles or starts nearer to each other would do",
        )
