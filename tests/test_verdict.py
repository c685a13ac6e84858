"""Verdict of a run: broken, not reached or kept, in one line, and the same in every place."""

import json
from dataclasses import replace
from html import escape

import numpy as np
import pytest
from recorded_run import altered, fly_straight, in_order, make_crossing, recorded
from test_cli import call
from test_forgeries import forged
from test_python_missions import PLANE, Damped

import sato
from sato.campaigns.selection import list_runs
from sato.campaigns.table import open_table
from sato.campaigns.trial import judge
from sato.check.report import (
    Promise,
    Report,
    expect_apart,
    expect_below,
    expect_none,
    expect_small_error,
)
from sato.reconfiguration.leg import Leg, Loss
from sato.record import RunFileError
from sato.run_data import Variable
from sato.runs import Run
from sato.scene import SwarmScene

SHORT = {
    "crossing": [],
    "formation6": ["limit_s=40"],
    "connectivity": ["duration_s=1", "start_s=0"],
}


def promise(kept, kind="record", name="speed"):
    return Promise(name, kept, 1.0, 0.0, "too fast", (3,), 4.5, kind)


def test_broken_is_before_not_reached_and_unchecked_before_kept():
    held, broken, missed = promise(True), promise(False), promise(False, "aim")
    assert Report((held, broken, missed), {}, ("fuel",)).verdict == "broken"
    assert Report((held, missed), {}, ("fuel",)).verdict == "not reached"
    assert Report((held,), {}, ("fuel",)).verdict == "unchecked"
    assert Report((held,), {}, failure="LookupError: oops").verdict == "unchecked"
    assert Report((held,), {"success": False}).verdict == "not reached"
    assert Report((held,), {"success": True}).verdict == Report((held,), {}).verdict == "kept"


def test_no_report_claims_success_unless_its_verdict_is_kept(rng):
    for _ in range(300):
        kinds = rng.choice(["record", "safety", "aim"], rng.integers(5))
        promises = tuple(promise(bool(rng.random() < 0.7), str(kind)) for kind in kinds)
        skipped, failure = ("fuel",) * int(rng.integers(2)), "oops" * int(rng.random() < 0.2)
        given = {} if rng.random() < 0.3 else {"success": bool(rng.integers(2))}
        report = Report(promises, given, skipped, failure=failure)
        every = all(each.kept for each in promises) and given.get("success", True)
        is_kept = every and not skipped and not failure
        assert report.kept == report.summary["success"] == report.as_dict()["kept"] == is_kept
        assert report.summary["verdict"] == report.verdict
        assert report.line.startswith(f"{report.verdict.upper()}: ") and "\n" not in report.line
        assert str(report).splitlines()[0] == report.line == report.as_dict()["line"]


def test_safety_is_named_first_and_the_others_after_it():
    far = expect_apart(0.053, 1.0, (0, 1), 17.3)
    names = ["unaltered", "flight", "control", "speed", "targets"]
    report = Report((*(promise(False, name=name) for name in names), far), {})
    text = "BROKEN: separation, 0.053 m < 1 m, agents 0 and 1 at 17.3 s"
    assert report.line == f"{text}; also unaltered, flight, control, 2 more"


def test_promises_tell_the_agent_and_the_time_of_the_worst_value(rng):
    for _ in range(50):
        shape = tuple(rng.integers(1, 6, rng.integers(2, 4)))
        values, time = rng.normal(size=shape), np.cumsum(rng.random(shape[0] + 1))
        k, i, *_ = np.unravel_index(int(np.abs(values).argmax()), shape)
        for found in (
            expect_small_error("flight", values, 0.0, "m", time),
            expect_below("speed", values, 0.0, 0.0, "m/s", time),
        ):
            assert (found.agents, found.time) == ((i,), time[k])
        odd = values > 0
        found = expect_none("alive", odd, "odd", time)
        if odd.any():
            k, i, *_ = np.argwhere(odd)[0]
            assert (found.agents, found.time) == ((i,), time[k])
        else:
            assert (found.agents, found.time) == ((), None)
    assert expect_below("speed", [[1.0, np.nan]], 2.0, 0.0, "m/s", np.zeros(1)).agents == (1,)
    assert "agent 1 at 0 s" in expect_below("turn", [[1, 9]], 2, 0, "rad/s", np.zeros(1)).text


