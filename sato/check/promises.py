"""What a run promises, each judged by recomputing it."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.path import sampled_separations
from sato.check.evidence import Evidence, Stretch
from sato.check.fuel import Bound, burnt, size
from sato.check.words import at_end, reached
from sato.network import Network

RELATIVE = 1e-10  # of the largest position, speed or control: what rounding may do in a step
SIGMAS = 8.0  # a normal draw is further out once in 10¹⁵


class Promise(NamedTuple):
    """Something that a run must keep, and what was found."""

    name: str
    kept: bool
    value: float  # what was found: the worst violation, or the quantity itself
    tolerance: float  # what it may be
    sentence: str


def promises(evidence: Evidence, bounds: list[Bound | None]) -> tuple[Promise, ...]:
    """Judge everything."""
    return (
        complete(evidence),
        times(evidence),
        numbers(evidence),
        start(evidence),
        alive(evidence),
        component(evidence),
        flight(evidence),
        applied(evidence),
        control_limit(evidence),
        speed_limit(evidence),
        targets(evidence),
        legs(evidence),
        assignment(evidence),
        believed(evidence),
        separation(evidence),
        feasible(evidence),
        arrival(evidence),
        fuel(evidence, bounds),
    )


def complete(evidence: Evidence) -> Promise:
    """The flight was not interrupted and every leg came to its end."""
    ended = {s.leg for s in evidence.stretches if s.end is not None}
    lacking = [leg for leg in range(len(evidence.mission.legs)) if leg not in ended]
    cut = not evidence.attributes.get("complete", 1)
    text = f"legs that never ended: {lacking}" if lacking else "every leg came to its end"
    return _none("complete", len(lacking) + cut, text + (", and it was interrupted" if cut else ""))


def times(evidence: Evidence) -> Promise:
    """Instants are a control step apart, from zero on."""
    t, step = evidence.time, evidence.mission.step
    off = _largest(np.abs(t - step * np.arange(len(t))))
    if not (np.diff(t) > 0).all():
        k = int(np.argmin(np.diff(t) > 0))
        return Promise(
            "times", False, off, 0.0, f"time does not increase from instant {k} to {k + 1}"
        )
    tolerance = 1e-9 * step
    return _within("times", off, tolerance, "s off from one control step to the next")


def numbers(evidence: Evidence) -> Promise:
    """Live agents have states at all instants and controls at all but the last."""
    lives = evidence.alive
    bad = int((lives & ~np.isfinite(evidence.state).all(axis=2)).sum())
    for u in (evidence.control, evidence.applied):
        bad += int((lives[:-1, :, None] != np.isfinite(u[:-1])).any(axis=2).sum())
        bad += int(np.isfinite(u[-1]).any(axis=1).sum())
    return _none("numbers", bad, "states or controls that are no numbers, or of nobody's")


def start(evidence: Evidence) -> Promise:
    """Agents start, and come in, where the scenario says."""
    mission, lives = evidence.mission, evidence.alive
    came = np.vstack([lives[:1], lives[1:] & ~lives[:-1]])
    k, i = np.nonzero(came)
    if evidence.state.shape[1:] != mission.start.shape:
        return _none("start", 1, "another number of agents than the scenario's")
    off = _largest(np.abs(evidence.state[k, i] - mission.start[i]))
    odd = int((lives[0] != mission.alive).sum())
    if odd:
        return _none("start", odd, "agents there at the start that should not be, or lacking")
    tolerance = RELATIVE * float(np.abs(mission.start).max())
    return _within("start", off, tolerance, "off from the scenario's own start, at most")


def alive(evidence: Evidence) -> Promise:
    """Agents come and go with an event, and only so."""
    expected = evidence.alive[:1].repeat(len(evidence.time), axis=0)
    for k, event in evidence.told("loss", "join"):
        expected[k:, np.asarray(event["agents"], dtype=np.int64)] = event["kind"] == "join"
    odd = int((expected != evidence.alive).sum())
    return _none("alive", odd, "times an agent was there or not against the events")


def component(evidence: Evidence) -> Promise:
    """Components are those of the positions and the communication radius."""
    odd = 0
    radius = evidence.mission.comm_radius
    for p, lives, said in zip(evidence.position, evidence.alive, evidence.component, strict=True):
        found = Network.within(p, radius, lives).component
        odd += int((_canonical(found) != _canonical(said)).sum())
    return _none("component", odd, "labels that positions and communication radius do not give")


def flight(evidence: Evidence) -> Promise:
    """Every step, flown again from the recorded state by the applied control, ends as recorded."""
    x, u, steps = evidence.state, evidence.applied[:-1], evidence.steps
    flown = (
        np.einsum("kab,kib->kia", steps.A, x[:-1])
        + np.einsum("kab,kib->kia", steps.B, u)
        + steps.z[:, None]
    )
    off = np.abs(flown - x[1:]) / _scale(evidence)
    # The dead stay where they are, so that nothing of the file is beyond the check.
    still = ~evidence.alive[:-1] & ~evidence.alive[1:]
    resting = np.abs(x[1:] - x[:-1]) / _scale(evidence)
    worst = max(_largest(off[evidence.flies]), _largest(np.nan_to_num(resting[still])))
    text = "relative error of a step flown again by its applied control"
    return _within("flight", worst, RELATIVE, text)


def applied(evidence: Evidence) -> Promise:
    """The applied control is the commanded one, but for the scenario's disturbance."""
    off = _largest(np.abs(evidence.applied - evidence.control)[:-1][evidence.flies])
    tolerance = SIGMAS * evidence.mission.disturbance
    return _within("applied", off, tolerance, "m/s² between commanded and applied control")


