"""Whatever is in a scenario, it is drawn, or refused in a sentence."""

import pickle
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sato
import sato.scenario.ranges
from problems.conic import Infeasible, Unsolved
from sato.reconfiguration import reach
from sato.reconfiguration.departure import depart_leg
from sato.scenario.errors import InputError
from sato.scenario.ranges import check_memory

FUZZ = runpy.run_path(str(Path(__file__).parents[1] / "scripts" / "fuzz_scenarios.py"))
BASES = FUZZ["base_scenarios"]()


@pytest.mark.parametrize("name", sorted(BASES))
def test_mutated_scenarios_are_drawn_or_refused(name):
    refused = 0
    for seed in range(6):
        changed, _ = FUZZ["mutate"](BASES[name], np.random.default_rng(seed))
        refused += bool(FUZZ["build"](changed))  # any other exception is raised
    assert 0 < refused <= 6


@pytest.mark.parametrize(
    ("name", "setting", "message"),
    [
        ("crossing", "max_control_m_s2=1e300", "model.max_control_m_s2: must be 0, or between"),
        ("crossing", "max_control_m_s2=1e-31", "between 1e-30 and 1e+30 in size, got 1e-31"),
        ("crossing", f"steps={10**400}", "leg.0.steps: must be at most 1e+09, got an integer of"),
        ("crossing", "comm_radius_km=1e300", "swarm.comm_radius_m: must be 0, or between"),
        (
            "crossing",
            "start.positions_m=[[0,0],[1e31,0]]",
            "start.positions_m: must be 0, or",
        ),
        ("orbit", "leg.shape.radius_m=1e9", "leg.0.shape: lies 1e+06 km from the chief"),
    ],
)
def test_numbers_out_of_range_are_refused_by_key(name, setting, message):
    with pytest.raises((sato.ScenarioError, sato.InputError)) as caught:
        sato.read(name, [setting]).draw(np.random.default_rng(0))
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "fields", "message"),
    [
        (sato.Loss, {"kind": "agents", "agents": np.array(True)}, "agents: must be a list"),
        (sato.FormationLeg, {"formation": "Square", "graph": np.array(3)}, "list of pairs"),
        (sato.Leg, {"shape": sato.Ring(spacing=1.0), "steps": np.array(3)}, "steps: must be an"),
    ],
)
def test_arrays_without_axes_are_refused_by_key(kind, fields, message):
    with pytest.raises(sato.InputError, match=message):
        kind(**fields)


def test_a_norm_that_is_a_table_of_numbers_is_refused():
    mission = sato.read("crossing")
    with pytest.raises(sato.InputError, match=r'model.fuel_norm: must be 1, 2 or "inf"'):
        replace(mission, fuel_norm=np.rec.array([(1, 2.0)]))


def test_toml_that_python_cannot_hold_is_refused():
    for text in ("a = " + "9" * 5000, "a = " + "[" * 10_000):
        with pytest.raises(sato.ScenarioError, match="scenario: is not TOML"):
            sato.parse(text)


def test_no_negative_zero_enters_a_mission(rng):
    mission = sato.read("connectivity", ["yaw_error_rad=-0.0"])
    assert not np.signbit(mission.yaw_error)
    mission.draw(rng)


@pytest.mark.parametrize("name", ["random", "formation", "connectivity"])
def test_swarms_beyond_the_memory_are_refused_with_the_number_that_fits(name, rng, monkeypatch):
    monkeypatch.setattr(sato.scenario.ranges, "machine_memory", lambda: 4e9)
    with pytest.raises(sato.InputError, match=r"GB; \d+ would do, or fewer steps") as caught:
        sato.read(name, ["agents=100000"]).draw(rng)
    fits = int(str(caught.value).split()[-6])
    assert 100 < fits < 100_000


def test_memory_is_refused_just_above_what_there_is(monkeypatch):
    monkeypatch.setattr(sato.scenario.ranges, "machine_memory", lambda: 1e9)
    check_memory(1000, lambda n: 1000.0 * n**2)
    with pytest.raises(sato.InputError, match=r"1001 take about 1 GB .* 1 GB; 1000 would do"):
        check_memory(1001, lambda n: 1000.0 * n**2)
    with pytest.raises(sato.InputError, match="fewer steps or targets, or a shorter"):
        check_memory(3, lambda n: 1e10 * n)


