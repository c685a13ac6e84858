"""The command line, tried as a user would: above all with input that cannot be."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from full_disk import file_size_limit
from typer.testing import CliRunner, Result

import sato
import sato.reconfiguration.system
from problems.conic import Infeasible
from sato import record
from sato.cli import app
from sato.compilation import NOTICE
from sato.console import print_summary, show_mission_progress
from sato.reconfiguration.system import SYSTEM
from sato.run_data import RunData
from sato.summary import format_value

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


def replace_loop(monkeypatch: pytest.MonkeyPatch, simulate: Any) -> None:
    simulate.__module__ = SYSTEM.simulate.__module__  # as a function of the library
    monkeypatch.setattr(sato.reconfiguration.system, "SYSTEM", replace(SYSTEM, simulate=simulate))


def call_until(error: BaseException, frames: int, monkeypatch: pytest.MonkeyPatch) -> Result:
    """Fly the tiny scenario into a folder `here`, with an error after some frames."""

    def stopped(*given: object) -> object:
        for k, frame in enumerate(SYSTEM.simulate(*given)):
            if k == frames:
                raise error
            yield frame

    replace_loop(monkeypatch, stopped)
    return call("run", "tiny.toml", "--out", "here")


def sentence(result: Result, code: int = 2) -> str:
    said = result.stderr.strip()
    assert result.exit_code == code
    assert "Traceback" not in said
    assert said.startswith("sato: ")
    assert "\n" not in said
    return said


# Refused settings: what the sentence must name, the place and what would do.
REFUSED = [
    ("swarm.agentz=3", "swarm.agentz", "did you mean swarm.agents?"),
    ("swurm.agents=3", "swurm.agents", "did you mean swarm.agents?"),
    ("plan.commit_steps=2", "plan.commit_steps", "is now called freeze_steps"),
    ("agents", "--set takes table.key=value"),
    ("leg.0={}", "leg.0", "did you mean leg?"),
    ("model.kind=[]", "model.kind", "there is no kind"),
    ("position_m=1", "chief.position_m", "disturbance.position_m"),
    ("start={kind='rondom'}", "swarm.start", 'did you mean "random"?'),
    ("agents=many", "swarm.agents", "must be an integer", '"many"'),
    ("agents=2.5", "swarm.agents", "must be an integer", "2.5"),
    ("max_speed_m_s=true", "model.max_speed_m_s", "number", "true"),
    ("fuel_norm=true", "model.fuel_norm", "1, 2"),
    ("leg.shape={kind='text',text=7}", "leg.0.shape.text", "must be a string", "7"),
    ("leg.shape=7", "leg.0.shape", "must be a table", "7"),
    ("comm_radius_s=3", "comm_radius_s", "write comm_radius_m"),
    ("agents_m=3", "agents_m", "write agents"),
    ("start={kind='points',positions=[[0,0]]}", "swarm.start.positions", "write positions_m"),
    ("agents=0", "swarm.agents", "greater than 0", "got 0"),
    ("disturbance.position_m=-1", "disturbance.position_m", "at least 0", "-1"),
    ("plan.step_s=nan", "plan.step_s", "finite", "nan"),
    ("max_control_m_s2=inf", "model.max_control_m_s2", "finite"),
    ("positions_m=[[0,0],[2,nan],[4,0]]", "swarm.start.positions_m", "finite", "[1, 1]"),
    ("shape.spacing_m=0.3", "leg.0.shape", "0.3 m", "0.5000005 m"),
    ("shape={kind='text',text='I',height_m=0.4}", "leg.0.shape", "height", "would do"),
    ("shape={kind='points',positions_m=[[0,0],[0.1,0],[4,0]]}", "leg.0.shape", "0.1 m apart"),
    ("shape={kind='points',positions_m=[[0,0]]}", "leg.0.shape", "lists 1"),
    ("shape={kind='picture',file='a.png',height_m=9}", "leg.0.shape", "a.png"),
    ("shape={kind='text',text='U',spacing_m=1,font='Nothing'}", "Nothing"),
    ("positions_m=[[0,0],[0.4,0],[4,0]]", "swarm.start", "agent 0 starts 0.4 m from agent 1"),
    ("positions_m=[[0,0],[4,0],[4,0]]", "swarm.start", "agent 1 starts 0 m from agent 2"),
    ("shape={kind='points',positions_m=[[0,0],[4,1],[4,1]]}", "leg.0.shape", "place, [4, 1]"),
    ("start.velocities_m_s=[[0,0],[0.6,0],[0,0]]", "agent 1 starts at 0.6 m/s", "max_speed_m_s"),
    ("agents=4", "swarm.start.positions_m", "3 positions for 4"),
    ("start={kind='random',box_m=0.9,separation_m=0.8}", "swarm.start.box_m", "is full"),
    ("start={kind='random',box_m=9,separation_m=0.4}", "swarm.start.separation_m", "0.5 or more"),
    ("start={kind='random',box_m=900,separation_m=0.8,connected=true}", "swarm.start.connected"),
    ("max_speed_m_s=0.6", "Proposition 9", "swarm.comm_radius_m = 5.3"),
    ("replan_steps=5", "plan.replan_steps", "at most 4 would do"),
    ("auction_steps=6", "plan.auction_steps", "4 would do"),
    ("targets=2", "leg.0.targets", "3 or more would do"),
    ("leg.steps=2", "leg.0.steps", "agent ", "would do"),
    ("leg.lose={kind='middle',share=0.5,at_step=20}", "leg.0.lose.at_step", "at most 19"),
    ("leg.lose={kind='middle',share=1.5}", "leg.0.lose", "less than"),
    ("leg.lose={kind='agents',agents=[3]}", "leg.0.lose.agents", "0 to 2"),
    ("shape.center_m=[1]", "leg.0.shape.center_m", "2 coordinates"),
    ("name='../up'", "name", "../up"),
]


@pytest.mark.parametrize(("setting", "words"), [(s, words) for s, *words in REFUSED])
def test_bad_input_is_refused_in_a_sentence_and_nothing_is_written(home, setting, words):
    said = sentence(call("run", "tiny.toml", "--set", setting))
    assert said.startswith("sato: tiny.toml: ")
    assert [word for word in words if word not in said] == []
    assert os.listdir(home) == ["tiny.toml"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("uiucc", None, "did you mean uiuc? Built in are conflict, "),
        ("absent.toml", None, "no such file"),
        ("broken.toml", b"swarm = ", "is not TOML"),
        ("binary.toml", b"\xff\xfe\x00", "not UTF-8"),
        ("empty.toml", b"", 'system: is missing; "reconfiguration", '),
        ("other.toml", b'system = "reconfigurtion"', 'there is no system "reconfigurtion"'),
        ("short.toml", b'system = "reconfiguration"', "model.kind: is missing"),
    ],
)
def test_a_file_that_is_no_scenario_is_refused_by_name(home, name, content, words):
    if content is not None:
        (home / name).write_bytes(content)
    said = sentence(call("run", name))
    assert name in said and words in said
    assert not (home / "runs").exists()


@pytest.mark.parametrize(
    ("scenario", "options", "message"),
    [
        (3, {}, "scenario: must be a path, a Mission or a dict, got 3"),
        ("crossing", {"overrides": "agents=3"}, 'or a dict, got "agents=3"; ["agents=3"] would do'),
        (sato.parse(TINY), {"overrides": ["agents=3"]}, "overrides: cannot change a mission"),
        ("crossing", {"seed": "a"}, "seed: must be an integer at least 0 and below 1.8"),
        ("crossing", {"seed": 1.0}, "got 1.0"),
        ("crossing", {"seed": True}, "got true"),
        ("crossing", {"seed": -1}, "got -1"),
        ("crossing", {"seed": 2**64}, f"got {2**64}"),
        ({"swarm": 3, "system": "reconfiguration"}, {}, "model.kind: is missing"),
        ({"swarm": 3} | {"system": "connectivity"}, {}, "swarm: must be a table, got 3"),
    ],
)
def test_bad_arguments_are_refused_by_name(scenario, options, message):
    for fly in (sato.run, sato.simulate):
        with pytest.raises((sato.InputError, sato.ScenarioError)) as caught:
            fly(scenario, **options)
        assert message in str(caught.value)


@pytest.mark.parametrize("out", ["tiny.toml", "tiny.toml/deeper", "/proc/sato-cannot-write"])
def test_a_folder_that_cannot_be_written_is_refused_before_the_flight(home, monkeypatch, out):
    replace_loop(monkeypatch, _never)
    said = sentence(call("run", "tiny.toml", "--out", out))
    assert f"{out}: cannot be written to" in said and "--out" in said


def _never(*_: object) -> None:
    raise AssertionError("nothing should be flown")


@pytest.mark.parametrize("command", ["check", "plot", "animate", "export"])
@pytest.mark.parametrize("content", [None, b"", b"\x89HDF\r\n\x1a\nand no more", b"text"])
def test_an_unreadable_run_is_refused_by_name(home, command, content):
    (home / "old").mkdir()
    if content is not None:
        (home / "old" / "run.nc").write_bytes(content)
    assert "old/run.nc" in sentence(call(command, "old"))


@pytest.mark.parametrize(
    "words", ["run", "fly", "run tiny.toml --seed one", "run tiny.toml --sed 1"]
)
def test_words_that_are_no_command_exit_with_2(home, words):
    result = call(*words.split())
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    assert os.listdir(home) == ["tiny.toml"]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("run tiny.toml --seed 1e3", "'--seed': must be an integer, got \"1e3\""),
        ("run tiny.toml --speed fast", "'--speed': must be a number, got \"fast\""),
        ("campaign run many.toml --trials 0", "'--trials': must be at least 1, got \"0\""),
    ],
)
def test_options_of_another_type_or_range_are_refused_in_our_words(home, words, reason):
    assert call(*words.split()).output.endswith(f"Error: Invalid value for {reason}\n")


def test_a_run_leaves_its_file_and_its_summary(home):
    result = call("run", "tiny.toml", "--seed", "3")
    assert result.exit_code == 0, result.output
    said = result.stderr.removeprefix(f"{NOTICE}\n")  # where no cache has the kernels
    assert said.startswith("leg 1 of 1 at 0 s: 1 component, least separation 2 m\n")
    folder = home / "runs" / "tiny-3"
    assert sorted(os.listdir(folder)) == ["run.nc", "summary.json"]
    said = json.loads((folder / "summary.json").read_text())
    assert (said["scenario"], said["seed"], said["reached"]) == ("tiny", 3, True)
    assert said["wall_s"] > 0
    assert said["peak_memory_mib"] > 0
    assert "runs/tiny-3" in result.stdout.replace("\n", "")
    assert call("check", str(folder)).exit_code == 0
    judged = json.loads(call("check", str(folder), "--json").stdout)
    assert judged["kept"] is True
    again = call("run", "tiny.toml", "--seed", "3")
    assert "runs/tiny-3: the run that was there is overwritten" in again.stderr
    refused = call("run", "tiny.toml", "--seed", "3", "--set", "steps=2")
    assert "overwritten" not in refused.stderr
    assert "overwritten" not in result.stderr


def test_the_run_can_be_repeated_from_its_own_file(home):
    first = sato.run("tiny.toml", seed=3, overrides=["steps=24"])
    (home / "again.toml").write_text("\ufeff" + first.data.attrs["scenario"])
    again = sato.run("again.toml", seed=3)
    for other in ("wall_s", "peak_memory_mib", "origin", "digest"):
        del first.data.attrs[other], again.data.attrs[other]
    assert first.data.identical(again.data)


@pytest.mark.filterwarnings("default")
def test_quiet_says_nothing_but_warnings_in_a_line_each(home, monkeypatch):
    def doubtful(*given: object) -> object:
        warnings.warn("the model is wrong by 7 m;\n   another would do", stacklevel=1)
        yield from SYSTEM.simulate(*given)

    result = call("run", "tiny.toml", "--quiet", "--out", "here", "--set", "steps=25")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "", "")
    assert sato.load("here").summary["legs"][0]["steps"] == 25
    replace_loop(monkeypatch, doubtful)
    result = call("run", "tiny.toml", "--quiet", "--out", "here")
    said = "warning: the model is wrong by 7 m; another would do\n"
    assert (result.exit_code, result.stdout, result.stderr) == (0, "", said)


def test_trajectories_are_exported_beside_the_run_or_where_it_is_asked(home):
    call("run", "tiny.toml", "--quiet", "--out", "here")
    beside = call("export", "here", "--format", "csv")
    assert (beside.exit_code, beside.stdout) == (0, "here/trajectories.csv\n")
    there = call("export", "here/run.nc", "--format", "csv", "--out", "new/all.csv")
    assert (there.exit_code, there.stdout) == (0, "new/all.csv\n")
    assert call("export", "here", "--format", "csv").exit_code == 0  # over what is there
    table = Path("new/all.csv").read_text()
    assert table == Path("here/trajectories.csv").read_text()
    assert table.startswith("object,time_s,x_m,y_m,vx_m_s,vy_m_s\nagent-0,0.0,0.0,0.0,")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([], 2, "an OEM needs a [chief], and this run has none; the format csv needs no chief"),
        (["--format", "stk"], 2, 'there is no format "stk", only oem, csv and rrd'),
        (["--format", "csv", "--out", "here"], 2, "here: is a folder"),
        (["--format", "csv", "--out", "tiny.toml/x"], 2, "tiny.toml: cannot be written to"),
        (["--format", "csv", "--out", "/proc/x.csv"], 2, "/proc: cannot be written to"),
    ],
)
def test_an_export_that_cannot_be_is_refused_in_a_sentence(home, words, code, said):
    call("run", "tiny.toml", "--quiet", "--out", "here")
    assert said in sentence(call("export", "here", *words), code)
    assert sorted(os.listdir("here")) == ["run.nc", "summary.json"]


@pytest.mark.parametrize("words", [["run", ""], ["run", "tiny.toml", "--out", ""]])
def test_an_empty_word_is_refused_and_nothing_is_written(home, words):
    before = sorted(os.listdir())
    refused = call(*words)
    assert refused.exit_code == 2
    assert "a word is empty" in refused.stderr
    assert sorted(os.listdir()) == before


def test_player_is_written_beside_the_run_or_where_it_is_asked(home):
    call("run", "tiny.toml", "--quiet", "--out", "here")
    beside = call("player", "here")
    assert (beside.exit_code, beside.stdout) == (0, "here/player.html\n")
    there = call("player", "here/run.nc", "-o", "new/page.html")
    assert (there.exit_code, there.stdout) == (0, "new/page.html\n")
    assert Path("new/page.html").read_bytes() == Path("here/player.html").read_bytes()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "nowhere: there is no such run file"),
        (["tiny.toml"], "tiny.toml: cannot be read as netCDF-4"),
        (["here", "-o", "here"], "here: is a folder, and the player is one file"),
        (["here", "-o", "/proc/page.html"], "/proc: cannot be written to"),
        (["old"], "was written by sato 0.1, which reads it"),
        (["cut"], "is not a run of sato, for it has no velocity"),
    ],
)
def test_a_run_that_cannot_be_played_is_refused_in_a_sentence(home, words, said):
    call("run", "tiny.toml", "--quiet", "--out", "here")
    run = sato.load("here")
    old, cut = run.data.assign_attrs(version="0.1"), run.data.drop_vars("velocity")
    del old.attrs["format"]
    for name, data in (("old", old), ("cut", cut)):
        record.save(RunData.from_xarray(data), run.summary, Path(name))
    before = sorted(os.listdir("here"))
    assert said in sentence(call("player", *words))
    assert sorted(os.listdir("here")) == before


def test_in_orbit_the_fuel_of_each_spacecraft_is_told(capsys):
    each = {"mean": 1.25, "least": 0.5, "most": 2.0}
    print_summary({"fuel_m_s": 15.0, "fuel_per_agent_m_s": each}, Path("here"))
    said = capsys.readouterr().out
    for words in ("Δv per spacecraft, mean, m/s", "1.25", "most, m/s", "fuel, m/s"):
        assert words in said


def test_on_a_terminal_a_bar_tells_leg_step_and_separation(home, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "120")
    with show_mission_progress(SYSTEM.progress) as watch:
        sato.run("tiny.toml", progress=watch)
    said = capsys.readouterr().err
    assert "leg 1 of 1, step 20 of 20, 1 component, least separation 1.41 m" in said


def test_numbers_that_differ_do_not_read_the_same():
    assert format_value(0.5000005, 0.5) == "0.5000005"
    assert format_value(0.4999999995, 0.5) != format_value(0.5)
    assert format_value(1.2345678, 0.5) == "1.235" and format_value(0.5, 0.5) == "0.5"


def test_a_target_not_reached_exits_with_1(home, monkeypatch):
    def drifting(*given: object) -> object:
        for frame in SYSTEM.simulate(*given):
            yield frame._replace(position=frame.position + 1e-3)

    replace_loop(monkeypatch, drifting)
    assert call("run", "tiny.toml", "--out", "here").exit_code == 1
    assert json.loads((home / "here" / "summary.json").read_text())["reached"] is False
    assert call("check", "here").exit_code == 1


@pytest.mark.parametrize(
    ("error", "reason"),
    [(KeyboardInterrupt(), "interrupted"), (Infeasible(None, "no way out"), "no way out")],
    ids=["interrupted", "infeasible"],
)
def test_a_flight_that_ends_early_leaves_what_was_flown(home, monkeypatch, error, reason):
    result = call_until(error, 5, monkeypatch)
    assert result.exit_code == 1
    assert "Traceback" not in result.output
    run = sato.load("here")
    assert run.data.sizes["time"] == 5
    assert run.data.attrs["stopped"] == run.summary["stopped"] == reason
    assert np.isnan(run.data["control"][-1]).all()
    assert call("check", "here").exit_code == 1


def test_a_run_that_cannot_be_saved_where_it_should_is_saved_elsewhere(home, monkeypatch):
    def obstructed(*given: object) -> object:
        yield from SYSTEM.simulate(*given)
        (home / "here").write_text("in the way")

    monkeypatch.setattr(tempfile, "tempdir", str(home))
    replace_loop(monkeypatch, obstructed)
    said = sentence(call("run", "tiny.toml", "--quiet", "--out", "here"), code=1)
    assert said.startswith("sato: here/run.nc: ")
    assert sato.load(said.split("; the run is in ")[1]).summary["reached"]
    with file_size_limit(1000):
        said = sentence(call("run", "tiny.toml", "--quiet", "--out", "there"), code=1)
    assert said == "sato: there/run.nc: File too large"
    assert len(list(home.glob("sato-*"))) == 1 and os.listdir("there") == []


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (KeyboardInterrupt(), "interrupted"),
        (Infeasible(None, "no way out"), "no way out"),
        (KeyError("oops"), "fault of the program"),
        (OSError(28, "No space left on device", "x.nc"), "x.nc: No space left on device"),
    ],
    ids=["interrupted", "infeasible", "fault", "full disk"],
)
def test_an_end_without_a_run_is_a_sentence(home, monkeypatch, error, said):
    assert said in sentence(call_until(error, 0, monkeypatch), code=1)
    assert not (home / "here").exists()


INTERRUPTED = """
import signal, sys, weakref
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
import sato
from sato import record
from sato.__main__ import main

