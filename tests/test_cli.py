"""The command line, tried as a user would: above all with input that cannot be."""

import json
import os
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import sato
import sato.reconfiguration.system
from sato.cli import app
from sato.console import print_summary, show_mission_progress
from sato.reconfiguration.state import ReconfigurationFrame
from sato.reconfiguration.system import SYSTEM

TINY = """
system = "reconfiguration"
name = "tiny"

[swarm]
agents = 3
start = { kind = "points", positions_m = [[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]] }
comm_radius_m = 5.0
collision_radius_m = 0.5

[model]
kind = "double_integrator"
max_control_m_s2 = 0.1
max_speed_m_s = 0.5

[plan]
step_s = 1.0
horizon_steps = 4
replan_steps = 4

[[leg]]
shape = { kind = "ring", spacing_m = 2.0 }
steps = 20
"""


@pytest.fixture
def home(tmp_path, monkeypatch):
    (tmp_path / "tiny.toml").write_text(TINY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(*words: str) -> Result:
    return CliRunner().invoke(app, words)


def replace_loop(monkeypatch: pytest.MonkeyPatch, simulate: object) -> None:
    """Replace the loop of the system."""
    monkeypatch.setattr(sato.reconfiguration.system, "SYSTEM", replace(SYSTEM, simulate=simulate))


def sentence(result: Result) -> str:
    said = result.stderr.strip()
    assert "Traceback" not in said
    assert said.startswith("sato: ")
    assert "\n" not in said
    return said


# What is wrong, and what the sentence must name: the place, and what would do.
REFUSED = {
    "an unknown key": ("swarm.agentz=3", ["swarm.agentz", "did you mean swarm.agents?"]),
    "an unknown table": ("swurm.agents=3", ["swurm.agents", "did you mean swarm.agents?"]),
    "no key at all": ("agents", ["--set takes table.key=value"]),
    "an ambiguous key": ("position_m=1", ["chief.position_m", "disturbance.position_m"]),
    "an unknown kind": ("start={kind='rondom'}", ["swarm.start", 'did you mean "random"?']),
    "a wrong type": ("agents=many", ["swarm.agents", "must be an integer", '"many"']),
    "a fraction of an agent": ("agents=2.5", ["swarm.agents", "must be an integer", "2.5"]),
    "a flag for a number": ("max_speed_m_s=true", ["model.max_speed_m_s", "number", "true"]),
    "a flag for a norm": ("fuel_norm=true", ["model.fuel_norm", "1, 2"]),
    "a number for a text": ("leg.shape={kind='text',text=7}", ["leg.0.shape.text", "text"]),
    "text for a table": ("leg.shape=7", ["leg.0.shape", "must be a table", "7"]),
    "a key without its unit": ("swarm.comm_radius=3", ["write comm_radius_m"]),
    "another kind of unit": ("comm_radius_s=3", ["comm_radius_s", "write comm_radius_m"]),
    "a unit where there is none": ("agents_m=3", ["agents_m", "write agents"]),
    "a unit missing in a list": (
        "start={kind='points', positions=[[0,0]]}",
        ["swarm.start.positions", "write positions_m"],
    ),
    "no agents": ("agents=0", ["swarm.agents", "greater than 0", "got 0"]),
    "a negative radius": ("comm_radius_m=-3", ["swarm.comm_radius_m", "greater than 0", "-3"]),
    "not a number": ("plan.step_s=nan", ["plan.step_s", "finite", "nan"]),
    "an infinite number": ("max_control_m_s2=inf", ["model.max_control_m_s2", "finite"]),
    "not a number in a list": (
        "positions_m=[[0,0],[2,nan],[4,0]]",
        ["swarm.start.positions_m", "finite", "[1, 1]"],
    ),
    "a negative disturbance": (
        "disturbance.position_m=-1",
        ["disturbance.position_m", "at least 0"],
    ),
    "a shape too small": ("shape.spacing_m=0.3", ["leg.0.shape", "0.3", "0.5 m"]),
    "a ring too small": ("shape={kind='ring',radius_m=0.2}", ["leg.0.shape", "radius", "would do"]),
    "a lattice too small": ("shape={kind='lattice',spacing_m=0.2}", ["leg.0.shape", "would do"]),
    "a text too small": (
        "shape={kind='text',text='I',height_m=0.4}",
        ["leg.0.shape", "height", "would do"],
    ),
    "points too close": (
        "shape={kind='points',positions_m=[[0,0],[0.1,0],[4,0]]}",
        ["leg.0.shape", "0.1 m apart"],
    ),
    "too few points": ("shape={kind='points',positions_m=[[0,0]]}", ["leg.0.shape", "lists 1"]),
    "no such picture": ("shape={kind='picture',file='a.png',height_m=9}", ["leg.0.shape", "a.png"]),
    "no such font": ("shape={kind='text',text='U',spacing_m=1,font='Nothing'}", ["Nothing"]),
    "starts too close": (
        "positions_m=[[0,0],[0.4,0],[4,0]]",
        ["swarm.start", "agent 0 starts 0.4 m from agent 1", "0.5 m"],
    ),
    "starts too fast": (
        "start.velocities_m_s=[[0,0],[0.6,0],[0,0]]",
        ["swarm.start", "agent 1 starts at 0.6 m/s", "model.max_speed_m_s"],
    ),
    "starts of another number": ("agents=4", ["swarm.start.positions_m", "3 positions for 4"]),
    "a full box": (
        "start={kind='random',box_m=0.9,separation_m=0.8}",
        ["swarm.start.box_m", "is full", "would do"],
    ),
    "a separation below the collision radius": (
        "start={kind='random',box_m=9,separation_m=0.4}",
        ["swarm.start.separation_m", "0.5 or more would do"],
    ),
    "no such network": (
        "start={kind='random',box_m=900,separation_m=0.8,connected=true}",
        ["swarm.start.connected", "smaller box_m"],
    ),
    "Proposition 9 broken by the radius": (
        "comm_radius_m=3",
        [
            "Proposition 9",
            "swarm.comm_radius_m = 4.5",
            "model.max_speed_m_s = 0.3125",
            "plan.horizon_steps = 2",
            "plan.allow_undetectable = true",
        ],
    ),
    "Proposition 9 broken by the speed": ("max_speed_m_s=0.6", ["swarm.comm_radius_m = 5.3"]),
    "a period longer than the horizon": (
        "replan_steps=5",
        ["plan.replan_steps", "at most 4 would do"],
    ),
    "periods that do not nest": ("auction_steps=6", ["plan.auction_steps", "4 would do"]),
    "fewer targets than agents": ("targets=2", ["leg.0.targets", "3 or more would do"]),
    "a target out of reach": ("leg.steps=2", ["leg.0.steps", "agent ", "would do"]),
    "a loss after the leg": (
        "leg.lose={kind='middle',share=0.5,at_step=20}",
        ["leg.0.lose.at_step", "at most 19"],
    ),
    "a share above the whole": ("leg.lose={kind='middle',share=1.5}", ["leg.0.lose", "less than"]),
    "a loss of nobody": ("leg.lose={kind='agents',agents=[3]}", ["leg.0.lose.agents", "0 to 2"]),
    "a center in another space": ("shape.center_m=[1]", ["leg.0.shape.center_m", "2 coordinates"]),
    "a name that is no folder": ("name='../up'", ["name"]),
}


@pytest.mark.parametrize(("setting", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_bad_input_is_refused_in_a_sentence_and_nothing_is_written(home, setting, words):
    result = call("run", "tiny.toml", "--set", setting)
    said = sentence(result)
    assert result.exit_code == 2
    assert said.startswith("sato: tiny.toml: ")
    for word in words:
        assert word in said
    assert [p.name for p in home.iterdir()] == ["tiny.toml"]


def test_an_unknown_scenario_is_refused_with_those_there_are(home):
    result = call("run", "uiucc")
    said = sentence(result)
    assert result.exit_code == 2
    assert 'no scenario "uiucc"' in said
    assert "did you mean uiuc?" in said
    assert "crossing" in said
    assert [p.name for p in home.iterdir()] == ["tiny.toml"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("absent.toml", None, "no such file"),
        ("broken.toml", b"swarm = ", "is not TOML"),
        ("binary.toml", b"\xff\xfe\x00", "not UTF-8"),
        ("empty.toml", b"", 'system: there is no system ""'),
        ("other.toml", b'system = "reconfigurtion"', 'there is no system "reconfigurtion"'),
        ("short.toml", b'system = "reconfiguration"', "model.kind: is missing"),
    ],
)
def test_a_file_that_is_no_scenario_is_refused_by_name(home, name, content, words):
    if content is not None:
        (home / name).write_bytes(content)
    result = call("run", name)
    said = sentence(result)
    assert result.exit_code == 2
    assert name in said
    assert words in said
    assert not (home / "runs").exists()


@pytest.mark.parametrize("out", ["tiny.toml", "tiny.toml/deeper", "/proc/sato-cannot-write"])
def test_a_folder_that_cannot_be_written_is_refused_before_the_flight(home, monkeypatch, out):
    replace_loop(monkeypatch, _never)
    result = call("run", "tiny.toml", "--out", out)
    said = sentence(result)
    assert result.exit_code == 2
    assert f"{out}: cannot be written to" in said
    assert "--out" in said


@pytest.mark.parametrize("command", ["check", "plot", "animate", "export"])
@pytest.mark.parametrize("content", [None, b"", b"\x89HDF\r\n\x1a\nand no more", b"text"])
def test_an_unreadable_run_is_refused_by_name(home, command, content):
    (home / "old").mkdir()
    if content is not None:
        (home / "old" / "run.nc").write_bytes(content)
    result = call(command, "old")
    assert result.exit_code == 2
    assert "old/run.nc" in sentence(result)


@pytest.mark.parametrize(
    "words",
    [
        ["run"],
        ["fly"],
        ["run", "tiny.toml", "--seed", "-1"],
        ["run", "tiny.toml", "--seed", "one"],
        ["run", "tiny.toml", "--sed", "1"],
    ],
)
def test_words_that_are_no_command_exit_with_2(home, words):
    result = call(*words)
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    assert [p.name for p in home.iterdir()] == ["tiny.toml"]


def _never(*_: object) -> None:
    raise AssertionError("nothing should be flown")


def test_a_run_leaves_its_file_and_its_summary(home):
    result = call("run", "tiny.toml", "--seed", "3")
    assert result.exit_code == 0, result.output
    folder = home / "runs" / "tiny-3"
    assert sorted(p.name for p in folder.iterdir()) == ["run.nc", "summary.json"]
    said = json.loads((folder / "summary.json").read_text())
    assert (said["scenario"], said["seed"], said["reached"]) == ("tiny", 3, True)
    assert said["wall_s"] > 0
    assert said["peak_memory_mib"] > 0
    assert "runs/tiny-3" in result.stdout.replace("\n", "")
    assert call("check", str(folder)).exit_code == 0
    judged = json.loads(call("check", str(folder), "--json").stdout)
    assert judged["kept"] is True


def test_the_run_can_be_repeated_from_its_own_file(home):
    first = sato.run("tiny.toml", seed=3, overrides=["steps=24"])
    (home / "again.toml").write_text(first.data.attrs["scenario"])
    again = sato.run("again.toml", seed=3)
    for timed in ("wall_s", "peak_memory_mib"):
        del first.data.attrs[timed], again.data.attrs[timed]
    assert first.data.identical(again.data)


def test_quiet_says_nothing(home):
    result = call("run", "tiny.toml", "--quiet", "--out", "here")
    assert (result.stdout, result.stderr) == ("", "")
    assert (home / "here" / "run.nc").exists()


@pytest.mark.filterwarnings("default")
def test_a_warning_is_a_line_on_the_error_stream_also_when_quiet(home, monkeypatch):
    real = SYSTEM.simulate

    def doubtful(*given: object) -> object:
        warnings.warn("the model is wrong by 7 m;\n   another would do", stacklevel=1)
        yield from real(*given)

    replace_loop(monkeypatch, doubtful)
    result = call("run", "tiny.toml", "--quiet", "--out", "here")
    assert result.exit_code == 0
    said = "warning: the model is wrong by 7 m; another would do\n"
    assert (result.stdout, result.stderr) == ("", said)


def test_trajectories_are_exported_beside_the_run_or_where_it_is_asked(home):
    call("run", "tiny.toml", "--quiet", "--out", "here")
    beside = call("export", "here", "--format", "csv")
    assert (beside.exit_code, beside.stdout) == (0, "here/trajectories.csv\n")
    there = call("export", "here/run.nc", "--format", "csv", "--out", "new/all.csv")
    assert (there.exit_code, there.stdout) == (0, "new/all.csv\n")
    table = Path("new/all.csv").read_text()
    assert table == Path("here/trajectories.csv").read_text()
    assert table.startswith("object,time_s,x_m,y_m,vx_m_s,vy_m_s\nagent-0,0.0,0.0,0.0,")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([], 2, "only scenarios with a [chief] fly in orbit, and the format csv"),
        (["--format", "stk"], 2, 'there is no format "stk", only oem and csv'),
        (["--format", "csv", "--out", "here"], 2, "here: is a folder"),
        (["--format", "csv", "--out", "tiny.toml/x"], 1, "tiny.toml/x: "),
    ],
)
def test_an_export_that_cannot_be_is_refused_in_a_sentence(home, words, code, said):
    call("run", "tiny.toml", "--quiet", "--out", "here")
    result = call("export", "here", *words)
    assert result.exit_code == code
    assert said in sentence(result)
    assert sorted(p.name for p in (home / "here").iterdir()) == ["run.nc", "summary.json"]


