"""Promises of what is written: a file that agrees with its scenario and with itself."""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from dynamics.orbit import chief_size
from sato.check.common import lacking
from sato.check.promise import RELATIVE, Promise, largest, none, within
from sato.network import Network, canonical
from sato.reconfiguration.check.evidence import Evidence, Stretch
from sato.reconfiguration.check.words import at_end


def chief(evidence: Evidence) -> Promise:
    """The chief's orbit on file is the plant's, at every instant."""
    plant, step, said = evidence.mission.truth, evidence.mission.step, evidence.chief
    flown = [plant.chief(k * step) for k in range(len(evidence.time))]
    known = np.array([six for six in flown if six is not None])
    if said is None or not len(known):
        odd = (said is None) != (not len(known))
        return none("chief", odd, "lack of a chief's orbit, or orbit where the plant has none")
    if said.shape != known.shape:
        return none("chief", 1, "orbit of a chief with another number of entries than the plant's")
    off = largest(np.abs(said - known) / chief_size(known[0]))
    return within("chief", off, RELATIVE, "off from the orbit of the plant's chief, relative")


def numbers(evidence: Evidence) -> Promise:
    """Live agents have states at all instants and controls at all but the last."""
    lives = evidence.alive
    bad = lacking(lives, evidence.state)
    for u in (evidence.control, evidence.applied):
        bad += int((lives[:-1, :, None] != np.isfinite(u[:-1])).any(axis=2).sum())
        bad += int(np.isfinite(u[-1]).any(axis=1).sum())
    return none("numbers", bad, "states or controls that are no numbers, or of nobody's")


def start(evidence: Evidence) -> Promise:
    """Agents start, and come in, where the scenario says."""
    mission, lives = evidence.mission, evidence.alive
    came = np.vstack([lives[:1], lives[1:] & ~lives[:-1]])
    k, i = np.nonzero(came)
    if evidence.state.shape[1:] != mission.start.shape:
        return none("start", 1, "another number of agents than the scenario's")
    off = largest(np.abs(evidence.state[k, i] - mission.start[i]))
    odd = int((lives[0] != mission.alive).sum())
    if odd:
        return none("start", odd, "agents there at the start that should not be, or lacking")
    tolerance = RELATIVE * float(np.abs(mission.start).max())
    return within("start", off, tolerance, "off from the scenario's own start, at most")


def targets(evidence: Evidence) -> Promise:
    """The targets on file are those that the scenario gives."""
    off, odd = 0.0, 0
    for goals, leg in zip(evidence.goals, evidence.mission.legs, strict=False):
        count = len(leg.targets)
        if len(goals) < count or np.isfinite(goals[count:]).any():
            odd += 1
            continue
        off = max(off, largest(np.abs(goals[:count] - leg.targets)))
    odd += abs(len(evidence.goals) - len(evidence.mission.legs))
    if odd:
        return none("targets", odd, "legs with another number of targets than the scenario's")
    tolerance = RELATIVE * float(np.nanmax(np.abs(evidence.goals)))
    return within("targets", off, tolerance, "off from the scenario's own targets")


def legs(evidence: Evidence) -> Promise:
    """Legs follow one another, and each ends as the instants before it say."""
    expected = np.zeros(len(evidence.time), dtype=np.int64)
    for k, event in evidence.happened.told("leg_start"):
        expected[k:] = int(event["leg"])
    odd = int((expected != evidence.leg).sum())
    begun = [s.leg for s in evidence.stretches]
    odd += begun != list(range(len(begun)))
    for one, other in pairwise(evidence.stretches):
        odd += one.end is None or one.last != other.first
    odd += sum(_contradicted(evidence, s) for s in evidence.stretches if s.end is not None)
    return none("legs", odd, "entries of legs and their ends that the instants contradict")


def assignment(evidence: Evidence) -> Promise:
    """A target changes with an event, and only so; lost agents hold none."""
    agents = evidence.alive.shape[1]
    expected = np.full((len(evidence.time), agents), -1)
    for k, event in evidence.happened.told("assignment", "loss"):
        who = np.asarray(event["agents"], dtype=np.int64)
        lost = event["kind"] == "loss"
        expected[k:, who] = -1 if lost else np.asarray(event["target"], dtype=np.int64)
    odd = int((expected != evidence.target).sum())
    return none("assignment", odd, "targets held against the events")


def believed(evidence: Evidence) -> Promise:
    """The numbers of targets believed in are those told at the end of each leg."""
    expected = np.full(evidence.believed.shape, -1)
    for stretch in evidence.stretches:
        if stretch.end is not None:
            _, live, told, _ = at_end(evidence, stretch)
            expected[stretch.leg, live] = told[live]
    odd = int((expected != evidence.believed).sum())
    return none("believed", odd, "numbers of targets believed in against the events")


def _contradicted(evidence: Evidence, stretch: Stretch) -> int:
    # What the end of a leg tells against what its last instants show.
    held, live, _, labels = at_end(evidence, stretch)
    position = np.where(live[:, None], evidence.position[stretch.last], np.nan)
    network = Network.within(position, evidence.mission.comm_radius, live)
    odd = int((live != _alive_at_end(evidence, stretch)).sum())
    odd += int((canonical(labels) != canonical(network.component)).sum())
    if stretch.steps:
        odd += int((held != evidence.target[stretch.last - 1])[live].sum())
    return odd


def _alive_at_end(evidence: Evidence, stretch: Stretch) -> Bool[Array, " agents"]:
    # The instant before, and what happened in the last one until the leg was declared over.
    lives: Array = evidence.alive[max(stretch.last - 1, 0)].copy()
    for k, event in evidence.happened.told("loss", "join", "leg_end"):
        if event is stretch.end:
            break
        if k == stretch.last:
            lives[np.asarray(event["agents"], dtype=np.int64)] = event["kind"] == "join"
    return lives
