"""Evasion in orbit: detours past what drifts over targets, and past what others hold."""

import json
from functools import partial

import commitment_examples  # noqa: F401  the judge is found beside it
import judge
import numpy as np
import pytest
from reconfiguration_runs import wreck_in_the_way

import sato
from dynamics import ClohessyWiltshire
from dynamics.j2 import J2
from dynamics.orbit import Orbit
from sato.reconfiguration import orbital_commitment
from sato.reconfiguration.offers import Offers
from sato.reconfiguration.orbital_evasion import (
    Detours,
    Flights,
    _move_aside,
    make_room,
    offer_detour,
)
from sato.reconfiguration.planning import divide_horizon

R = 0.5
ORBIT = Orbit.from_elements(6878e3, 0.02, np.pi / 4)


def record_detours(monkeypatch):
    """Record the arguments of each search, and what it finds."""
    found, search = [], orbital_commitment.list_detours

    def list_detours(*own):
        found.append((*own, search(*own)))
        return found[-1][-1]

    monkeypatch.setattr(orbital_commitment, "list_detours", list_detours)
    return found


@pytest.mark.parametrize("seed", range(5))
def test_spacecraft_evade_what_drifts_over_their_targets(seed):
    run = sato.run(wreck_in_the_way(np.random.default_rng(seed)), seed=0)
    judged = judge.judge_run(run)["judged"]
    assert judged["arrived"]
    assert judged["collisions"] + judged["wreck_collisions"] == 0
    assert judged["wreck_ratio"] < 1.01  # it comes by


def test_spacecraft_with_little_thrust_find_no_detours_and_fly_on(monkeypatch):
    found = record_detours(monkeypatch)
    run = sato.run(wreck_in_the_way(np.random.default_rng(2), max_control=0.045), seed=0)
    assert any(len(detours.u) == 0 for *_, detours in found)
    assert run.summary["reached"]


def test_spacecraft_without_detours_are_hit(monkeypatch):
    monkeypatch.setattr(orbital_commitment, "offer_detour", lambda offers, *_: offers)
    run = sato.run(wreck_in_the_way(np.random.default_rng(0)), seed=0)
    assert judge.judge_run(run)["judged"]["wreck_ratio"] < 0.5


def least_distance(path, bodies, count=400):
    """Least distance of a path from bodies, each piece densely sampled."""
    t = np.linspace(0, 1, count)
    b = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=1)
    return np.linalg.norm(b @ (path[: bodies.shape[1]] - bodies), axis=-1).min()


@pytest.mark.parametrize("model", [ClohessyWiltshire(1e-3), J2(ORBIT)])
def test_detours_keep_limits_and_pass_all_that_is_known(model, monkeypatch):
    found = record_detours(monkeypatch)
    sato.run(wreck_in_the_way(np.random.default_rng(4), model=model), seed=0)
    assert sum(len(detours.u) > 5 for *_, detours in found) > 2
    for flights, _, state, u, path, known, detours in found:
        mission = flights.mission
        plant, h, S = mission.flown_plant, mission.step, flights.horizon.pieces_per_step
        least = partial(least_distance, bodies=known.paths)
        assert least(path) < R
        assert (np.diff(((detours.u - u) ** 2).sum(axis=(1, 2))) >= 0).all()
        assert (np.abs(detours.u) <= mission.max_control * (1 + 1e-8)).all()
        x = np.tile(state, (len(detours.u), 1))
        for k in range(u.shape[0]):
            x = plant.propagate(x, detours.u[:, k], flights.time + k * h, h)[-1]
            ends = detours.paths[:, (k + 1) * S - 1, -1]
            np.testing.assert_allclose(x[:, :3], ends, rtol=0, atol=1e-4)
            assert (np.linalg.norm(x[:, 3:], axis=1) <= mission.max_speed * (1 + 1e-6)).all()
        assert min(map(least, detours.paths), default=R) >= R


