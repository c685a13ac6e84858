"""C for on board: what is written, and that it answers as Python does."""

import ctypes
import os
from dataclasses import replace
from itertools import islice
from math import inf

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from problems.avoidance import AvoidanceProblem, HalfSpaces, empty_half_spaces
from problems.conic import Infeasible
from problems.fixed_size_avoidance import FixedSizeAvoidanceProblem
from problems.transfer import TransferProblem
from sato.cli import app
from sato.onboard import export, export_c
from sato.onboard.library import INVALID_INPUT, SOLVED, UNSOLVED, CompiledSolver, compile_solver
from sato.onboard.problem import build_onboard_problem
from sato.onboard.random_instances import random_instances

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


def call(*words: str) -> Result:
    return CliRunner().invoke(app, words)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two programmes in C: in the plane with a speed limit, and in orbit without one."""
    home = tmp_path_factory.mktemp("onboard")
    (home / "orbit.toml").write_text(ORBIT)
    wanted = {"uiuc": (3, 10), str(home / "orbit.toml"): (2, None)}
    found = {}
    for (scenario, size), name in zip(wanted.items(), ("plane", "orbit"), strict=True):
        written = export_c(scenario, home / name, *size)
        found[name] = written, compile_solver(home / name), home / name
    return found


def flown_by_python(written, question):
    transfer = written.program.transfer
    flight = AvoidanceProblem(transfer).solve(*question).trajectory
    return flight, transfer.model.dt * transfer.weight @ np.abs(flight.u).sum(axis=1)


@pytest.mark.parametrize("name", ["plane", "orbit"])
def test_the_code_answers_as_python_does(made, name, rng):
    written, code, _ = made[name]
    programme = written.program
    steps, V = programme.transfer.model, programme.transfer.max_speed
    least_cost = programme.transfer.max_control * steps.dt
    bound = 0
    for question in islice(random_instances(written, rng), 50):
        start, goal, spaces = question
        flight, cost = flown_by_python(written, question)
        flown = code.solve(*question)
        assert flown.code == SOLVED
        assert abs(flown.cost - cost) <= 1e-6 * max(cost, least_cost)
        # By arithmetic of our own: the answer keeps all that was asked.
        x = steps.simulate(start, flown.u)
        assert np.abs((x[-1] - goal) / programme.state_units).max() <= 1e-6
        assert np.abs(flown.u).max() <= programme.transfer.max_control
        assert spaces.violation(x, flown.u).max() <= 1e-6 * written.horizon.radius
        if programme.limited:
            assert np.linalg.norm(x[1:-1, steps.axes :], axis=1).max() <= V * (1 + 1e-6)
        bound += spaces.violation(flight.x, flight.u).max() > -1e-6 * written.horizon.radius
    assert bound >= 10  # else the half-spaces were never put to the test


def test_the_speed_limit_is_kept_where_it_binds(made):
    written, code, _ = made["plane"]
    V = written.program.transfer.max_speed
    nobody = empty_half_spaces(written.program.transfer)
    start, goal = np.zeros(4), np.array([1.57, 0.4, 0, 0])
    flight, cost = flown_by_python(written, (start, goal, nobody))
    assert np.linalg.norm(flight.x[1:-1, 2:], axis=1).max() > V * (1 - 1e-6)
    flown = code.solve(start, goal, nobody)
    assert (flown.code, flown.cost) == (SOLVED, pytest.approx(cost, rel=1e-6))


def test_a_start_that_touches_a_half_space_is_no_obstacle(made):
    # Nothing moves the first state: a wall that it lies beyond by rounding is not in the way.
    _, code, _ = made["plane"]
    axis, still = np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 2))
    for beyond, found in ((1e-13, SOLVED), (1e-3, UNSOLVED)):
        wall = HalfSpaces(np.array([0]), axis, still, np.array([beyond]))
        assert code.solve(np.zeros(4), np.array([0.5, 0.4, 0, 0]), wall).code == found


def test_what_the_code_says_of_its_answer_is_so(made, rng):
    written, code, _ = made["plane"]
    steps = written.program.transfer.model
    for start, goal, spaces in islice(random_instances(written, rng), 5):
        flown = code.solve(start, goal, spaces)
        x = steps.simulate(start, flown.u)
        assert flown.fuel == pytest.approx(steps.dt * np.abs(flown.u).sum(), rel=1e-12)
        assert flown.position_error == pytest.approx(np.abs(x[-1] - goal)[:2].max(), abs=1e-13)
        assert flown.velocity_error == pytest.approx(np.abs(x[-1] - goal)[2:].max(), abs=1e-13)
        assert flown.broken == pytest.approx(max(0, spaces.violation(x, flown.u).max()), abs=1e-13)
        assert flown.residual <= 1e-6


def test_an_answer_does_not_depend_on_those_before_it(made, rng):
    written, code, _ = made["plane"]
    first, *others = islice(random_instances(written, rng), 8)
    alone = code.solve(*first)
    for other in others:
        code.solve(*other)
    np.testing.assert_array_equal(code.solve(*first).u, alone.u)


def test_the_order_of_half_spaces_does_not_matter(made, rng):
    written, code, _ = made["plane"]
    start, goal, spaces = next(random_instances(written, rng))
    turned = HalfSpaces(*(part[::-1] for part in spaces))
    there, back = (code.solve(start, goal, s).cost for s in (spaces, turned))
    assert there == pytest.approx(back, rel=1e-7)


def test_where_there_is_no_flight_none_is_claimed(made):
    written, code, _ = made["plane"]
    nobody, far = empty_half_spaces(written.program.transfer), np.array([50.0, 0, 0, 0])
    near = np.array([0.5, 0.2, 0, 0])
    before = code.solve(np.zeros(4), near, nobody)
    with pytest.raises(Infeasible):
        AvoidanceProblem(written.program.transfer).solve(np.zeros(4), far, nobody)
    flown = code.solve(np.zeros(4), far, nobody)
    assert flown.code == UNSOLVED
    assert not flown.residual <= 1e-6
    # Nothing moves the first state, so neither can it be made to keep anything.
    wall = HalfSpaces(np.array([0]), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 2)), np.array([1.0]))
    assert code.solve(np.zeros(4), near, wall).code == UNSOLVED
    after = code.solve(np.zeros(4), near, nobody)
    assert after.code == SOLVED
    np.testing.assert_array_equal(after.u, before.u)


def test_bad_numbers_are_refused_before_anything_is_solved(made):
    written, code, _ = made["plane"]
    rest, goal = np.zeros(4), np.array([0.1, 0, 0, 0])
    nobody = empty_half_spaces(written.program.transfer)
    wall = HalfSpaces(np.array([1]), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 2)), np.array([-9.0]))
    assert code.solve(rest, goal, wall).code == SOLVED
    most = written.program.rows
    crowd = HalfSpaces(*(np.repeat(part, most, axis=0) for part in wall))
    assert code.solve(rest, goal, crowd).code == SOLVED
    for start, end, spaces in (
        (np.array([np.nan, 0, 0, 0]), goal, nobody),
        (rest, np.array([0, inf, 0, 0]), nobody),
        (rest, goal, wall._replace(rhs=np.array([np.nan]))),
        (rest, goal, wall._replace(step_index=np.array([written.program.horizon]))),
        (rest, goal, wall._replace(step_index=np.array([-1]))),
        (rest, goal, HalfSpaces(*(np.repeat(part, most + 1, axis=0) for part in wall))),
    ):
        flown = code.solve(start, end, spaces)
        assert (flown.code, flown.residual, flown.fuel) == (INVALID_INPUT, inf, 0.0)


def test_the_library_shows_one_function_alone(made):
    library = ctypes.CDLL(str(made["plane"][2] / "libsato_onboard.so"))
    assert library.sato_solve
    for inner in ("cpg_solve", "qoco_solve", "plus"):
        with pytest.raises(AttributeError):
            getattr(library, inner)


def test_the_statement_of_fixed_size_is_that_of_avoidance(rng):
    """Without C: the same optimum, solved in Python."""
    import cvxpy as cp

    written = build_onboard_problem("uiuc", 2, 8)
    programme = written.program
    transfer, units = programme.transfer, programme.state_units
    start, goal, spaces = next(random_instances(written, rng))
    statement = programme.to_cvxpy()
    data = {parameter.name(): np.zeros(parameter.shape) for parameter in statement.parameters()}
    data["room"] += 1
    coast = transfer.model.simulate(start, np.zeros((len(transfer.model), 2)))
    data["reach"] = (goal - coast[-1]) / units
    data["coasting"] = (coast[1:-1, 2:] / transfer.max_speed).T
    free = {
        k: list(np.flatnonzero(programme.row_steps == k)) for k in range(programme.horizon_steps)
    }
    for k, on_state, on_control, least in zip(*spaces, strict=True):
        row = free[int(k)].pop()
        data["on_state"][:, row] = -on_state * units * (k > 0)
        data["on_control"][:, row] = -on_control * transfer.max_control
        data["room"][row] = on_state @ coast[k] - least
    for parameter in statement.parameters():
        parameter.value = data[parameter.name()]
    scale = transfer.max_control * transfer.model.dt
    found = scale * statement.solve(solver=cp.CLARABEL)
    assert found == pytest.approx(flown_by_python(written, (start, goal, spaces))[1], rel=1e-6)


def test_what_cannot_be_written_once_is_refused():
    steps = discretize_zoh(DoubleIntegrator(2), 1.0, 6)
    with pytest.raises(ValueError, match="fuel norm 1 and control norm inf, got 2 and inf"):
        FixedSizeAvoidanceProblem(TransferProblem(steps, 0.1, fuel_norm=2), 3, 4)
    with pytest.raises(ValueError, match="at least 2 steps"):
        FixedSizeAvoidanceProblem(TransferProblem(steps, 0.1), 7, 4)
    changing = replace(steps, A=steps.A * np.linspace(1, 1.1, 6)[:, None, None])
    with pytest.raises(ValueError, match="A must be the same at every step"):
        FixedSizeAvoidanceProblem(TransferProblem(changing, 0.1), 3, 4)
    constant = discretize_zoh(ClohessyWiltshire(1e-3), 60.0, 6)
    assert not FixedSizeAvoidanceProblem(TransferProblem(constant, 0.01), 3, 4).has_speed_limit


def test_the_command_writes_a_folder_that_says_what_it_is(tmp_path):
    said = call("export-c", "--steps", "6", "--neighbours", "2", "--out", str(tmp_path / "c"))
    assert said.exit_code == 0, said.stderr
    assert "flights of 6 steps with the speed limit of 0.2 m/s" in said.stdout
    assert "room for 2 neighbours" in said.stdout
    text = (tmp_path / "c" / "README.md").read_text()
    for word in ("`uiuc`", "6 of 1 s", "0.1 m/s²", "0.2 m/s", "Apache 2.0"):
        assert word in text
    assert os.listdir(tmp_path) == ["c"]  # and nothing beside it


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scenario", "nowhere"], 'there is no scenario "nowhere"'),
        (["--scenario", "changing.toml"], "its model changes with the time or with the path"),
        (["--scenario", "formation"], "solve no transfer"),
        (["--steps", "1"], "greater than or equal to 2"),
        (["--neighbours", "0"], "greater than or equal to 1"),
    ],
)
def test_bad_requests_are_refused_and_leave_nothing(tmp_path, monkeypatch, words, said):
    (tmp_path / "changing.toml").write_text(ORBIT.replace("clohessy_wiltshire", "j2"))
    monkeypatch.chdir(tmp_path)
    answer = call("export-c", *words, "--out", str(tmp_path / "c"))
    assert answer.exit_code == 2
    assert said in answer.stderr
    assert os.listdir(tmp_path) == ["changing.toml"]


def test_what_is_there_is_not_written_over(tmp_path):
    (tmp_path / "letter").write_text("dear")
    for out in (tmp_path, tmp_path / "letter"):
        answer = call("export-c", "--out", str(out))
        assert answer.exit_code == 2
        assert str(out) in answer.stderr
    assert (tmp_path / "letter").read_text() == "dear"


def test_a_failure_on_the_way_leaves_nothing(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device", "somewhere")

    monkeypatch.setattr(export, "generate", fail)
    answer = call("export-c", "--steps", "6", "--out", str(tmp_path / "c"))
    assert answer.exit_code == 1
    assert "No space left on device" in answer.stderr
    assert os.listdir(tmp_path) == []


def test_without_the_generator_the_line_that_installs_it_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("sato.onboard.codegen.find_spec", lambda name: None)
    answer = call("export-c", "--out", str(tmp_path / "c"))
    assert answer.exit_code == 2
    assert "pip install 'cvxpygen" in answer.stderr


def test_code_that_is_not_compiled_says_what_would_do_it(tmp_path):
    with pytest.raises(ValueError, match="make in its folder compiles it"):
        CompiledSolver(tmp_path)
