"""The words of the summary: reached, hole, duplicate, gap and the rest."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from dynamics.path import least_distance, sampled_separations
from sato.check.common import words
from sato.reconfiguration.check.evidence import Evidence, Stretch
from sato.reconfiguration.check.fuel import Bound, burnt
from sato.reconfiguration.check.prediction import end_by_model


def summarise(evidence: Evidence, bounds: list[Bound | None]) -> dict[str, Any]:
    """Everything that the summary says of a run, from its data; what it lacks is absent."""
    mission = evidence.mission
    legs = [describe(evidence, s) for s in evidence.stretches]
    found, _ = evidence.pieces
    samples = sampled_separations(evidence.position, evidence.alive)
    said = words(evidence.attributes, evidence.alive) | {
        "reached": len(legs) == len(mission.legs) and all(leg["reached"] for leg in legs),
        "min_separation_m": min(found.least.distance, float(samples.min())),
        "min_separation_at_samples_m": float(samples.min()),
        "collision_radius_m": mission.collision_radius,
        "solves": sum(int(e["solves"]) for _, e in evidence.happened.told("replan")),
        "fuel_m_s": float(burnt(evidence).sum()),
        "slack_used": _count(evidence, "slack"),
        "braked": _count(evidence, "braked"),
        "infeasible": _count(evidence, "infeasible"),
        "legs": legs,
    }
    if mission.truth.chief(0.0) is not None:
        said |= _in_orbit(evidence)
    known = [b.total for b in bounds if b is not None]
    if len(known) == len(mission.legs):
        said["fuel_lower_bound_m_s"] = sum(known)
    if not detectable(evidence):
        said["undetectable"] = True
    return {k: v for k, v in said.items() if not (isinstance(v, float) and not np.isfinite(v))}


def model_error(evidence: Evidence, stretch: Stretch) -> float:
    """How far the plant ended a leg from where the shared model would have, at most [m].

    Over the agents that were there at the end, each from where it was at the leg's start, or
    where it came in, under the controls that were applied to it.
    """
    _, live, _, _ = at_end(evidence, stretch)
    agents = np.flatnonzero(live)
    end = end_by_model(evidence, stretch, agents, evidence.applied)
    off = (evidence.state[stretch.last, agents] - end)[:, : evidence.axes]
    return float(np.linalg.norm(off, axis=1).max(initial=0.0))


def describe(evidence: Evidence, stretch: Stretch) -> dict[str, Any]:
    """What one leg came to."""
    held, live, believed, component = at_end(evidence, stretch)
    position_error, velocity_error = errors(evidence, stretch)
    count = int(believed[live].max(initial=0))
    said = {
        "reached": reached(evidence, stretch),
        "duplicates": duplicates(held[live]),
        "holes": len(holes(evidence, stretch)),
        "gap": gap(evidence, stretch),
        "targets_believed": count,
        "worst_position_error_m": _worst(position_error),
        "worst_velocity_error_m_s": _worst(velocity_error),
        "components_at_start": len(np.unique(_real(evidence.component[stretch.first]))),
        "components_at_end": len(np.unique(_real(component))),
        "steps": stretch.steps,
        "resets": sum(
            stretch.first <= k < stretch.last for k, _ in evidence.happened.told("reset")
        ),
    }
    return {k: v for k, v in said.items() if v is not None}


def at_end(
    evidence: Evidence, stretch: Stretch
) -> tuple[
    Int[Array, " agents"], Bool[Array, " agents"], Int[Array, " agents"], Int[Array, " agents"]
]:
    """Target held, whether alive, targets believed in and component when a leg ends.

    Its last instant is the first of the next leg, which has its own targets and losses
    by then, so they are told by the event. A leg that never ended is taken as it stood.
    """
    agents = evidence.alive.shape[1]
    if stretch.end is None:
        last = stretch.last
        alive = evidence.alive[last]
        return evidence.target[last], alive, np.zeros(agents, int), evidence.component[last]
    alive = np.zeros(agents, dtype=bool)
    alive[np.asarray(stretch.end["agents"], dtype=np.int64)] = True
    held, believed, component = (
        np.asarray(stretch.end[name], dtype=np.int64)
        for name in ("target", "believed", "component")
    )
    return held, alive, believed, component


def errors(
    evidence: Evidence, stretch: Stretch
) -> tuple[Float[Array, " live"], Float[Array, " live"]]:
    """How far every live agent is from its target's position and velocity; NaN without one."""
    held, live, _, _ = at_end(evidence, stretch)
    goals, d = evidence.goals[stretch.leg], evidence.axes
    inside = (held[live] >= 0) & (held[live] < len(goals))
    off = evidence.state[stretch.last, live] - goals[np.where(inside, held[live], 0)]
    off[~inside] = np.nan
    return np.linalg.norm(off[:, :d], axis=1), np.linalg.norm(off[:, d:], axis=1)


