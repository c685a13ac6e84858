"""Forged runs: whoever changes a run, and seals it anew, is found out by the check."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray
from recorded_run import make_crossing, recorded

import sato
from sato.record import initial_summary
from sato.run_data import RunData
from sato.runs import Run
from sato.scenario.origin import Origin

LEG = 'shape={kind="lattice", spacing_m=2.5}, steps='
LOST = 'lose=[{kind="random", share=0.3, at_step=4}]'
JOINS = 'join=[{agents=1, start={kind="points", positions_m=[[7, 7]]}, at_step=6}]'
SETTINGS = ["agents=4", "reset=need", f"leg=[{{{LEG}30, {LOST}, {JOINS}}}, {{{LEG}14}}]"]


@pytest.fixture(scope="module")
def honest():
    """Return a run of two legs, in the first of which one agent is lost and one joins."""
    run = sato.run("random", seed=1, overrides=SETTINGS)
    assert run.check().kept, run.check()
    assert [event["kind"] for event in run.events("loss", "join")] == ["loss", "join"]
    return run


@pytest.fixture(scope="module")
def collided():
    """Return a run of two agents that collide, of which the planner knows."""
    run = recorded(make_crossing(0.15), own_targets=True)
    run = forged(run, events=[*run.events(), relaxation("slack"), relaxation("infeasible")])
    assert broken(run) == {"separation"}
    return run


def relaxation(kind):
    return {"time": 3.0, "kind": kind, "agents": [0]}


def forged(run, events=None, attrs=None, data=None, **variables):
    """Return the run with other events, attributes and variables, sealed, without a summary."""
    data = (run.data if data is None else data).copy(deep=True)
    for name, values in variables.items():
        data[name] = (data[name].dims, values, data[name].attrs)
    if events is not None:
        ordered = sorted(events, key=lambda event: event["time"])
        texts = np.array([json.dumps(event) for event in ordered], dtype=object)
        data = data.drop_vars("event").assign(event=("event", texts, run.data["event"].attrs))
    data.attrs |= attrs or {}
    mission = sato.parse(data.attrs["scenario"]) if "scenario" in (attrs or {}) else run.mission
    return Run(RunData.from_xarray(data).seal(), initial_summary(data.attrs), mission)


def broken(run):
    return {promise.name for promise in run.check().broken}


def values(run, name):
    return run.data[name].values.copy()


def changed(name, where, by):
    """Return a forgery of a variable, or of several, at one place."""

    def forge(run):
        found = {each: values(run, each) for each in name.split()}
        for each in found.values():
            each[where] = ~each[where] if by is None else each[where] + by
        return forged(run, **found)

    return forge


def events(change):
    """Return a forgery that puts a list of events in the place of each."""
    return lambda run: forged(run, [new for event in run.events() for new in change(event)])


def without(kind):
    return events(lambda event: [] if event["kind"] == kind else [event])


def moved(kind, by):
    return events(lambda event: [event | {"time": event["time"] + by * (event["kind"] == kind)}])


def inserted(**event):
    return lambda run: forged(run, [*run.events(), event])


def swapped(first):
    """Return a forgery that exchanges two agents from an instant on."""

    def forge(run):
        names = "position velocity control applied_control alive component target_index".split()
        found = {name: values(run, name) for name in names}
        for each in found.values():
            each[first:, [0, 1]] = each[first:, [1, 0]]
        return forged(run, **found)

    return forge


def mirrored(run):
    names = "position velocity control applied_control target_position target_velocity".split()
    return forged(run, **{name: values(run, name) * [1, -1] for name in names})


def lost_before_the_collision(run):
    """Let an agent be lost at the instant before it collides, and stay there."""
    first, alive = 7, values(run, "alive")
    alive[first:, 1] = False
    found = {name: values(run, name) for name in ("position", "velocity")}
    for each in found.values():
        each[first:, 1] = each[first, 1]
    for name in ("control", "applied_control"):
        found[name] = values(run, name)
        found[name][first:, 1] = np.nan
    component, target = values(run, "component"), values(run, "target_index")
    component[first:, 1] = target[first:, 1] = -1
    component[first:, 0] = 0
    end = {"agents": [0], "component": [0, -1], "target": [0, -1]}
    told = [e | end if e["kind"] == "leg_end" else e for e in run.events()]
    told.append({"time": float(run.data["time"][first]), "kind": "loss", "agents": [1]})
    found |= {"component": component, "target_index": target, "alive": alive}
    believed = values(run, "targets_believed")
    believed[:, 1] = -1
    return forged(run, told, targets_believed=believed, **found)


def another_is_lost(run):
    [loss] = run.events("loss")
    [lost] = loss["agents"]
    other = next(i for i in range(4) if i != lost)

    def change(event):
        return [event | {"agents": [other]} if event["kind"] == "loss" else event]

    alive = values(run, "alive")
    alive[:, [lost, other]] = alive[:, [other, lost]]
    return forged(events(change)(run), alive=alive)


def cut(count, with_end=False):
    """Return a forgery of the first instants alone, with an end of the leg or without."""

    def forge(run):
        data = run.data.isel(time=slice(count)).copy(deep=True)
        time = float(data["time"][-1])
        told = [event for event in run.events() if event["time"] <= time]
        if with_end:
            told.append(run.events("leg_end")[-1] | {"time": time})
        for name in ("control", "applied_control"):
            data[name][-1] = np.nan
        return forged(run, told, data=data)

    return forge


def longer(run):
    """Let all agents stay at their targets for another step."""
    data, step = run.data, float(run.data["time"][1])
    data = xarray.concat([data, data.isel(time=[-1])], "time", data_vars="minimal")
    data["time"] = ("time", step * np.arange(len(data["time"])), run.data["time"].attrs)
    data["position"][-1] = data["position"][-2] + step * data["velocity"][-2]
    for name in ("control", "applied_control"):
        data[name][-2] = data["position"][-2] * 0
        data[name][-2] = np.where(data["alive"].values[-2][:, None], 0.0, np.nan)
    last = float(run.data["time"][-1])
    told = [e | {"time": e["time"] + step * (e["time"] == last)} for e in run.events()]
    return forged(run, told, data=data)


def doubled(k):
    """Return a forgery in which an instant stands twice."""

    def forge(run):
        order = np.sort(np.append(np.arange(len(run.data["time"]) - 1), k))
        data = run.data.isel(time=order).copy(deep=True)
        data["time"] = run.data["time"]
        return forged(run, data=data)

    return forge


def attribute(**attrs):
    return lambda run: forged(run, attrs=attrs)


def other_scenario(*settings, **attrs):
    """Return a forgery with the scenario that other overrides give, and its limits."""

    def forge(run):
        text = sato.read("random", [*SETTINGS, *settings]).to_toml()
        return forged(run, attrs={"scenario": text, **attrs})

    return forge


def without_origin(run):
    data = run.data.copy()
    del data.attrs["origin"]
    return forged(run, data=data)


def summarized(**entries):
    return lambda run: replace(run, claimed=run.summary | entries)


SMALL = {"collision_radius_m": 0.4}
ORIGIN = Origin("built-in", "random", ("swarm.agents = 4",)).to_json()
FORGERIES = {
    "a position": (changed("position", (9, 1, 0), 1e-6), "flight"),
    "all positions": (changed("position", slice(None), 0.01), "start"),
    "a velocity": (changed("velocity", (9, 1, 0), 1e-6), "flight"),
    "a command": (changed("control", (9, 1, 0), 1e-6), "applied"),
    "a control": (changed("control applied_control", (9, 1, 0), 1e-6), "flight"),
    "agents exchanged": (swapped(0), "start"),
    "agents exchanged on the way": (swapped(9), "flight"),
    "all mirrored": (mirrored, "start"),
    "a time": (changed("time", 9, 0.1), "times"),
    "times stretched": (lambda run: forged(run, time=1.1 * values(run, "time")), "times"),
    "the time of an event": (moved("assignment", 0.2), "times"),
    "an agent alive or not": (changed("alive", (9, 1), None), "alive"),
    "a loss left out": (without("loss"), "alive"),
    "a loss of another": (another_is_lost, "alive"),
    "a loss a step later": (moved("loss", 1.0), "alive"),
    "a loss twice": (events(lambda e: [e, e] if e["kind"] == "loss" else [e]), "alive"),
    "a join left out": (without("join"), "alive"),
    "a join a step earlier": (moved("join", -1.0), "alive"),
    "a join of one that is there": (inserted(time=3.0, kind="join", agents=[0]), "alive"),
    "an assignment left out": (without("assignment"), "assignment"),
    "a target held": (changed("target_index", (9, 1), 1), "assignment"),
    "targets": (changed("target_position", (0, 0), 1e-6), "targets"),
    "a target count": (changed("target_count", (27, 1), 1), "believed"),
    "a final target count": (changed("targets_believed", (0, 1), 1), "believed"),
    "a component": (changed("component", (9, 1), 1), "component"),
    "a leg": (changed("leg_index", 9, 1), "legs"),
    "the start of a leg left out": (without("leg_start"), "legs"),
    "the end of a leg earlier": (moved("leg_end", -1.0), "legs"),
    "an end of a leg twice": (events(lambda e: [e, e] if e["kind"] == "leg_end" else [e]), "legs"),
    "the end cut off": (cut(-5), "complete"),
    "an end before the deadline": (cut(-5, with_end=True), "legs"),
    "a step more at the targets": (longer, "legs"),
    "an instant twice": (doubled(9), "flight"),
    "the radius": (attribute(**SMALL), "attributes"),
    "the radius in the scenario": (other_scenario("collision_radius_m=0.4", **SMALL), "scenario"),
    "the overrides": (attribute(origin=ORIGIN), "scenario"),
    "the name of the scenario": (attribute(name="uiuc"), "scenario"),
    "no origin": (without_origin, "scenario"),
    "the seed": (attribute(seed=2), "start"),
    "an empty summary": (lambda run: replace(run, claimed={}), "summary"),
    "a number of the summary": (summarized(fuel_m_s=0.1), "summary"),
    "the broken promises": (summarized(broken=["fuel"]), "summary"),
    "one more entry": (summarized(prize="first"), "summary"),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_forgery_breaks_the_promise_about_it(honest, name):
    forge, promise = FORGERIES[name]
    assert promise in broken(forge(honest))


@pytest.mark.parametrize(
    "forge",
    [without("slack"), without("infeasible"), inserted(**relaxation("braked"))],
    ids=["slack left out", "refusal left out", "braking inserted"],
)
def test_relaxations_that_are_told_or_not_excuse_no_collision(collided, forge):
    assert broken(forge(collided)) == {"separation"}


def test_loss_that_was_not_asked_for_excuses_no_collision(collided):
    assert broken(lost_before_the_collision(collided)) == {"alive"}


def test_cut_run_that_is_called_complete_is_found(honest):
    run = forged(cut(-5)(honest), attrs={"complete": 0, "stopped": "interrupted"})
    assert "complete" in broken(run)
    assert "complete" in broken(forged(run, attrs={"complete": 1}))


def test_run_with_an_agent_less_is_broken(honest):
    run = forged(honest, data=honest.data.isel(agent=slice(1, None)))
    assert run.check().line == "BROKEN: record, the file has 4 agents, and its scenario 5"


def renamed(name, value):
    """Return a forgery of an entry of all events that have it."""
    return events(lambda event: [event | {name: value} if name in event else event])


DAMAGES = {
    "leg of event 0, a leg_start, is 7": renamed("leg", 7),
    "leg of event 0, a leg_start, is missing": events(
        lambda event: [{key: value for key, value in event.items() if key != "leg"}]
    ),
    "agents of event 0, a leg_start, is [9]": renamed("agents", [9]),
    "agents of event 0, a leg_start, is ": renamed("agents", 10**400),
    "time of event 0, a leg_start, is None": lambda run: forged(
        run,
        data=run.data.assign(event=("event", [json.dumps({"kind": "leg_start"} | {"time": None})])),
    ),
    "event 0 is no table with a kind": lambda run: forged(
        run, data=run.data.assign(event=("event", ["{}"]))
    ),
    "event 0 is of kind 'landed', which": renamed("kind", "landed"),
    "leg_index is 5 at time 9, which": changed("leg_index", 9, 5),
    "target_index is 100 at time 9, agent 1, which": changed("target_index", (9, 1), 99),
    "position is 1e+300 at time 9, agent 1, axis 0, which": changed("position", (9, 1, 0), 1e300),
    "control_instant is 0 at time 9, which": changed("control_instant", 9, None),
    "the file has no instants": lambda run: forged(run, data=run.data.isel(time=slice(0))),
    "the file has 1 axes, and its scenario 2": lambda run: forged(
        run, data=run.data.isel(axis=slice(1))
    ),
    "the file has 1 legs, and its scenario 2": lambda run: forged(
        run, data=run.data.isel(leg=slice(1))
    ),
    "alive is along agent and time, not time and agent": lambda run: forged(
        run, data=run.data.assign(alive=run.data["alive"].T)
    ),
}


@pytest.mark.parametrize("fault", DAMAGES)
def test_values_that_no_check_could_read_are_named(honest, fault):
    run = DAMAGES[fault](honest)
    report = run.check()
    assert report.line.startswith(f"BROKEN: record, {fault}"), report.line
    assert run.report.line == report.line and not run.summary["success"]


@pytest.mark.parametrize("complete", [2, -1, np.nan, "yes"])
def test_a_flight_is_complete_or_not(honest, complete):
    assert (
        forged(honest, attrs={"complete": complete})
        .check()
        .line.startswith(f"BROKEN: complete, the attribute complete is {complete}, neither 0 nor 1")
    )


@pytest.mark.parametrize(
    ("origin", "line"),
    [
        (Origin("file", "mine.toml"), "the file mine.toml"),
        (Origin("python"), "a mission from Python"),
        (Origin("built-in", "random", (*SETTINGS, "swarm.collision_radius_m = 0.4")), "_m = 0.4"),
    ],
)
def test_consistent_flight_of_another_scenario_is_named_and_kept(honest, origin, line):
    forge = other_scenario("collision_radius_m=0.4", origin=origin.to_json(), **SMALL)
    report = forge(honest).check()
    assert report.kept, report
    [scenario] = [promise for promise in report.promises if promise.name == "scenario"]
    assert scenario.message.endswith(line)


def test_origin_is_recorded_and_told(honest, tmp_path):
    [scenario] = [each for each in honest.check().promises if each.name == "scenario"]
    assert scenario.message.startswith("random with swarm.agents = 4, plan.reset = need, leg = [{")
    (tmp_path / "mine.toml").write_text(sato.read("conflict").to_toml())
    mine, settings = tmp_path / "mine.toml", ["max_speed_m_s=0.6"]
    assert str(Origin.of(mine, settings)) == "the file mine.toml with model.max_speed_m_s = 0.6"
    assert str(Origin.of("uiuc", ["leg.0.steps=90"])) == "uiuc with leg.0.steps = 90"
    assert str(Origin.of(sato.read("uiuc"), ())) == "a mission from Python"
    assert Origin.from_json(Origin.of(mine, settings).to_json()) == Origin.of(mine, settings)
