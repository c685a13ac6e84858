"""Promises of what is written: a file that agrees with its scenario and with itself."""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from dynamics.orbit import polar_nodal_scales
from sato.check.common import count_non_finite
from sato.check.promise import (
    ROUNDING_TOLERANCE,
    Promise,
    expect_none,
    expect_small_error,
    max_or_zero,
)
from sato.network.graph import CommunicationGraph, canonicalize_labels
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.check.summary import read_leg_end


def check_chief(evidence: ReconfigurationRecord) -> Promise:
    """The chief's orbit on file is the plant's, at every instant."""
    plant, step, said = evidence.mission.flown_plant, evidence.mission.step, evidence.chief
    flown = [plant.chief_elements(k * step) for k in range(len(evidence.time))]
    known = np.array([six for six in flown if six is not None])
    if said is None or not len(known):
        odd = (said is None) != (not len(known))
        return expect_none(
            "chief", odd, "lack of a chief's orbit, or orbit where the plant has none"
        )
    if said.shape != known.shape:
        return expect_none(
            "chief", 1, "orbit of a chief with another number of entries than the plant's"
        )
    off = max_or_zero(np.abs(said - known) / polar_nodal_scales(known[0]))
    return expect_small_error(
        "chief", off, ROUNDING_TOLERANCE, "off from the orbit of the plant's chief, relative"
    )


def check_finite(evidence: ReconfigurationRecord) -> Promise:
    """Live agents have states at all instants and controls at all but the last."""
    lives = evidence.alive
    bad = count_non_finite(lives, evidence.state)
    for u in (evidence.control, evidence.applied_control):
        bad += int((lives[:-1, :, None] != np.isfinite(u[:-1])).any(axis=2).sum())
        bad += int(np.isfinite(u[-1]).any(axis=1).sum())
    return expect_none("numbers", bad, "states or controls that are no numbers, or of nobody's")


def check_start(evidence: ReconfigurationRecord) -> Promise:
    """Agents start, and come in, where the scenario says."""
    mission, lives = evidence.mission, evidence.alive
    came = np.vstack([lives[:1], lives[1:] & ~lives[:-1]])
    k, i = np.nonzero(came)
    if evidence.state.shape[1:] != mission.initial_states.shape:
        return expect_none("start", 1, "another number of agents than the scenario's")
    off = max_or_zero(np.abs(evidence.state[k, i] - mission.initial_states[i]))
    odd = int((lives[0] != mission.alive).sum())
    if odd:
        return expect_none("start", odd, "agents there at the start that should not be, or lacking")
    tolerance = ROUNDING_TOLERANCE * float(np.abs(mission.initial_states).max())
    return expect_small_error("start", off, tolerance, "off from the scenario's own start, at most")


def check_targets(evidence: ReconfigurationRecord) -> Promise:
    """The targets on file are those that the scenario gives."""
    off, odd = 0.0, 0
    for goals, leg in zip(evidence.targets, evidence.mission.legs, strict=False):
        count = len(leg.targets)
        if len(goals) < count or np.isfinite(goals[count:]).any():
            odd += 1
            continue
        off = max(off, max_or_zero(np.abs(goals[:count] - leg.targets)))
    odd += abs(len(evidence.targets) - len(evidence.mission.legs))
    if odd:
        return expect_none(
            "targets", odd, "legs with another number of targets than the scenario's"
        )
    tolerance = ROUNDING_TOLERANCE * float(np.nanmax(np.abs(evidence.targets)))
    return expect_small_error("targets", off, tolerance, "off from the scenario's own targets")


def check_legs(evidence: ReconfigurationRecord) -> Promise:
    """Legs follow one another, and each ends as the instants before it say."""
    expected = np.zeros(len(evidence.time), dtype=np.int64)
    for k, event in evidence.events.of_kind("leg_start"):
        expected[k:] = int(event["leg"])
    odd = int((expected != evidence.leg).sum())
    begun = [s.leg_index for s in evidence.leg_records]
    odd += begun != list(range(len(begun)))
    for one, other in pairwise(evidence.leg_records):
        odd += one.end_event is None or one.end_index != other.start_index
    odd += sum(
        _count_contradictions(evidence, s) for s in evidence.leg_records if s.end_event is not None
    )
    return expect_none("legs", odd, "entries of legs and their ends that the instants contradict")


def check_assignment(evidence: ReconfigurationRecord) -> Promise:
    """A target changes with an event, and only so; lost agents hold none."""
    agents = evidence.alive.shape[1]
    expected = np.full((len(evidence.time), agents), -1)
    for k, event in evidence.events.of_kind("assignment", "loss"):
        who = np.asarray(event["agents"], dtype=np.int64)
        lost = event["kind"] == "loss"
        expected[k:, who] = -1 if lost else np.asarray(event["target"], dtype=np.int64)
    odd = int((expected != evidence.target_index).sum())
    return expect_none("assignment", odd, "targets held against the events")


def check_target_counts(evidence: ReconfigurationRecord) -> Promise:
    """The numbers of targets believed in are those told at the end of each leg."""
    expected = np.full(evidence.final_target_count.shape, -1)
    for stretch in evidence.leg_records:
        if stretch.end_event is not None:
            _, live, told, _ = read_leg_end(evidence, stretch)
            expected[stretch.leg_index, live] = told[live]
    odd = int((expected != evidence.final_target_count).sum())
    return expect_none("believed", odd, "numbers of targets believed in against the events")


def _count_contradictions(evidence: ReconfigurationRecord, stretch: LegRecord) -> int:
    # What the end of a leg tells against what its last instants show.
    held, live, _, labels = read_leg_end(evidence, stretch)
    position = np.where(live[:, None], evidence.position[stretch.end_index], np.nan)
    network = CommunicationGraph.from_positions(position, evidence.mission.comm_radius, live)
    odd = int((live != _find_alive_at_end(evidence, stretch)).sum())
    odd += int((canonicalize_labels(labels) != canonicalize_labels(network.component)).sum())
    if stretch.step_count:
        odd += int((held != evidence.target_index[stretch.end_index - 1])[live].sum())
    return odd


def _find_alive_at_end(
    evidence: ReconfigurationRecord, stretch: LegRecord
) -> Bool[Array, " agents"]:
    # The instant before, and what happened in the last one until the leg was declared over.
    lives: Array = evidence.alive[max(stretch.end_index - 1, 0)].copy()
    for k, event in evidence.events.of_kind("loss", "join", "leg_end"):
        if event is stretch.end_event:
            break
        if k == stretch.end_index:
            lives[np.asarray(event["agents"], dtype=np.int64)] = event["kind"] == "join"
    return lives
