"""Check of a reconfiguration: an unaltered run passes, and every alteration is found."""

import json
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from recorded_run import (
    altered,
    broken,
    check,
    fly_straight,
    in_order,
    make_crossing,
    make_mission,
    recorded,
    with_data,
)
from typer.testing import CliRunner

import sato
from dynamics import discretize_zoh
from dynamics.propagation import Impact
from problems.assignment import solve_assignment
from problems.conic import Infeasible
from problems.transfer import TransferProblem
from sato.check.common import EventLog, check_times
from sato.cli import app
from sato.reconfiguration.check.fuel import compute_agent_bounds, compute_step_fuel
from sato.reconfiguration.check.legs import check_assignment
from sato.reconfiguration.check.recorded import ReconfigurationRecord

STATES = ["position", "velocity"]


@pytest.fixture(scope="module")
def flown():
    return recorded(make_mission())


def test_unaltered_run_keeps_all_promises(flown):
    report = check(flown)
    assert report.kept, report.broken
    assert report.broken == ()
    json.dumps(report.as_dict(), allow_nan=False)


def test_losses_and_joins_at_the_first_step_keep_all_promises():
    lose, join = sato.Loss("random", share=0.25), sato.Join(None, [[4.5, 0.0]])
    row = np.c_[np.arange(4), np.zeros(4)]
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        start=row,
        legs=[sato.Leg(row + np.array([0.0, 2.0]), 12, losses=[lose], joins=[join])],
        step=1.0,
        comm_radius=9.0,
        collision_radius=0.3,
        max_control=0.2,
        max_speed=1.0,
    )
    run = sato.run(mission)
    assert run.data.alive[0].sum() == 4
    assert run.check().kept, run.check().broken


@pytest.mark.parametrize(
    ("names", "where", "change", "promises"),
    [
        *[(n, (k, 4, 1), 1e-6, {"flight"}) for n in STATES for k in (0, 1, 11, 12, 13, 21, 22)],
        *[(n, where, 1e-6, {"flight"}) for n in STATES for where in [(18, 2, 0), (5, 6, 0)]],
        *[("applied_control", (k, 1, 0), 1e-6, {"flight", "applied"}) for k in (0, 7, 12, 21)],
        *[("control", (k, 1, 0), 1e-6, {"applied"}) for k in (0, 7, 12, 21)],
        *[("control applied_control", (k, 1, 0), 1e-6, {"flight"}) for k in (0, 7, 12, 21)],
        ("target_position", (0, 2, 1), 0.7, {"targets"}),
        ("target_velocity", (1, 8, 0), 1e-6, {"targets"}),
    ],
)
def test_shift_of_a_number_breaks_the_promise_about_it(flown, names, where, change, promises):
    assert broken(altered(flown, names, where, by=change)) >= promises


@pytest.mark.parametrize(
    ("name", "where", "value", "promise"),
    [
        ("alive", (15, 3), False, "alive"),
        ("alive", (15, 2), True, "alive"),
        ("component", (6, 1), 9, "component"),
        ("component", (16, 2), 0, "component"),
        ("leg_index", (11,), 1, "legs"),
        ("leg_index", (22,), 0, "legs"),
        ("targets_believed", (0, 3), 5, "believed"),
        ("position", (4, 4, 0), np.nan, "numbers"),
        ("control", (4, 4, 0), np.nan, "numbers"),
    ],
)
def test_another_value_breaks_the_promise_about_it(flown, name, where, value, promise):
    assert promise in broken(altered(flown, name, where, value))


@pytest.mark.parametrize("instant", range(23))
def test_altered_time_or_target_index_is_found_at_any_instant(flown, instant):
    time = altered(flown, "time", instant, by=1e-6).data["time"].values
    assert not check_times(EventLog(time, ()), flown.mission.step).kept
    for agent, value in [(0, 8), (3, -1), (2, 5)]:
        if int(flown.data["target_index"][instant, agent]) != value:
            run = altered(flown, "target_index", (instant, agent), value)
            record = ReconfigurationRecord.from_data(run.recorded, run.mission)
            assert not check_assignment(record).kept


def test_times_that_do_not_increase_are_found(flown):
    run = altered(flown, "time", 5, flown.data["time"].values[4])
    [promise] = [p for p in check(run).broken if p.name == "times"]
    assert promise.message == "time does not increase from instant 4 to 5"


def with_events(run, change):
    """Return the run with changed events."""
    events = [json.loads(str(event)) for event in run.data["event"].values]
    texts = np.array([json.dumps(event) for event in change(events)], dtype=object)
    return with_data(run, run.data.drop_vars("event").assign(event=("event", texts)))


