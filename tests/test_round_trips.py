"""Round trips: values come back from files, copies and pickles, or are named as skipped."""

import copy
import importlib
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest

import sato
from sato.campaigns.trial import Trial
from sato.connectivity.stick import WaypointStick
from sato.export import format_utc
from sato.formation.settings import AssignmentSettings
from sato.run_data import RunData

SCRIPTS = Path(__file__).parents[1] / "scripts"
START = np.c_[1.5 * np.arange(3), np.zeros((3, 3))]
PLAIN = {
    "model": sato.DoubleIntegrator(2),
    "start": START,
    "legs": [sato.Leg(START + np.eye(4)[1], steps=8)],
    "step": 1.0,
    "comm_radius": 20.0,
    "collision_radius": 0.5,
    "max_control": 0.2,
    "max_speed": 1.0,
}


class Euler(sato.Plant):
    """Double integrator, a step at a time, with friction."""

    def __init__(self, friction=0.0):
        self.friction = friction

    def propagate(self, x, u, t, dt, substeps=1):
        """Return the states at equal instants from t to t + dt, the first of them x itself."""
        states, h = [x], dt / substeps
        for _ in range(substeps):
            v = x[:, 2:]
            x = x + h * np.hstack([v + h * u / 2, u - self.friction * v])
            states.append(x)
        return np.array(states)


class Damped(sato.LinearModel):
    """Point mass with friction."""

    axes = 2

    def __init__(self, friction):
        self.friction = np.array([friction])

    def A(self, t):
        """State matrix."""
        zero = np.zeros((2, 2))
        return np.block([[zero, np.eye(2)], [zero, -self.friction[0] * np.eye(2)]])


class Steady(WaypointStick):
    """Stick that is always held forward."""

    def command_velocity(self, time, position, waypoints_reached):
        """Return the velocity."""
        return np.array([0.5, 0.0, 0.0])


class Pillar(sato.Sphere):
    """Obstacle of the user's own."""


class Guarded(sato.Reconfiguration):
    """Mission of the user's own."""


OWN = {
    "plant": ({"plant": Euler()}, "the plant `test_round_trips.Euler`"),
    "model": ({"model": Damped(0.05)}, "the model `test_round_trips.Damped`"),
    "obstacle": (
        {"obstacles": [Pillar((30.0, 30.0), 1.0)]},
        "the obstacle.0 `test_round_trips.Pillar`",
    ),
}