@pytest.mark.parametrize("when", [4, 9, 25])  # on the way, at the end of 10 steps, and after it
def test_ways_aside_return_or_drift_no_more_or_move_on(when):
    changes = {"step": 60.0, "allow_undetectable": True}
    mission = wreck_in_the_way(np.random.default_rng(0), **changes)
    horizon, h = divide_horizon(mission, 0.0, 10), mission.orbital_period / 50
    flights = Flights(mission, horizon, 0.0, 100, h)
    model, first = flights.horizon.discrete_model, 10 * flights.horizon.pieces_per_step
    begin, end = when * first // 10, (when + 1) * first // 10 - 1
    piece, last = (begin, end) if when < 10 else 2 * [first + when - 10]
    aside = np.random.default_rng(1).normal(size=(5, 3))
    each = list(_move_aside(flights, piece, aside))
    assert [len(ways) for ways in each] == [5 if when != 9 and when < 10 else 0, 5, 5]
    for kind, u in enumerate(each):
        x = model.simulate(np.zeros((len(u), 6)), u)
        path = flights.follow(x, u, x[:, -1])
        np.testing.assert_allclose(path[:, last, -1], aside[: len(u)], rtol=0, atol=1e-6)
        away = np.linalg.norm(path[:, -1, -1] - path[:, first, 0], axis=1)  # in two orbits
        assert kind == 2 or (away < 1e-3).all()
        assert kind < 2 or (away > 1.0).any()
        assert kind or (np.abs(x[:, -1]) < 1e-6).all()
    energy = [(u**2).sum(axis=(1, 2)) for u in each[1:]]
    assert (energy[1] <= energy[0] * (1 + 1e-9)).all()


def line_to(end, pieces=3):
    """Control points of a straight way from the origin, in equal pieces."""
    share = (np.arange(pieces)[:, None] + np.linspace(0, 1, 4)) / pieces
    return share[..., None] * np.array(end)


def test_detour_is_the_first_that_is_clear_of_what_others_hold():
    ends = [(3.0, 0.0), (3.0, 1.0), (3.0, 2.0), (3.0, 3.0)]
    paths = np.array([line_to(end) for end in ends])
    detours = Detours(np.arange(4.0)[:, None, None] + np.zeros((1, 3, 2)), paths)
    held = np.stack([line_to((0.0, 0.0)), line_to((0.0, -3.0))])[None]
    allowed, agents = np.ones((1, 2), dtype=bool), np.arange(1)
    rest = np.zeros((1, 2, 3, 2)), held, allowed, np.ones(1)
    offers = make_room(Offers(agents, (3, 0), np.array([3]), None, *rest))
    for blocked, chosen in (((), 0), ((0,), 2), ((1, 2), None), ((0, 3), None)):
        # Another that stands at the end of a way; within 1 m of the next.
        others = np.array([np.broadcast_to(ends[b], (3, 4, 2)) for b in blocked])
        clearance = np.full(len(blocked), 1.2)
        after = offer_detour(offers, 0, detours, others.reshape(-1, 3, 4, 2), clearance)
        assert after.is_allowed.tolist() == [[chosen is None, chosen is not None, True]]
        if chosen is not None:
            assert (after.u[0, 1] == chosen).all()
            np.testing.assert_array_equal(after.paths[0, 1], paths[chosen])
        np.testing.assert_array_equal(after.paths[0, [0, 2]], held[0])


def test_spacecraft_with_given_targets_arrive_together_after_a_reset():
    run = sato.run(wreck_in_the_way(np.random.default_rng(0)), seed=0)
    events = [json.loads(event) for event in run.data.event.values]
    ends = [event for event in events if event["kind"] == "leg_end"]
    last = [e["agents"] for e in events if e["kind"] == "arrival" and e["time"] == ends[0]["time"]]
    assert any(event["kind"] == "reset" for event in events)
    assert last == [[1, 2, 3]]
