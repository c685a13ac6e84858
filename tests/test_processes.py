"""A process for each vehicle: the flight of the simulation, kills, restarts, pauses, refusals."""

import os
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from threading import Timer

import numpy as np
import pytest
from reconfiguration_runs import make_mission

import sato
from sato.network.link import Link
from sato.processes import fleet as fleet_module
from sato.processes.fleet import Fleet, VehicleError
from sato.processes.flight import as_processes
from sato.processes.lock_step import LockStep
from sato.processes.messages import Call, Measured
from sato.processes.world import World, move
from sato.reconfiguration.check.promises import check_run
from sato.reconfiguration.first_commitment import Traffic
from sato.reconfiguration.leg import longest_leg
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.system import SYSTEM
from sato.record import collect_run_data

pytest.importorskip("zenoh")

SEED = 1


def four(*changes):
    return sato.read("random", ["swarm.agents=4", "leg.0.steps=20", *changes])


def eventful(*changes):
    """Noise, two legs, a loss and a join."""
    noise = "disturbance.position_m=0.002", "disturbance.acceleration_m_s2=0.001"
    mission = four(*noise, *changes)
    lost, join = sato.Loss("agents", agents=(1,), at_step=5), sato.Join(1, [[9.0, 9.0]], 3)
    (leg,) = mission.legs
    later = sato.Leg(sato.Ring(2.0), 16, recount=True)
    return replace(mission, legs=(replace(leg, losses=(lost,), joins=(join,)), later))


def simulated(mission):
    rng = np.random.default_rng(SEED)
    return list(simulate(mission.draw(rng), rng))


@contextmanager
def flight(mission):
    rng = np.random.default_rng(SEED)
    world = World(mission.draw(rng), rng)
    with Fleet("", len(world.x)) as fleet:
        yield fleet, LockStep(world, fleet, mission.to_toml(), SEED)


def kill(fleet, number):
    fleet.processes[number].kill()
    fleet.processes[number].join()
    fleet._looks_at = 0.0


def check(mission, frames):
    rng = np.random.default_rng(SEED)
    drawn = mission.draw(rng)
    attributes = {"name": "random", "seed": SEED, "version": "0", "scenario": mission.to_toml()}
    data = collect_run_data(SYSTEM, frames, drawn, **attributes)
    return check_run(data, drawn, rng)


def assert_same(frames, expected):
    assert len(frames) == len(expected)
    for frame, other in zip(frames, expected, strict=True):
        assert (frame.target_index == other.target_index).all()
        assert (frame.alive == other.alive).all()
        np.testing.assert_allclose(frame.control, other.control, rtol=0, atol=1e-9)
        np.testing.assert_allclose(frame.position, other.position, rtol=0, atol=1e-9)


LOSSY = "link.loss=0.1", "link.late=2"
TIMED = "link.loss=0.05", "link.round_s=0.02", "swarm.comm_radius_m=20", "leg.0.steps=40"


@pytest.mark.parametrize("link", [(), LOSSY, TIMED], ids=["ideal", "lossy", "timed"])
def test_processes_in_lock_step_fly_as_the_simulation(link):
    mission = eventful(*link)
    with flight(mission) as (_, processes):
        frames = list(processes.fly())
    assert_same(frames, simulated(mission))
    assert check(mission, frames).kept


def test_vehicles_join_and_give_legs_up_in_lock_step_as_in_the_simulation():
    join = sato.Join(1, np.array([[0.75, 0.0]]), at_step=2)
    joined = sato.Leg(np.array([[8.0, 0.0], [0.75, 12.0]]), 60, joins=(join,))
    places, hasty = np.array([[0.0, 0.0], [5.0, 0.0]]), Link(round=2 / 22)
    short = [sato.Leg(places + np.array([0.0, y]), 3) for y in (0.05, 0.1)]
    missions = [make_mission(places[:1], joined, comm_radius=40.0, link=Link(round=0.05))]
    missions.append(make_mission(places, *short, comm_radius=40.0, link=hasty))
    for mission in missions:
        with flight(mission) as (_, processes):
            assert_same(list(processes.fly()), simulated(mission))
            world = processes.world
            assert {own.leg for own in world.status.values()} == {world.leg_index}
    assert world.leg_index == 1 and world.leg_step == longest_leg(3, 2)


def test_kill_in_the_middle_of_a_decision_is_a_loss_at_its_instant():
    mission = four()
    with flight(mission) as (fleet, processes):
        send, count = fleet.send, 0

        def send_and_kill(number, value):
            nonlocal count
            count += 1
            if count == 150:
                fleet.processes[2].kill()
            send(number, value)

        fleet.send = send_and_kill
        frames = list(processes.fly())
    (k,) = [int(f.time) for f in frames for e in f.events if e["kind"] == "loss"]
    lost = sato.Loss("agents", agents=(2,), at_step=k)
    (leg,) = mission.legs
    assert_same(frames, simulated(replace(mission, legs=(replace(leg, losses=(lost,)),))))
    assert check(mission, frames).kept


