"""What a system must bring, shown by one that is made up here, and all that it then has."""

import subprocess
import sys
from dataclasses import replace
from typing import Annotated, Literal, NamedTuple

import numpy as np
import pytest
import tomli_w
from matplotlib.figure import Figure
from pydantic import PositiveInt
from test_cli import call, sentence

import sato
import sato.systems
from sato.check import Report, common
from sato.check.event_log import EventLog
from sato.check.promise import expect_below
from sato.former import SYSTEMS as FILES
from sato.former import ScenarioFile, parse
from sato.former.refusal import Refusal
from sato.interfaces import (
    Frame,
    FrameAlive,
    FrameComponent,
    FrameEvents,
    FramePosition,
    FrameTime,
    FrameVelocity,
    MissionProgress,
    Recorded,
    System,
)
from sato.network.graph import CommunicationGraph
from sato.record import read_frames, recorded_fields
from sato.scenario.errors import InputError
from sato.systems import SYSTEMS, load_system

DRIFT = """
system = "drift"
name = "still"
agents = 4
steps = 6
comm_radius_m = 2.5
"""


class Drift(NamedTuple):
    """Agents a metre and a half apart that drift as they are pushed."""

    velocity: np.ndarray  # (agents, 2) [m/s]
    steps: int
    comm_radius: float  # [m]


class Drifting(NamedTuple):
    """One instant."""

    time: FrameTime
    position: FramePosition
    velocity: FrameVelocity
    alive: FrameAlive
    component: FrameComponent
    heading: Annotated[np.ndarray, Recorded(("agent",), "rad", "from the x axis")]
    mood: str
    events: FrameEvents


class DriftFile(ScenarioFile):
    """The system as a file."""

    system: Literal["drift"]
    agents: PositiveInt
    steps: PositiveInt
    comm_radius_m: float

    def build(self, rng):
        with self.building():
            if self.agents > 9:
                raise Refusal("agents", f"9 at most would do, got {self.agents}")
        velocity = rng.uniform(-0.01, 0.01, (self.agents, 2))
        return Drift(velocity, self.steps, self.comm_radius_m)

    def warn(self, mission):
        pass

    def to_toml(self):
        return tomli_w.dumps(self.model_dump())


def drift(mission, rng):
    agents = len(mission.velocity)
    alive, heading = np.ones(agents, bool), np.arctan2(*mission.velocity.T)
    for k in range(mission.steps + 1):
        place = np.stack([1.5 * np.arange(agents), np.zeros(agents)], axis=1)
        position = place + k * mission.velocity
        component = CommunicationGraph.from_positions(
            position, mission.comm_radius, alive
        ).component
        told = ({"kind": "half", "agents": [0]},) if 2 * k == mission.steps else ()
        yield Drifting(
            float(k), position, mission.velocity, alive, component, heading, "calm", told
        )


def attributes(mission):
    return {"comm_radius_m": mission.comm_radius}


def judge(data, mission, rng):
    time, position = (np.asarray(data[name], dtype=float) for name in ("time", "position"))
    alive = np.asarray(data["alive"], dtype=bool)
    off = np.abs(np.diff(position, axis=0) - mission.velocity).max()
    promises = (
        common.check_attributes(data.attrs, attributes(mission)),
        common.check_times(time, 1.0),
        common.check_finite(alive, position),
        common.check_alive(alive, EventLog.from_dataset(data)),
        common.check_components(
            position, alive, np.asarray(data["component"]), mission.comm_radius
        ),
        expect_below("drift", float(off), 1e-12, 0.0, "m off in a step"),
    )
    came = not common.incomplete_reason(data.attrs)
    return Report(
        promises, common.common_summary(data.attrs, alive) | {"success": came, "path_m": 1.0}
    )


def figures(data, mission):
    def path():
        figure = Figure()
        figure.add_subplot().plot(*np.moveaxis(np.asarray(data["position"]), -1, 0))
        return figure

    return {"path": path}


SYSTEM = System(
    name="drift",
    frame=Drifting,
    simulate=drift,
    stop_errors=(ArithmeticError,),
    attributes=attributes,
    check=judge,
    progress=lambda mission, frame: MissionProgress(
        "drift", round(frame.time), mission.steps, "calm"
    ),
    figures=figures,
)


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setitem(SYSTEMS, "drift", __name__)
    monkeypatch.setitem(FILES, "drift", DriftFile)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drift.toml").write_text(DRIFT)
    return tmp_path


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_variable_is_declared_once_and_none_has_the_name_of_a_dimension(name):
    system = load_system(name)
    assert system.name == name
    dims = {n: ("time", *f.dims) for n, f in recorded_fields(system.frame).items()}
    if system.run_variables is not None:
        others = recorded_fields(system.run_variables)
        assert not others.keys() & dims.keys()
        dims |= {n: f.dims for n, f in others.items()}
    names = {dim for own in dims.values() for dim in own}
    assert all(dims[name] == (name,) for name in names & dims.keys())
    assert {"time", "position", "velocity", "alive", "component"} <= dims.keys()


