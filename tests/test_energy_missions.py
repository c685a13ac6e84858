"""Missions that plan for least energy, and by a solver of the user's choice."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from random_programs import infeasible_program, random_program
from reconfiguration_runs import at_rest, fly, leg_to, make_mission, row
from recorded_run import recorded

import sato
from dynamics import discretize_zoh
from problems import solvers
from problems.assignment import solve_assignment
from problems.auction_cost import compute_energies
from problems.conic import Infeasible, SolverResult, solve
from problems.solvers import SolverAdapter, load_adapters, solve_clarabel, verified
from problems.solvers.adapter import SDP
from problems.solvers.verified import VerifiedSolver
from sato.reconfiguration import feasibility
from sato.reconfiguration.bidding_rules import compute_epsilon
from sato.reconfiguration.check.fuel import compute_step_energy
from sato.reconfiguration.check.promises import check_fuel
from sato.reconfiguration.check.recorded import ReconfigurationRecord


def crossing_rows(count=4, **changes):
    """Rows whose agents swap sides, as a mission that is not drawn."""
    arguments = {"max_control": 0.3, "max_speed": np.inf, "allow_undetectable": True}
    leg = leg_to(at_rest(row(count, 3.0)[::-1]), 12)
    return make_mission(row(count, -3.0), leg, comm_radius=20.0, **arguments | changes)


class Careless:
    """Says that it has solved every program, at the origin."""

    def __init__(self, problem, tolerance):
        self.problem = problem

    def solve(self, b):
        return SolverResult("solved", "done", np.zeros(len(self.problem.q)), np.zeros(len(b)))


@pytest.fixture
def careless(monkeypatch):
    known = load_adapters() | {"careless": SolverAdapter("careless", SDP, True, Careless, "math")}
    for module in (solvers, verified, feasibility):
        monkeypatch.setattr(module, "load_adapters", lambda: known)


def energy_of(mission, frames):
    return mission.step * float(np.nansum([frame.control**2 for frame in frames]))


def test_targets_of_least_energy_are_within_n_epsilon(rng):
    for _ in range(5):
        start, goal = rng.permutation(row(6, -3.0)), row(6, 3.0) + rng.normal(0, 0.1, (6, 2))
        limits = {"max_control": 1.0, "max_speed": np.inf, "allow_undetectable": True}
        leg = leg_to(at_rest(goal), 12)
        mission = make_mission(start, leg, comm_radius=40.0, objective="energy", **limits)
        held = fly(mission)[0].target_index
        leg, model = mission.legs[0], discretize_zoh(mission.linear_model, 1.0, 12)
        cost = 12**3 / 12 * compute_energies(model, mission.initial_states, leg.targets)
        best = cost[np.arange(6), solve_assignment(cost)].sum()
        epsilon = compute_epsilon(mission, leg)
        assert cost[np.arange(6), held].sum() <= best + 6 * epsilon
        assert epsilon == pytest.approx(0.5 * mission.target_spacing**2)


def test_energy_missions_arrive_for_less_energy_than_those_of_fuel():
    spent = {}
    for objective in ("fuel", "energy"):
        mission = crossing_rows(objective=objective)
        frames = fly(mission)
        spent[objective] = energy_of(mission, frames)
        reached = mission.legs[0].targets[frames[-1].target_index, :2]
        assert_allclose(frames[-1].position, reached, atol=1e-5)
    assert spent["energy"] < 0.9 * spent["fuel"]


def test_the_summary_tells_energy_and_its_lower_bound():
    run = sato.run("random", overrides=["agents=8", "plan.objective=energy"])
    summary, u = run.summary, np.nan_to_num(run.data.control.values)
    assert run.check().kept and summary["reached"]
    assert summary["energy_m2_s3"] == pytest.approx(run.mission.step * (u**2).sum())
    least = summary["energy_lower_bound_m2_s3"]
    assert 0.5 * summary["energy_m2_s3"] < least <= summary["energy_m2_s3"] * (1 + 1e-9)
    assert "solver_fallbacks" not in summary
    for name in ("energy_m2_s3", "energy_lower_bound_m2_s3"):
        forged = replace(run, claimed=summary | {name: summary[name] * 1.001})
        [promise] = forged.check().broken
        assert promise.name == "summary" and name in promise.message


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_no_leg_takes_less_energy_than_its_lower_bound(noise):
    mission = crossing_rows(objective="energy", disturbance=noise)
    run = recorded(mission, fly(mission))
    record, forged = (ReconfigurationRecord.from_data(run.recorded, mission) for _ in range(2))
    energy, [bound] = float(compute_step_energy(record).sum()), record.energy_bounds
    assert check_fuel(record).kept
    assert (bound.bound <= energy * (1 + 1e-9)) == (noise == 0)  # which helps on the way
    vars(forged)["energy_bounds"] = [bound._replace(bound=energy * (1 + 1e-5))]
    assert check_fuel(forged).kept == (noise > 0)  # for then it is computed without limits


def test_another_solver_flies_the_same_mission_within_its_tolerance():
    overrides = ["plan.objective=energy"]
    default = sato.run("crossing", overrides=overrides).summary
    for name in ("scs", "qoco"):
        found = sato.run("crossing", overrides=[*overrides, f"plan.solver={name}"]).summary
        assert found["reached"] and found["solver_fallbacks"] <= 1
        assert found["energy_m2_s3"] == pytest.approx(default["energy_m2_s3"], rel=1e-4)


def test_rejected_answers_are_those_of_the_default_solver_and_counted(careless):
    default = sato.run("crossing")
    run = sato.run("crossing", overrides=["plan.solver=careless"])
    assert run.summary["solver_fallbacks"] >= run.summary["solves"]
    np.testing.assert_allclose(run.data.position, default.data.position, atol=1e-6)


def test_answers_of_a_chosen_solver_are_verified(rng, careless):
    problem, _, _ = random_program(rng, "second-order", rank=3)
    expected = solve(problem, solve_clarabel).x
    chosen = VerifiedSolver("careless")
    np.testing.assert_array_equal(chosen(problem).x, expected)
    assert chosen.fallback_count == 1
    with pytest.raises(Infeasible):
        chosen(infeasible_program(rng))
    assert chosen.fallback_count == 2


def test_sessions_of_programs_that_differ_in_b_alone_stay_open(rng, monkeypatch):
    opened, known = [], load_adapters()
    factory = known["osqp"].session_factory
    osqp = replace(known["osqp"], session_factory=lambda *a: (opened.append(1), factory(*a))[1])
    monkeypatch.setattr(verified, "load_adapters", lambda: {"osqp": osqp})
    chosen, (problem, _, _) = VerifiedSolver("osqp"), random_program(rng, rank=8)
    for shift in (0.0, 0.1, 0.2):
        asked = replace(problem, b=problem.b + shift * (np.arange(len(problem.b)) >= 3))
        assert asked.cost(chosen(asked).x) == pytest.approx(
            asked.cost(solve(asked, solve_clarabel).x), rel=1e-5
        )
    assert len(opened) == 1 and chosen.fallback_count == 0
    chosen(replace(problem, q=problem.q + 0.01))
    assert len(opened) == 2
    with pytest.raises(Infeasible):
        chosen(infeasible_program(rng))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"solver": "clarabell"}, "plan.solver: there is no solver .*did you mean clarabel"),
        ({"solver": "osqp", "max_speed": 1.0}, "cannot take second-order cones; .*qoco.* would do"),
        ({"solver": "ecos", "objective": "energy"}, "quadratic cost; .*osqp.* would do"),
        ({"tolerance": 0.0}, "plan.tolerance: must be greater than 0"),
    ],
)
def test_solvers_that_cannot_serve_are_refused_with_those_that_can(changes, message):
    with pytest.raises(sato.InputError, match=message):
        crossing_rows(**changes)


def test_a_solver_that_is_not_installed_is_refused_with_its_package(monkeypatch):
    monkeypatch.setattr("problems.solvers.adapter.find_spec", lambda module: None)
    with pytest.raises(sato.InputError, match="qoco is not installed; pip install qoco would do"):
        crossing_rows(solver="qoco")