def test_in_orbit_the_fuel_of_each_spacecraft_is_told(capsys):
    each = {"mean": 1.25, "least": 0.5, "most": 2.0}
    print_summary({"fuel_m_s": 15.0, "fuel_per_agent_m_s": each}, Path("here"))
    said = capsys.readouterr().out
    for words in ("Δv per spacecraft, mean, m/s", "1.25", "most, m/s", "fuel, m/s"):
        assert words in said


def test_progress_goes_to_the_error_stream_a_line_a_leg(home):
    result = call("run", "tiny.toml")
    assert result.stderr.startswith("leg 1 of 1 at 0 s: 1 component, least separation 2 m\n")


def test_on_a_terminal_a_bar_tells_leg_step_and_separation(home, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "120")
    with show_mission_progress(SYSTEM.progress) as watch:
        sato.run("tiny.toml", progress=watch)
    said = capsys.readouterr().err
    assert "leg 1 of 1, step 20 of 20, 1 component, least separation 1.41 m" in said


def test_what_a_name_does_not_say_is_spelt_out():
    from sato.summary import format_label

    assert format_label("bytes_per_vehicle_s") == "sent by each vehicle, bytes/s"
    assert format_label("fuel_per_agent_m_s", "mean") == "Δv per spacecraft, mean, m/s"
    assert format_label("min_separation_m") == "min separation, m"
    assert format_label("slack_used") == "slack used"


