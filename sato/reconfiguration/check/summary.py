"""The words of the summary: reached, hole, duplicate, gap and the rest."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from dynamics.trajectory_geometry import min_distance, sampled_separations
from sato.check.common import common_summary
from sato.reconfiguration.check.fuel import FuelBound, compute_step_fuel
from sato.reconfiguration.check.prediction import predict_end_states
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord


def summarize(evidence: ReconfigurationRecord, bounds: list[FuelBound | None]) -> dict[str, Any]:
    """Everything that the summary says of a run, from its data; what it lacks is absent."""
    mission = evidence.mission
    legs = [summarize_leg(evidence, s) for s in evidence.leg_records]
    is_reached_throughout = len(legs) == len(mission.legs) and all(leg["reached"] for leg in legs)
    found, _ = evidence.separations
    samples = sampled_separations(evidence.position, evidence.alive)
    said = common_summary(evidence.attributes, evidence.alive) | {
        "reached": is_reached_throughout,
        "success": is_reached_throughout,
        "min_separation_m": min(found.minimum.distance, float(samples.min())),
        "min_separation_at_samples_m": float(samples.min()),
        "collision_radius_m": mission.collision_radius,
        "solves": sum(int(e["solves"]) for _, e in evidence.events.of_kind("replan")),
        "fuel_m_s": float(compute_step_fuel(evidence).sum()),
        "slack_used": _count_events(evidence, "slack"),
        "braked": _count_events(evidence, "braked"),
        "infeasible": _count_events(evidence, "infeasible"),
        "legs": legs,
    }
    if mission.flown_plant.chief_elements(0.0) is not None:
        said |= _summarize_orbit(evidence)
    known = [b.total for b in bounds if b is not None]
    if len(known) == len(mission.legs):
        said["fuel_lower_bound_m_s"] = sum(known)
    if not is_detectable(evidence):
        said["undetectable"] = True
    return {k: v for k, v in said.items() if not (isinstance(v, float) and not np.isfinite(v))}


def max_model_error(evidence: ReconfigurationRecord, stretch: LegRecord) -> float:
    """How far the plant ended a leg from where the shared model would have, at most [m].

    Over the agents that were there at the end, each from where it was at the leg's start, or
    where it came in, under the controls that were applied to it.
    """
    _, live, _, _ = read_leg_end(evidence, stretch)
    agents = np.flatnonzero(live)
    end = predict_end_states(evidence, stretch, agents, evidence.applied_control)
    off = (evidence.state[stretch.end_index, agents] - end)[:, : evidence.axes]
    return float(np.linalg.norm(off, axis=1).max(initial=0.0))


def summarize_leg(evidence: ReconfigurationRecord, stretch: LegRecord) -> dict[str, Any]:
    """What one leg came to."""
    held, live, believed, component = read_leg_end(evidence, stretch)
    position_error, velocity_error = compute_terminal_errors(evidence, stretch)
    count = int(believed[live].max(initial=0))
    said = {
        "reached": is_reached(evidence, stretch),
        "duplicates": count_duplicates(held[live]),
        "holes": len(find_holes(evidence, stretch)),
        "gap": compute_gap(evidence, stretch),
        "targets_believed": count,
        "worst_position_error_m": _max_finite(position_error),
        "worst_velocity_error_m_s": _max_finite(velocity_error),
        "components_at_start": len(np.unique(_drop_dead(evidence.component[stretch.start_index]))),
        "components_at_end": len(np.unique(_drop_dead(component))),
        "steps": stretch.step_count,
        "resets": sum(
            stretch.start_index <= k < stretch.end_index
            for k, _ in evidence.events.of_kind("reset")
        ),
    }
    return {k: v for k, v in said.items() if v is not None}


def read_leg_end(
    evidence: ReconfigurationRecord, stretch: LegRecord
) -> tuple[
    Int[Array, " agents"], Bool[Array, " agents"], Int[Array, " agents"], Int[Array, " agents"]
]:
    """Target held, whether alive, targets believed in and component when a leg ends.

    Its last instant is the first of the next leg, which has its own targets and losses
    by then, so they are told by the event. A leg that never ended is taken as it stood.
    """
    agents = evidence.alive.shape[1]
    if stretch.end_event is None:
        last = stretch.end_index
        alive = evidence.alive[last]
        return evidence.target_index[last], alive, np.zeros(agents, int), evidence.component[last]
    alive = np.zeros(agents, dtype=bool)
    alive[np.asarray(stretch.end_event["agents"], dtype=np.int64)] = True
    held, believed, component = (
        np.asarray(stretch.end_event[name], dtype=np.int64)
        for name in ("target", "believed", "component")
    )
    return held, alive, believed, component


def compute_terminal_errors(
    evidence: ReconfigurationRecord, stretch: LegRecord
) -> tuple[Float[Array, " live"], Float[Array, " live"]]:
    """How far every live agent is from its target's position and velocity; NaN without one."""
    held, live, _, _ = read_leg_end(evidence, stretch)
    goals, d = evidence.targets[stretch.leg_index], evidence.axes
    inside = (held[live] >= 0) & (held[live] < len(goals))
    off = evidence.state[stretch.end_index, live] - goals[np.where(inside, held[live], 0)]
    off[~inside] = np.nan
    return np.linalg.norm(off[:, :d], axis=1), np.linalg.norm(off[:, d:], axis=1)


