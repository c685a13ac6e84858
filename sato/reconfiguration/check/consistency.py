"""Promises of consistency: the file agrees with its mission and with itself."""

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


def check_chief(record: ReconfigurationRecord) -> Promise:
    """Check that the recorded orbit of the chief is that of the plant, at every instant."""
    plant, step, found = record.mission.flown_plant, record.mission.step, record.chief
    elements = [plant.chief_elements(k * step) for k in range(len(record.time))]
    known = np.array([each for each in elements if each is not None])
    if found is None or not len(known):
        is_wrong = (found is None) != (not len(known))
        return expect_none("chief", is_wrong, "missing orbit of a chief, or one without a chief")
    if found.shape != known.shape:
        return expect_none("chief", 1, "orbit of a chief with another number of entries")
    error = max_or_zero(np.abs(found - known) / polar_nodal_scales(known[0]))
    text = "relative error of the orbit of the chief"
    return expect_small_error("chief", error, ROUNDING_TOLERANCE, text)


def check_finite(record: ReconfigurationRecord) -> Promise:
    """Check that live agents have states at all instants and controls at all but the last."""
    alive = record.alive
    bad = count_non_finite(alive, record.state)
    for u in (record.control, record.applied_control):
        bad += int((alive[:-1, :, None] != np.isfinite(u[:-1])).any(axis=2).sum())
        bad += int(np.isfinite(u[-1]).any(axis=1).sum())
    text = "states or controls that are not finite, or of agents that are not alive"
    return expect_none("numbers", bad, text)


def check_start(record: ReconfigurationRecord) -> Promise:
    """Check that agents start, and join, with the states of the mission."""
    mission, alive = record.mission, record.alive
    if record.state.shape[1:] != mission.initial_states.shape:
        return expect_none("start", 1, "another number of agents than in the mission")
    wrong = int((alive[0] != mission.alive).sum())
    if wrong:
        text = "agents that are alive at the start and should not be, or the reverse"
        return expect_none("start", wrong, text)
    k, i = np.nonzero(np.vstack([alive[:1], alive[1:] & ~alive[:-1]]))
    error = max_or_zero(np.abs(record.state[k, i] - mission.initial_states[i]))
    tolerance = ROUNDING_TOLERANCE * float(np.abs(mission.initial_states).max())
    return expect_small_error("start", error, tolerance, "error of an initial state, at most")


def check_targets(record: ReconfigurationRecord) -> Promise:
    """Check that the recorded targets are those of the mission."""
    legs = record.mission.legs
    error, wrong = 0.0, abs(len(record.targets) - len(legs))
    for targets, leg in zip(record.targets, legs, strict=False):
        count = len(leg.targets)
        if len(targets) < count or np.isfinite(targets[count:]).any():
            wrong += 1
            continue
        error = max(error, max_or_zero(np.abs(targets[:count] - leg.targets)))
    if wrong:
        text = "legs with another number of targets than in the mission"
        return expect_none("targets", wrong, text)
    tolerance = ROUNDING_TOLERANCE * float(np.nanmax(np.abs(record.targets)))
    return expect_small_error("targets", error, tolerance, "error of a target, at most")


def check_legs(record: ReconfigurationRecord) -> Promise:
    """Check that legs follow one another, and that each ends as its last instants show."""
    expected = np.zeros(len(record.time), dtype=np.int64)
    for k, event in record.events.of_kind("leg_start"):
        expected[k:] = int(event["leg"])
    wrong = int((expected != record.leg).sum())
    begun = [leg.leg_index for leg in record.leg_records]
    wrong += begun != list(range(len(begun)))
    for leg, following in pairwise(record.leg_records):
        wrong += leg.end_event is None or leg.end_index != following.start_index
    ended = (leg for leg in record.leg_records if leg.end_event is not None)
    wrong += sum(_count_contradictions(record, leg) for leg in ended)
    return expect_none("legs", wrong, "entries of legs and their ends that the instants contradict")


def check_assignment(record: ReconfigurationRecord) -> Promise:
    """Check that targets change by events only, and that lost agents hold none."""
    expected = np.full(record.target_index.shape, -1)
    for k, event in record.events.of_kind("assignment", "loss"):
        agents = np.asarray(event["agents"], dtype=np.int64)
        is_loss = event["kind"] == "loss"
        expected[k:, agents] = -1 if is_loss else np.asarray(event["target"], dtype=np.int64)
    wrong = int((expected != record.target_index).sum())
    return expect_none("assignment", wrong, "targets held against the events")


def check_target_counts(record: ReconfigurationRecord) -> Promise:
    """Check that the final target counts are those of the events at the end of each leg."""
    expected = np.full(record.final_target_count.shape, -1)
    for leg in record.leg_records:
        if leg.end_event is not None:
            end = record.leg_end(leg)
            expected[leg.leg_index, end.alive] = end.target_count[end.alive]
    wrong = int((expected != record.final_target_count).sum())
    return expect_none("believed", wrong, "target counts against the events")


def _count_contradictions(record: ReconfigurationRecord, leg: LegRecord) -> int:
    end = record.leg_end(leg)
    position = np.where(end.alive[:, None], record.position[leg.end_index], np.nan)
    graph = CommunicationGraph.from_positions(position, record.mission.comm_radius, end.alive)
    wrong = int((end.alive != _find_alive_at_end(record, leg)).sum())
    labels = canonicalize_labels(end.component), canonicalize_labels(graph.component)
    wrong += int((labels[0] != labels[1]).sum())
    if leg.step_count:
        is_changed = end.target_index != record.target_index[leg.end_index - 1]
        wrong += int(is_changed[end.alive].sum())
    return wrong


def _find_alive_at_end(record: ReconfigurationRecord, leg: LegRecord) -> Bool[Array, " agents"]:
    # The instant before, and the events of the last one until the leg ended.
    alive: Array = record.alive[max(leg.end_index - 1, 0)].copy()
    for k, event in record.events.of_kind("loss", "join", "leg_end"):
        if event is leg.end_event:
            break
        if k == leg.end_index:
            alive[np.asarray(event["agents"], dtype=np.int64)] = event["kind"] == "join"
    return alive