def test_an_override_reaches_the_run(home):
    assert call("run", "tiny.toml", "--set", "steps=25", "--set", "seed=1").exit_code == 2
    call("run", "tiny.toml", "--set", "steps=25", "--out", "here")
    assert sato.load("here").summary["legs"][0]["steps"] == 25


def test_a_target_not_reached_exits_with_1(home, monkeypatch):
    real = SYSTEM.simulate

    def drifting(*given: object) -> object:
        for frame in real(*given):
            yield frame._replace(position=frame.position + 1e-3)

    replace_loop(monkeypatch, drifting)
    result = call("run", "tiny.toml", "--out", "here")
    assert result.exit_code == 1
    assert json.loads((home / "here" / "summary.json").read_text())["reached"] is False
    assert call("check", "here").exit_code == 1


def test_an_interrupted_flight_leaves_what_was_flown(home, monkeypatch):
    real = SYSTEM.simulate

    def stopped(*given: object) -> object:
        for k, frame in enumerate(real(*given)):
            if k == 5:
                raise KeyboardInterrupt
            yield frame

    replace_loop(monkeypatch, stopped)
    result = call("run", "tiny.toml", "--out", "here")
    assert result.exit_code == 1
    assert "Traceback" not in result.output
    run = sato.load("here")
    assert run.data.sizes["time"] == 5
    assert run.data.attrs["stopped"] == run.summary["stopped"] == "interrupted"
    assert np.isnan(run.data["control"][-1]).all()
    assert call("check", "here").exit_code == 1


