"""Check of a reconfiguration: an unaltered run passes, and every alteration is found."""

import json
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from recorded_run import record_run
from typer.testing import CliRunner

import sato
from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from dynamics.plant import LinearPlant
from dynamics.propagation import Impact
from problems.assignment import solve_assignment
from problems.conic import Infeasible
from problems.transfer import TransferProblem
from sato.check.common import check_times
from sato.cli import app
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.check import ReconfigurationRecord, check_run
from sato.reconfiguration.check.consistency import check_assignment
from sato.reconfiguration.check.fuel import (
    compute_agent_bounds,
    compute_fuel_bound,
    compute_step_fuel,
)
from sato.reconfiguration.mission import Join, Leg, Loss, Reconfiguration
from sato.reconfiguration.state import ReconfigurationFrame
from sato.reconfiguration.system import SYSTEM
from sato.runs import Run
from sato.shapes import Points


def square(corner: tuple[float, float], spacing: float) -> np.ndarray:
    """Return nine targets at rest on a lattice."""
    grid = np.stack(np.meshgrid(np.arange(3), np.arange(3), indexing="ij"), -1)
    return np.hstack([grid.reshape(-1, 2) * spacing + np.array(corner), np.zeros((9, 2))])


def in_order(states: np.ndarray) -> Points:
    """Targets that keep their order."""
    return Points(*np.hsplit(states, 2), keep_order=True)


def mission(agents: int = 6, **changed: object) -> Reconfiguration:
    """Draw a row that becomes a square, loses one agent, gains one, and moves on."""
    x = np.arange(6) * 1.2
    start = np.stack([x, 0.1 * x], axis=1)
    join = Join(None, [[6.5, 5.0]], at_step=3)
    plain = Reconfiguration(
        model=DoubleIntegrator(2),
        start=start,
        legs=(
            Leg(in_order(square((1.0, 3.0), 1.0)), steps=12, count=9),
            Leg(
                in_order(square((4.0, 6.0), 1.1)),
                steps=10,
                count=9,
                losses=(Loss("agents", agents=(2,)),),
                joins=(join,),
            ),
        ),
        step=1.5,
        comm_radius=3.5,
        collision_radius=0.2,
        max_control=0.3,
        max_speed=1.0,
        horizon_steps=1,
        replan_steps=1,
        auction_steps=1,
        position_tolerance=1e-6,
        velocity_tolerance=1e-6,
    )
    drawn = plain.draw(np.random.default_rng(0))
    return replace(drawn, agents=agents, target_count=agents, **changed)


def fly_straight(mission: Reconfiguration) -> list[ReconfigurationFrame]:
    """Fly each leg by least-norm controls to the targets of least squared distance."""
    d = mission.linear_model.axes
    x, alive = mission.initial_states.copy(), mission.alive.copy()
    target = np.full(len(x), -1)
    believed = np.full(len(x), mission.target_count)
    frames, k, ending = [], 0, ()

    def labels():
        return CommunicationGraph.from_positions(x[:, :d], mission.comm_radius, alive).component

    def frame(control, events):
        return ReconfigurationFrame(
            time=k * mission.step,
            position=x[:, :d].copy(),
            velocity=x[:, d:].copy(),
            alive=alive.copy(),
            component=labels(),
            control=control,
            applied_control=control,
            leg_index=number,
            target_index=target.copy(),
            target_count=believed.copy(),
            measured_position=None,
            measured_velocity=None,
            events=tuple(events),
        )

    for number, leg in enumerate(mission.legs):
        steps = discretize_zoh(mission.linear_model, mission.step, leg.steps)
        events = list(ending)
        for loss in leg.losses:
            alive[list(loss.agents)] = False
            target[list(loss.agents)] = -1
            events.append({"kind": "loss", "agents": list(loss.agents)})
        events.append({"kind": "leg_start", "leg": number, "agents": np.flatnonzero(alive)})
        u = np.full((len(x), leg.steps, d), np.nan)
        joining = {0: np.flatnonzero(alive)}
        joining |= {step: np.array(who) for who, step in mission.joining(number)}
        for step in range(leg.steps):
            if step in joining:
                who = joining[step]
                if step:
                    alive[who] = True
                    events.append({"kind": "join", "agents": who})
                free = np.setdiff1d(np.arange(mission.target_count), target[alive] if step else [])
                apart = np.linalg.norm(x[who, None, :d] - leg.targets[free, :d], axis=2) ** 2
                target[who] = free[solve_assignment(apart)]
                events.append({"kind": "assignment", "agents": who, "target": target[who]})
                rest = steps[slice(step, None)]
                u[who, step:] = least_norm(rest, x[who], leg.targets[target[who]])
            events.append({"kind": "replan", "agents": np.flatnonzero(alive), "solves": 2})
            frames.append(frame(u[:, step].copy(), events))
            x[alive] = steps[slice(step, step + 1)].simulate(x[alive], u[alive, step : step + 1])[
                :, -1
            ]
            events, k = [], k + 1
        end = {"kind": "leg_end", "leg": number, "agents": np.flatnonzero(alive)}
        end |= {"target": target.copy(), "believed": believed.copy(), "component": labels()}
        ending = (end,)
    frames.append(frame(np.full((len(x), d), np.nan), ending))
    return frames


