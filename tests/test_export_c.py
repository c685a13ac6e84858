"""Exported C: its files, and that its solutions equal those of Python."""

import ctypes
import os
import sys
from dataclasses import replace
from itertools import islice
from math import inf
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from problems.avoidance import AvoidanceProblem
from problems.conic import Infeasible
from problems.fixed_size_avoidance import FixedSizeAvoidanceProblem
from problems.half_spaces import HalfSpaces, empty_half_spaces
from problems.transfer import TransferProblem
from sato.cli import app
from sato.onboard import export, export_c

sys.path.append(str(Path(__file__).parents[1] / "scripts"))
from onboard_library import (
    INVALID_INPUT,
    SOLVED,
    UNSOLVED,
    CompiledSolver,
    random_instances,
)

ORBIT = """
system = "reconfiguration"
[swarm]
agents = 4
start = { kind = "random", box_m = 300.0, depth_m = 0.0, separation_m = 60.0 }
comm_radius_m = 2000.0
collision_radius_m = 20.0
[chief]
semi_major_axis_km = 6878.0
[model]
kind = "clohessy_wiltshire"
max_control_mm_s2 = 10.0
[plan]
step_s = 60.0
horizon_steps = 3
allow_undetectable = true  # no speed limit
[[leg]]
shape = { kind = "ring", radius_m = 100.0 }
steps = 12
"""


REST = np.zeros(4)


def wall(step, least):
    """Return a half-space of the first coordinate in the plane."""
    normal, none = np.array([[1.0, 0, 0, 0]]), np.zeros((1, 2))
    return HalfSpaces(np.array([step]), normal, none, np.array([least]))


