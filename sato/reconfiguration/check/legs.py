"""Promises of legs: their events agree with each other, with the instants and with the mission."""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from sato.check.report import Promise, expect_none
from sato.network.graph import CommunicationGraph, canonicalize_labels
from sato.reconfiguration.allowed_places import measure_distances
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.leg import longest_leg
from sato.reconfiguration.surroundings import count_escape_steps

BLOCKED_TOLERANCE = 0.05  # ellipsoids are taken for polytopes about them


def check_legs(record: ReconfigurationRecord) -> Promise:
    """Check that legs follow one another, and that each ends as its last instants show."""
    legs, expected = record.leg_records, np.zeros(len(record.time), dtype=np.int64)
    for leg in legs:
        expected[leg.start_index :] = leg.leg_index
    wrong = int((expected != record.leg_index).sum())
    wrong += [leg.leg_index for leg in legs] != list(range(len(legs)))
    for leg, following in pairwise(legs):
        wrong += leg.end_event is None or leg.end_index != following.start_index
    ended = [leg for leg in legs if leg.end_event is not None]
    wrong += len(record.events.of_kind("leg_end")) - len(ended)
    wrong += sum(_count_contradictions(record, leg) + _is_odd_length(record, leg) for leg in ended)
    return expect_none("legs", wrong, "entries of legs and their ends that the instants contradict")


def check_assignment(record: ReconfigurationRecord) -> Promise:
    """Check that targets change by events only, and that lost agents hold none."""
    expected = np.full_like(record.frames.target_index, -1)
    for k, event in record.events.of_kind("leg_start", "assignment", "loss"):
        agents = np.asarray(event["agents"], dtype=np.int64)
        is_new = event["kind"] == "assignment"
        expected[k:, agents] = np.asarray(event["target"], dtype=np.int64) if is_new else -1
    is_wrong = expected != record.frames.target_index
    if record.mission.assignment == "given":
        is_wrong |= (expected >= 0) & (expected != np.arange(expected.shape[1]))
    return expect_none("assignment", is_wrong, "targets held against the events or the mission")


def check_target_counts(record: ReconfigurationRecord) -> Promise:
    """Check that target counts change in auctions only, and end as the events of legs say."""
    expected = np.full_like(record.variables.targets_believed, -1)
    calls = {k for k, _ in record.events.of_kind("join", "closed")}
    replans = {k for k, _ in record.events.of_kind("replan")}
    wrong = 0
    for leg in record.leg_records:
        if leg.end_event is not None:
            expected[leg.leg_index, leg.alive] = leg.target_count[leg.alive]
        changes = np.diff(record.frames.target_count[leg.start_index : leg.end_index], axis=0)
        for k in np.flatnonzero(changes.any(axis=1)) + 1:
            is_due = k % record.mission.assignment_steps == 0 and leg.start_index + k in replans
            wrong += not (is_due or leg.start_index + k in calls)
    wrong += int((expected != record.variables.targets_believed).sum())
    return expect_none("believed", wrong, "target counts against the auctions or the events")


def check_blocked(record: ReconfigurationRecord) -> Promise:
    """Check that targets were left out only where something else comes too near to them.

    By the deadline and what it takes to get out of its way. In orbit, where what drifts may come
    near later, only that there was something.
    """
    mission, wrong, d = record.mission, 0, record.mission.axes
    radius = (float(mission.radii.max()) + mission.margin) * (1 + BLOCKED_TOLERANCE)
    sizes = [np.linalg.norm(o.corners, axis=1).max() + o.thickness for o in mission.obstacles]
    escape = count_escape_steps(mission, float(max(sizes, default=0.0)))
    for k, event in record.events.of_kind("blocked"):
        leg = int(record.leg_index[k])
        places = record.targets[leg, np.asarray(event["targets"], dtype=int), :d]
        # With states in which others saw vehicles that said nothing, as processes were paused.
        silent = [(at, e["agents"]) for at, e in record.events.of_kind("silent") if at <= k]
        seen = [record.state[at, np.asarray(agents, dtype=int)] for at, agents in silent]
        lost = np.concatenate([record.state[k, record.is_adrift[k]], *seen])
        away = np.full(len(places), np.inf)
        for step in range(mission.legs[leg].steps + escape + 1):
            time = step * mission.step
            at = lost[:, :d] + time * lost[:, d:]
            near = np.linalg.norm(mission.scale_separations(places[:, None] - at), axis=2)
            away = np.minimum(away, near.min(axis=1, initial=np.inf))
            for obstacle in mission.obstacles:  # that moves on between two steps
                moved = places - (record.time[k] + time) * obstacle.drift
                between = float(np.linalg.norm(obstacle.drift)) * mission.step / 2
                away = np.minimum(away, measure_distances(mission, obstacle, moved) - between)
        is_near = away <= radius if mission.is_point_mass else np.isfinite(away)
        wrong += int((~is_near).sum())
    return expect_none("blocked", wrong, "targets left out that nothing blocked")


def _count_contradictions(record: ReconfigurationRecord, leg: LegRecord) -> int:
    frames = record.frames
    position = np.where(leg.alive[:, None], frames.position[leg.end_index], np.nan)
    graph = CommunicationGraph.from_positions(position, record.mission.comm_radius, leg.alive)
    wrong = int((leg.alive != _find_alive_at_end(record, leg)).sum())
    labels = canonicalize_labels(leg.component), canonicalize_labels(graph.component)
    wrong += int((labels[0] != labels[1]).sum())
    if leg.step_count:
        last = leg.end_index - 1
        wrong += int((leg.target_index != frames.target_index[last])[leg.alive].sum())
        wrong += int((leg.target_count != frames.target_count[last])[leg.alive].sum())
    return wrong


def _is_odd_length(record: ReconfigurationRecord, leg: LegRecord) -> bool:
    """Tell whether a leg ends before its deadline, or long after clocks last began.

    One whose last plans were not clear lasts until others are made, or until it is given up. Over
    a network, clocks begin with the first plans, and a decision later all know that all are there.
    """
    steps, period = record.mission.legs[leg.leg_index].steps, record.mission.replan_steps
    lag = record.mission.lag_steps
    begin = ("reset", "assignment", "unconfirmed") if lag else ("reset",)
    begins = [k for k, _ in record.events.of_kind(*begin) if k < leg.end_index]
    left = ("braked", "cautious") if record.mission.has_surroundings else ("braked",)
    braked = [k + period + 1 for k, _ in record.events.of_kind(*left) if k < leg.end_index]
    latest = max([max([leg.start_index, *begins]) + steps, *braked]) + 3 * lag
    most = leg.start_index + longest_leg(steps, lag)
    gives_up = [k for k, _ in record.events.of_kind("infeasible") if k == leg.end_index == most]
    latest = min(max([latest, *gives_up]), most)
    return bool(leg.alive.any()) and not leg.start_index + steps <= leg.end_index <= latest


def _find_alive_at_end(record: ReconfigurationRecord, leg: LegRecord) -> Bool[Array, " agents"]:
    # The instant before, and the events of the last one until the leg ended.
    alive: Array = record.frames.alive[max(leg.end_index - 1, 0)].copy()
    for k, event in record.events.of_kind("loss", "join", "leg_end"):
        if event is leg.end_event:
            break
        if k == leg.end_index:
            alive[np.asarray(event["agents"], dtype=np.int64)] = event["kind"] == "join"
    return alive