def least_norm(steps, start, goal):
    """Return the controls of least sum of squares from start to goal."""
    T, d = len(steps), steps.axes
    response = np.stack(
        [steps.simulate(0 * start[0], e)[-1] for e in np.eye(T * d).reshape(-1, T, d)], axis=1
    )
    free = steps.simulate(start, np.zeros((len(start), T, d)))[:, -1]
    return ((goal - free) @ np.linalg.pinv(response).T).reshape(len(start), T, d)


def recorded(mission: Reconfiguration, frames: list[ReconfigurationFrame] | None = None) -> Run:
    """Record a flight."""
    return record_run(SYSTEM, frames or fly_straight(mission), mission, mission)


@pytest.fixture(scope="module")
def flown():
    return recorded(mission())


def broken(run: Run, about: Reconfiguration | None = None) -> set[str]:
    return {p.name for p in check_run(run.data, about or mission()).broken}


def altered(run: Run) -> Run:
    return replace(run, data=run.data.copy(deep=True), summary=dict(run.summary))


def test_unaltered_run_keeps_all_promises(flown):
    report = check_run(flown.data, mission())
    assert report.kept, report.broken
    assert report.broken == ()
    json.dumps(report.as_dict(), allow_nan=False)


STATES = ["position", "velocity"]


@pytest.mark.parametrize("name", STATES)
@pytest.mark.parametrize("instant", [0, 1, 11, 12, 13, 21, 22])
def test_altered_state_breaks_the_propagation_promise(flown, name, instant):
    run = altered(flown)
    run.data[name][instant, 4, 1] += 1e-6
    assert "flight" in broken(run)


@pytest.mark.parametrize("name", STATES)
def test_altered_state_of_an_absent_agent_is_found(flown, name):
    run = altered(flown)
    run.data[name][18, 2, 0] += 1e-6
    assert "flight" in broken(run)
    run = altered(flown)
    run.data[name][5, 6, 0] += 1e-6
    assert "flight" in broken(run)


@pytest.mark.parametrize("instant", [0, 7, 12, 21])
def test_altered_control_is_found(flown, instant):
    for name, expected in [("applied_control", {"flight", "applied"}), ("control", {"applied"})]:
        run = altered(flown)
        run.data[name][instant, 1, 0] += 1e-6
        assert broken(run) >= expected
    run = altered(flown)
    for name in ("control", "applied_control"):
        run.data[name][instant, 1, 0] += 1e-6
    assert "flight" in broken(run)


@pytest.mark.parametrize("instant", range(23))
def test_altered_target_index_is_found_at_any_instant(flown, instant):
    for agent, value in [(0, 8), (3, -1), (2, 5)]:
        run = altered(flown)
        if int(run.data["target_index"][instant, agent]) == value:
            continue
        run.data["target_index"][instant, agent] = value
        assert not check_assignment(ReconfigurationRecord.from_dataset(run.data, mission())).kept


@pytest.mark.parametrize("instant", range(23))
def test_altered_time_is_found_at_any_instant(flown, instant):
    run = altered(flown)
    time = run.data["time"].values.copy()
    time[instant] += 1e-6
    run.data["time"] = ("time", time)
    assert not check_times(time, mission().step).kept