def test_frames_are_read_back_as_the_type_that_was_recorded(home):
    run = sato.run("drift.toml", seed=5)
    run.save("here")
    frames = read_frames(Drifting, sato.load("here").data)
    assert type(frames) is Drifting and frames.mood is None
    flown = list(drift(parse(DRIFT).build(np.random.default_rng(5)), None))
    for name in recorded_fields(Drifting):
        expected = np.array([getattr(frame, name) for frame in flown])
        assert np.array_equal(getattr(frames, name), expected), name
        assert getattr(frames, name).dtype == expected.dtype
    assert frames.events == ({"time": 3.0, "kind": "half", "agents": [0]},)
    assert sato.load("here").data["axis"].values.tolist() == ["x", "y"]


def test_a_file_of_the_former_format_is_refused_with_the_version_that_reads_it(home):
    run = sato.run("drift.toml")
    del run.data.attrs["format"]
    run.data.attrs["version"] = "0.1.0"
    run.save("old")
    with pytest.raises(sato.RunFileError, match=r"written by sato 0.1.0, which reads it"):
        sato.load("old")


def test_a_system_is_not_loaded_before_it_is_asked_for():
    code = (
        "import sys, sato.record, sato.systems;"
        "print(*[m for m in sys.modules if m.startswith(('sato.reconf', 'sato.form'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_a_system_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(InputError, match=r'no system "drfit", only .*"reconfiguration"'):
        load_system("drfit")


def test_another_system_is_flown_recorded_and_judged_like_any(home):
    first = call("run", "drift.toml", "--out", "here", "--seed", "5")
    assert first.exit_code == 0, first.output
    assert first.stderr == "drift at 0 s: 1 component, least separation 1.5 m, calm\n"
    assert "success" in first.stdout and "path, m" in first.stdout
    run = sato.load("here")
    assert run.data["heading"].attrs["units"] == "rad"
    assert run.data["control_instant"].all()
    assert run.events("half") == [{"time": 3.0, "kind": "half", "agents": [0]}]
    assert run.summary["seed"] == 5 and run.summary["broken"] == []
    assert [p.name for p in run.check().promises] == [
        "unaltered", "attributes", "times", "numbers", "alive", "component", "drift", "summary",
    ]  # fmt: skip
    assert call("check", "here").exit_code == 0
    again = sato.run("drift.toml", seed=5)
    assert again.data.attrs["digest"] == run.data.attrs["digest"]


@pytest.mark.parametrize(
    ("name", "change", "promise"),
    [
        ("position", lambda x: x + 1e-6, "drift"),
        ("position", lambda x: x * np.nan, "numbers"),
        ("time", lambda t: t + 1e-6, "times"),
        ("time", lambda t: 0 * t, "times"),
        ("alive", lambda lives: ~lives, "alive"),
        ("component", lambda labels: labels + np.arange(4), "component"),
    ],
)
def test_another_system_is_judged_by_what_is_common_to_all(home, name, change, promise):
    run = sato.run("drift.toml", seed=5)
    values = run.data[name].values.copy()
    values[2] = change(values[2])
    run.data[name] = (run.data[name].dims, values, run.data[name].attrs)
    broken = {p.name for p in run.check().broken}
    assert {"unaltered", promise} <= broken


def test_what_ends_a_flight_without_being_a_fault_is_the_systems_own_word(home, monkeypatch):
    def lost(mission, rng):
        for frame in drift(mission, rng):
            if frame.time == 4:
                raise ArithmeticError("a wall in the way")
            yield frame

    monkeypatch.setattr(sys.modules[__name__], "SYSTEM", replace(SYSTEM, simulate=lost))
    assert call("run", "drift.toml", "--out", "here").exit_code == 1
    run = sato.load("here")
    assert run.summary["stopped"] == "a wall in the way" and len(run.data["time"]) == 4
    assert run.summary["success"] is False


def test_its_figures_are_drawn_and_a_film_that_it_has_not_is_refused(home):
    call("run", "drift.toml", "--out", "here", "--quiet")
    assert call("plot", "here").stdout == "here/path.png\n"
    refused = call("animate", "here")
    assert refused.exit_code == 2
    assert sentence(refused) == (
        "sato: drift runs have no film, only figures, which `sato plot` draws"
    )
    assert call("export", "here", "--format", "csv").exit_code == 0


def test_what_its_scenario_refuses_names_the_file(home):
    refused = call("run", "drift.toml", "--set", "agents=12")
    assert refused.exit_code == 2
    assert sentence(refused) == "sato: drift.toml: agents: 9 at most would do, got 12"


def test_a_run_of_a_system_that_is_not_known_or_lacks_its_variables_is_refused(home, monkeypatch):
    sato.run("drift.toml").save("here")
    lacking = sato.run("drift.toml")
    sato.Run(lacking.data.drop_vars("heading"), lacking.summary).save("there")
    with pytest.raises(sato.RunFileError, match=r"there/run.nc: is not a run .* no heading"):
        sato.load("there")
    monkeypatch.delitem(SYSTEMS, "drift")
    with pytest.raises(sato.RunFileError, match=r'no system "drift".* newer version of sato'):
        sato.load("here")


def test_a_frame_is_whatever_has_what_all_have(rng):
    mission = Drift(np.zeros((2, 2)), 1, 1.0)
    for frame in drift(mission, rng):
        assert isinstance(frame, Frame)
    assert not isinstance(mission, Frame)