def test_vehicle_whose_process_is_started_again_joins_once_there_is_room(monkeypatch):
    mission = four()
    with flight(mission) as (fleet, processes):
        frames = []
        for k, frame in enumerate(processes.fly()):
            frames.append(frame)
            if k == 3:
                kill(fleet, 2)
            elif k == 6:
                fleet.start([2])
                monkeypatch.setattr(Traffic, "has_room", lambda *_: False)
            elif k == 8:
                monkeypatch.undo()
    alive = np.array([frame.alive[2] for frame in frames])
    assert not alive[4:9].any() and alive[:4].all() and alive[9:].all()
    assert check(mission, frames).kept


def test_paused_process_is_waited_for():
    mission = four()
    with flight(mission) as (fleet, processes):
        frames = []
        for k, frame in enumerate(processes.fly()):
            frames.append(frame)
            if k == 3:
                os.kill(fleet.ids[1], signal.SIGSTOP)
                Timer(0.3, os.kill, (fleet.ids[1], signal.SIGCONT)).start()
    assert_same(frames, simulated(mission))


def test_no_process_is_left_where_the_world_is_killed(tmp_path):
    text = "from sato.__main__ import main; main()"
    command = [sys.executable, "-c", text, "run", "crossing", "--processes", "--out", tmp_path]
    world = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    line = next(said for said in world.stderr if ";" in said)  # after a notice, if it compiles
    ids = [int(part.split(": ")[-1]) for part in line.split(";")[0].split(", ")]
    world.kill()
    world.communicate()
    assert len(ids) == 2 and not list(tmp_path.iterdir())
    for process in ids:
        while is_there(process):
            os.sched_yield()


def test_vehicle_that_a_user_has_started_can_be_interrupted(tmp_path):
    with flight(four()) as (fleet, processes):
        frames = processes.fly()
        next(frames)
        kill(fleet, 2)
        command = [sys.executable, "-m", "sato", "vehicle", "2", "--key-file", fleet.key_file]
        vehicle = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
        while 2 not in fleet.new:
            fleet.receive()
        vehicle.send_signal(signal.SIGINT)
        assert "interrupted" in vehicle.communicate()[1] and vehicle.returncode == 1


def is_there(process):
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rsplit(")")[1].split()[0] != "Z"
    except OSError:
        return False


def test_fault_of_a_vehicle_ends_the_flight_with_its_reason():
    mission = sato.read("crossing")
    with flight(mission) as (fleet, processes):
        frames = processes.fly()
        next(frames)
        fleet.send(1, Call(0, 0, Measured(5, np.zeros(4), ()), (), True))
        with pytest.raises(VehicleError, match=r"vehicle 1: .* called at instant 5 after"):
            list(frames)


@pytest.mark.parametrize(
    ("scenario", "overrides", "reason"),
    [
        ("formation", (), '"formation" flies no vehicles as processes'),
        ("random", ("swarm.agents=17",), "17 vehicles are too many .* 16 would do"),
        ("crossing", ("plan.orders=2",), "plan.orders = 2"),
    ],
)
def test_missions_that_processes_cannot_fly_are_refused(scenario, overrides, reason):
    with pytest.raises(sato.InputError, match=reason):
        sato.run(scenario, overrides=overrides, processes="lock-step")


def test_too_little_memory_is_refused_with_the_number_that_fits(monkeypatch, tmp_path):
    (tmp_path / "meminfo").write_text("MemTotal: 1 kB\nMemAvailable: 600000 kB\n")
    monkeypatch.setattr(fleet_module, "MEMINFO", tmp_path / "meminfo")
    with pytest.raises(sato.InputError, match=r"4 processes .* 2 would do"):
        sato.run(four(), processes="lock-step")


def test_port_in_use_is_refused():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(sato.InputError, match=f"--port {port} cannot be used"):
            sato.run("crossing", processes="lock-step", port=port)
    with pytest.raises(sato.InputError, match="port: must be an integer above 0 and below 65536"):
        sato.run("crossing", processes="lock-step", port=70_000)


def test_missing_library_is_named_with_the_line_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(sato.InputError, match=r"pip install 'sato-swarm\[network\]'"):
        sato.run("crossing", processes="lock-step")


def test_models_of_ones_own_are_refused():
    class Own(sato.DoubleIntegrator):
        """A model that no file can hold."""

    mission = replace(sato.read("crossing"), model=Own(2))
    with pytest.raises(sato.InputError, match="of your own cannot be sent"):
        as_processes(SYSTEM, mission, 0, "lock-step")


@pytest.mark.parametrize(
    "obstacle",
    [
        sato.Sphere((1.0, 2.0), 0.5, velocity=(0.1, -0.2)),
        sato.Box((0.0, 0.0), (1.0, 2.0), velocity=(0.1, -0.2)),
        sato.Ellipsoid((0.0, 0.0), (1.0, 2.0), velocity=(0.1, -0.2)),
        sato.Polytope([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], velocity=(0.1, -0.2)),
    ],
)
def test_obstacle_that_is_seen_later_is_where_it_has_moved_to(obstacle):
    later = move(obstacle, 5.0)
    np.testing.assert_allclose(later.place_at(2.0), obstacle.place_at(7.0), atol=1e-12)
    np.testing.assert_allclose(later.corners, obstacle.corners, atol=1e-12)