@pytest.mark.parametrize("power", [6, 24])
@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_a_limit_far_above_what_is_of_use_flies_as_well_as_none(power, unit):
    swapped = sato.Leg([[unit, unit], [0.0, unit]], 8)
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        start=[[0.0, 0.0], [unit, 0.0]],
        legs=[swapped],
        step=1.0,
        comm_radius=9 * unit,
        collision_radius=unit / 10,
        max_control=unit * 10.0**power,
        assignment="given",
        horizon_steps=8,
        allow_undetectable=True,
    )
    run = sato.run(mission)
    assert run.check().kept and not run.events("slack", "braked", "infeasible")
    assert run.summary["fuel_m_s"] < 1.5 * run.summary["fuel_lower_bound_m_s"]


def test_a_limit_that_a_model_needs_is_not_cut():
    # At rest 20 km from the chief, a vehicle falls toward it much faster than its way asks for.
    start, target = np.zeros((2, 6)), np.zeros((2, 6))
    start[:, 0] = target[:, 0] = 2e4
    start[:, 1], target[:, 1] = (0.0, 50.0), (100.0, 150.0)

    def draw(max_control):
        mission = sato.Reconfiguration(
            model=sato.ClohessyWiltshire(1.1e-3),
            start=start,
            legs=[sato.Leg(target, 10)],
            step=200.0,
            comm_radius=1e9,
            allow_undetectable=True,
            collision_radius=5.0,
            max_control=max_control,
        )
        return mission.draw(np.random.default_rng(0))

    assert draw(0.2).max_control == 0.2
    assert 1.0 < draw(1e9).max_control < 1e3


def test_a_search_for_the_time_does_not_follow_an_orbit_for_long():
    mission = sato.read("orbit", ["swarm.agents=2"]).draw(np.random.default_rng(0))
    asked, find_targets = list[int](), lambda steps: asked.append(steps) or mission.legs[0].targets
    departure = depart_leg(mission, 0)
    assert not reach._Search(departure, find_targets, 1.5).is_enough(10**6) and asked == []
    assert reach._Search(departure, find_targets, 1.5).is_enough(24) and asked


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"max_control_axes": 1.0}, r"max_control_axes_m_s2: must be a list .* \[1, 1\], got 1$"),
        ({"max_control": 1.0, "priority": 3}, r"swarm\.priority: must be a list of numbers such"),
    ],
)
def test_a_number_in_place_of_a_list_is_refused_in_our_words(changes, message):
    with pytest.raises(sato.InputError, match=message):
        sato.Reconfiguration(
            model=sato.DoubleIntegrator(2),
            start=[[0.0, 0.0]],
            legs=[sato.Leg([[1.0, 0.0]], 9)],
            step=1.0,
            comm_radius=9.0,
            collision_radius=1.0,
            **changes,
        )


@pytest.mark.parametrize(
    "error",
    [
        InputError("swarm.agents", "must be positive"),
        Unsolved("a program", "it stopped"),
        Infeasible("a program", "by a certificate", np.array([1.0, 2.0])),
    ],
)
def test_errors_survive_the_way_from_a_worker_process(error):
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (type(error), str(error))
    assert again.__dict__.keys() == error.__dict__.keys()
    assert all(np.array_equal(again.__dict__[name], error.__dict__[name]) for name in vars(error))


@pytest.mark.parametrize("norm", [1, 2, "inf"])
def test_refusal_asks_for_no_long_program_that_speed_limits_make_slow(norm, monkeypatch):
    solved = []

    def solve_none(transfer, start, target):
        solved.append(len(transfer.model))

    monkeypatch.setattr("sato.reconfiguration.pair_reach.solve_transfer", solve_none)
    orbit = sato.Orbit.from_elements(6878e3, inclination=0.8)
    start = np.array([[0.0, 0.0, 0.0], [0.0, 150.0, 0.0]])
    goal = start + np.array([0.0, 600e3, 0.0])
    mission = sato.Reconfiguration(
        model=sato.ClohessyWiltshire.from_orbit(orbit),
        start=start,
        legs=[sato.Leg(goal, 24)],
        step=60.0,
        comm_radius=3e3,
        collision_radius=50.0,
        max_control=1e-3,
        max_speed=2.0,
        control_norm=norm,
    )
    with pytest.raises(InputError, match=r"leg\.0\.steps: agent 0 can reach none of its targets"):
        mission.draw(np.random.default_rng(0))
    assert max(solved, default=0) < 250


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        (np.full((3, 3), np.nan), r"yaw_error_rad: must be finite, got nan at \[0, 0\]$"),
        ([0.1, 0.2, 0.3], r"yaw_error_rad: must be an array with 2 axes, got shape \(3,\)$"),
    ],
)
def test_a_list_where_a_number_would_do_too_is_refused_as_a_list(errors, message):
    with pytest.raises(sato.InputError, match=message):
        sato.Connectivity(agents=3, yaw_error=errors)