def test_times_that_do_not_increase_are_found(flown):
    run = altered(flown)
    time = run.data["time"].values.copy()
    time[5] = time[4]
    run.data["time"] = ("time", time)
    [promise] = [p for p in check_run(run.data, mission()).broken if p.name == "times"]
    assert promise.message == "time does not increase from instant 4 to 5"


@pytest.mark.parametrize(
    ("name", "where", "value", "promise"),
    [
        ("alive", (15, 3), False, "alive"),
        ("alive", (15, 2), True, "alive"),
        ("component", (6, 1), 9, "component"),
        ("component", (16, 2), 0, "component"),
        ("leg_index", (11,), 1, "legs"),
        ("leg_index", (22,), 0, "legs"),
        ("target_position", (0, 2, 1), 3.7, "targets"),
        ("target_velocity", (1, 8, 0), 1e-6, "targets"),
        ("targets_believed", (0, 3), 5, "believed"),
        ("position", (4, 4, 0), np.nan, "numbers"),
        ("control", (4, 4, 0), np.nan, "numbers"),
    ],
)
def test_alteration_breaks_the_promise_about_it(flown, name, where, value, promise):
    run = altered(flown)
    run.data[name][where] = value
    assert promise in broken(run)


def with_events(run: Run, change) -> Run:
    """Return the run with changed events."""
    events = [json.loads(str(e)) for e in run.data["event"].values]
    told = np.array([json.dumps(e) for e in change(events)], dtype=object)
    return replace(run, data=run.data.drop_vars("event").assign(event=("event", told)))


def test_assignment_without_its_event_is_found(flown):
    seen = with_events(flown, lambda events: [e for e in events if e["kind"] != "assignment"])
    assert "assignment" in broken(seen)


@pytest.mark.parametrize(
    ("key", "value"), [("target", [0] * 7), ("component", [0, 1, 2, 3, 4, 5, 6]), ("agents", [0])]
)
def test_leg_end_agrees_with_the_instants_before_it(flown, key, value):
    def change(events):
        return [e | {key: value} if e["kind"] == "leg_end" else e for e in events]

    assert "legs" in broken(with_events(flown, change))


def test_loss_without_its_event_is_found(flown):
    assert "alive" in broken(
        with_events(flown, lambda all: [e for e in all if e["kind"] != "loss"])
    )


def test_infeasible_program_breaks_a_promise(flown):
    event = {"time": 3.0, "kind": "infeasible", "agents": [1], "what": "avoidance"}
    assert broken(with_events(flown, lambda events: [*events, event])) == {"feasible"}


def test_interrupted_run_is_not_complete():
    frames = fly_straight(mission())[:15]
    report = check_run(recorded(mission(), frames).data, mission())
    assert {p.name for p in report.broken} == {"complete", "reached"}
    assert report.summary["reached"] is False
    assert [leg["reached"] for leg in report.summary["legs"]] == [True, False]
    assert "fuel_lower_bound_m_s" not in report.summary


def test_limits_are_those_of_the_mission(flown):
    assert broken(flown, mission(max_control=0.05)) >= {"control"}
    assert broken(flown, mission(max_speed=0.3)) >= {"speed"}
    assert "control" in broken(flown, mission(max_control=0.12, control_norm=1))
    assert broken(flown, mission(comm_radius=1.1, allow_undetectable=True)) >= {"component"}


def test_missed_target_is_a_leg_not_reached():
    about = mission()
    moved = about.legs[0].targets + np.array([0, 2e-6, 0, 0])
    elsewhere = replace(about, legs=(replace(about.legs[0], shape=in_order(moved)), about.legs[1]))
    run = recorded(about)
    run.data["target_position"][0] = moved[:, :2]
    assert broken(run, elsewhere) == {"reached"}
    summary = check_run(run.data, elsewhere).summary
    assert summary["legs"][0]["holes"] == 6 and summary["legs"][1]["holes"] == 0
    assert summary["legs"][0]["worst_position_error_m"] == pytest.approx(2e-6, rel=1e-6)


def test_summary_describes_each_leg(flown):
    said = check_run(flown.data, mission()).summary
    first, second = said["legs"]
    assert said["reached"] and said["agents"] == 7 and said["seed"] == 3
    assert (first["reached"], first["duplicates"], first["holes"]) == (True, 0, 0)
    assert (first["steps"], second["steps"]) == (12, 10)
    # Six of nine targets of a lattice are taken; the third row is one spacing away.
    assert first["gap"] == pytest.approx(1.0)
    assert first["components_at_start"] == 1 and first["components_at_end"] == 1
    assert said["solves"] == 2 * 22
    assert said["slack_used"] == said["braked"] == 0
    assert "undetectable" not in said


