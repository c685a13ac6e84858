"""Run files of formation flights: variables, attributes, events and summary."""

import json

import numpy as np
import pytest
from formation_runs import fly

import sato
from sato.formation.supervisor import Phase
from sato.formation.system import make_progress
from sato.scenario.file import parse

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
    return sato.run(parse(SQUARES), seed=6), *fly(seed=6, text=SQUARES)


def test_recorded_frames_and_coordinate_frames_are_those_flown(flown):
    run, mission, frames = flown
    data, own = run.data, mission.coordinate_frames
    names = ("position", "velocity", "velocity_command", "avoiding", "point_index", "leg_index")
    for name in (*names, "frame_drift"):
        assert np.array_equal(data[name], [getattr(frame, name) for frame in frames]), name
    np.testing.assert_allclose(np.exp(1j * data["frame_yaw"].values), own.rotation)
    assert np.array_equal(data["frame_offset"], own.origin)
    assert not data["component"].values.any()


def test_radii_and_limits_are_attributes(flown):
    run, *_ = flown
    expected = {"keep_out_m": 1.2, "max_climb_m_s": 0.2, "shape_m": 0.1, "max_speed_m_s": 0.5}
    assert {name: run.data.attrs[name] for name in expected} == expected


def test_summary_has_all_entries_and_is_plain_json(flown):
    run, *_ = flown
    summary = json.loads(json.dumps(run.summary, allow_nan=False))
    assert summary.keys() == {
        "system", "scenario", "seed", "version", "agents", "min_separation_m", "wall_s",
        "peak_memory_mib", "verdict", "success", "reached", "shape_error_m", "path_m", "time_s",
        "reassignments",
        "gridlocked_s", "bytes_per_vehicle_s", "longest_auction_s", "keep_out_m", "gains_rate",
        "legs", "broken",
    }  # fmt: skip
    leg = {"success", "shape_error_m", "inverted", "time_s", "path_m", "reassignments"}
    assert [each.keys() for each in summary["legs"]] == [leg, leg]
    assert summary["success"]
    errors = [each["shape_error_m"] for each in summary["legs"]]
    assert summary["shape_error_m"] == max(errors)
    for name in ("time_s", "path_m", "reassignments"):
        assert summary[name] == pytest.approx(sum(each[name] for each in summary["legs"]))


def test_progress_names_the_leg_the_steps_and_the_phase(flown):
    _, mission, frames = flown
    first, last = make_progress(mission, frames[0]), make_progress(mission, frames[-1])
    assert first.stage == "leg 1 of 2" and last.stage == "leg 2 of 2"
    assert (first.done, last.done) == (0, len(frames) - 1)
    assert first.total == last.total == 30000
    assert (first.details, last.details) == (Phase.WAITING.value, Phase.COMPLETED.value)