def test_a_line_has_the_digits_that_tell_a_distance_from_its_limit():
    assert "0.99999999 m < 1 m" in expect_apart(1 - 1e-8, 1 - 1e-9, (0, 1), 2.0).message
    inexact = expect_apart(1.0001, 1.0, (0, 1), 2.0, 2e-4)
    assert "1.0001 m, up to 0.0002 m wrong, < 1 m" in inexact.message
    assert expect_apart(np.inf, 1.0, (-1, -1), 0.0).agents == ()
    assert not expect_apart(np.nan, 1.0, (0, 1), 0.0).kept


@pytest.fixture(scope="module")
def collided():
    """Return a run of two agents that pass each other at 0.15 m, where 0.2 m is asked."""
    return recorded(make_crossing(0.15), own_targets=True)


def nearest(run, scale=1.0):
    """Measure the closest approach between instants by dense cubics."""
    from scipy.interpolate import CubicHermiteSpline

    time = run.data["time"].values
    path = CubicHermiteSpline(time, run.data["position"].values, run.data["velocity"].values)
    fine = np.linspace(time[0], time[-1], 200 * len(time))
    apart = np.linalg.norm((path(fine)[:, 1] - path(fine)[:, 0]) / scale, axis=1)
    return float(apart.min()), float(fine[apart.argmin()])


def test_a_collision_is_told_with_pair_time_and_distance(collided):
    distance, time = nearest(collided)
    line = collided.report.line
    assert line.startswith("BROKEN: separation, 0.15 m < 0.2 m, agents 0 and 1 at ")
    assert distance == pytest.approx(0.15, abs=1e-4)
    assert float(line.split(" at ")[1].split()[0]) == pytest.approx(time, abs=0.01)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"collision_radius": (0.2, 0.3)}, "0.6 (R_i + R_j)/2 < 1 (R_i + R_j)/2"),
        ({"separation_axes": (1.0, 2.0)}, "0.375 of the ellipsoid < 1 of the ellipsoid"),
    ],
)
def test_a_collision_relative_to_radii_or_an_ellipsoid_is_told(change, text):
    run = recorded(replace(make_crossing(0.15), **change), own_targets=True)
    _, time = nearest(run, np.array(change.get("separation_axes", (1.0, 1.0))))
    assert run.report.line.startswith(f"BROKEN: separation, {text}, agents 0 and 1 at ")
    [near] = [each for each in run.report.broken if each.name == "separation"]
    assert near.time == pytest.approx(time, abs=0.01)


def test_a_collision_with_an_obstacle_tells_which_and_when():
    wall = sato.Box((-0.5, -0.3), (0.5, -0.1))
    run = recorded(replace(make_crossing(0.9), obstacles=(wall,)), own_targets=True)
    [near] = [each for each in run.report.broken if each.kind == "safety"]
    x, y = run.data["position"].sel(agent=0).values.T
    at = np.interp(near.time, run.data["time"].values, x)
    assert near.agents == (0,) and abs(at) <= 0.6 and y[0] == 0
    assert "obstacles, 0.1 m < 0.2 m to obstacle 0, a box, agent 0 at " in run.report.line


def test_a_missed_target_is_told_with_leg_agent_and_distance():
    mission = make_crossing(0.9)
    frames = fly_straight(mission, own_targets=True)
    frames[-1] = frames[-1]._replace(position=np.add(frames[-1].position, [[0, 0], [0.4, 0]]))
    run = recorded(mission, frames)
    aim = next(each for each in run.report.promises if each.name == "reached")
    assert aim.message == "leg 1, target 1 is 0.4 m from agent 1 (tolerance 1e-06 m)"
    assert not aim.kept and aim.kind == "aim" and run.verdict == "broken"  # for it jumped there


def test_a_leg_that_is_not_reached_breaks_no_other_promise():
    there = np.array([[0.0, 0, 0, 0], [1.5, 0, 0, 0]])
    everybody = Loss("agents", agents=(0, 1), at_step=2)
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2), start=there, legs=[Leg(there, 6, losses=[everybody])],
        step=1.0, comm_radius=9.0, collision_radius=0.3, max_control=0.2, max_speed=1.0,
    )  # fmt: skip
    run = sato.run(mission)
    assert run.verdict == "not reached"
    assert run.report.line == "NOT REACHED: leg 1, no agent is left"


@pytest.fixture(scope="module", params=SHORT)
def saved(request, tmp_path_factory):
    """Return the folder of a run of each system, and the run."""
    run = sato.run(request.param, seed=1, overrides=SHORT[request.param])
    return run.save(tmp_path_factory.mktemp("saved")), run


