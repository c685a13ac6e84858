"""Reports of vehicles, checked against the mission before the world takes them.

Types, and that numbers are finite, are checked as messages are decoded. A vehicle whose report is
of another mission ends the flight, with what was flown in the record.
"""

from sato.processes.fleet import VehicleError
from sato.processes.messages import Status
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import Event
from sato.reconfiguration.stopping import Commitment

EVENTS = "slack braked infeasible cautious reset unconfirmed".split()  # that a vehicle reports
MORE_OF_EVENTS = {"amount_m": list, "what": str}


def check_status(mission: Reconfiguration, number: int, status: Status, step_index: int) -> None:
    """Refuse a report that no vehicle of the mission makes at an instant."""
    most = max(len(mission.initial_states), *(len(leg.targets) for leg in mission.legs))
    check_commitment(mission, number, status.commitment, step_index)
    check_commitment(mission, number, status.intended, step_index + mission.lag_steps)
    is_possible = {
        "leg": 0 <= status.leg < len(mission.legs),
        "control": status.control.shape == (mission.axes,),
        "target_index": -1 <= status.target_index < most,
        "target_count": 0 <= status.target_count <= most,
        "blocked": all(0 <= target < most for target in status.blocked),
        "events": all(_is_own(event, number) for event in status.events),
    }
    if wrong := next((name for name, is_right in is_possible.items() if not is_right), None):
        raise VehicleError(f"vehicle {number} reports what the mission has not: {wrong}")


def check_commitment(
    mission: Reconfiguration, number: int, commitment: Commitment | None, latest: int
) -> None:
    """Refuse controls that no vehicle of the mission flies, or from a later instant on."""
    if commitment is None:
        return
    if commitment.u.shape[1] != mission.axes or not 0 <= commitment.first_step <= latest:
        reason = f"of shape {commitment.u.shape} from instant {commitment.first_step} on"
        cure = f"({mission.axes} axes, and instant {latest} or before, would do)"
        raise VehicleError(f"vehicle {number} commits to controls {reason} {cure}")


def _is_own(event: Event, number: int) -> bool:
    more = {name: value for name, value in event.items() if name not in ("kind", "agents")}
    if event.get("kind") not in EVENTS or event.get("agents") != [number]:
        return False
    if not all(isinstance(value, MORE_OF_EVENTS.get(name, ())) for name, value in more.items()):
        return False
    return all(isinstance(part, float | int) for part in more.get("amount_m", ()))