def is_reached(evidence: ReconfigurationRecord, stretch: LegRecord) -> bool:
    """Whether every live agent is at the target that it holds, and holds it alone."""
    held, live, _, _ = read_leg_end(evidence, stretch)
    mission, (position, velocity) = evidence.mission, compute_terminal_errors(evidence, stretch)
    near = (position <= mission.position_tolerance) & (velocity <= mission.velocity_tolerance)
    return stretch.end_event is not None and bool(near.all()) and not count_duplicates(held[live])


def count_duplicates(held: Int[Array, " live"]) -> int:
    """Targets with two live holders or more."""
    _, counts = np.unique(held[held >= 0], return_counts=True)
    return int((counts > 1).sum())


def find_holes(evidence: ReconfigurationRecord, stretch: LegRecord) -> Int[Array, " find_holes"]:
    """Targets among the first m that no live agent is near."""
    _, live, believed, _ = read_leg_end(evidence, stretch)
    first = _finite_targets(evidence, stretch)[: int(believed[live].max(initial=0))]
    apart = _distance_to_nearest(first, evidence.position[stretch.end_index, live])
    return np.flatnonzero(~(apart <= evidence.mission.position_tolerance))


def compute_gap(evidence: ReconfigurationRecord, stretch: LegRecord) -> float | None:
    """Largest distance from a target to its nearest live agent, in spacings of the first m.

    None where the first m have no spacing: fewer than two, or the leg never ended.
    """
    _, live, believed, _ = read_leg_end(evidence, stretch)
    goals = _finite_targets(evidence, stretch)
    spacing = min_distance(goals[: int(believed[live].max(initial=0))])
    if not np.isfinite(spacing) or not live.any():
        return None
    return float(
        _distance_to_nearest(goals, evidence.position[stretch.end_index, live]).max() / spacing
    )


def is_detectable(evidence: ReconfigurationRecord) -> bool:
    """Whether agents out of earshot cannot collide within the horizon [Morgan2016, Prop. 9]."""
    m = evidence.mission
    reach = 2 * m.max_speed * m.horizon_steps * m.step + m.collision_radius
    return bool(not np.isfinite(reach) or m.comm_radius >= reach * (1 - 1e-12))


def _summarize_orbit(evidence: ReconfigurationRecord) -> dict[str, Any]:
    # Fuel of the agents that are there at the end: who was lost had less to do.
    fuel = compute_step_fuel(evidence).sum(axis=0)[evidence.alive[-1]]
    said: dict[str, Any] = {
        "model_error_m": max(
            (max_model_error(evidence, s) for s in evidence.leg_records), default=0.0
        )
    }
    if len(fuel):
        each = {"mean": fuel.mean(), "least": fuel.min(), "most": fuel.max()}
        said["fuel_per_agent_m_s"] = {name: float(value) for name, value in each.items()}
    return said


def _finite_targets(
    evidence: ReconfigurationRecord, stretch: LegRecord
) -> Float[Array, "targets d"]:
    goals = evidence.targets[stretch.leg_index]
    return np.asarray(goals[np.isfinite(goals).all(axis=1), : evidence.axes])


def _distance_to_nearest(
    points: Float[Array, "k d"], agents: Float[Array, "live d"]
) -> Float[Array, " k"]:
    agents = agents[np.isfinite(agents).all(axis=1)]
    if not len(agents) or not len(points):
        return np.full(len(points), np.inf)
    return np.asarray(cKDTree(agents).query(points)[0])


def _count_events(evidence: ReconfigurationRecord, kind: str) -> int:
    return sum(max(len(e["agents"]), 1) for _, e in evidence.events.of_kind(kind))


def _max_finite(values: Float[Array, " k"]) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None


def _drop_dead(component: Int[Array, " agents"]) -> Int[Array, " live"]:
    return np.asarray(component[component >= 0])