def test_holes_and_duplicates_are_counted(flown):
    def doubled(events):
        ends = [e for e in events if e["kind"] == "leg_end" and e["leg"] == 1]
        ends[0]["target"][0] = ends[0]["target"][1]
        return events

    assert (
        check_run(with_events(flown, doubled).data, mission()).summary["legs"][1]["duplicates"] == 1
    )

    def hopeful(events):
        for e in events:
            if e["kind"] == "leg_end":
                e["believed"] = [8] * 7
        return events

    said = check_run(with_events(flown, hopeful).data, mission()).summary
    assert said["legs"][0]["holes"] == 2


def test_fuel_is_the_norm_of_the_commanded_control_over_time(flown):
    u = np.nan_to_num(flown.data["control"].values)
    for norm, order in [(1, 1), (2, 2), ("inf", np.inf)]:
        said = check_run(flown.data, mission(fuel_norm=norm)).summary
        expected = 1.5 * np.linalg.norm(u, order, axis=2).sum()
        assert said["fuel_m_s"] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("speed", [1.0, 0.45])
def test_fuel_bound_is_the_optimal_assignment_of_problem_6(flown, speed):
    about = mission(max_speed=speed)
    report = check_run(flown.data, about)
    step, expected, own = about.step, 0.0, np.zeros(7)
    for leg, (first, last) in enumerate(pairwise([0, 12, 22])):
        alive = flown.data["alive"].values[last - 1]
        agents = np.flatnonzero(alive)
        cost = np.full((len(agents), 6), 1e3)
        for row, i in enumerate(agents):
            came = first + int(np.argmax(flown.data["alive"].values[first:, i]))
            start = np.hstack([flown.data[n].values[came, i] for n in STATES])
            transfer = TransferProblem(
                discretize_zoh(about.linear_model, step, last - came), 0.3, speed
            )
            for j in range(6):
                with suppress(Infeasible):
                    cost[row, j] = transfer.solve(start, about.legs[leg].targets[j]).fuel
        expected += cost[np.arange(len(agents)), solve_assignment(cost)].sum()
        held = flown.data["target_index"].values[last - 1, agents]
        own[agents] += cost[np.arange(len(agents)), held]
    assert report.summary["fuel_lower_bound_m_s"] == pytest.approx(expected, rel=1e-5)
    assert report.summary["fuel_m_s"] > expected
    there = np.arange(7) != 2  # lost after the first leg
    evidence = ReconfigurationRecord.from_dataset(flown.data, about)
    bound = compute_agent_bounds(
        evidence, [compute_fuel_bound(evidence, s) for s in evidence.leg_records]
    )
    np.testing.assert_allclose(bound[there], own[there], rtol=1e-5)
    assert (compute_step_fuel(evidence).sum(axis=0) >= bound * (1 - 1e-6))[there].all()


def test_fuel_bound_holds_in_other_norms(flown):
    one = check_run(flown.data, mission()).summary["fuel_lower_bound_m_s"]
    two = check_run(flown.data, mission(fuel_norm=2)).summary["fuel_lower_bound_m_s"]
    assert one / 2**0.5 <= two <= one


def crossing(gap: float) -> Reconfiguration:
    start = np.array([[-4.0, 0, 0, 0], [4.0, gap, 0, 0]])
    goals = np.array([[4.0, 0, 0, 0], [-4.0, gap, 0, 0]])
    return mission(
        agents=2,
        start=start,
        legs=(Leg(in_order(goals), 15),),
        comm_radius=9.0,
        max_speed=2.0,
    )


def test_collision_between_the_samples_is_found():
    for gap, expected in [(0.15, {"separation"}), (0.25, set())]:
        about = crossing(gap)
        frames = fly_crossed(about)
        report = check_run(recorded(about, frames).data, about)
        assert {p.name for p in report.broken} == expected
        assert report.summary["min_separation_m"] == pytest.approx(gap, rel=1e-9)
        assert report.summary["min_separation_at_samples_m"] > 0.3


