"""A system in one file: all that it must bring, and all that it then has."""

import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
import pytest
from matplotlib.figure import Figure
from recorded_run import altered
from test_cli import call, sentence

import sato
from dynamics.units import Length
from sato import record
from sato.check import common
from sato.check.report import Report, expect_below
from sato.interfaces import (
    Alive,
    Component,
    Events,
    MissionProgress,
    Position,
    Reals,
    System,
    Time,
    Velocity,
)
from sato.network.graph import CommunicationGraph
from sato.record import RunRecord, recorded_fields
from sato.run_data import RunData
from sato.scenario.definition import Convert, In, Positive, as_array
from sato.scenario.errors import InputError
from sato.scenario.file import Mission
from sato.systems import SYSTEMS, load_system

SCENARIO = """
system = "drift"
name = "still"
comm_radius_m = 2.5

[swarm]
agents = 4
steps = 6
"""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Drift(Mission):
    """Agents 1.5 m apart that drift at random velocities."""

    system: ClassVar[str] = "drift"

    agents: Annotated[int, In("swarm"), Positive, "number of agents"]
    steps: Annotated[int, In("swarm"), Positive, "steps of a second"]
    comm_radius: Annotated[Length, In(""), Positive, "communication radius"]
    velocity: Annotated[
        np.ndarray | None, In("swarm"), Convert(lambda v: None if v is None else as_array(v, 2)),
        "velocity of each agent; drawn if absent",
    ] = None  # fmt: skip

    def check(self):
        if self.agents > 9:
            raise InputError("agents", f"9 at most would do, got {self.agents}")

    def draw(self, rng):
        return replace(self, velocity=rng.uniform(-0.01, 0.01, (self.agents, 2)))

    def warnings(self):
        return []

    def without_files(self):
        return self


class DriftFrame(NamedTuple):
    """One instant."""

    time: Time
    position: Position
    velocity: Velocity
    alive: Alive
    component: Component
    heading: Annotated[Reals, "rad", "from the x axis"]
    mood: str
    events: Events


def simulate(mission, rng):
    alive, heading = np.ones(mission.agents, bool), np.arctan2(*mission.velocity.T)
    start = np.stack([1.5 * np.arange(mission.agents), np.zeros(mission.agents)], axis=1)
    for k in range(mission.steps + 1):
        position = start + k * mission.velocity
        graph = CommunicationGraph.from_positions(position, mission.comm_radius, alive)
        events = ({"kind": "half", "agents": [0]},) if 2 * k == mission.steps else ()
        yield DriftFrame(
            float(k), position, mission.velocity, alive, graph.component, heading, "calm", events
        )


def attributes(mission):
    return {"comm_radius_m": mission.comm_radius}


def check(data, mission, rng):
    record = RunRecord.from_data(data, mission)
    frames, errors = record.frames, np.diff(record.frames.position, axis=0) - mission.velocity
    promises = (
        common.check_complete(data.attrs),
        common.check_attributes(data.attrs, attributes(mission)),
        common.check_times(record.events, 1.0),
        common.check_finite(frames.alive, frames.position),
        common.check_alive(frames.alive, record.events),
        common.check_components(frames, mission.comm_radius),
        expect_below("drift", np.abs(errors), 1e-12, 0.0, "m off in a step"),
    )
    summary = {"success": promises[0].kept, "path_m": 1.0}
    return Report(promises, common.common_summary(data.attrs, frames.alive) | summary)


def figures(data, mission):
    def path():
        figure = Figure()
        figure.add_subplot().plot(*np.moveaxis(np.asarray(data["position"]), -1, 0))
        return figure

    return {"path": path}


