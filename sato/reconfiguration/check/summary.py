"""Summary of a reconfiguration: reached, holes, duplicates, gap, fuel and the rest."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from dynamics.trajectory_geometry import min_distance, sampled_separations
from sato.check.common import common_summary
from sato.reconfiguration.check.fuel import FuelBound, compute_step_fuel
from sato.reconfiguration.check.prediction import predict_end_states
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.feasibility import is_detectable


def summarize(record: ReconfigurationRecord, bounds: list[FuelBound | None]) -> dict[str, Any]:
    """Summarize a run from its data; entries that do not apply are absent."""
    mission = record.mission
    legs = [summarize_leg(record, leg) for leg in record.leg_records]
    found, _ = record.separations
    samples = sampled_separations(record.position, record.alive)
    reached = len(legs) == len(mission.legs) and all(leg["reached"] for leg in legs)
    summary = common_summary(record.attributes, record.alive) | {
        "reached": reached,
        "success": reached,
        "min_separation_m": min(found.minimum.distance, float(samples.min())),
        "min_separation_at_samples_m": float(samples.min()),
        "collision_radius_m": mission.collision_radius,
        "solves": sum(int(e["solves"]) for _, e in record.events.of_kind("replan")),
        "fuel_m_s": float(compute_step_fuel(record).sum()),
        "slack_used": _count_events(record, "slack"),
        "braked": _count_events(record, "braked"),
        "infeasible": _count_events(record, "infeasible"),
        "legs": legs,
    }
    if mission.flown_plant.chief_elements(0.0) is not None:
        summary |= _summarize_orbit(record)
    known = [bound.total for bound in bounds if bound is not None]
    if len(known) == len(mission.legs):
        summary["fuel_lower_bound_m_s"] = sum(known)
    if np.isfinite(mission.max_speed) and not is_detectable(mission):
        summary["undetectable"] = True
    return {k: v for k, v in summary.items() if not (isinstance(v, float) and not np.isfinite(v))}


def summarize_leg(record: ReconfigurationRecord, leg: LegRecord) -> dict[str, Any]:
    """Summarize one leg; entries that do not apply are absent."""
    end = record.leg_end(leg)
    position_error, velocity_error = compute_terminal_errors(record, leg)
    resets = (k for k, _ in record.events.of_kind("reset"))
    summary = {
        "reached": is_reached(record, leg),
        "duplicates": count_duplicates(end.target_index[end.alive]),
        "holes": len(find_holes(record, leg)),
        "gap": compute_gap(record, leg),
        "targets_believed": _largest_target_count(record, leg),
        "worst_position_error_m": _max_finite(position_error),
        "worst_velocity_error_m_s": _max_finite(velocity_error),
        "components_at_start": _count_components(record.component[leg.start_index]),
        "components_at_end": _count_components(end.component),
        "steps": leg.step_count,
        "resets": sum(leg.start_index <= k < leg.end_index for k in resets),
    }
    return {k: v for k, v in summary.items() if v is not None}


def max_model_error(record: ReconfigurationRecord, leg: LegRecord) -> float:
    """Compute the largest error of the shared model at the end of a leg [m].

    Over the agents that are there at the end, each from its state at the start of the leg, or
    where it joined, under the controls that were applied to it.
    """
    agents = np.flatnonzero(record.leg_end(leg).alive)
    end = predict_end_states(record, leg, agents, record.applied_control)
    error = (record.state[leg.end_index, agents] - end)[:, : record.axes]
    return float(np.linalg.norm(error, axis=1).max(initial=0.0))


def compute_terminal_errors(
    record: ReconfigurationRecord, leg: LegRecord
) -> tuple[Float[Array, " live"], Float[Array, " live"]]:
    """Compute the error in position and velocity at each live agent's target; NaN without one."""
    end, targets, d = record.leg_end(leg), record.targets[leg.leg_index], record.axes
    held = end.target_index[end.alive]
    is_valid = (held >= 0) & (held < len(targets))
    error = record.state[leg.end_index, end.alive] - targets[np.where(is_valid, held, 0)]
    error[~is_valid] = np.nan
    return np.linalg.norm(error[:, :d], axis=1), np.linalg.norm(error[:, d:], axis=1)


