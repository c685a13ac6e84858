"""Recordings of a stick: clocks of their own, what they cover, and what is refused."""

import numpy as np
import pytest
import xarray as xr

import sato
from sato.connectivity.stick import RecordedStick

STILL, AHEAD = [0.0, 0.0, 0.0], [0.4, 0.0, 0.0]


def mission_of(times, velocities=None, **changes):
    rows = velocities or [AHEAD] * (len(times) - 1) + [STILL]
    stick = RecordedStick(np.array(times, dtype=float), np.array(rows, dtype=float).reshape(-1, 3))
    return sato.Connectivity(agents=3, stick=stick, **({"duration": 2.0} | changes))


@pytest.mark.parametrize("clock", [1.75e9, 1e8, 4.1e9])
def test_recording_with_a_clock_of_its_own_flies_as_from_its_first_row(clock, tmp_path):
    plain = sato.run(mission_of([0.0, 0.5, 1.5]))
    run = sato.run(mission_of([clock, clock + 0.5, clock + 1.5]))
    assert np.abs(run.data.stick.values).max() == 0.4
    assert (run.data.position.values == plain.data.position.values).all()
    run.save(tmp_path / "run")
    assert sato.load(tmp_path / "run").check().kept


def test_file_of_unix_seconds_is_flown_from_its_first_row(tmp_path):
    file = tmp_path / "stick.csv"
    file.write_text("".join(f"{1.75e9 + t},0.4,0,0\n" for t in (0.0, 0.5, 3.0)), encoding="utf-8")
    mission = sato.Connectivity(agents=3, duration=1.0, stick=RecordedStick(file=str(file)))
    drawn = mission.draw(np.random.default_rng(0))
    assert drawn.stick.times.tolist() == [0.0, 0.5, 3.0]


def test_recording_from_before_the_flight_begins_with_its_command_then():
    drawn = mission_of([-3.0, -1.0, 0.5]).draw(np.random.default_rng(0))
    assert drawn.stick.command_velocity(0.0, np.zeros(3), 0).tolist() == AHEAD


@pytest.mark.parametrize("first", [2.0, 7.3, 86400.0, 9e7])
def test_recording_after_the_flight_is_refused_with_both_ranges(first):
    text = rf"stick\.times_s: lie from {first:.10g} to .* after the flight of 2 s; times that are"
    with pytest.raises(ValueError, match=text):
        sato.run(mission_of([first, first + 1.0]))


@pytest.mark.parametrize("scale", [1e3, 1e6, 1e9])
def test_recording_in_milliseconds_or_less_is_refused(scale):
    with pytest.raises(ValueError, match="milliseconds or less of some clock; times in seconds"):
        mission_of([1.75e9 * scale, 1.75e9 * scale + 4096.0])


@pytest.mark.parametrize("times", [[0.0, 0.0], [1.0, 0.5], [0.0, np.nan], [0.0, 1.0, 1.0]])
def test_times_that_do_not_increase_are_refused(times):
    with pytest.raises(ValueError, match=r"times_s"):
        mission_of(times)


def test_velocities_with_other_times_as_labels_are_refused():
    times = np.array([0.0, 0.5])
    labels = {"time": 2 * times, "axis": ["x", "y", "z"]}
    velocities = xr.DataArray([AHEAD, STILL], labels, ("time", "axis"))
    with pytest.raises(sato.InputError, match="velocities_m_s: has other times as labels"):
        RecordedStick(times, velocities)
    same = RecordedStick(times, velocities.assign_coords(time=times)[::-1])
    assert same == RecordedStick(times, np.array([AHEAD, STILL]))


def test_empty_recording_is_refused():
    with pytest.raises(ValueError, match="times_s"):
        mission_of([], [])


def test_command_that_outlasts_its_recording_is_said():
    with pytest.warns(UserWarning, match="ends at 0.5 s of 2 s, and its last command of 0.4 m/s"):
        sato.run(mission_of([0.0, 0.5], [STILL, AHEAD]))
    assert mission_of([0.0, 0.5]).draw(np.random.default_rng(0)).warnings() == []


def test_recording_that_ends_at_rest_before_the_flight_is_refused():
    with pytest.raises(ValueError, match=r"times_s: lie from -9 to -1 s, before the flight"):
        mission_of([-9.0, -4.0, -1.0]).draw(np.random.default_rng(0))


def test_recording_that_ends_within_two_steps_is_doubted():
    [doubt] = mission_of([0.0, 1 / 3600]).draw(np.random.default_rng(0)).warnings()
    assert "takes 0.000278 s, and a step of the flight 0.02 s; are the times in s?" in doubt


@pytest.mark.parametrize(("times", "is_doubted"), [([0, 500, 900], True), ([0, 1, 2.5], False)])
def test_recording_of_which_most_comes_after_the_flight_is_doubted(times, is_doubted):
    doubts = mission_of(times).draw(np.random.default_rng(0)).warnings()
    assert any("1 of 3 commands; are the times in s?" in text for text in doubts) == is_doubted


def test_file_beside_times_is_refused():
    with pytest.raises(sato.InputError, match="file: has the recording, and times too"):
        RecordedStick(file="stick.csv", times=[0.0, 1.0], velocities=np.zeros((2, 3)))