def without(kind):
    """Return a change that leaves out the events of a kind."""
    return lambda events: [event for event in events if event["kind"] != kind]


def at_leg_ends(**values):
    """Return a change of the events at the ends of legs."""
    return lambda events: [e | values if e["kind"] == "leg_end" else e for e in events]


@pytest.mark.parametrize(
    ("change", "promise"),
    [
        (without("assignment"), "assignment"),
        (without("loss"), "alive"),
        (at_leg_ends(target=[0] * 7), "legs"),
        (at_leg_ends(component=[0, 1, 2, 3, 4, 5, 6]), "legs"),
        (at_leg_ends(agents=[0]), "legs"),
    ],
)
def test_events_that_the_instants_contradict_are_found(flown, change, promise):
    assert promise in broken(with_events(flown, change))


def test_interrupted_run_is_not_complete():
    mission = make_mission()
    report = check(recorded(mission, fly_straight(mission)[:15]))
    assert {p.name for p in report.broken} == {"complete", "reached"}
    assert report.summary["reached"] is False
    assert [leg["reached"] for leg in report.summary["legs"]] == [True, False]
    assert "fuel_lower_bound_m_s" not in report.summary


def test_limits_are_those_of_the_mission(flown):
    assert "control" in broken(flown, make_mission(max_control=0.05))
    assert "speed" in broken(flown, make_mission(max_speed=0.3))
    assert "control" in broken(flown, make_mission(max_control=0.12, control_norm=1))
    near = make_mission(comm_radius=1.1, allow_undetectable=True)
    assert "component" in broken(flown, near)


def test_missed_target_is_a_leg_not_reached():
    about = make_mission()
    moved = about.legs[0].targets + np.array([0, 2e-6, 0, 0])
    elsewhere = replace(about, legs=(replace(about.legs[0], shape=in_order(moved)), about.legs[1]))
    run = altered(recorded(about), "target_position", 0, moved[:, :2])
    report = check(run, elsewhere)
    assert [p.name for p in report.broken] == ["reached"]
    first, second = report.summary["legs"]
    assert first["holes"] == 6 and second["holes"] == 0
    assert first["worst_position_error_m"] == pytest.approx(2e-6, rel=1e-6)


def test_summary_describes_each_leg(flown):
    said = check(flown).summary
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
    far = make_mission(horizon_steps=2, allow_undetectable=True)  # against Proposition 9
    assert check(flown, far).summary["undetectable"] is True


def test_holes_and_duplicates_are_counted(flown):
    change = at_leg_ends(believed=[8] * 7, target=[0, 0, 1, 2, 3, 4, 5])
    first, _ = check(with_events(flown, change)).summary["legs"]
    assert (first["holes"], first["duplicates"]) == (2, 1)


def test_fuel_is_the_norm_of_the_commanded_control_over_time(flown):
    u = np.nan_to_num(flown.data["control"].values)
    for norm, order in [(1, 1), (2, 2), ("inf", np.inf)]:
        said = check(flown, make_mission(fuel_norm=norm)).summary
        expected = 1.5 * np.linalg.norm(u, order, axis=2).sum()
        assert said["fuel_m_s"] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("speed", [1.0, 0.45])
def test_fuel_bound_is_the_optimal_assignment_of_problem_6(flown, speed):
    about, total, own = make_mission(max_speed=speed), 0.0, np.zeros(7)
    record = ReconfigurationRecord.from_data(flown.recorded, about)
    frames = record.frames
    for leg, (first, last) in enumerate(pairwise([0, 12, 22])):
        agents = np.flatnonzero(frames.alive[last - 1])
        cost = np.full((len(agents), 6), 1e3)
        for row, i in enumerate(agents):
            came = first + int(np.argmax(frames.alive[first:, i]))
            model = discretize_zoh(about.linear_model, about.step, last - came)
            transfer = TransferProblem(model, 0.3, speed)
            for j in range(6):
                with suppress(Infeasible):
                    goal = about.legs[leg].targets[j]
                    cost[row, j] = transfer.solve(record.state[came, i], goal).fuel
        total += cost[np.arange(len(agents)), solve_assignment(cost)].sum()
        own[agents] += cost[np.arange(len(agents)), frames.target_index[last - 1, agents]]
    summary = check(flown, about).summary
    assert summary["fuel_lower_bound_m_s"] == pytest.approx(total, rel=1e-5)
    assert summary["fuel_m_s"] > total
    stays = np.arange(7) != 2  # lost after the first leg
    bound = compute_agent_bounds(record)
    np.testing.assert_allclose(bound[stays], own[stays], rtol=1e-5)
    assert (compute_step_fuel(record).sum(axis=0) >= bound * (1 - 1e-6))[stays].all()