def test_an_interruption_before_the_first_instant_leaves_nothing(home, monkeypatch):
    def stopped(*_: object) -> object:
        raise KeyboardInterrupt
        yield

    replace_loop(monkeypatch, stopped)
    result = call("run", "tiny.toml", "--out", "here")
    assert result.exit_code == 1
    assert "interrupted" in sentence(result)
    assert not (home / "here").exists()


def test_a_programme_without_an_answer_is_an_outcome_and_not_a_crash(home, monkeypatch):
    from problems.conic import Infeasible

    real = SYSTEM.simulate

    def lost(*given: object) -> object:
        for k, frame in enumerate(real(*given)):
            if k == 5:
                raise Infeasible(None, "no way out")
            yield frame

    replace_loop(monkeypatch, lost)
    result = call("run", "tiny.toml", "--out", "here")
    assert result.exit_code == 1
    assert sato.load("here").data.attrs["stopped"] == "no way out"


def test_a_fault_of_the_program_is_a_sentence_too(home, monkeypatch):
    def faulty(*_: object) -> ReconfigurationFrame:
        raise KeyError("oops")

    replace_loop(monkeypatch, faulty)
    result = call("run", "tiny.toml", "--out", "here")
    assert result.exit_code == 1
    assert "fault of the program" in sentence(result)