@pytest.fixture
def fuzz(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    return importlib.import_module("fuzz_definitions")


def test_random_definitions_come_back_equal_or_are_named(fuzz):
    wrong, ends, kept = fuzz.fuzz(120, 3, flights=False)
    assert wrong == []
    assert len(kept) >= 100 and ends["skipped"] >= 5


def test_the_fuzzer_sees_a_last_bit_that_is_lost(fuzz):
    mission = sato.Reconfiguration(**PLAIN)
    other = replace(mission, comm_radius=float(np.nextafter(20.0, 30.0)))
    (text,) = fuzz.compare("to_toml", mission, other)
    assert text == "to_toml: not equal, .comm_radius: 20.0 became 20.000000000000004"


@pytest.mark.parametrize("name", OWN)
def test_values_of_the_users_own_are_named_and_skipped(name, tmp_path):
    changed, says = OWN[name]
    mission = sato.Reconfiguration(**PLAIN | changed)
    run = sato.run(mission)
    run.save(tmp_path / "run")
    loaded = sato.load(tmp_path / "run")
    report = loaded.check()
    given = sato.load(tmp_path / "run", mission=mission).check()
    assert report.verdict == "unchecked" and given.kept and run.check().kept
    assert f"{says} is of your own; sato.load(path, mission=...) gives it" in str(report)
    assert "  flight: skipped" in str(report) and "flight" in report.skipped
    assert report.as_dict()["skip_reason"] == report.skip_reason
    with pytest.raises(sato.RunFileError, match="is of your own"):
        loaded.figures()
    with pytest.raises(sato.ScenarioError, match=rf'{says.split()[1]}: "test_round_trips\.'):
        sato.parse(mission.to_toml())
    other = replace(mission, plant=sato.LinearPlant(sato.DoubleIntegrator(2)))
    with pytest.raises(sato.RunFileError, match="another mission"):
        sato.load(tmp_path / "run", mission=other)


def test_a_run_without_its_mission_says_so():
    run = replace(sato.run(sato.Reconfiguration(**PLAIN)), mission=None)
    assert "were skipped, no mission is given" in run.report.line
    with pytest.raises(sato.RunFileError, match="no mission is given"):
        run.figures()


def test_a_plant_of_the_library_is_not_said_to_be_the_users_own(tmp_path):
    sato.run(
        sato.Reconfiguration(**PLAIN | {"plant": sato.LinearPlant(sato.DoubleIntegrator(2))})
    ).save(tmp_path / "run")
    said = "the plant `dynamics.plant.LinearPlant` is of Python, which no file holds; sato.load"
    assert said in str(sato.load(tmp_path / "run").check())


def test_a_stick_of_the_users_own_is_no_stick_of_the_library(tmp_path):
    mission = sato.Connectivity(stick=Steady(), duration=0.1)
    run = sato.run(mission)
    run.save(tmp_path / "run")
    report = sato.load(tmp_path / "run").check()
    names = {promise.name for promise in run.check().promises}
    assert set(report.skipped) == names - {promise.name for promise in report.promises}
    assert "the stick `test_round_trips.Steady` is of your own" in str(report)
    assert sato.load(tmp_path / "run", mission=mission).check().kept


def test_promises_of_formations_are_listed_as_skipped(tmp_path):
    flown = sato.run("formation", overrides=["protocol.limit_s=0.5"])
    every = {promise.name for promise in flown.check().promises}
    text = flown.recorded.attrs["scenario"].replace(
        "[radio]\n", '[radio]\nkind = "own"\nclass = "a.B"\n'
    )
    forged = RunData(flown.recorded.variables, {**flown.recorded.attrs, "scenario": text}).seal()
    sato.Run(forged, flown.summary).save(tmp_path / "run")
    report = sato.load(tmp_path / "run").check()
    assert set(report.skipped) == every - {promise.name for promise in report.promises}
    assert "the radio `a.B`" in report.skip_reason


def test_runs_of_earlier_versions_with_own_parts_still_load(tmp_path):
    for changed in ({"model": Damped(0.05)}, {"model": Damped(0.05), "plant": Euler(0.05)}):
        mission = sato.Reconfiguration(**PLAIN | changed)
        run = sato.run(mission)
        text = mission.to_toml().replace('class = "test_round_trips.Damped"\n', "")
        text = text.replace('[plant]\nkind = "own"\nclass = "test_round_trips.Euler"\n\n', "")
        old = RunData(run.recorded.variables, {**run.recorded.attrs, "scenario": text}).seal()
        sato.Run(old, run.summary).save(tmp_path / "run")
        assert "the model is of your own" in str(sato.load(tmp_path / "run").check())
        assert sato.load(tmp_path / "run", mission=mission).check().kept


def test_campaigns_fly_own_parts_as_they_are_or_refuse_to_change_them():
    mission = sato.Reconfiguration(**PLAIN, plant=Euler(0.02))
    trial = Trial(0, mission, {}, 0, (0, 0))
    assert pickle.loads(pickle.dumps(trial)).build_mission() == mission
    with pytest.raises(sato.InputError, match=r'plant: "test_round_trips\.Euler" is of a mission'):
        trial._replace(parameters={"plan.horizon_steps": 6}).build_mission()


def test_a_mission_of_the_users_own_class_is_no_scenario():
    with pytest.raises(sato.ScenarioError, match=r"Guarded.* is of a mission in Python"):
        sato.parse(Guarded(**PLAIN).to_toml())


def test_models_and_plants_are_equal_by_what_they_are_made_of():
    def fly(**changed):
        return sato.Reconfiguration(**PLAIN | changed)

    assert fly(model=Damped(0.05)) == fly(model=Damped(0.05))
    assert fly(model=Damped(0.05)) != fly(model=Damped(0.06))
    assert fly(plant=Euler()) == fly(plant=Euler()) != fly(plant=Euler(0.1))
    linear = [sato.LinearPlant(Damped(f)) for f in (0.05, 0.05, 0.06)]
    same, again, other = (fly(model=Damped(0.05), plant=plant) for plant in linear)
    assert same == again != other and hash(same) == hash(again)
    for mission in (same, fly(plant=Euler(0.2))):
        _ = mission.draw(np.random.default_rng(0)).flown_plant
        for back in (pickle.loads(pickle.dumps(mission)), copy.deepcopy(mission)):
            assert back == mission and hash(back) == hash(mission)
            with pytest.raises(ValueError, match="read-only"):
                back.start.positions[0] = 1.0


def test_values_of_another_class_are_not_equal():
    settings = AssignmentSettings()
    mine = type("Mine", (AssignmentSettings,), {})
    mission = sato.read("formation")
    assert replace(mission, assignment=settings) != replace(mission, assignment=mine(*settings))
    assert sato.Sphere((0.0, 0.0), 1.0) != Pillar((0.0, 0.0), 1.0)


@pytest.mark.parametrize(
    ("name", "overrides", "path", "value"),
    [
        ("orbit", ["plan.foresight_steps=none"], "foresight_steps", None),
        ("orbit", ["plan.printed=true", "foresight_steps = none "], "printed", True),
        ("uiuc", ["leg.1.lose=none"], "legs", ()),
        ("uiuc", ["leg.lose=none"], "legs", ()),
        ("uiuc", ["solver=none"], "solver", "clarabel"),
        ("uiuc", ["name=none"], "name", "mission"),
        ("uiuc", ['name="none"'], "name", "none"),
        ("eccentric", ["plan.foresight_steps=3", "plan.foresight_steps=none"], "printed", False),
    ],
)
def test_none_takes_a_key_away(name, overrides, path, value):
    found = getattr(sato.read(name, overrides), path)
    if path == "legs":
        found = found[1].losses
    assert found == value


def test_none_is_a_value_where_it_is_one():
    assert sato.read("formation", ["assignment.kind=none"]).assignment.method == "none"


def test_pairs_take_a_key_away_with_python_none():
    data = {"system": "reconfiguration", "swarm": {"start": {"kind": "ring", "radius_m": 5.0}}}
    data["swarm"] |= {"agents": 3, "comm_radius_m": 20.0, "collision_radius_m": 0.5}
    data |= {"model": {"kind": "double_integrator", "max_control_m_s2": 0.2, "max_speed_m_s": 1}}
    data |= {"plan": {"step_s": 1.0}, "chief": {"semi_major_axis_km": 7000}}
    data |= {"leg": [{"shape": {"kind": "ring", "radius_m": 6.0}, "steps": 9}]}
    assert sato.from_dict(data, [("chief", None)]).chief is None
    assert sato.from_dict(data, ["chief=none"]) == sato.from_dict(data, [("chief", None)])


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("plan.step_min=none", "plan.step_s: is missing, and has no default"),
        ("plan.foresigt=none", "there is no such key; did you mean plan.foresight_steps?"),
        ("leg.0.lose.kind=random", 'leg.lose is no table yet; leg.0.lose={kind = "…"}, with all'),
        ("leg.2.steps=30", "leg.2.steps: is of a table that is not there: of leg there are 1"),
        ("leg.steps.x=3", "there is no such key; did you mean leg.steps?"),
        ("swarm=none", "swarm.start: is missing"),
        ("chief=none", "is motion about an orbit, and this mission has none"),
    ],
)
def test_keys_that_cannot_be_taken_away_are_refused(override, words):
    with pytest.raises(sato.ScenarioError) as caught:
        sato.read("orbit", [override])
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("epoch", "seconds", "expected"),
    [
        ("2300-01-01", [0.0, 60.0], ["2300-01-01T00:00:00.000", "2300-01-01T00:01:00.000"]),
        ("0001-01-01", [86400.0], ["0001-01-02T00:00:00.000"]),
        ("9998-12-31T23:59:59", [1.0], ["9999-01-01T00:00:00.000"]),
        ("1600-02-29T12:00:00+02:00", [0.5], ["1600-02-29T10:00:00.500"]),
        ("2016-12-31T23:59:59Z", [1.0], ["2017-01-01T00:00:00.000"]),
        ("2300-01-01T00:00:00.999999", [0.000001, 2e-9],
         ["2300-01-01T00:00:01.000000000", "2300-01-01T00:00:00.999999002"]),
    ],
)  # fmt: skip
def test_epochs_of_all_years_are_exported_as_they_are(epoch, seconds, expected):
    chief = sato.Chief(semi_major_axis=7e6, epoch=epoch)
    assert format_utc(RunData({}, {"epoch": chief.epoch}), np.array(seconds)) == expected


@pytest.mark.parametrize(
    ("epoch", "words"),
    [
        ("9999-06-01", "must be in the years 1 to 9998, got 9999"),
        ("0001-01-01T00:00:00+02:00", "must be a date and time in UTC"),
        ("2016-12-31T23:59:60", "no leap second"),
        ("10000-01-01", "must be a date and time in UTC"),
        ("2026-01-01T00:00:00.123456789", "must be of whole microseconds"),
    ],
)
def test_epochs_that_no_export_can_write_are_refused(epoch, words):
    with pytest.raises(sato.InputError, match=words):
        sato.Chief(semi_major_axis=7e6, epoch=epoch)


def test_timestamps_of_pandas_are_epochs_of_whole_microseconds():
    text = "2026-01-01T09:00:00.123456"
    given = pandas.Timestamp(text, tz="Asia/Tokyo")
    assert sato.Chief(semi_major_axis=7e6, epoch=given).epoch == "2026-01-01T00:00:00.123456"
    with pytest.raises(sato.InputError, match="epoch: must be of whole microseconds"):
        sato.Chief(semi_major_axis=7e6, epoch=pandas.Timestamp(text + "789"))