def fly_crossed(about: Reconfiguration) -> list[ReconfigurationFrame]:
    frames = []
    steps = discretize_zoh(about.linear_model, about.step, 15)
    u = least_norm(steps, about.initial_states, about.legs[0].targets)
    x = steps.simulate(about.initial_states, u)
    u = np.concatenate([u, np.full((2, 1, 2), np.nan)], axis=1)
    everyone = {"agents": [0, 1], "target": [0, 1], "component": [0, 0], "believed": [2, 2]}
    for k in range(16):
        events = []
        if k == 0:
            events += [{"kind": "leg_start", "leg": 0, "agents": [0, 1]}]
            events += [{"kind": "assignment", "agents": [0, 1], "target": [0, 1]}]
        if k == 15:
            events += [{"kind": "leg_end", "leg": 0} | everyone]
        labels = np.zeros(2, dtype=int)
        frames.append(
            ReconfigurationFrame(
                k * about.step,
                x[:, k, :2],
                x[:, k, 2:],
                np.ones(2, bool),
                labels,
                u[:, k],
                u[:, k],
                0,
                np.arange(2),
                np.full(2, 2),
                None,
                None,
                tuple(events),
            )
        )
    return frames


def test_separation_in_orbit_has_a_bounded_error(rng):
    model = ClohessyWiltshire(1.1e-3)
    place = np.array([[0.0, 0, 0], [0, 300, 0], [100, 600, 50], [0, 900, 0]])
    start = np.hstack([place, model.bounded_velocity(place)])
    goal = place[[1, 0, 3, 2]] + [0, 40.0, 200.0]
    goals = np.hstack([goal, model.bounded_velocity(goal)])
    about = mission(
        4,
        model=model,
        plant=LinearPlant(model),
        start=start,
        legs=(Leg(in_order(goals), 20),),
        step=60.0,
        comm_radius=2e3,
        collision_radius=10.0,
        max_control=0.01,
        max_speed=4.0,
        position_tolerance=1e-3,
    )
    run = recorded(about)
    report = check_run(run.data, about)
    assert report.kept, report.broken
    [promise] = [p for p in report.promises if p.name == "separation"]
    assert "known to" in promise.message
    fine = np.linspace(0, 60, 61)
    x, u = (np.moveaxis(np.asarray(a), 0, 1) for a in (run.data["position"], run.data["control"]))
    v = np.moveaxis(np.asarray(run.data["velocity"]), 0, 1)
    least = np.inf
    for dt in fine[1:]:
        later = discretize_zoh(model, float(dt), 1)
        for k in range(20):
            there = later.simulate(np.hstack([x[:, k], v[:, k]]), u[:, k : k + 1])[:, -1, :3]
            apart = np.linalg.norm(there[:, None] - there[None], axis=2) + 1e9 * np.eye(4)
            least = min(least, apart.min())
    assert report.summary["min_separation_m"] <= least + 1e-9
    assert report.summary["min_separation_m"] == pytest.approx(least, rel=1e-3)


def test_applied_control_differs_by_the_disturbance_alone(rng):
    about = mission(disturbance=1e-3, position_tolerance=1.0, velocity_tolerance=1.0)
    run = recorded(about)
    assert broken(run, about) == set()
    run.data["applied_control"][3, 1, 1] += 0.1
    assert broken(run, about) >= {"applied", "flight"}


def test_summary_tells_where_proposition_9_does_not_hold(flown):
    assert (
        check_run(flown.data, mission(horizon_steps=2, allow_undetectable=True)).summary[
            "undetectable"
        ]
        is True
    )


TINY = """
system = "reconfiguration"
name = "tiny"
[swarm]
agents = 8
start = { kind = "random", box_m = 7.0, separation_m = 0.8 }
comm_radius_m = 4.0
collision_radius_m = 0.5
[model]
kind = "double_integrator"
dimension = 2
max_control_m_s2 = 0.1
max_speed_m_s = 0.3
[plan]
step_s = 1.0
horizon_steps = 4
replan_steps = 4
auction_steps = 4
[[leg]]
shape = { kind = "ring", spacing_m = 1.0 }
targets = 10
steps = 30
[[leg]]
shape = { kind = "lattice", spacing_m = 1.0 }
targets = 10
steps = 30
lose = { kind = "middle", share = 0.25 }
"""


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiny")
    return sato.run(sato.parse(TINY), seed=0).save(folder)