def load(path):
    {}

sato.load = load
sys.argv = ["sato", "check", "here"]
main()
"""


@pytest.mark.parametrize(
    "body",
    [
        'exec("signal.raise_signal(signal.SIGINT)")',
        "a = {1}; b = weakref.ref(a, lambda _: signal.raise_signal(signal.SIGINT)); a = 0\n"
        "    for _ in range(10**9): pass",
    ],
)
def test_an_interrupt_is_told_in_a_sentence_wherever_it_arises(body):
    code = INTERRUPTED.format(body)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("sato: interrupted; every file is whole")


def test_the_list_of_scenarios_has_a_line_each(home):
    result = call("scenarios")
    assert result.exit_code == 0
    lines = result.stdout.strip().split("\n")
    assert [line.split()[0] for line in lines] == sorted(sato.scenarios())
    assert all(len(line.split()) > 3 for line in lines)


@pytest.mark.parametrize(
    ("command", "more"),
    [([], ("pydantic",)), (["gains"], ())],  # Typer takes it for arguments
)
def test_help_loads_nothing_that_takes_long(command, more):
    slow = {"numpy", "scipy", "xarray", "numba", "cvxpy", "rich", *more}
    code = (
        "import sys; from typer.testing import CliRunner; from sato.cli import app;"
        f"assert CliRunner().invoke(app, {[*command, '--help']}).exit_code == 0;"
        f"print(*sorted({slow} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_the_installed_command_refuses_as_its_parts_do(home):
    program = Path(sys.executable).with_name("sato")
    command = [program, "run", "tiny.toml", "--set", "swarm.comm_radius=3"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "sato: tiny.toml: swarm.comm_radius: has no unit; write comm_radius_m\n"
    assert os.listdir(home) == ["tiny.toml"]


def test_the_version_is_that_of_the_package():
    assert call("--version").stdout.strip() == sato.__version__


def test_the_package_offers_its_public_names_only():
    assert dir(sato) == sorted([*sato.__all__, "__version__"])
    assert all(getattr(sato, name) is not None for name in sato.__all__)


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