def reached(evidence: Evidence, stretch: Stretch) -> bool:
    """Whether every live agent is at the target that it holds, and holds it alone."""
    held, live, _, _ = at_end(evidence, stretch)
    mission, (position, velocity) = evidence.mission, errors(evidence, stretch)
    near = (position <= mission.position_tolerance) & (velocity <= mission.velocity_tolerance)
    return stretch.end is not None and bool(near.all()) and not duplicates(held[live])


def duplicates(held: Int[Array, " live"]) -> int:
    """Targets with two live holders or more."""
    _, counts = np.unique(held[held >= 0], return_counts=True)
    return int((counts > 1).sum())


def holes(evidence: Evidence, stretch: Stretch) -> Int[Array, " holes"]:
    """Targets among the first m that no live agent is near."""
    _, live, believed, _ = at_end(evidence, stretch)
    first = _targets(evidence, stretch)[: int(believed[live].max(initial=0))]
    apart = _distance_to_nearest(first, evidence.position[stretch.last, live])
    return np.flatnonzero(~(apart <= evidence.mission.position_tolerance))


def gap(evidence: Evidence, stretch: Stretch) -> float | None:
    """Largest distance from a target to its nearest live agent, in spacings of the first m.

    None where the first m have no spacing: fewer than two, or the leg never ended.
    """
    _, live, believed, _ = at_end(evidence, stretch)
    goals = _targets(evidence, stretch)
    spacing = least_distance(goals[: int(believed[live].max(initial=0))])
    if not np.isfinite(spacing) or not live.any():
        return None
    return float(_distance_to_nearest(goals, evidence.position[stretch.last, live]).max() / spacing)


def detectable(evidence: Evidence) -> bool:
    """Whether agents out of earshot cannot collide within the horizon [Morgan2016, Prop. 9]."""
    m = evidence.mission
    reach = 2 * m.max_speed * m.horizon_steps * m.step + m.collision_radius
    return bool(not np.isfinite(reach) or m.comm_radius >= reach * (1 - 1e-12))


def _in_orbit(evidence: Evidence) -> dict[str, Any]:
    # Fuel of the agents that are there at the end: who was lost had less to do.
    fuel = burnt(evidence).sum(axis=0)[evidence.alive[-1]]
    said: dict[str, Any] = {
        "model_error_m": max((model_error(evidence, s) for s in evidence.stretches), default=0.0)
    }
    if len(fuel):
        each = {"mean": fuel.mean(), "least": fuel.min(), "most": fuel.max()}
        said["fuel_per_agent_m_s"] = {name: float(value) for name, value in each.items()}
    return said


def _targets(evidence: Evidence, stretch: Stretch) -> Float[Array, "targets d"]:
    goals = evidence.goals[stretch.leg]
    return np.asarray(goals[np.isfinite(goals).all(axis=1), : evidence.axes])


def _distance_to_nearest(
    points: Float[Array, "k d"], agents: Float[Array, "live d"]
) -> Float[Array, " k"]:
    agents = agents[np.isfinite(agents).all(axis=1)]
    if not len(agents) or not len(points):
        return np.full(len(points), np.inf)
    return np.asarray(cKDTree(agents).query(points)[0])


def _count(evidence: Evidence, kind: str) -> int:
    return sum(max(len(e["agents"]), 1) for _, e in evidence.happened.told(kind))


def _worst(values: Float[Array, " k"]) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None


def _real(component: Int[Array, " agents"]) -> Int[Array, " live"]:
    return np.asarray(component[component >= 0])