def verdict(folder) -> int:
    return CliRunner().invoke(app, ["check", str(folder), "--json"]).exit_code


def test_saved_run_passes_from_its_file_alone(saved):
    report = sato.load(saved).check()
    assert report.kept, report.broken
    said = CliRunner().invoke(app, ["check", str(saved), "--json"])
    assert said.exit_code == 0
    assert json.loads(said.stdout) == json.loads(json.dumps(report.as_dict()))
    assert json.loads((saved / "summary.json").read_text()).items() >= report.summary.items()


@pytest.mark.parametrize(
    ("name", "by"),
    [
        ("position", 1e-6),
        ("velocity", 1e-6),
        ("control", 1e-6),
        ("applied_control", 1e-6),
        ("target_index", 1),
        ("time", 1e-6),
        ("target_position", 1e-6),
    ],
)
def test_run_file_altered_in_one_place_fails(saved, tmp_path, rng, name, by):
    run = sato.load(saved)
    values = run.data[name].values.copy()
    known = np.argwhere(np.isfinite(values))
    where = tuple(rng.choice(known))
    values[where] += by
    run.data[name] = (run.data[name].dims, values, run.data[name].attrs)
    run.save(tmp_path)
    assert verdict(tmp_path) == 1, where


def test_truncated_file_is_refused(saved, tmp_path):
    whole = (saved / "run.nc").read_bytes()
    (tmp_path / "run.nc").write_bytes(whole[: len(whole) // 2])
    assert verdict(tmp_path) == 2


DISTURBED = [
    "disturbance.acceleration_m_s2=1e-4",
    "disturbance.position_m=1e-3",
    "disturbance.velocity_m_s=1e-4",
    "leg.1.lose={kind='random',share=0.25,at_step=3}",
]


@pytest.fixture(scope="module")
def disturbed():
    return sato.run(sato.parse(TINY, DISTURBED), seed=4)


def test_disturbed_run_is_reached_within_its_tolerances(disturbed):
    assert disturbed.check().kept, disturbed.check().broken


@pytest.mark.parametrize(
    ("name", "promise"),
    [
        ("measured_position", "measured"),
        ("measured_velocity", "measured"),
        ("control", "applied"),
        ("applied_control", "flight"),
        ("position", "flight"),
    ],
)
def test_disturbances_are_those_of_the_seed(disturbed, rng, name, promise):
    for _ in range(5):
        run = altered(disturbed)
        values = run.data[name].values
        values[tuple(rng.choice(np.argwhere(np.isfinite(values))))] += 1e-7
        assert promise in {p.name for p in run.check().broken}


@pytest.mark.parametrize("name", ["target_count", "control_instant", "event", "component"])
def test_digest_finds_any_alteration(disturbed, name):
    run = altered(disturbed)
    values = run.data[name].values.copy()
    values.flat[0] = "{}" if name == "event" else 1 - int(values.flat[0])
    run.data[name] = (run.data[name].dims, values)
    if name == "event":
        with pytest.raises(sato.RunFileError, match="was altered since it was written"):
            run.check()
    else:
        assert "unaltered" in {p.name for p in run.check().broken}


def test_altered_run_that_cannot_be_propagated_is_refused(disturbed, monkeypatch):
    def crash(*_: object) -> None:
        raise Impact(3, 60.0)

    crashing = replace(SYSTEM, check=crash)
    monkeypatch.setattr(sato.reconfiguration.system, "SYSTEM", crashing)
    with pytest.raises(Impact):
        disturbed.check()
    run = altered(disturbed)
    run.data["position"][2, 1, 0] -= 7e6
    with pytest.raises(sato.RunFileError, match=r"altered .* agent 3 hits the Earth"):
        run.check()


def test_attributes_are_those_of_the_mission(flown):
    run = altered(flown)
    run.data.attrs["comm_radius_m"] *= 1 + 1e-9
    assert broken(run) == {"attributes"}


def test_altered_summary_is_found(saved, tmp_path):
    run = sato.load(saved)
    for name, value in [("reached", False), ("fuel_m_s", 0.1), ("slack_used", 1), ("braked", "no")]:
        [promise] = replace(run, summary=run.summary | {name: value}).check().broken
        assert promise.name == "summary" and promise.message.endswith(name)
