"""Summary of a reconfiguration: reached, holes, duplicates, gap, fuel and the rest."""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from dynamics.trajectory_geometry import min_distance, sampled_separations
from sato.check.common import common_summary, drop_non_finite
from sato.network.load import PURPOSES
from sato.reconfiguration.check.fuel import (
    compute_asked_bound,
    compute_step_energy,
    compute_step_fuel,
)
from sato.reconfiguration.check.prediction import predict_end_states
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.feasibility import is_detectable
from sato.summary import format_value


def summarize(record: ReconfigurationRecord) -> dict[str, Any]:
    """Summarize a run from its data; entries that do not apply are absent."""
    mission, frames, radius = record.mission, record.frames, record.mission.collision_radius
    legs = [summarize_leg(record, leg) for leg in record.leg_records]
    found, _ = record.separations
    least = float(sampled_separations(frames.position, frames.alive).min())
    reached = len(legs) == len(mission.legs) and all(leg["reached"] for leg in legs)
    summary = common_summary(record.attributes, frames.alive) | {
        "reached": reached,
        "min_separation_m": min(found.minimum.distance, least),
        "min_separation_at_samples_m": least,
        "collision_radius_m": list(radius) if isinstance(radius, tuple) else radius,
        "solves": sum(int(event["solves"]) for _, event in record.events.of_kind("replan")),
        "fuel_m_s": float(compute_step_fuel(record).sum()),
        "margin_m": float(mission.margin),
        "position_tolerance_m": float(mission.position_tolerance),
        "velocity_tolerance_m_s": float(mission.velocity_tolerance),
    }
    if mission.has_own_separations:
        summary["min_relative_separation"] = record.relative_separations[0].minimum.distance
    if record.clearance is not None:
        summary["min_obstacle_distance_m"] = record.clearance.distance
    if (drifts := record.drift_approaches) is not None:
        summary["min_drift_separation_m"] = drifts.nearest.distance if drifts.nearest else np.nan
        summary["drift_losses"], summary["drift_losses_left_out"] = drifts[1:]
    assignments = [bound.assignment if bound else None for bound in record.fuel_bounds]
    if mission.objective == "energy":
        assignments = list(record.energy_bounds)
        summary["energy_m2_s3"] = float(compute_step_energy(record).sum())
        if len(legs) == len(mission.legs):
            summary["energy_lower_bound_m2_s3"] = sum(each.bound for each in record.energy_bounds)
    if mission.solver != "clarabel":
        for name, kind in (("solver_fallbacks", "fallback"), ("solver_errors", "solver_error")):
            counts = [int(event["programs"]) for _, event in record.events.of_kind(kind)]
            if counts or kind == "fallback":
                summary[name] = sum(counts)
    for kind in ("slack", "braked", "infeasible", "cautious"):
        name = "slack_used" if kind == "slack" else kind
        summary[name] = sum(max(len(e["agents"]), 1) for _, e in record.events.of_kind(kind))
    summary |= _summarize_messages(record)
    unit = "m2_s3" if mission.objective == "energy" else "m_s"
    for leg, cost in zip(legs, assignments, strict=True):
        if cost is not None:
            gap = cost.held - cost.optimum
            leg |= drop_non_finite({f"assignment_{unit}": cost.held, f"assignment_gap_{unit}": gap})
    summary["legs"] = legs
    if mission.flown_plant.chief_elements(0.0) is not None:
        errors = [max_model_error(record, leg) for leg in record.leg_records]
        summary["model_error_m"] = max(errors, default=0.0)
        # Fuel of the agents that are there at the end: a lost agent had less to do.
        fuel = compute_step_fuel(record).sum(axis=0)[frames.alive[-1]]
        if len(fuel):
            each = {"mean": fuel.mean(), "least": fuel.min(), "most": fuel.max()}
            summary["fuel_per_agent_m_s"] = {name: float(value) for name, value in each.items()}
    known = [bound.total for bound in record.fuel_bounds if bound is not None]
    if len(known) == len(mission.legs):
        summary["fuel_lower_bound_m_s"] = sum(known)
    bounds = zip(record.leg_records, record.fuel_bounds, strict=True)
    asked = [compute_asked_bound(record, leg, bound) for leg, bound in bounds]
    if len(asked) == len(mission.legs):
        summary["fuel_lower_bound_asked_m_s"] = sum(asked)
    if np.isfinite(mission.top_speeds).all() and not is_detectable(mission):
        summary["undetectable"] = True
    return drop_non_finite(summary)


def _summarize_messages(record: ReconfigurationRecord) -> dict[str, Any]:
    """Summarize what the agent received that received most, and the rounds of all auctions."""
    messages, bytes = record.variables.received_messages, record.variables.received_bytes
    rounds = record.frames.rounds
    if messages is None or bytes is None or rounds is None:
        return {}
    most = int(bytes.sum(axis=1).argmax())
    each = dict(zip(PURPOSES, bytes[most].tolist(), strict=True))
    return {
        "bytes_received_max": {"total": int(bytes[most].sum()), **each},
        "messages_received_max": int(messages.sum(axis=1).max()),
        "auction_rounds_max": int(rounds[:, PURPOSES.index("auction")].max()),
    }


