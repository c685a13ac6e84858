"""Promises that the runs of every system make."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.check.event_log import EventLog
from sato.check.promise import Promise, expect_none, expect_small_error, max_or_zero
from sato.network.graph import CommunicationGraph, canonicalize_labels


def common_summary(
    said: Mapping[str, Any], alive: Bool[Array, "instants agents"]
) -> dict[str, Any]:
    """What the summary of every run begins with.

    Args:
        said: The attributes of the run.
        alive: Who took part, and when.
    """
    return {
        "system": str(said["system"]),
        "scenario": str(said["name"]),
        "seed": int(said["seed"]),
        "version": str(said["version"]),
        "agents": int(alive.shape[1]),
    }


def incomplete_reason(said: Mapping[str, Any]) -> str:
    """In words, why a flight was not completed; empty if it was.

    Args:
        said: The attributes of the run.
    """
    if said.get("complete", 1):
        return ""
    return f"the flight was not completed ({said.get('stopped', 'nobody says why')})"


def check_attributes(said: Mapping[str, Any], asked: Mapping[str, float]) -> Promise:
    """The radii and limits in the attributes are those of the scenario."""
    odd = sum(name in said and float(said[name]) != value for name, value in asked.items())
    odd += sum(name not in said for name in asked)
    return expect_none("attributes", odd, "radii or limits that are not the scenario's")


def check_times(time: Float[Array, " instants"], step: float) -> Promise:
    """Instants are a step apart, from zero on [s]."""
    off = max_or_zero(np.abs(time - step * np.arange(len(time))))
    if not (np.diff(time) > 0).all():
        k = int(np.argmin(np.diff(time) > 0))
        return Promise(
            "times", False, off, 0.0, f"time does not increase from instant {k} to {k + 1}"
        )
    return expect_small_error("times", off, 1e-9 * step, "s off from one control step to the next")


def count_non_finite(
    alive: Bool[Array, "instants agents"], values: Float[Array, "instants agents *k"]
) -> int:
    """How often something of a live agent is no number."""
    return int((alive & ~np.isfinite(values).reshape(*alive.shape, -1).all(axis=2)).sum())


def check_finite(
    alive: Bool[Array, "instants agents"], *states: Float[Array, "instants agents *k"]
) -> Promise:
    """Live agents have states at all instants."""
    bad = sum(count_non_finite(alive, values) for values in states)
    return expect_none("numbers", bad, "states of live agents that are no numbers")


def check_alive(lives: Bool[Array, "instants agents"], happened: EventLog) -> Promise:
    """Agents come and go with an event, and only so."""
    expected = lives[:1].repeat(len(lives), axis=0)
    for k, event in happened.of_kind("loss", "join"):
        expected[k:, np.asarray(event["agents"], dtype=np.int64)] = event["kind"] == "join"
    odd = int((expected != lives).sum())
    return expect_none("alive", odd, "times an agent was there or not against the events")


def check_components(
    position: Float[Array, "instants agents d"],
    alive: Bool[Array, "instants agents"],
    component: Int[Array, "instants agents"],
    radius: float,
) -> Promise:
    """Components are those of the positions and the communication radius [m]."""
    odd = 0
    for p, lives, said in zip(position, alive, component, strict=True):
        found = CommunicationGraph.from_positions(p, radius, lives).component
        odd += int((canonicalize_labels(found) != canonicalize_labels(said)).sum())
    return expect_none(
        "component", odd, "labels that positions and communication radius do not give"
    )
