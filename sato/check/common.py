"""Promises of the runs of every system."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.check.event_log import EventLog
from sato.check.promise import Promise, expect_none, expect_small_error, max_or_zero
from sato.network.graph import CommunicationGraph, canonicalize_labels


def common_summary(
    attributes: Mapping[str, Any], alive: Bool[Array, "instants agents"]
) -> dict[str, Any]:
    """Return the entries that begin every summary.

    Args:
        attributes: Attributes of the run.
        alive: True for agents that take part, at each instant.
    """
    return {
        "system": str(attributes["system"]),
        "scenario": str(attributes["name"]),
        "seed": int(attributes["seed"]),
        "version": str(attributes["version"]),
        "agents": int(alive.shape[1]),
    }


def incomplete_reason(attributes: Mapping[str, Any]) -> str:
    """Describe why a flight was not completed; empty if it was.

    Args:
        attributes: Attributes of the run.
    """
    if attributes.get("complete", 1):
        return ""
    return f"the flight was not completed ({attributes.get('stopped', 'for an unknown reason')})"


def check_attributes(attributes: Mapping[str, Any], expected: Mapping[str, float | str]) -> Promise:
    """Check that the radii and limits in the attributes are those of the scenario."""
    wrong = sum(name not in attributes or attributes[name] != expected[name] for name in expected)
    return expect_none("attributes", wrong, "radii or limits that are not the scenario's")


def check_times(time: Float[Array, " instants"], step: float) -> Promise:
    """Check that instants are a step [s] apart, from zero on."""
    error = max_or_zero(np.abs(time - step * np.arange(len(time))))
    if not (np.diff(time) > 0).all():
        k = int(np.argmin(np.diff(time) > 0))
        return Promise(
            "times", False, error, 0.0, f"time does not increase from instant {k} to {k + 1}"
        )
    return expect_small_error(
        "times", error, 1e-9 * step, "s off from one control step to the next"
    )


def count_non_finite(
    alive: Bool[Array, "instants agents"], values: Float[Array, "instants agents *k"]
) -> int:
    """Count the instants at which a live agent has a value that is not finite."""
    return int((alive & ~np.isfinite(values).reshape(*alive.shape, -1).all(axis=2)).sum())


def check_finite(
    alive: Bool[Array, "instants agents"], *states: Float[Array, "instants agents *k"]
) -> Promise:
    """Check that live agents have finite states at all instants."""
    count = sum(count_non_finite(alive, values) for values in states)
    return expect_none("numbers", count, "states of live agents that are not finite")


def check_alive(alive: Bool[Array, "instants agents"], log: EventLog) -> Promise:
    """Check that agents join and are lost with an event, and only so."""
    expected = alive[:1].repeat(len(alive), axis=0)
    for k, event in log.of_kind("loss", "join"):
        expected[k:, np.asarray(event["agents"], dtype=np.int64)] = event["kind"] == "join"
    wrong = int((expected != alive).sum())
    return expect_none("alive", wrong, "instants of an agent alive or not against the events")


def check_components(
    position: Float[Array, "instants agents d"],
    alive: Bool[Array, "instants agents"],
    component: Int[Array, "instants agents"],
    radius: float,
) -> Promise:
    """Check that components are those of the positions and the communication radius [m]."""
    wrong = 0
    for p, is_alive, labels in zip(position, alive, component, strict=True):
        found = CommunicationGraph.from_positions(p, radius, is_alive).component
        wrong += int((canonicalize_labels(found) != canonicalize_labels(labels)).sum())
    return expect_none(
        "component", wrong, "labels that positions and communication radius do not give"
    )