def test_fuel_bound_holds_in_other_norms(flown):
    one = check(flown).summary["fuel_lower_bound_m_s"]
    two = check(flown, make_mission(fuel_norm=2)).summary["fuel_lower_bound_m_s"]
    assert one / 2**0.5 <= two <= one


def test_collision_between_the_samples_is_found():
    for gap, expected in [(0.15, {"separation"}), (0.25, set())]:
        run = recorded(make_crossing(gap), own_targets=True)
        report = check(run)
        assert {p.name for p in report.broken} == expected
        assert report.summary["min_separation_m"] == pytest.approx(gap, rel=1e-9)
        assert report.summary["min_separation_at_samples_m"] > 0.3


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("random")
    return sato.run("random", overrides=["agents=8"]).save(folder)


def verdict(folder) -> int:
    return CliRunner().invoke(app, ["check", str(folder), "--json"]).exit_code


def test_saved_run_passes_from_its_file_alone(saved):
    report = sato.load(saved).check()
    assert report.kept, report.broken
    said = CliRunner().invoke(app, ["check", str(saved), "--json"])
    assert said.exit_code == 0
    assert json.loads(said.stdout) == json.loads(json.dumps(report.as_dict()))
    messages = {promise.name: promise.message for promise in report.promises}
    assert messages["scenario"] == "random with swarm.agents = 8"
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
    where = tuple(rng.choice(np.argwhere(np.isfinite(run.data[name].values))))
    run = altered(run, name, where, by=by)
    run.save(tmp_path)
    assert verdict(tmp_path) == 1, where


def test_truncated_file_is_refused(saved, tmp_path):
    whole = (saved / "run.nc").read_bytes()
    (tmp_path / "run.nc").write_bytes(whole[: len(whole) // 2])
    assert verdict(tmp_path) == 2


DISTURBED = [
    "agents=8",
    "disturbance.acceleration_m_s2=1e-4",
    "disturbance.position_m=1e-3",
    "disturbance.velocity_m_s=1e-4",
    "leg.0.lose={kind='random',share=0.25,at_step=3}",
]


@pytest.fixture(scope="module")
def disturbed():
    return sato.run("random", seed=4, overrides=DISTURBED)


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
    places = np.argwhere(np.isfinite(disturbed.data[name].values))
    for where in rng.choice(places, 5):
        run = altered(disturbed, name, tuple(where), by=1e-7)
        assert promise in {p.name for p in run.check().broken}


@pytest.mark.parametrize("name", ["target_count", "control_instant", "event", "component"])
def test_digest_finds_any_alteration(disturbed, name):
    first = disturbed.data[name].values.flat[0]
    value = "{}" if name == "event" else 1 - int(first)
    run = altered(disturbed, name, (0,) * disturbed.data[name].ndim, value)
    found = {p.name for p in run.check().broken}
    assert "unaltered" in found and ("record" in found) == (name != "component")


def test_altered_run_that_cannot_be_propagated_is_refused(disturbed, monkeypatch):
    def crash(*_: object) -> None:
        raise Impact(3, 60.0)

    crashing = replace(sato.reconfiguration.system.SYSTEM, check=crash)
    monkeypatch.setattr(sato.reconfiguration.system, "SYSTEM", crashing)
    with pytest.raises(Impact):
        disturbed.check()
    run = altered(disturbed, "position", (2, 1, 0), by=-7e6)
    with pytest.raises(sato.RunFileError, match=r"altered .* agent 3 hits the Earth"):
        run.check()


def test_attributes_are_those_of_the_mission(flown):
    limits = flown.data.assign_attrs(comm_radius_m=flown.data.attrs["comm_radius_m"] * (1 + 1e-9))
    assert broken(with_data(flown, limits)) == {"attributes"}


def test_altered_summary_is_found(saved, tmp_path):
    run = sato.load(saved)
    for name, value in [("reached", False), ("fuel_m_s", 0.1), ("slack_used", 1), ("braked", "no")]:
        [promise] = replace(run, claimed=run.summary | {name: value}).check().broken
        assert promise.name == "summary" and promise.message.endswith(name)
    run.save(tmp_path)
    (tmp_path / "summary.json").write_text("{}")
    said = CliRunner().invoke(app, ["check", str(tmp_path)])
    assert said.exit_code == 1 and "fuel_m_s" in said.stdout