def test_a_disk_that_fills_up_is_a_sentence(home, monkeypatch):
    def full(*_: object) -> Path:
        raise OSError(28, "No space left on device", "here/run.nc")

    monkeypatch.setattr(sato.Run, "save", full)
    result = call("run", "tiny.toml", "--quiet", "--out", "here")
    assert result.exit_code == 1
    assert "here/run.nc: No space left on device" in sentence(result)


def test_the_list_of_scenarios_has_a_line_each(home):
    result = call("scenarios")
    assert result.exit_code == 0
    lines = result.stdout.strip().split("\n")
    assert [line.split()[0] for line in lines] == sorted(sato.scenarios())
    assert all(len(line.split()) > 3 for line in lines)


def test_help_loads_nothing_that_takes_long():
    code = (
        "import sys; from typer.testing import CliRunner; from sato.cli import app;"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0;"
        "print(*sorted({'numpy', 'scipy', 'pydantic', 'xarray', 'numba'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_the_installed_command_refuses_as_its_parts_do(home):
    program = Path(sys.executable).with_name("sato")
    done = subprocess.run(
        [program, "run", "tiny.toml", "--set", "comm_radius=3"], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr == "sato: tiny.toml: comm_radius: has no unit; write comm_radius_m\n"
    assert os.listdir(home) == ["tiny.toml"]


def test_the_version_is_that_of_the_package():
    assert call("--version").stdout.strip() == sato.__version__


def test_numbers_that_differ_do_not_read_the_same():
    from sato.summary import format_value

    assert format_value(0.5000005, 0.5) == "0.5000005"
    assert format_value(0.4999999995, 0.5) != format_value(0.5)
    assert format_value(1.2345678, 0.5) == "1.235" and format_value(0.5, 0.5) == "0.5"


def test_a_run_that_is_there_is_said_to_be_overwritten(home):
    first = call("run", "tiny.toml", "--out", "there")
    again = call("run", "tiny.toml", "--out", "there")
    words = "there: the run that is there will be overwritten"
    assert words not in first.stderr and words in again.stderr


def test_two_who_look_further_than_they_hear_collide_and_it_is_said(home):
    said = call("run", "undetectable", "--out", "unseen")
    summary = json.loads((home / "unseen" / "summary.json").read_text())
    assert said.exit_code == 1 and summary["undetectable"] and summary["broken"] == ["separation"]
    assert summary["min_separation_m"] < 0.5 * summary["collision_radius_m"]


@pytest.fixture
def interruptible():
    # Who starts the tests in the background may have had the signal ignored.
    former = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, former)


def test_a_signal_waits_for_the_next_instant_and_keeps_what_was_flown(home, interruptible):
    def interrupt(mission, frame):
        if frame.time >= 3:
            signal.raise_signal(signal.SIGINT)

    run = sato.run("tiny.toml", progress=interrupt)
    assert run.summary["stopped"] == "interrupted" and len(run.data["time"]) == 4
    [promise] = [p for p in run.check().broken if p.name == "complete"]
    assert "not completed (interrupted)" in promise.message
