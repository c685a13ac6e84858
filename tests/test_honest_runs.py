"""Honest runs are not accused: built-in scenarios, and missions at the edge."""

import numpy as np
import pytest
import reconfiguration_runs
from reconfiguration_runs import row
from recorded_run import in_order, make_mission, recorded
from test_forgeries import broken as broken_promises
from test_forgeries import forged

import sato
from sato.reconfiguration import leg as legs
from sato.reconfiguration.leg import Leg

SMALL = {
    "conflict": [],
    "crossing": [],
    "random": ["agents=6", "acceleration_m_s2=1e-4", "position_m=1e-3"],
    "random3d": ["agents=5"],
    "random_cw": ["agents=4"],
    "formation6": ["limit_s=3"],
    "connectivity": ["duration_s=1", "start_s=0", "death=[{robot=2, time_s=0.5}]"],
}


@pytest.mark.parametrize("name", SMALL)
def test_honest_run_of_a_built_in_scenario_is_not_accused(name):
    run = sato.run(name, seed=1, overrides=SMALL[name])
    assert run.verdict == "kept" or (name == "formation6" and run.verdict == "not reached"), run


def test_drift_of_control_steps_between_instants_is_not_accused():
    run = sato.run("formation6", seed=2, overrides=["control.step_s=0.01", "limit_s=8"])
    assert run.verdict == "not reached", run


def pair(*legs):
    """Two agents a meter apart, as a definition."""
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        start=row(2, 0.0),
        legs=legs,
        step=1.0,
        comm_radius=9.0,
        collision_radius=0.3,
        max_control=0.2,
        max_speed=1.0,
    )


@pytest.mark.parametrize("objective", ["fuel", "energy"])
def test_agents_that_are_at_their_targets_may_burn_nothing(objective):
    there = np.array([[1.1, 0.3, 0, 0], [4.7, 0.9, 0, 0]])
    legs = (Leg(in_order(there * (1 + 2.2e-16)), 15),)  # but for rounding
    mission = make_mission(2, start=there, legs=legs, comm_radius=9.0, objective=objective)
    run = recorded(mission, own_targets=True, controls=np.zeros((2, 15, 2)))
    assert run.check().kept, run.check()
    assert run.check().summary["fuel_m_s"] == 0
    assert run.check().summary["fuel_lower_bound_m_s"] == pytest.approx(0, abs=1e-12)


def test_nobody_left_is_not_reached():
    everybody = sato.Loss("agents", agents=(0, 1), at_step=2)
    run = sato.run(pair(Leg(row(2, 1.0), 6, losses=[everybody])))
    assert run.summary["reached"] is run.summary["success"] is False
    assert run.summary["legs"][0]["reached"] is False
    assert {promise.name for promise in run.check().broken} == {"reached"}


def test_flight_at_whose_end_a_vehicle_waits_in_vain_is_not_reached():
    stay = Leg(row(3, 0.0), 6, joins=[sato.Join(None, row(1, 0.1), at_step=4)])
    run = sato.run(pair(stay))
    (refused,) = run.events("refused")
    assert len(run.events("join")) == 0
    assert refused["time"] == run.events("leg_end")[0]["time"]
    assert not run.summary["reached"]
    assert {promise.name for promise in run.check().broken} == {"reached"}


def test_join_waits_until_there_is_room():
    away = Leg(row(3, 4.0), 30, joins=[sato.Join(None, row(2, 0.2)[:1], at_step=1)])
    run = sato.run(pair(away))
    (join,) = run.events("join")
    assert join["time"] > 1.0 and run.check().kept


def test_leg_that_is_given_up_contradicts_nothing(monkeypatch):
    monkeypatch.setattr(legs, "MAX_LEG_FACTOR", 5)
    places = 0.501 * np.stack(np.meshgrid(range(3), range(3)), axis=-1).reshape(-1, 2)
    swapped = np.vstack([places[[1, 0]], places[2:]])
    leg = sato.Leg(sato.Points(swapped, keep_order=True), 6)
    run = sato.run(reconfiguration_runs.make_mission(places, leg, assignment="given"))
    assert run.summary["legs"][0]["steps"] == 30 and not run.summary["reached"]
    assert broken_promises(run) == {"reached"}
    untold = [event for event in run.events() if event["kind"] != "infeasible"]
    assert "legs" in broken_promises(forged(run, untold))


def test_a_run_holds_what_the_files_of_its_mission_held(tmp_path):
    file = tmp_path / "targets.csv"
    file.write_text("x,y\n0,5\n3,5\n")
    leg = sato.Leg(sato.Points(file=str(file)), 40)
    run = sato.run(reconfiguration_runs.make_mission(row(2, 0.0), leg))
    file.write_text("x,y\n0,6\n3,6\n")
    assert run.check().kept
    assert run.drawn_mission.legs[0].targets[:, 1].max() == 5.0
    file.unlink()
    run.save(tmp_path / "run")
    assert sato.load(tmp_path / "run").mission == run.mission