def call(*args: str) -> Result:
    return CliRunner().invoke(app, args)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Export and compile two problems: in the plane with a speed limit, and in orbit without."""
    home = tmp_path_factory.mktemp("onboard")
    (home / "orbit.toml").write_text(ORBIT)
    sources = {"plane": ("uiuc", 3, 10), "orbit": (str(home / "orbit.toml"), 2, None)}
    return {
        name: (export_c(scenario, home / name, *size), CompiledSolver(home / name), home / name)
        for name, (scenario, *size) in sources.items()
    }


def solve_in_python(problem, instance):
    transfer = problem.program.transfer
    flight = AvoidanceProblem(transfer, *instance).solve().trajectory
    return flight, transfer.model.dt * transfer.weights @ np.abs(flight.u).sum(axis=1)


@pytest.mark.parametrize(("name", "rounding"), [("plane", 1e-13), ("orbit", 1e-12)])
def test_c_finds_the_cost_of_python_and_keeps_all_constraints(made, name, rounding, rng):
    problem, code, _ = made[name]
    program = problem.program
    steps, V = program.transfer.model, program.transfer.max_speed
    least_cost = program.transfer.max_control * steps.dt
    bound = 0
    for instance in islice(random_instances(problem, rng), 50):
        start, target, spaces = instance
        flight, cost = solve_in_python(problem, instance)
        flown = code.solve(*instance)
        assert flown.code == SOLVED and flown.residual <= 1e-6
        assert abs(flown.cost - cost) <= 1e-6 * max(cost, least_cost)
        # Recomputed independently of the code.
        x = steps.simulate(start, flown.u)
        missed, violation = np.abs(x[-1] - target), max(0, spaces.violation(x, flown.u).max())
        assert (missed / program.state_units).max() <= 1e-6
        assert np.abs(flown.u).max() <= program.transfer.max_control
        assert violation <= 1e-6 * problem.horizon.clearance
        assert flown.fuel == pytest.approx(steps.dt * np.abs(flown.u).sum(), rel=1e-12)
        position, velocity = np.split(missed, 2)
        reported = flown.position_error, flown.velocity_error, flown.half_space_violation
        recomputed = position.max(), velocity.max(), violation
        np.testing.assert_allclose(reported, recomputed, rtol=0, atol=rounding)
        if program.has_speed_limit:
            assert np.linalg.norm(x[1:-1, steps.axes :], axis=1).max() <= V * (1 + 1e-6)
        bound += spaces.violation(flight.x, flight.u).max() > -1e-6 * problem.horizon.clearance
    assert bound >= 10  # enough instances in which half-spaces bind


def test_speed_limit_is_kept_where_it_binds(made):
    problem, code, _ = made["plane"]
    V = problem.program.transfer.max_speed
    empty = empty_half_spaces(problem.program.transfer)
    start, target = np.zeros(4), np.array([1.57, 0.4, 0, 0])
    flight, cost = solve_in_python(problem, (start, target, empty))
    assert np.linalg.norm(flight.x[1:-1, 2:], axis=1).max() > V * (1 - 1e-6)
    flown = code.solve(start, target, empty)
    assert (flown.code, flown.cost) == (SOLVED, pytest.approx(cost, rel=1e-6))


def test_start_on_the_boundary_of_a_half_space_is_feasible(made):
    # No control changes the first state, so a violation by rounding must not matter.
    _, code, _ = made["plane"]
    for beyond, found in ((1e-13, SOLVED), (1e-3, UNSOLVED)):
        assert code.solve(REST, np.array([0.5, 0.4, 0, 0]), wall(0, beyond)).code == found


def test_solution_does_not_depend_on_earlier_calls(made, rng):
    problem, code, _ = made["plane"]
    first, *others = islice(random_instances(problem, rng), 8)
    alone = code.solve(*first)
    for other in others:
        code.solve(*other)
    np.testing.assert_array_equal(code.solve(*first).u, alone.u)


def test_order_of_half_spaces_does_not_matter(made, rng):
    problem, code, _ = made["plane"]
    start, target, spaces = next(random_instances(problem, rng))
    reversed_spaces = HalfSpaces(*(column[::-1] for column in spaces))
    costs = [code.solve(start, target, s).cost for s in (spaces, reversed_spaces)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-7)


def test_infeasible_transfer_is_unsolved_and_leaves_no_trace(made):
    problem, code, _ = made["plane"]
    empty, far = empty_half_spaces(problem.program.transfer), np.array([50.0, 0, 0, 0])
    near = np.array([0.5, 0.2, 0, 0])
    before = code.solve(REST, near, empty)
    with pytest.raises(Infeasible):
        AvoidanceProblem.alone(problem.program.transfer, REST, far).solve()
    flown = code.solve(REST, far, empty)
    assert flown.code == UNSOLVED
    assert not flown.residual <= 1e-6
    after = code.solve(REST, near, empty)
    assert after.code == SOLVED
    np.testing.assert_array_equal(after.u, before.u)


def test_invalid_input_is_refused_before_solving(made):
    problem, code, _ = made["plane"]
    target, empty = np.array([0.1, 0, 0, 0]), empty_half_spaces(problem.program.transfer)
    most = problem.program.rows_per_step
    full, overfull = (
        HalfSpaces(*(np.repeat(column, count, axis=0) for column in wall(1, -9.0)))
        for count in (most, most + 1)
    )
    assert code.solve(REST, target, full).code == SOLVED
    for start, end, spaces in (
        (np.array([np.nan, 0, 0, 0]), target, empty),
        (REST, np.array([0, inf, 0, 0]), empty),
        (REST, target, wall(1, 0.0)._replace(rhs=np.array([np.nan]))),
        (REST, target, wall(problem.program.horizon_steps, -9.0)),
        (REST, target, wall(1, -9.0)._replace(step_index=np.array([-1]))),
        (REST, target, overfull),
    ):
        flown = code.solve(start, end, spaces)
        assert (flown.code, flown.residual, flown.fuel) == (INVALID_INPUT, inf, 0.0)


def test_library_exports_a_single_function(made):
    library = ctypes.CDLL(str(made["plane"][2] / "libsato_onboard.so"))
    assert library.sato_solve
    for internal in ("cpg_solve", "qoco_solve", "plus"):
        with pytest.raises(AttributeError):
            getattr(library, internal)


def test_problem_without_constant_matrices_is_refused():
    steps = discretize_zoh(DoubleIntegrator(2), 1.0, 6)
    with pytest.raises(ValueError, match=r"has fuel_norm 1, .* got \(2, 'inf', 2\)"):
        FixedSizeAvoidanceProblem(TransferProblem(steps, 0.1, fuel_norm=2), 3, 4)
    changing = replace(steps, A=steps.A * np.linspace(1, 1.1, 6)[:, None, None])
    with pytest.raises(ValueError, match="the same at every step"):
        FixedSizeAvoidanceProblem(TransferProblem(changing, 0.1), 3, 4)
    constant = discretize_zoh(ClohessyWiltshire(1e-3), 60.0, 6)
    assert not FixedSizeAvoidanceProblem(TransferProblem(constant, 0.01), 3, 4).has_speed_limit


def test_command_writes_a_folder_with_a_readme(tmp_path):
    result = call("export-c", "--steps", "6", "--neighbors", "2", "--out", str(tmp_path / "c"))
    assert result.exit_code == 0, result.stderr
    assert "flights of 6 steps with the speed limit of 0.2 m/s" in result.stdout
    assert "room for 2 neighbors" in result.stdout
    text = (tmp_path / "c" / "README.md").read_text()
    for cell in ("uiuc", "6 steps", "steps of 1 s", "0.1 m/s²", "0.2 m/s", "Apache 2.0"):
        assert cell in text
    assert os.listdir(tmp_path) == ["c"]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--scenario", "nowhere"], 'there is no scenario "nowhere"'),
        (["--scenario", "changing.toml"], "its model changes with time or with the trajectory"),
        (["--scenario", "formation"], "solve no transfer"),
        (["--steps", "1"], "must be at least 2"),
        (["--neighbors", "0"], "must be at least 1"),
    ],
)
def test_refused_export_leaves_no_files(tmp_path, monkeypatch, args, message):
    (tmp_path / "changing.toml").write_text(ORBIT.replace("clohessy_wiltshire", "j2"))
    monkeypatch.chdir(tmp_path)
    result = call("export-c", *args, "--out", str(tmp_path / "c"))
    assert result.exit_code == 2
    assert message in result.stderr
    assert os.listdir(tmp_path) == ["changing.toml"]


def test_existing_files_are_not_overwritten(tmp_path):
    (tmp_path / "letter").write_text("dear")
    for out in (tmp_path, tmp_path / "letter"):
        result = call("export-c", "--out", str(out))
        assert result.exit_code == 2
        assert str(out) in result.stderr
    assert (tmp_path / "letter").read_text() == "dear"


def test_failure_while_writing_leaves_no_files(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device", "somewhere")

    monkeypatch.setattr(export, "generate_solver", fail)
    result = call("export-c", "--steps", "6", "--out", str(tmp_path / "c"))
    assert result.exit_code == 1
    assert "No space left on device" in result.stderr
    assert os.listdir(tmp_path) == []


def test_missing_generator_is_refused_with_the_install_command(tmp_path, monkeypatch):
    monkeypatch.setattr("sato.onboard.export.find_spec", lambda name: None)
    result = call("export-c", "--out", str(tmp_path / "c"))
    assert result.exit_code == 2
    assert "pip install 'cvxpygen" in result.stderr


def test_code_that_does_not_compile_is_refused(tmp_path):
    with pytest.raises(ValueError, match="does not compile: "):
        CompiledSolver(tmp_path)
