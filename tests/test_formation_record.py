"""What a formation flight leaves behind, and what it says on the way."""

import json

import numpy as np
import pytest

import sato
from problems.desired_formation import DesiredFormation
from problems.gain_matrix import GainMatrix
from sato.formation.loop import FormationFrame, simulate
from sato.formation.record import GAIN_PARTS, run_attributes
from sato.formation.supervisor import Phase
from sato.formation.system import SYSTEM, describe_progress
from sato.former import parse
from sato.record import recorded_fields
from sato.systems import load_system

SQUARES = """
system = "formation"
name = "squares"

[swarm]
agents = 4
start = { kind = "points", positions_m = [[0, 0, 1], [3, 0, 1], [0, 3, 1], [3, 4, 1]] }
max_climb_m_s = 0.2

[protocol]
hover_s = 0.5

[[leg]]
formation = { kind = "library", name = "swarm4/Square" }

[[leg]]
formation = { kind = "library", name = "swarm4/Diamond" }
"""


@pytest.fixture(scope="module")
def flown():
    run = sato.run(parse(SQUARES), seed=6)
    rng = np.random.default_rng(6)
    mission = parse(SQUARES).build(rng)
    return run, mission, list(simulate(mission, rng))


def test_what_is_on_file_is_what_was_flown(flown):
    run, mission, frames = flown
    data = run.data
    for name in recorded_fields(FormationFrame):
        assert np.array_equal(data[name], [getattr(frame, name) for frame in frames]), name
    assert data["control_instant"].values.all() and data["alive"].values.all()
    np.testing.assert_allclose(np.exp(1j * data["frame_yaw"].values), mission.frames.rotation)
    assert np.array_equal(data["frame_offset"], mission.frames.offset)
    assert not data["component"].values.any()


def test_the_gains_on_file_are_gains_of_the_formation_on_file(flown, tmp_path):
    run, mission, _ = flown
    data = sato.load(run.save(tmp_path)).data
    assert tuple(data["part"].values) == GAIN_PARTS
    for leg, gains in enumerate(mission.gains):
        real, imaginary, z = data["gains"].values[leg]
        shape = DesiredFormation(
            data["formation"].values[leg], data["graph"].values[leg].astype(bool)
        )
        found = GainMatrix(shape, real + 1j * imaginary, z, "read", 1.0, 1.0)
        assert np.array_equal(found.xy, gains.xy) and np.array_equal(found.z, gains.z)
        assert found.matches_formation(gains.formation)


def test_drift_is_that_of_the_reckoning_against_the_way_flown(flown):
    run, *_ = flown
    way = np.linalg.norm(np.diff(run.data["position"], axis=0), axis=2).sum(axis=0)
    drifted = np.linalg.norm(run.data["frame_drift"].values[-1], axis=1)
    np.testing.assert_allclose(drifted, 0.01 * way, rtol=1e-9)


def test_radii_and_limits_are_attributes(flown):
    run, mission, _ = flown
    said = run_attributes(mission)
    assert said["keep_out_m"] == 1.2 and said["max_climb_m_s"] == 0.2 and said["shape_m"] == 0.1
    for name, value in said.items():
        assert run.data.attrs[name] == value


def test_the_events_tell_the_flight(flown):
    run, mission, _ = flown
    kinds = [e["kind"] for e in run.events("leg_start", "leg_end", "given_up")]
    assert kinds == ["leg_start", "leg_end"] * 2
    auctions, assignments = run.events("auction"), run.events("assignment")
    assert len(auctions) >= len(assignments) >= 2
    # What an auction came to is known when its messages have gone round.
    known = [e["time"] + e["rounds"] / mission.radio.rate for e in auctions]
    for event in assignments:
        assert min(abs(event["time"] - time) for time in known) < 1.5 * mission.frame_period
    assert all(e["rounds"] > 0 for e in auctions)
    for event in assignments:
        assert sorted(event["point"]) == [0, 1, 2, 3]


def test_the_summary_has_the_words_that_it_must_have_and_is_plain(flown):
    run, *_ = flown
    said = json.loads(json.dumps(run.summary, allow_nan=False))
    words = {
        "system", "scenario", "seed", "version", "agents", "min_separation_m", "wall_s",
        "peak_memory_mib", "success", "shape_error_m", "path_m", "time_s", "reassignments",
        "gridlocked_s", "bytes_per_vehicle_s", "longest_auction_s", "keep_out_m", "gains_rate",
        "legs", "broken",
    }  # fmt: skip
    assert said.keys() == words
    leg = {"success", "shape_error_m", "inverted", "time_s", "path_m", "reassignments"}
    assert [each.keys() for each in said["legs"]] == [leg, leg]
    assert said["success"] and said["shape_error_m"] == max(
        each["shape_error_m"] for each in said["legs"]
    )
    for word in ("time_s", "path_m", "reassignments"):
        assert said[word] == pytest.approx(sum(each[word] for each in said["legs"]))


def test_whoever_waits_hears_of_the_leg_the_steps_and_the_phase(flown):
    _, mission, frames = flown
    first, last = describe_progress(mission, frames[0]), describe_progress(mission, frames[-1])
    assert first.stage == "leg 1 of 2" and last.stage == "leg 2 of 2"
    assert (first.done, last.done) == (0, len(frames) - 1)
    assert first.total == last.total == 30000
    assert (first.details, last.details) == (Phase.WAITING.value, Phase.COMPLETED.value)


def test_the_system_is_at_home_and_has_figures_but_no_film(flown):
    run, mission, _ = flown
    assert load_system("formation") is SYSTEM
    assert SYSTEM.animation is None and SYSTEM.stop_errors == ()
    assert all(map(callable, SYSTEM.figures(run.data, mission).values()))