def first_lines(folder):
    """Return what each place says first of a run, its exit code and its success."""
    run, checked = sato.load(folder), call("check", str(folder))
    page = run.player(folder / "page.html").read_text(encoding="utf-8")
    html = run._repr_html_().removeprefix("<pre>").splitlines()[0]
    shown = page.partition('<p id="verdict">')[2].partition("</p>")[0]
    lines = {repr(run).splitlines()[0], checked.stdout.splitlines()[0], run.report.line}
    assert html == shown == escape(run.report.line)
    [line] = lines
    return line, checked.exit_code, run.summary["success"], judge(run)["summary"]["success"]


def test_every_place_says_the_same_of_an_honest_run(saved):
    folder, run = saved
    line, code, *success = first_lines(folder)
    assert line == run.report.line and success == 2 * [run.report.kept]
    assert line.startswith(f"{run.verdict.upper()}: ") and code == int(not run.report.kept)
    assert sato.load(folder).summary == run.summary


@pytest.mark.parametrize("entries", [{"success": True}, {"verdict": "kept"}, {"prize": 1}, {}])
@pytest.mark.parametrize("name", ["position", "velocity"])
@pytest.mark.parametrize("seals", [True, False])
def test_no_place_repeats_a_forged_success(saved, tmp_path, entries, name, seals):
    _, run = saved
    forged = altered(run, name, (3, 1, 0), by=1e-3 * bool(entries))
    data = forged.recorded.seal() if seals else forged.recorded
    claimed = run.summary | {"success": True, "verdict": "kept"} | (entries or {"agents": 99})
    (tmp_path / "run.nc").write_bytes(data.to_netcdf())
    (tmp_path / "summary.json").write_text(json.dumps(claimed))
    line, code, *success = first_lines(tmp_path)
    assert line.startswith("BROKEN: ") and code == 1 and success == [False, False]


@pytest.mark.parametrize("complete", [0, 1])
def test_a_run_that_was_stopped_is_not_reached_and_says_why(saved, complete):
    _, run = saved
    attrs = {**run.recorded.attrs, "complete": complete, "stopped": "interrupted"}
    stopped = Run(replace(run.recorded, attrs=attrs).seal(), {}, run.mission)
    aims = {each.name for each in stopped.report.broken if each.kind == "aim"}
    assert "complete" in aims
    assert stopped.summary["success"] is False and "interrupted" in str(stopped.report)


def test_a_loaded_run_without_its_mission_claims_no_success(tmp_path):
    mission = sato.Reconfiguration(model=Damped(), **PLANE)
    run = sato.run(mission)
    run.save(tmp_path)
    assert sato.load(tmp_path, mission=mission).verdict == run.verdict == "kept"
    bare, checked = sato.load(tmp_path), call("check", str(tmp_path))
    assert bare.verdict == "unchecked" and not bare.summary["success"] and checked.exit_code == 1
    assert bare.summary["fuel_m_s"] == run.summary["fuel_m_s"]  # as claimed
    assert "skipped, the model `test_python_missions.Damped` is" in repr(bare).splitlines()[0]
    assert "sato.load(path, mission=...)" in repr(bare).splitlines()[0]
    bare.save(tmp_path)
    assert sato.load(tmp_path, mission=mission).verdict == "kept"
    assert checked.stdout.splitlines()[0] == bare.report.line


def test_a_file_that_contradicts_its_scenario_is_broken_and_still_shown(collided):
    fewer = collided.data.isel(agent=slice(1, None))
    run = Run(type(collided.recorded).from_xarray(fewer), collided.summary, collided.mission)
    assert {promise.name for promise in run.check().broken} == {"unaltered", "record"}
    assert run.report.line.startswith("BROKEN: unaltered, ") and not run.summary["success"]
    assert repr(run).startswith("BROKEN: unaltered, ")
    sealed = replace(run, recorded=run.recorded.seal())
    assert repr(sealed).startswith("BROKEN: record, the file has 1 agents, and its scenario 2")


@pytest.mark.parametrize("seals", [True, False])
def test_a_file_whose_scenario_cannot_be_drawn_is_broken(seals):
    run = sato.run("formation6", overrides=["limit_s=3"])  # starts 1.5 m apart
    text = run.recorded.attrs["scenario"].replace("keep_out_m = 1.2", "keep_out_m = 1.7")
    data = replace(run.recorded, attrs={**run.recorded.attrs, "scenario": text})
    claimed = run.summary | {"success": True}
    forged = Run(data.seal() if seals else data, claimed, sato.parse(text))
    assert forged.report.line.startswith("BROKEN: file, ") and not forged.summary["success"]


def test_a_check_that_fails_is_no_success(collided, monkeypatch):
    def fail(*_):
        raise LookupError("oops")

    monkeypatch.setattr("sato.verify.verify_run", fail)
    run = replace(collided)
    assert run.report.line == "UNCHECKED: the check ended early, LookupError: oops"
    assert run.summary["success"] is False and run.summary["check_failed"] == "LookupError: oops"
    assert judge(run)["exit"] == "error"