def is_reached(record: ReconfigurationRecord, leg: LegRecord) -> bool:
    """Tell whether every live agent is at the target that it alone holds."""
    end, mission = record.leg_end(leg), record.mission
    position, velocity = compute_terminal_errors(record, leg)
    is_near = (position <= mission.position_tolerance) & (velocity <= mission.velocity_tolerance)
    is_unique = not count_duplicates(end.target_index[end.alive])
    return leg.end_event is not None and bool(is_near.all()) and is_unique


def count_duplicates(held: Int[Array, " live"]) -> int:
    """Count the targets with two live holders or more."""
    _, counts = np.unique(held[held >= 0], return_counts=True)
    return int((counts > 1).sum())


def find_holes(record: ReconfigurationRecord, leg: LegRecord) -> Int[Array, " holes"]:
    """Find the targets among the first m without a live agent within the tolerance."""
    first = _finite_targets(record, leg)[: _largest_target_count(record, leg)]
    distance = _distance_to_nearest(first, _live_positions(record, leg))
    return np.flatnonzero(~(distance <= record.mission.position_tolerance))


def compute_gap(record: ReconfigurationRecord, leg: LegRecord) -> float | None:
    """Compute the largest distance from a target to its nearest live agent.

    In spacings of the first m targets; None where they have none, or no agent is alive.
    """
    targets, agents = _finite_targets(record, leg), _live_positions(record, leg)
    spacing = min_distance(targets[: _largest_target_count(record, leg)])
    if not np.isfinite(spacing) or not len(agents):
        return None
    return float(_distance_to_nearest(targets, agents).max() / spacing)


def _summarize_orbit(record: ReconfigurationRecord) -> dict[str, Any]:
    # Fuel of the agents that are there at the end: a lost agent had less to do.
    fuel = compute_step_fuel(record).sum(axis=0)[record.alive[-1]]
    errors = (max_model_error(record, leg) for leg in record.leg_records)
    summary: dict[str, Any] = {"model_error_m": max(errors, default=0.0)}
    if len(fuel):
        each = {"mean": fuel.mean(), "least": fuel.min(), "most": fuel.max()}
        summary["fuel_per_agent_m_s"] = {name: float(value) for name, value in each.items()}
    return summary


def _largest_target_count(record: ReconfigurationRecord, leg: LegRecord) -> int:
    end = record.leg_end(leg)
    return int(end.target_count[end.alive].max(initial=0))


def _finite_targets(record: ReconfigurationRecord, leg: LegRecord) -> Float[Array, "targets d"]:
    targets = record.targets[leg.leg_index]
    return np.asarray(targets[np.isfinite(targets).all(axis=1), : record.axes])


def _live_positions(record: ReconfigurationRecord, leg: LegRecord) -> Float[Array, "live d"]:
    return np.asarray(record.position[leg.end_index, record.leg_end(leg).alive])


def _distance_to_nearest(
    points: Float[Array, "k d"], agents: Float[Array, "live d"]
) -> Float[Array, " k"]:
    agents = agents[np.isfinite(agents).all(axis=1)]
    if not len(agents) or not len(points):
        return np.full(len(points), np.inf)
    return np.asarray(cKDTree(agents).query(points)[0])


def _count_events(record: ReconfigurationRecord, kind: str) -> int:
    return sum(max(len(e["agents"]), 1) for _, e in record.events.of_kind(kind))


def _max_finite(values: Float[Array, " k"]) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None


def _count_components(component: Int[Array, " agents"]) -> int:
    return len(np.unique(component[component >= 0]))
