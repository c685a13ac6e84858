"""Processes that run freely, by the clock: what comes too late is not flown, and all are safe."""

import os
import signal
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from threading import Timer

import numpy as np
import pytest
from local_fleet import fly_freely
from reconfiguration_runs import make_mission, min_separation

import sato
from sato.network.link import Link
from sato.processes.codec import decode
from sato.processes.fleet import Fleet
from sato.processes.flight import as_processes
from sato.processes.free_running import FreeRunning
from sato.processes.free_vehicle import FreeVehicle
from sato.processes.messages import Briefing, Consent, FreePacket, Held, Intention, Measured
from sato.processes.vehicle import Vehicle
from sato.processes.world import World
from sato.reconfiguration.check.promises import check_run
from sato.reconfiguration.system import SYSTEM
from sato.record import collect_run_data

pytest.importorskip("zenoh")

SEED, SPEED = 1, 3.0


def mission_of(count, *changes):
    link = "link.round_s=0.02", "link.loss=0.05", "swarm.comm_radius_m=20"
    plan = "plan.horizon_steps=8", "plan.replan_steps=4", "plan.auction_steps=8", "leg.0.steps=28"
    return sato.read("random", [f"swarm.agents={count}", *link, *plan, *changes])


def test_vehicles_survive_a_kill_a_restart_and_a_pause():
    mission, frames, fleets = mission_of(4), [], []
    system = as_processes(SYSTEM, mission, SEED, "free-running", None, SPEED, fleets.append)
    rng = np.random.default_rng(SEED)
    for k, frame in enumerate(system.simulate(mission.draw(rng), rng)):
        frames.append(frame)
        fleet = fleets[0]
        if k == 4:
            fleet.processes[2].kill()
        elif k == 6:
            fleet.start([2])
        elif k == 10:
            os.kill(fleet.ids[1], signal.SIGSTOP)
            Timer(1.0, os.kill, (fleet.ids[1], signal.SIGCONT)).start()
    rng = np.random.default_rng(SEED)
    drawn = mission.draw(rng)
    names = {"name": "random", "seed": SEED, "version": "0", "scenario": mission.to_toml()}
    report = check_run(collect_run_data(SYSTEM, frames, drawn, **names), drawn, rng)
    kinds = {event["kind"] for frame in frames for event in frame.events}
    assert {"loss", "join", "silent"} <= kinds
    assert report.kept, report.broken


def alone():
    """One of two vehicles out of each other's hearing, and what it says."""
    start = [[0.0, 0.0], [90.0, 0.0]]
    leg = sato.Leg(sato.Points(np.add(start, [3.0, 0.0]), keep_order=True), 20)
    mission = replace(mission_of(2), start=sato.Points(start), legs=(leg,), assignment="given")
    sent = []
    vehicle = Vehicle(0, Briefing(mission.to_toml(), SEED, 0, None, 0.01))
    return FreeVehicle(vehicle, sent.append, 0.01), sent


def kind_of(sent, kind):
    return [value for value in sent if isinstance(value, kind)]


def act(vehicle, times):
    vehicle._listens_until = 0.0
    for _ in range(times):
        vehicle._act()


REST = np.zeros(4)


def test_vehicle_tells_others_that_it_commits_only_with_consent():
    vehicle, sent = alone()
    vehicle._take_in(Measured(0, REST, ()))
    act(vehicle, 60)
    (intention,) = kind_of(sent, Intention)
    assert intention.commitment.first_step == 4 and intention.commitment.u.any()
    assert not any(decode(packet.content).commits for packet in kind_of(sent, FreePacket))
    vehicle._take_in(Consent(4))
    act(vehicle, 1)
    assert decode(kind_of(sent, FreePacket)[-1].content).commits