def control_limit(evidence: Evidence) -> Promise:
    """No commanded control is above its limit."""
    mission = evidence.mission
    u = size(evidence.control[:-1][evidence.flies], mission.control_norm)
    return _limit("control", _largest(u), mission.max_control, 1e-9, "m/s² commanded")


def speed_limit(evidence: Evidence) -> Promise:
    """No agent is faster than it may be, but for what noise adds before it is noticed."""
    mission = evidence.mission
    speed = np.linalg.norm(evidence.velocity[evidence.alive], axis=-1)
    noise = mission.replan_steps * mission.step * mission.disturbance + mission.velocity_noise
    slack = SIGMAS * noise * evidence.axes**0.5
    limit = mission.max_speed + slack if slack else mission.max_speed
    return _limit("speed", _largest(speed), limit, 1e-9, "m/s flown")


def targets(evidence: Evidence) -> Promise:
    """The targets on file are those that the scenario gives."""
    off, odd = 0.0, 0
    for goals, leg in zip(evidence.goals, evidence.mission.legs, strict=False):
        count = len(leg.targets)
        if len(goals) < count or np.isfinite(goals[count:]).any():
            odd += 1
            continue
        off = max(off, _largest(np.abs(goals[:count] - leg.targets)))
    odd += abs(len(evidence.goals) - len(evidence.mission.legs))
    if odd:
        return _none("targets", odd, "legs with another number of targets than the scenario's")
    tolerance = RELATIVE * float(np.nanmax(np.abs(evidence.goals)))
    return _within("targets", off, tolerance, "off from the scenario's own targets")


def legs(evidence: Evidence) -> Promise:
    """Legs follow one another, and each ends as the instants before it say."""
    expected = np.zeros(len(evidence.time), dtype=np.int64)
    for k, event in evidence.told("leg_start"):
        expected[k:] = int(event["leg"])
    odd = int((expected != evidence.leg).sum())
    begun = [s.leg for s in evidence.stretches]
    odd += begun != list(range(len(begun)))
    for one, other in pairwise(evidence.stretches):
        odd += one.end is None or one.last != other.first
    odd += sum(_contradicted(evidence, s) for s in evidence.stretches if s.end is not None)
    return _none("legs", odd, "entries of legs and their ends that the instants contradict")


def assignment(evidence: Evidence) -> Promise:
    """A target changes with an event, and only so; lost agents hold none."""
    agents = evidence.alive.shape[1]
    expected = np.full((len(evidence.time), agents), -1)
    for k, event in evidence.told("assignment", "loss"):
        who = np.asarray(event["agents"], dtype=np.int64)
        lost = event["kind"] == "loss"
        expected[k:, who] = -1 if lost else np.asarray(event["target"], dtype=np.int64)
    odd = int((expected != evidence.target).sum())
    return _none("assignment", odd, "targets held against the events")


def believed(evidence: Evidence) -> Promise:
    """The numbers of targets believed in are those told at the end of each leg."""
    expected = np.full(evidence.believed.shape, -1)
    for stretch in evidence.stretches:
        if stretch.end is not None:
            _, live, told, _ = at_end(evidence, stretch)
            expected[stretch.leg, live] = told[live]
    odd = int((expected != evidence.believed).sum())
    return _none("believed", odd, "numbers of targets believed in against the events")