def test_a_collision_is_marked_in_trajectories_player_and_film(collided, tmp_path):
    scene = collided.scene()
    assert isinstance(scene, SwarmScene) and scene.verdict == collided.report.line
    [near] = scene.broken
    assert near.agents == (0, 1)
    labels = [text.get_text() for text in collided.figures()["trajectories"].legends[0].texts]
    assert "broken: separation" in labels
    from sato.film import SwarmFilm

    film = SwarmFilm(scene)
    for time, is_told in ((near.time - 0.1, False), (near.time + 0.1, True)):
        film.draw_frame(time)
        assert ("broken: separation" in film.axes.get_title()) == is_told


def test_rows_of_a_campaign_have_a_verdict_and_are_sorted(tmp_path):
    sato.campaign(
        "crossing", trials=2, out=tmp_path, workers=1, grid={"collision_radius_m": [0.8, 1.0]}
    ).close()
    with open_table(tmp_path) as table:
        assert [row["verdict"] for row in table.rows()] == 4 * ["kept"]
        for sort, sign in (("min_separation_m", 1), ("-min_separation_m", -1)):
            _, rows = list_runs(table, [], ["min_separation_m"], sort=sort)
            values = [sign * float(row[2]) for row in rows]
            assert values == sorted(values)


@pytest.mark.parametrize(("radius", "code"), [("[0.8, 40.0]", 0), ("[40.0, 50.0]", 1)])
def test_a_campaign_without_any_success_exits_with_one(tmp_path, monkeypatch, radius, code):
    monkeypatch.chdir(tmp_path)
    text = '[campaign]\nscenario = "crossing"\n[grid]\n"swarm.collision_radius_m" = '
    (tmp_path / "all.toml").write_text(text + radius)
    result = call("campaign", "run", "all.toml", "--out", "here", "--workers", "1")
    assert result.exit_code == code, result.output
    assert ("none of 2 runs succeeded" in result.stderr) == bool(code)


def test_a_campaign_whose_columns_all_fail_exits_with_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("def more(run):\n    return run.nothing\n")
    text = '[campaign]\nscenario = "crossing"\ncolumns = "mine:more"\ntrials = 2\n'
    (tmp_path / "all.toml").write_text(text)
    result = call("campaign", "run", "all.toml", "--out", "here", "--workers", "1")
    assert result.exit_code == 1 and "columns failed in all runs" in result.stderr


def test_clocks_that_the_seed_does_not_give_hide_no_collision():
    cross = np.array([[-4.0, 0, 0, 0], [0, -4.0, 0, 0]])
    legs = (Leg(in_order(-cross), 15),)
    flown = replace(make_crossing(0.15), start=cross, legs=legs)
    honest = recorded(flown, own_targets=True)
    told = {"time": 0.0, "kind": "clocks", "agents": [0, 1], "steps": [0, 6]}
    assert {each.name for each in honest.report.broken} == {"separation"}
    run = forged(honest, [*honest.events(), told])
    assert {each.name for each in run.report.broken} == {"times"} and run.verdict == "broken"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("axis", "axis has labels y and x, which no run has"),
        ("position", "position has km as its unit, not m"),
        ("velocity", "velocity is inf at time 3, agent 0, axis 0, which no run has"),
        ("time", "time is nan at time 3, which no run has"),
    ],
)
def test_units_labels_and_numbers_that_no_run_has_break_the_record(collided, name, text, tmp_path):
    dims, values, attributes = collided.recorded.variables[name]
    values, attributes = np.array(values), dict(attributes)
    match name:
        case "axis":
            values = values[::-1]
        case "position":
            attributes["units"] = "km"
        case "velocity":
            values[3, 0, 0] = np.inf
        case "time":
            values[3] = np.nan
    variables = collided.recorded.variables | {name: Variable(dims, values, attributes)}
    data = replace(collided.recorded, variables=variables).seal()
    damaged = replace(collided, recorded=data)
    assert damaged.report.line == f"BROKEN: record, {text}"
    with pytest.raises(RunFileError, match=f"the record is damaged: {text}"):
        damaged.export(tmp_path / "table.csv", "csv")


def test_a_body_of_which_the_mission_does_not_know_breaks_the_attributes(collided):
    data = replace(collided.recorded, attrs=collided.recorded.attrs | {"center": "MARS"}).seal()
    broken = replace(collided, recorded=data).report.broken
    assert "attributes" in {promise.name for promise in broken}
