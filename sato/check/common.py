"""Events and promises that the runs of every system have."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import near_balls, sampled_separations
from sato.check.report import Promise, Times, expect_none, expect_small_error
from sato.interfaces import Frame
from sato.network.graph import CommunicationGraph, canonicalize_labels
from sato.run_data import RunData

Alive = Bool[Array, "instants agents"]


@dataclass(frozen=True, eq=False)
class EventLog:
    """Events of a run, with the instants of the record at which they happened."""

    time: Float[Array, " instants"]  # of the record [s]
    events: tuple[dict[str, Any], ...]  # in the order of time

    @classmethod
    def from_data(cls, data: RunData) -> "EventLog":
        """Read the events of a run."""
        events = tuple(json.loads(str(text)) for text in np.asarray(data["event"]))
        return cls(np.asarray(data["time"], dtype=float), events)

    @cached_property
    def instants(self) -> list[int]:
        """Index of the instant nearest to each event."""
        times = [float(event["time"]) for event in self.events]
        middles = np.sort((self.time[1:] + self.time[:-1]) / 2)
        return [int(k) for k in np.searchsorted(middles, times)]

    def of_kind(self, *kinds: str) -> list[tuple[int, dict[str, Any]]]:
        """Return the events of some kinds, each with the index of its instant."""
        timed = zip(self.instants, self.events, strict=True)
        return [(k, event) for k, event in timed if event["kind"] in kinds]


Change = tuple[int, str, int]  # instant, "loss", "join" or "refused", and agent


def apply_changes(start: Bool[Array, " agents"], instants: int, changes: list[Change]) -> Alive:
    """Return who is there at each instant, by who is at the start and losses and joins in order.

    An agent has one of these, a loss or a join.
    """
    alive = np.tile(start, (instants, 1))
    for k, kind, agent in changes:
        alive[k:, agent] = kind == "join"
    return alive


class ClosestPair(NamedTuple):
    """Closest approach of two agents that fly straight from each instant to the next."""

    distance: float  # [m]; infinite where no two are alive at a time
    instant: int  # before it
    pair: tuple[int, int]
    fraction: float = 0.0  # of the way to the next instant

    def time(self, instants: Float[Array, " instants"]) -> float:
        """Return its time [s], by those of all instants."""
        return float(np.interp(self.instant + self.fraction, range(len(instants)), instants))


def find_closest_approach(position: Float[Array, "instants agents d"], alive: Alive) -> ClosestPair:
    """Find the closest approach of all pairs of live agents, between instants too.

    Who is lost at an instant has moved until then.
    """
    # The last instant is repeated, so that it counts where there is no other.
    way, alive = np.concatenate([position, position[-1:]]), np.concatenate([alive, alive[-1:]])
    moves = alive[:-1] & np.isfinite(way[1:]).all(axis=2)
    change = np.where(moves[..., None], np.diff(way, axis=0), 0.0)
    sampled = sampled_separations(position, alive[:-1])
    bound = float(sampled.min(initial=np.inf))
    if not bound < np.inf:
        return ClosestPair(np.inf, -1, (-1, -1))
    middle, half = way[:-1] + change / 2, np.linalg.norm(change, axis=2) / 2
    found = []
    # Two agents come closer than at the instant before by their two ways at most.
    longest = 2 * np.where(np.isfinite(half), half, 0.0).max(axis=1)
    for k in np.flatnonzero(sampled - 2 * longest <= bound * (1 + 1e-12)):
        # An agent stays in the ball about the middle of its way.
        agents = np.flatnonzero(alive[k] & np.isfinite(middle[k]).all(axis=1))
        pairs = agents[near_balls(middle[k, agents], bound / 2 + half[k, agents])]
        found.append(np.column_stack([np.full(len(pairs), k), pairs]))
    k, i, j = np.concatenate(found).T
    gap, motion = way[k, j] - way[k, i], change[k, j] - change[k, i]
    motion[~(moves[k, i] & moves[k, j])] = 0.0
    far = (motion**2).sum(axis=1)
    share = -(gap * motion).sum(axis=1) / np.where(far > 0, far, 1.0)
    share = np.clip(share, 0.0, 1.0)
    distance = np.linalg.norm(gap + share[:, None] * motion, axis=1)
    best = int(distance.argmin())
    pair = int(i[best]), int(j[best])
    return ClosestPair(float(distance[best]), int(k[best]), pair, float(share[best]))


def common_summary(attributes: Mapping[str, Any], alive: Alive) -> dict[str, Any]:
    """Return the entries that begin every summary, from the attributes of the run."""
    return {
        "system": str(attributes["system"]),
        "scenario": str(attributes["name"]),
        "seed": int(attributes["seed"]),
        "version": str(attributes["version"]),
        "agents": int(alive.shape[1]),
    }


def drop_non_finite(summary: dict[str, Any]) -> dict[str, Any]:
    """Leave out the numbers of a summary that are infinite or not known."""
    return {k: v for k, v in summary.items() if not isinstance(v, float) or np.isfinite(v)}


def check_complete(attributes: Mapping[str, Any], lacking: str = "") -> Promise:
    """Check that a flight was completed, and that nothing is named that its record is lacking."""
    complete, stopped = attributes.get("complete", 1), ""
    known = None if isinstance(complete, Array) else complete
    if known == 0 or "stopped" in attributes:
        reason = attributes.get("stopped", "for an unknown reason")
        stopped = f"the flight was not completed ({reason})"
    if known not in (0, 1):
        lacking = f"the attribute complete is {complete}, neither 0 nor 1"
    reasons = [text for text in (lacking, stopped) if text]
    text = "; ".join(reasons) or "everything was flown and recorded"
    promise = Promise("complete", not reasons, float(len(reasons)), 0.0, text)
    # A flight that says that it was stopped is true to its word; one that hides it is not.
    return promise if lacking and not stopped else promise._replace(kind="aim")


def check_attributes(attributes: Mapping[str, Any], expected: Mapping[str, Any]) -> Promise:
    """Check that the radii and limits in the attributes are those of the scenario."""
    wrong = [not np.array_equal(attributes.get(n, ""), value) for n, value in expected.items()]
    return expect_none("attributes", wrong, "radii or limits that are not the scenario's")


def check_times(log: EventLog, step: float) -> Promise:
    """Check that instants are a step [s] apart, from zero on, and events at instants."""
    time = log.time
    given = np.array([event["time"] for event in log.events], dtype=float)
    errors = np.concatenate([time - step * np.arange(len(time)), given - time[log.instants]])
    text = "s off from the steps, of an instant or an event"
    promise = expect_small_error("times", errors, 1e-9 * step, text)
    is_later = np.diff(time) > 0
    if is_later.all():
        return promise
    k = int(np.argmin(is_later))
    text = f"time does not increase from instant {k} to {k + 1}"
    return promise._replace(kept=False, tolerance=0.0, message=text)


def check_finite(
    alive: Alive, *states: Float[Array, "instants agents ..."], time: Times = None
) -> Promise:
    """Check that live agents have finite states at all instants."""
    rows = [np.isfinite(values).reshape(*alive.shape, -1).all(axis=2) for values in states]
    wrong = [alive & ~row for row in rows]
    text = "states of live agents that are not finite"
    return expect_none("numbers", np.sum(wrong, axis=0), text, time)


def check_alive(
    alive: Alive, log: EventLog, expected: Alive | None = None, changes: Iterable[Change] = ()
) -> Promise:
    """Check that agents join and are lost as expected, each with its event, and only so.

    Without what the losses and joins of the mission give, those of the events are believed.
    """
    timed = log.of_kind("loss", "join", "refused")
    found = [(k, event["kind"], int(i)) for k, event in timed for i in event["agents"]]
    if expected is None:
        expected, changes = apply_changes(alive[0], len(alive), found), found
    text = "instants or events of an agent alive or not against the scenario"
    odd = expected != alive
    if odd.any():
        return expect_none("alive", odd, text, log.time)
    return expect_none("alive", count_differences(found, changes), text)


def count_differences(found: Iterable[object], expected: Iterable[object]) -> int:
    """Count what is in one of two collections and not in the other, as often as it is."""
    a, b = Counter(found), Counter(expected)
    return (a - b).total() + (b - a).total()


def check_components(frames: Frame, radius: float) -> Promise:
    """Check that components are those of the positions and the communication radius [m]."""
    wrong = []
    instants = zip(frames.position, frames.alive, frames.component, strict=True)
    for position, alive, labels in instants:
        found = CommunicationGraph.from_positions(position, radius, alive).component
        wrong.append(canonicalize_labels(found) != canonicalize_labels(labels))
    text = "labels that positions and communication radius do not give"
    return expect_none("component", wrong, text, np.asarray(frames.time))