def separation(evidence: Evidence) -> Promise:
    """No two agents come closer than the collision radius, at samples or between them."""
    found, missed = evidence.pieces
    radius = evidence.mission.collision_radius
    samples = float(sampled_separations(evidence.position, evidence.alive).min())
    least = min(found.least.distance, samples)
    i, j = found.least.pair
    k = max(found.least.piece, 0) // evidence.refinement
    allowed = radius * (1 - 1e-9)
    text = f"{least:.9g} m between agents {i} and {j} in step {k}, {radius:g} m allowed"
    if missed:
        text += f" (the path between samples is known to {missed:.1g} m)"
    return Promise("separation", bool(least - missed >= allowed), least, allowed, text)


def feasible(evidence: Evidence) -> Promise:
    """Every programme had an answer."""
    count = len(evidence.told("infeasible"))
    return _none("feasible", count, "programmes that had no answer on the way")


def arrival(evidence: Evidence) -> Promise:
    """Every leg was reached."""
    short = [s.leg for s in evidence.stretches if not reached(evidence, s)]
    text = f"legs that were not reached: {short}" if short else "every leg was reached"
    lacking = len(evidence.mission.legs) - len(evidence.stretches)
    return _none("reached", len(short) + lacking, text)


def fuel(evidence: Evidence, bounds: list[Bound | None]) -> Promise:
    """No leg burnt less than the least that it could have."""
    burn, short, text = burnt(evidence), 0.0, "a leg's fuel below its lower bound, relative"
    mission = evidence.mission
    for stretch, bound in zip(evidence.stretches, bounds, strict=True):
        # Where a leg was not reached, or the plant was pushed, less fuel is no wonder.
        if bound is None or not reached(evidence, stretch) or mission.disturbance:
            continue
        spent = float(burn[stretch.first : stretch.last, bound.agents].sum())
        slack = (
            2
            * len(bound.agents)
            * (mission.velocity_tolerance + mission.position_tolerance / mission.step)
        )
        short = max(short, (bound.total - spent - slack) / max(bound.total, 1e-12))
    return _within("fuel", short, 1e-6, text)


def _contradicted(evidence: Evidence, stretch: Stretch) -> int:
    # What the end of a leg tells against what its last instants show.
    held, live, _, labels = at_end(evidence, stretch)
    position = np.where(live[:, None], evidence.position[stretch.last], np.nan)
    network = Network.within(position, evidence.mission.comm_radius, live)
    odd = int((live != _alive_at_end(evidence, stretch)).sum())
    odd += int((_canonical(labels) != _canonical(network.component)).sum())
    if stretch.steps:
        odd += int((held != evidence.target[stretch.last - 1])[live].sum())
    return odd


def _alive_at_end(evidence: Evidence, stretch: Stretch) -> Bool[Array, " agents"]:
    # The instant before, and what happened in the last one until the leg was declared over.
    lives: Array = evidence.alive[max(stretch.last - 1, 0)].copy()
    for k, event in evidence.told("loss", "join", "leg_end"):
        if event is stretch.end:
            break
        if k == stretch.last:
            lives[np.asarray(event["agents"], dtype=np.int64)] = event["kind"] == "join"
    return lives


def _scale(evidence: Evidence) -> Float[Array, " n"]:
    p, v, u = (
        np.max(np.abs(a), initial=0.0, where=np.isfinite(a))
        for a in (evidence.position, evidence.velocity, evidence.applied)
    )
    step, d = evidence.mission.step, evidence.axes
    return np.repeat([p + v * step, v + u * step], d) + 1e-300


def _canonical(labels: Int[Array, " agents"]) -> Int[Array, " agents"]:
    # Components numbered in order of their first member, the dead −1.
    named = np.full(len(labels), -1)
    live = labels >= 0
    if live.any():
        _, first, inverse = np.unique(labels[live], return_index=True, return_inverse=True)
        named[live] = np.argsort(np.argsort(first))[inverse]
    return named


def _largest(values: Float[Array, "*k"] | Bool[Array, "*k"]) -> float:
    # NaN where there is any, so that nothing passes unseen.
    return float(np.max(values, initial=0.0))


def _none(name: str, count: int | np.integer, what: str) -> Promise:
    text = what if what.startswith(("legs", "every")) else f"{int(count) or 'no'} {what}"
    return Promise(name, int(count) == 0, float(count), 0.0, text)


def _within(name: str, value: float, tolerance: float, what: str) -> Promise:
    return Promise(name, bool(value <= tolerance), value, tolerance, f"{value:.3g} {what}")


def _limit(name: str, value: float, limit: float, relative: float, what: str) -> Promise:
    kept = bool(value <= limit * (1 + relative))
    return Promise(name, kept, value, limit, f"{value:.6g} {what}, {limit:.6g} allowed")
