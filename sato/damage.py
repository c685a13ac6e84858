"""Damage of a record: values that no run has, found before its promises are checked."""

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from dynamics.inputs import LARGEST, shorten
from sato.interfaces import Recorded
from sato.network.load import PURPOSES
from sato.record import AXIS_NAMES, CommonVariables, recorded_fields
from sato.run_data import RunData
from sato.scenario.errors import join_names
from sato.systems import load_system

# Least value of a whole number, and the dimension that it counts along, in variables and events.
RANGES: dict[str, tuple[int, str]] = {
    "agents": (0, "agent"),
    "component": (-1, "agent"),
    "leg": (0, "leg"),
    "leg_index": (0, "leg"),
    "point": (0, "agent"),
    "point_index": (0, "agent"),
    "target": (-1, "target"),
    "target_index": (-1, "target"),
    "targets": (0, "target"),
    **dict.fromkeys(("believed", "programs", "rounds", "solves", "steps", "target_count"), (0, "")),
}
UNBOUNDED = ("lambda2", "lambda3", "lambda2_estimate")  # infinite for one or two agents
LABELS = {"axis": AXIS_NAMES, "purpose": PURPOSES}
LARGEST_WHOLE = 2**53  # number that a double holds
LISTS = ("agents", "believed", "component", "point", "steps", "target", "targets")  # in events
PLAIN = "arrival braked cautious closed infeasible join loss refused reset silent slack unconfirmed"
# Kinds of events by system, each with what the check reads of it beside its time and agents.
EVENTS: dict[str, dict[str, str]] = {
    "reconfiguration": {
        **dict.fromkeys(PLAIN.split(), ""),
        "leg_start": "leg",
        "leg_end": "leg target believed component",
        "assignment": "target",
        "blocked": "targets",
        "clocks": "steps",
        "replan": "solves",
        "fallback": "programs",
        "solver_error": "programs",
    },
    "formation": {
        **dict.fromkeys(("leg_start", "leg_end", "given_up", "gridlock", "gridlock_end"), "leg"),
        "assignment": "point",
        "auction": "leg rounds",
    },
    "connectivity": dict.fromkeys("loss split waypoint whole".split(), ""),
}


def find_damage(data: RunData, mission: Any | None) -> str:
    """Describe the first value that no run of a drawn mission, or of any, has; empty if none."""
    system = load_system(data.attrs["system"])
    if system.name not in EVENTS:
        return ""  # of a user's own, which may record anything
    kinds = filter(None, (system.run_variables, CommonVariables))
    fields = {name: field for kind in kinds for name, field in recorded_fields(kind).items()}
    for name, field in recorded_fields(system.frame).items():
        fields[name] = field._replace(dims=("time", *field.dims))
    pairs = (zip(dims, values.shape, strict=True) for dims, values, _ in data.variables.values())
    sizes = {dim: size for pair in pairs for dim, size in pair}
    if not sizes["time"]:
        return "the file has no instants"
    if mission is not None:
        for dim, wanted in _list_sizes(mission).items():
            if sizes.get(dim, wanted) != wanted:
                names = "axes" if dim == "axis" else f"{dim}s"
                return f"the file has {sizes[dim]} {names}, and its scenario {wanted}"
    faults = (_find_fault(data, name, field, sizes) for name, field in fields.items())
    fault = next(filter(None, faults), "")
    return fault or next(_find_event_faults(data, EVENTS[system.name], sizes), "")


def _list_sizes(mission: Any) -> dict[str, int]:
    is_joined = mission.system == "reconfiguration"  # by agents that are not there at the start
    count = len(mission.alive) if is_joined else mission.agents
    sizes = dict.fromkeys(("agent", "other", "point", "neighbor"), count)
    sizes |= {"axis": mission.axes if is_joined else 3, "purpose": len(PURPOSES)}
    return sizes | {"leg": len(getattr(mission, "legs", ()))}


def _find_fault(data: RunData, name: str, field: Recorded, sizes: Mapping[str, int]) -> str:
    if name not in data:
        return ""
    dims, values, attributes = data.variables[name]
    if dims != field.dims:
        return f"{name} is along {join_names(dims, 'and')}, not {join_names(field.dims, 'and')}"
    if (unit := str(attributes.get("units", field.unit))) != field.unit:
        return f"{name} has {unit} as its unit, not {field.unit}"
    if name in LABELS and tuple(values) != LABELS[name][: len(values)]:
        return f"{name} has labels {join_names(values, 'and')}, which no run has"
    if field.dtype is None:
        return ""
    if values.dtype.kind not in "biuf":
        return f"{name} has {values.dtype} for numbers"
    least, most = (0, 1) if field.dtype is bool else _find_range(name, sizes)
    with np.errstate(invalid="ignore"):
        is_wrong = (np.abs(values) > LARGEST) & (np.isfinite(values) | (name not in UNBOUNDED))
        if field.dtype is not float:
            is_wrong = (values % 1 != 0) | (values < least) | (values > most)
    if name in ("control_instant", "time"):  # every instant of a run is one, and has a time
        is_wrong |= np.isnan(values) if name == "time" else values == 0
    if not is_wrong.any():
        return ""
    place = np.unravel_index(int(np.argmax(is_wrong)), is_wrong.shape)
    where = ", ".join(f"{dim} {index}" for dim, index in zip(dims, place, strict=True))
    return f"{name} is {values[place]:.6g} at {where}, which no run has"


def _find_event_faults(
    data: RunData, needed: Mapping[str, str], sizes: Mapping[str, int]
) -> Iterator[str]:
    for number, text in enumerate(data["event"]):
        event = None
        with suppress(ValueError, RecursionError):
            event = json.loads(str(text))
        if not isinstance(event, dict) or not isinstance(event.get("kind"), str):
            yield f"event {number} is no table with a kind"
            continue
        if event["kind"] not in needed:
            yield f"event {number} is of kind {shorten(event['kind'])}, which no run has"
            continue
        entries = ["time", "agents", *needed[event["kind"]].split()]
        for name in dict.fromkeys([*entries, *filter(RANGES.__contains__, event)]):
            value = event.get(name)
            if not _is_entry(event, name, value, sizes):
                what = shorten(value) if name in event else "missing"
                yield f"{name} of event {number}, a {event['kind']}, is {what}, which no run has"


def _is_entry(event: dict[str, Any], name: str, value: Any, sizes: Mapping[str, int]) -> bool:
    if name == "time":
        return type(value) in (int, float) and abs(value) <= LARGEST
    if (type(value) is list) != (name in LISTS):
        return False
    least, most = _find_range(name, sizes)
    values = value if type(value) is list else [value]
    is_whole = all(type(entry) is int and least <= entry <= most for entry in values)
    if name not in LISTS or name in ("agents", "targets"):
        return is_whole
    is_of_agents = name == "target" and event["kind"] == "assignment"
    return is_whole and len(values) == (len(event["agents"]) if is_of_agents else sizes["agent"])


def _find_range(name: str, sizes: Mapping[str, int]) -> tuple[int, int]:
    least, dim = RANGES.get(name, (-1, ""))
    return least, sizes.get(dim, 0) - 1 if dim else LARGEST_WHOLE