def summarize_leg(record: ReconfigurationRecord, leg: LegRecord) -> dict[str, Any]:
    """Summarize one leg; entries that do not apply are absent."""
    position_error, velocity_error = compute_terminal_errors(record, leg)
    resets = (k for k, _ in record.events.of_kind("reset"))
    start, held = record.frames.component[leg.start_index], leg.target_index[leg.alive]
    _, holders = np.unique(held[held >= 0], return_counts=True)
    return drop_non_finite(
        {
            "reached": is_reached(record, leg),
            "duplicates": int((holders > 1).sum()),
            **_measure_shape(record, leg),
            "targets_believed": leg.largest_target_count,
            "worst_position_error_m": float(np.fmax.reduce(position_error, initial=np.nan)),
            "worst_velocity_error_m_s": float(np.fmax.reduce(velocity_error, initial=np.nan)),
            "components_at_start": len(np.unique(start[start >= 0])),
            "components_at_end": len(np.unique(leg.component[leg.component >= 0])),
            "steps": leg.step_count,
            "resets": sum(leg.start_index <= k < leg.end_index for k in resets),
        }
    )


def max_model_error(record: ReconfigurationRecord, leg: LegRecord) -> float:
    """Compute the largest error of the shared model at the end of a leg [m].

    Over the agents that are there at the end, each from its state at the start of the leg, or
    where it joined, under the controls that were applied to it.
    """
    end = predict_end_states(record, leg, record.frames.applied_control)
    error = (record.state[leg.end_index, leg.alive] - end)[:, : record.mission.axes]
    return float(np.linalg.norm(error, axis=1).max(initial=0.0))


def compute_terminal_errors(
    record: ReconfigurationRecord, leg: LegRecord
) -> tuple[Float[Array, " live"], Float[Array, " live"]]:
    """Compute the error in position and velocity at each live agent's target; NaN without one."""
    targets, d = record.targets[leg.leg_index], record.mission.axes
    held = leg.target_index[leg.alive]
    is_valid = (held >= 0) & (held < len(targets))
    error = record.state[leg.end_index, leg.alive] - targets[np.where(is_valid, held, 0)]
    error[~is_valid] = np.nan
    return np.linalg.norm(error[:, :d], axis=1), np.linalg.norm(error[:, d:], axis=1)


def is_reached(record: ReconfigurationRecord, leg: LegRecord) -> bool:
    """Tell whether every live agent is at the target that it alone holds, and there is one.

    A leg at whose end a vehicle still waits to join is not reached.
    """
    return not find_fault(record, leg)


def find_fault(record: ReconfigurationRecord, leg: LegRecord) -> str:
    """Describe why a leg was not reached; empty if it was."""
    mission, name = record.mission, f"leg {leg.leg_index + 1}"
    if leg.end_event is None:
        return f"{name} did not end"
    if not leg.alive.any():
        return f"{name}, no agent is left"
    refused = [event for k, event in record.events.of_kind("refused") if k == leg.end_index]
    if any(mission.waits[event["agents"]].any() for event in refused):
        return f"{name}, a vehicle waits to join"
    agents, held = np.flatnonzero(leg.alive), leg.target_index[leg.alive]
    errors = zip(compute_terminal_errors(record, leg), ("m", "m/s"), strict=True)
    limits = mission.position_tolerance, mission.velocity_tolerance
    for (error, unit), limit in zip(errors, limits, strict=True):
        if not (error <= limit).all():
            worst = int(np.argmax(error))  # that of an agent without a target is NaN
            agent, target, tolerance = agents[worst], held[worst], f"tolerance {limit:g} {unit}"
            if np.isnan(error[worst]):
                return f"{name}, agent {agent} has no target"
            off = f"{format_value(float(error[worst]), limit)} {unit}"
            return f"{name}, target {target} is {off} from agent {agent} ({tolerance})"
    twice = [int(target) for target in held if (held == target).sum() > 1]
    return f"{name}, target {twice[0]} has two holders" if twice else ""


def _measure_shape(record: ReconfigurationRecord, leg: LegRecord) -> dict[str, float]:
    # Targets that are a free choice are no shape that could have holes.
    is_given = record.mission.assignment == "given"
    if record.mission.legs[leg.leg_index].is_free and not is_given:
        return {}
    left_out = record.find_left_out(leg)
    targets = record.leg_targets(leg)[:, : record.mission.axes]
    agents = record.frames.position[leg.end_index, leg.alive]
    agents = agents[np.isfinite(agents).all(axis=1)]
    distance = np.full(len(targets), np.inf)  # from each target to its nearest live agent
    if len(agents):
        distance, _ = cKDTree(agents).query(targets)
    is_open = ~np.isin(np.arange(len(distance)), left_out)
    m, distance = leg.largest_target_count, distance[is_open]
    is_hole = ~(distance[:m] <= record.mission.position_tolerance)
    spacing = min_distance(targets[is_open][:m])
    gap = float(distance.max(initial=0.0)) / spacing if 0 < spacing < np.inf else np.nan
    found = {"holes": int(is_hole.sum()), "gap": gap}
    return found | ({"blocked": len(left_out)} if len(left_out) else {})