@pytest.mark.parametrize("has_consent", [True, False])
def test_vehicle_flies_what_is_new_with_consent_alone(has_consent):
    vehicle, sent = alone()
    vehicle._take_in(Measured(0, REST, ()))
    act(vehicle, 60)
    if has_consent:
        vehicle._take_in(Consent(4))
    for k in range(1, 5):
        vehicle._take_in(Measured(k, REST, ()))
    held = kind_of(sent, Held)[-1].status
    assert held.control.any() == has_consent
    assert held.commitment.u.any() == has_consent


PAUSES = (0.0, 6.0), (0.05, 6.0), (1.9, 8.0), (3.9, 10.0)


@pytest.mark.parametrize("pause", PAUSES)
def test_nobody_flies_into_a_vehicle_that_is_paused(pause, monkeypatch):
    start, goal = [[0.0, 0.0], [0.62, 0.0]], [[4.0, 0.0], [1.82, 4.0]]
    leg = sato.Leg(sato.Points(goal, keep_order=True), 40)
    limits = {"max_control": 0.3, "max_speed": 0.6, "comm_radius": 40.0}
    link = Link(round=0.02)
    mission = make_mission(np.array(start), leg, assignment="given", link=link, **limits)
    frames = list(islice(fly_freely(mission, monkeypatch, {1: pause}), 14))
    assert any(event["kind"] == "silent" for frame in frames for event in frame.events)
    assert min_separation(mission, frames, 20) >= mission.collision_radius * (1 - 1e-6)
    assert frames[-1].position[0, 0] > 0.2


def test_vehicle_joins_clear_of_what_another_takes_up_at_that_instant(monkeypatch):
    join = sato.Join(1, np.array([[0.75, 0.0]]), at_step=2)
    leg = sato.Leg(np.array([[8.0, 0.0], [0.75, 12.0]]), 60, joins=(join,))
    mission = make_mission(np.zeros((1, 2)), leg, comm_radius=40.0, link=Link(round=0.02))
    frames = list(islice(fly_freely(mission, monkeypatch, {}), 20))
    assert any(event["kind"] == "join" for frame in frames for event in frame.events)
    assert min_separation(mission, frames, 20) >= mission.collision_radius


def test_vehicle_gives_up_where_it_hears_one_that_does_not_hear_it():
    vehicle, sent = alone()
    vehicle._take_in(Measured(0, REST, ()))
    act(vehicle, 3)
    vehicle._take_in(FreePacket(1, 4, (5,), 1, kind_of(sent, FreePacket)[-1].content))
    act(vehicle, 60)
    assert not kind_of(sent, Intention)


@contextmanager
def actuators(count):
    """A flight whose vehicles have no processes, its world, and what it sends to them."""
    mission, rng, sent = mission_of(count), np.random.default_rng(SEED), []
    world = World(mission.draw(rng), rng)
    with Fleet("", count) as fleet:
        fleet.send = lambda number, value: sent.append(value)
        yield FreeRunning(world, fleet, mission.to_toml(), SEED), world, sent


def test_actuators_take_nothing_for_an_instant_that_has_come():
    commitment = sato.reconfiguration.stopping.Commitment(2, np.ones((3, 2)))
    with actuators(2) as (flight, world, sent):
        for world.step_index in (1, 2):
            flight._take_in(0, Intention(commitment, (1,)))
    assert sent == [Consent(2)]


def test_actuators_take_nothing_that_was_decided_without_a_neighbor():
    commitment = sato.reconfiguration.stopping.Commitment(4, np.ones((3, 2)))
    with actuators(3) as (flight, world, sent):
        flight._ask(world.x)
        sent.clear()
        for neighbors in ((1,), (1, 2)):
            flight._take_in(0, Intention(commitment, neighbors))
            assert sent == [Consent(4)] * (len(neighbors) - 1)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (("link.round_s=0", "link.loss=0"), "link.round_s: is 0.* 0.02 would do"),
        (("link.skew_s=0.5", "leg.0.steps=90"), "link.skew_s: 0.5.* 0 would do"),
    ],
)
def test_links_that_processes_do_not_have_are_refused(changes, reason):
    with pytest.raises(sato.InputError, match=reason):
        sato.run(mission_of(2, *changes), processes="free-running")
