"""Keys of flights over processes: those who have one are heard, once for each message."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sato
from sato.atomic import is_held
from sato.processes.codec import encode
from sato.processes.envelope import MAX_SIZE, OVERHEAD, VERSION, WORLD, Envelopes
from sato.processes.fleet import Fleet, VehicleError
from sato.processes.lock_step import LockStep
from sato.processes.membership import KEY_FILE, Incarnation, create_key, read_key
from sato.processes.messages import Measured, Reply, Status
from sato.processes.network import Connection, load_zenoh
from sato.processes.reports import check_status
from sato.processes.vehicle import open_packet
from sato.reconfiguration.agent_inputs import AgentMessage
from sato.reconfiguration.stopping import Commitment
from sato.scenario.errors import InputError

KEY = bytes(range(32))


def world(key=KEY, vehicles=3):
    return Envelopes(key, WORLD, 1, range(vehicles))


def vehicle(number=0, key=KEY, incarnation=1):
    return Envelopes(key, number, incarnation, [WORLD])


@given(content=st.binary(max_size=300), number=st.integers(0, 2))
def test_envelope_gives_back_its_sender_and_content_once(content, number):
    here, data = world(), vehicle(number).seal(WORLD, content)
    assert len(data) == len(content) + OVERHEAD and OVERHEAD <= 40
    assert here.open(data) == (number, content)
    assert here.open(data) is None


@settings(max_examples=300)
@given(content=st.binary(max_size=60), data=st.data())
def test_envelope_that_was_changed_is_no_message(content, data):
    sealed = bytearray(vehicle().seal(WORLD, content))
    place = data.draw(st.integers(0, len(sealed) - 1))
    sealed[place] ^= data.draw(st.integers(1, 255))
    assert world().open(bytes(sealed)) is None


@given(data=st.binary(max_size=200))
def test_bytes_that_nobody_sealed_are_no_message(data):
    assert world().open(data) is None


def test_envelopes_of_others_are_no_messages():
    here = world()
    assert here.open(vehicle(key=bytes(32)).seal(WORLD, b"x")) is None  # of another flight
    assert here.open(vehicle().seal(1, b"x")) is None  # to somebody else
    assert here.open(vehicle(3).seal(WORLD, b"x")) is None  # of a vehicle that is not there
    assert vehicle(1).open(vehicle(0).seal(1, b"x")) is None  # past the world
    assert vehicle(1).open(world().seal(1, b"x")) == (WORLD, b"x")
    old = bytearray(vehicle().seal(WORLD, b"x"))
    old[0] = VERSION + 1
    assert here.open(bytes(old)) is None
    with pytest.raises(ValueError, match="a message of 2,000,000 bytes is more than"):
        vehicle().seal(WORLD, bytes(MAX_SIZE))
    assert here.open(bytes(MAX_SIZE + 1)) is None


def test_vehicle_that_starts_again_is_believed_and_its_past_is_not():
    here, first = world(), vehicle(incarnation=1)
    past = [first.seal(WORLD, bytes([k])) for k in range(3)]
    assert here.open(past[1]) and here.open(past[0]) is None
    assert here.open(vehicle(incarnation=2).seal(WORLD, b"again")) == (0, b"again")
    assert here.open(past[2]) is None


def test_vehicle_that_starts_again_hears_nothing_that_was_said_before():
    here = world()
    assert here.open(vehicle(incarnation=1).seal(WORLD, b""))
    past = here.seal(0, b"past")
    again = vehicle(incarnation=2)
    assert again.open(past) is None
    assert here.open(again.seal(WORLD, b""))
    assert again.open(here.seal(0, b"now")) == (WORLD, b"now")
    assert again.open(past) is None


def test_key_is_read_by_its_owner_and_for_vehicles_of_the_flight(tmp_path):
    member, file = create_key(tmp_path, "mission", 4711, 2), tmp_path / KEY_FILE
    assert read_key(file, 1) == member and file.stat().st_mode & 0o777 == 0o600
    with pytest.raises(InputError, match="NUMBER: there is no vehicle 7; they are 0 to 1"):
        read_key(file, 7)
    with pytest.raises(InputError, match="is no key of a flight that goes on"):
        read_key(tmp_path / "none", 0)
    for text in ("", "[]", json.dumps({"key": "xy"})):
        (tmp_path / "bad").write_text(text)
        (tmp_path / "bad").chmod(0o600)
        with pytest.raises(InputError, match="is no key of a flight"):
            read_key(tmp_path / "bad", 0)
    file.chmod(0o644)
    with pytest.raises(InputError, match="can be read by others; mode 600 would do"):
        read_key(file, 0)


def test_keys_of_two_flights_differ(tmp_path):
    keys = set()
    for n, mission in enumerate(("a", "a", "b")):
        (tmp_path / str(n)).mkdir()
        keys.add(create_key(tmp_path / str(n), mission, 1, 1).key)
    assert len(keys) == 3


def test_starts_of_a_vehicle_are_counted_and_it_is_there_once(tmp_path):
    first = Incarnation(tmp_path / KEY_FILE, 3)
    with pytest.raises(InputError, match="the process of vehicle 3 is there already"):
        Incarnation(tmp_path / KEY_FILE, 3)
    assert is_held(tmp_path / "3")
    os.close(first._file)
    assert not is_held(tmp_path / "3")
    assert (first.number, Incarnation(tmp_path / KEY_FILE, 3).number) == (1, 2)
    assert Incarnation(tmp_path / KEY_FILE, 0).number == 1


def test_those_without_the_key_are_not_let_in():
    zenoh = load_zenoh()
    with Fleet("", 2) as fleet:
        place = json.loads(fleet.key_file.read_text())["endpoint"]
        for password in (None, "guess"):
            config = zenoh.Config()
            settings = {"mode": "client", "connect/endpoints": [place]}
            settings |= {"connect/timeout_ms": 300, "scouting/multicast/enabled": False}
            if password is not None:
                settings |= {"transport/auth/usrpwd/user": "sato"}
                settings |= {"transport/auth/usrpwd/password": password}
            for key, value in settings.items():
                config.insert_json5(key, json.dumps(value))
            with pytest.raises(zenoh.ZError):
                zenoh.open(config)
        assert (fleet.key_file.parent.stat().st_mode & 0o777) == 0o700
    assert not fleet.key_file.exists()


def test_connections_share_no_memory_with_other_processes(tmp_path):
    member = create_key(tmp_path, "mission", None, 1)
    users = tmp_path / "users"
    users.write_text(f"sato:{member.key.hex()}\n")
    connections = [Connection(member, WORLD, 1, users), Connection(member, 0, 1)]
    connections[1].send(WORLD, b"x" * 100_000)
    assert connections[0].receive(10)[0] == 0
    mapped = Path("/proc/self/maps").read_text()
    for connection in connections:
        connection.close()
    assert ".zenoh" not in mapped


def test_next_flight_removes_the_folder_of_a_killed_one(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "sato-fleet-dead").mkdir()
    (tmp_path / "sato-fleet-dead" / KEY_FILE).write_text("")
    with Fleet("", 1) as fleet:
        assert list(tmp_path.iterdir()) == [fleet.key_file.parent]
    assert not list(tmp_path.iterdir())


def test_next_command_removes_the_sockets_of_a_killed_one(tmp_path):
    code = "from sato.workers import place_sockets; place_sockets(); import os, sys"
    for end, count in (("os.kill(os.getpid(), 9)", 1), ("", 0)):
        words = [sys.executable, "-c", f"{code}; {end}"]
        subprocess.run(words, env=os.environ | {"TMPDIR": str(tmp_path)})
        assert len(list(tmp_path.iterdir())) == count


def test_number_that_no_vehicle_has_is_told_at_once(tmp_path):
    create_key(tmp_path, "mission", 4711, 2)
    command = [sys.executable, "-m", "sato", "vehicle", "7", "--key-file", tmp_path / KEY_FILE]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr == "sato: NUMBER: there is no vehicle 7; they are 0 to 1\n"


def test_sender_that_floods_takes_no_room_of_others():
    with Fleet("", 2) as fleet:
        connection = fleet._connection
        ends = [Envelopes(connection._envelopes._key, number, 1, [WORLD]) for number in (0, 1)]
        most = encode(bytes(MAX_SIZE - 1000))
        for end, content in [(ends[0], most)] * 5 + [(ends[1], encode("here"))]:
            sealed = end.seal(WORLD, content)
            payload = SimpleNamespace(to_bytes=lambda sealed=sealed: sealed)
            connection._receive(SimpleNamespace(payload=payload))
        senders = [connection.receive(0.0)[0] for _ in range(5)]
        assert senders == [0, 0, 0, 0, 1] and connection.receive(0.0) is None


STATUS = Status(
    leg=0, is_leg_over=False, control=np.zeros(2), commitment=Commitment(3, np.zeros((4, 2))),
    intended=None, target_index=0, target_count=2, clock=0, has_plan=True, decides=True,
    calls=False, solves=0, blocked=(),
    events=({"kind": "slack", "agents": [1], "amount_m": [0.1]},),
)  # fmt: skip


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"leg": 1}, "reports what the mission has not: leg"),
        ({"control": np.zeros(3)}, "reports what the mission has not: control"),
        ({"target_index": 2}, "reports what the mission has not: target_index"),
        ({"target_count": -1}, "reports what the mission has not: target_count"),
        ({"blocked": (7,)}, "reports what the mission has not: blocked"),
        ({"events": ({"kind": "forged", "agents": [1]},)}, "the mission has not: events"),
        ({"events": ({"kind": "slack", "agents": [0]},)}, "the mission has not: events"),
        ({"events": ({"kind": "slack", "agents": [1], "what": b""},)}, "has not: events"),
        ({"events": ({},)}, "the mission has not: events"),
        ({"commitment": Commitment(4, np.zeros((4, 2)))}, "commits to controls of shape"),
        ({"intended": Commitment(-1, np.zeros((4, 2)))}, "commits to controls of shape"),
        ({"commitment": Commitment(3, np.zeros((4, 3)))}, "commits to controls of shape"),
    ],
)
def test_reports_that_the_mission_has_not_end_in_a_sentence(change, told):
    mission = sato.read("crossing").draw(np.random.default_rng(0))
    check_status(mission, 1, STATUS, 3)
    with pytest.raises(VehicleError, match=f"vehicle 1 .*{told}"):
        check_status(mission, 1, STATUS._replace(**change), 3)


def test_packets_in_the_name_of_another_vehicle_are_refused():
    packet = encode(AgentMessage(0, 0, 0, None))
    assert open_packet(0, packet).sender == 0
    with pytest.raises(ValueError, match="vehicle 1 sends a packet in the name of 0"):
        open_packet(1, packet)
    with pytest.raises(ValueError, match="vehicle 1 sends a packet in the name of float"):
        open_packet(1, encode(1.0))


@pytest.mark.parametrize("sent", [1, Reply(6, None, None), Reply(8, None, None), ()])
def test_what_answers_no_call_ends_a_flight_in_lock_step(sent):
    fleet = SimpleNamespace(send=lambda *_: None, receive=lambda: (0, sent), take_gone=list)
    world = SimpleNamespace(live=[0], alive=[True], leg_index=0, lose=list)
    relay = SimpleNamespace(take=lambda number: ())
    flight = SimpleNamespace(fleet=fleet, world=world, _relay=relay, _serial=6)
    with pytest.raises(VehicleError, match="vehicle 0 sends what is no answer to the last call"):
        LockStep._call(flight, {0: Measured(0, np.zeros(4), ())}, begins=True)