SYSTEM = System(
    name="drift",
    frame=DriftFrame,
    simulate=simulate,
    stop_errors=(ArithmeticError,),
    attributes=attributes,
    check=check,
    progress=lambda mission, frame: MissionProgress(
        "drift", round(frame.time), mission.steps, "calm"
    ),
    figures=figures,
)


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setitem(SYSTEMS, "drift", (f"{__name__}:Drift", f"{__name__}:SYSTEM"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drift.toml").write_text(SCENARIO)
    return tmp_path


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_variable_is_declared_once_and_none_is_named_as_a_dimension(name):
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
    data = sato.load("here").recorded
    frames = RunRecord.from_data(data, None).frames
    assert type(frames) is DriftFrame and frames.mood is None
    flown = list(sato.simulate("drift.toml", seed=5))
    for name in recorded_fields(DriftFrame):
        expected = np.array([getattr(frame, name) for frame in flown])
        assert np.array_equal(getattr(frames, name), expected), name
        assert getattr(frames, name).dtype == expected.dtype
    assert frames.events == ({"time": 3.0, "kind": "half", "agents": [0]},)
    assert data["axis"].tolist() == ["x", "y"]


def test_file_of_the_former_format_names_the_version_that_reads_it(home):
    run = sato.run("drift.toml")
    attrs = {**run.recorded.attrs, "version": "0.1.0"}
    del attrs["format"]
    record.save(replace(run.recorded, attrs=attrs), run.summary, Path("old"))
    with pytest.raises(sato.RunFileError, match=r"written by sato 0.1.0, which reads it"):
        sato.load("old")
    attrs["format"] = 99
    record.save(replace(run.recorded, attrs=attrs), run.summary, Path("new"))
    with pytest.raises(sato.RunFileError, match="too old for it"):
        sato.load("new")


def test_system_is_not_imported_before_it_is_needed():
    code = (
        "import sys, sato.record, sato.runs, sato.systems;"
        "print(*[m for m in sys.modules if m.startswith(('sato.reconf', 'matplotlib', 'xarray'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize("name", ["drfit", 3, None])
def test_unknown_system_is_refused_with_those_that_exist(name):
    with pytest.raises(
        InputError, match=r'system: (there is no system .*|is missing); .*"formation"'
    ):
        load_system(name)


def test_new_system_is_flown_recorded_and_checked(home):
    first = call("run", "drift.toml", "--out", "here", "--seed", "5")
    assert first.exit_code == 0, first.output
    assert first.stderr == "drift at 0 s: 1 component, least separation 1.5 m, calm\n"
    assert "success" in first.stdout and "path, m" in first.stdout
    run = sato.load("here")
    assert run.data["heading"].attrs["units"] == "rad"
    assert run.data["control_instant"].all()
    assert run.events("half") == [{"time": 3.0, "kind": "half", "agents": [0]}]
    assert run.summary["seed"] == 5 and run.summary["broken"] == []
    assert [promise.name for promise in run.check().promises] == [
        "unaltered", "scenario", "complete", "attributes", "times", "numbers", "alive", "component",
        "drift", "summary",
    ]  # fmt: skip
    assert call("check", "here").exit_code == 0
    again = sato.run(Drift(name="still", agents=4, steps=6, comm_radius=2.5), seed=5)
    assert again.data.equals(run.data) and "from Python" in str(again.check().promises[1])
    assert again.mission == run.mission


@pytest.mark.parametrize(
    ("name", "change", "promise"),
    [
        ("position", lambda x: x + 1e-6, "drift"),
        ("position", lambda x: x * np.nan, "numbers"),
        ("time", lambda t: t + 1e-6, "times"),
        ("time", lambda t: 0 * t, "times"),
        ("alive", lambda alive: ~alive, "alive"),
        ("component", lambda labels: labels + np.arange(4), "component"),
    ],
)
def test_common_promises_are_checked_for_every_system(home, name, change, promise):
    run = sato.run("drift.toml", seed=5)
    run = altered(run, name, 2, change(run.data[name].values[2]))
    assert {"unaltered", promise} <= {p.name for p in run.check().broken}


def test_a_stop_error_of_the_system_ends_a_run_early(home, monkeypatch):
    def stopped(mission, rng):
        for frame in simulate(mission, rng):
            if frame.time == 4:
                raise ArithmeticError("a wall in the way")
            yield frame

    monkeypatch.setattr(sys.modules[__name__], "SYSTEM", replace(SYSTEM, simulate=stopped))
    assert call("run", "drift.toml", "--out", "here").exit_code == 1
    run = sato.load("here")
    assert run.summary["stopped"] == "a wall in the way" and len(run.data["time"]) == 4
    assert run.summary["success"] is False


def test_a_fault_in_a_check_does_not_lose_the_run(home, monkeypatch):
    def faulty(data, mission, rng):
        raise LookupError("oops")

    monkeypatch.setattr(sys.modules[__name__], "SYSTEM", replace(SYSTEM, check=faulty))
    with pytest.warns(UserWarning, match="could not be checked: LookupError: oops"):
        run = sato.run("drift.toml")
    assert run.summary["check_failed"] == "LookupError: oops" and len(run.data["time"]) == 7


def test_figures_are_drawn_and_a_film_without_a_scene_is_refused(home):
    call("run", "drift.toml", "--out", "here", "--quiet")
    (home / "here" / "mine.png").write_bytes(b"not a figure of a run")
    sato.load("here").figures()["path"].savefig("here/kept.png")
    assert call("plot", "here", "--pdf").stdout == "here/path.pdf\n"
    assert call("plot", "here").stdout == "here/path.png\n"
    names = sorted(path.name for path in (home / "here").iterdir())
    assert names == ["kept.png", "mine.png", "path.png", "run.nc", "summary.json"]
    refused = call("animate", "here")
    assert refused.exit_code == 2
    assert sentence(refused) == "sato: runs of drift have no scene that a viewer could show"
    assert call("export", "here", "--format", "csv").exit_code == 0


def test_refusals_of_the_definition_name_the_file(home):
    refused = call("run", "drift.toml", "--set", "agents=12")
    assert refused.exit_code == 2
    assert sentence(refused) == "sato: drift.toml: agents: 9 at most would do, got 12"


def test_definition_is_shown_with_its_keys_and_defaults(home):
    assert call("keys", "drift").stdout.splitlines()[5:9] == [
        "[swarm]",
        "  agents    integer > 0  required  number of agents",
        "  steps     integer > 0  required  steps of a second",
        "  velocity  list         -         velocity of each agent; drawn if absent",
    ]
    shown = call("show", "drift.toml", "--set", "steps=8").stdout
    assert 'system = "drift"' in shown and "steps = 8" in shown and "comm_radius_m = 2.5" in shown


def test_runs_of_unknown_systems_or_without_variables_are_refused(home, monkeypatch):
    sato.run("drift.toml").save("here")
    lacking = sato.run("drift.toml")
    data = RunData.from_xarray(lacking.data.drop_vars("heading"))
    record.save(data, lacking.summary, Path("there"))
    with pytest.raises(sato.RunFileError, match=r"there/run.nc: is not a run .* no heading"):
        sato.load("there")
    monkeypatch.delitem(SYSTEMS, "drift")
    with pytest.raises(sato.RunFileError, match=r'no system "drift".* newer version of sato'):
        sato.load("here")
