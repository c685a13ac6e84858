"""Comparison of solvers, with fake ones that are wrong, crash, hang and print."""

import csv
import json
import multiprocessing
import os
import platform
import tempfile
from dataclasses import replace

import numpy as np
import pytest
from fake_solvers import Honest, fake_solvers
from scipy.sparse import csc_array
from typer.testing import CliRunner

import sato.compare.figures
from problems.conic import ConicProgram
from problems.families import Family, Instance
from problems.solvers import SolverAdapter, load_adapters
from sato.cli import app
from sato.compare.figures import performance_ratios
from sato.compare.machine import describe_machine
from sato.compare.measure import Measurement, measure_solvers
from sato.compare.plan import ComparisonPlan, make_plan, next_with_same_matrix
from sato.compare.report import COLUMNS, list_failures, summarize, write_comparison
from sato.compare.summary import find_violations, reference_tolerance
from sato.compare.worker import SolveOutcome, SolveRequest, Worker, WorkerError

KNOWN = load_adapters()


def box_family(size="small", feasible=True, seed=0, with_10=None):
    """Return three instances of x ≥ lower with different limits, in one of which b₀ is 10."""
    rng = np.random.default_rng(seed)
    q, A = rng.uniform(1, 2, 4), csc_array(-np.eye(4))
    instances = []
    for i in range(3):
        lower = rng.normal(size=4)
        lower[0] = -10 if i == with_10 else lower[0]
        problem = ConicProgram(q, A, -lower, 0, 4)
        reference = float(q @ lower) if feasible else float("nan")
        instances.append(Instance(f"{size}/{i}", problem, feasible, reference, 0.0, lower, q))
    return Family("box", size, seed, "drawn here", ("none",), tuple(instances))


def measure(*names, families=None, repeats=2, tolerances=(1e-4, 1e-6), patience=10.0):
    """Measure fake solvers."""
    solvers = tuple(fake_solvers()[name] for name in names)
    plan = ComparisonPlan(tuple(families or [box_family()]), solvers, tolerances, repeats, patience)
    return measure_solvers(plan, np.random.default_rng(0), lookup=fake_solvers)


def made_up(solver="a", seconds=1.0, verdict="solved", instance=0, tolerance=1e-6, **numbers):
    """Return a made-up measurement."""
    exact = dict.fromkeys(("cost_error", "primal_residual", "dual_residual", "gap"), 0.0)
    outcome = SolveOutcome(verdict, "reason", seconds, 5, **exact | numbers)
    family = box_family()
    return Measurement(
        solver, "box", "small", family.instances[instance], tolerance, outcome, None, 1.0
    )


def test_correct_solver_is_solved_in_both_solves(capfd):
    found = measure("printing")
    assert capfd.readouterr() == ("", "")  # what a library prints stays in its process
    assert len(found) == 2 * 3
    for m in found:
        assert m.is_correct and m.first.verdict == m.second.verdict == "solved"
        assert m.first.cost_error < 1e-14 and m.second.cost_error < 1e-14
        assert m.first.iterations == 7
        assert m.first.seconds > 0 and m.second.seconds > 0


def test_claims_are_verified_and_other_solvers_go_on():
    expected = {
        "wrong": ("wrong claim", "primal residual"),
        "pessimist": ("wrong claim", "but there is a point"),
        "crashing": ("crashed", "Aborted"),
        "raising": ("crashed", "ValueError: no idea"),
        "honest": ("solved", "done"),
    }
    found = measure(*expected, tolerances=(1e-4,))
    assert len(found) == 3 * len(expected)
    for m in found:
        verdict, reason = expected[m.solver]
        assert m.first.verdict == verdict
        assert reason in m.first.reason


def test_crashed_workers_leave_no_process_and_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    measure("crashing", "raising", repeats=1, tolerances=(1e-4,))
    assert not multiprocessing.active_children()
    assert not list(tmp_path.glob("sato-compare-*"))


def test_second_solve_is_verified_too():
    for m in measure("constant"):
        assert m.first.verdict == "solved"
        assert m.second.verdict == "wrong claim"
        assert not m.is_correct


def test_accepted_point_of_an_infeasible_problem_is_a_violation():
    for m in measure("honest", families=[box_family(feasible=False)]):
        assert m.first.verdict == "solved" and not m.is_correct
        assert "known to be infeasible" in find_violations([m])[0]


def test_infeasibility_without_proof_is_unproven_where_it_is_true():
    infeasible = box_family(feasible=False)
    found = measure("pessimist", families=[infeasible])
    assert {m.first.verdict for m in found} == {"unproven"}
    assert {m.first.verdict for m in measure("pessimist")} == {"wrong claim"}


def test_too_slow_a_solver_is_skipped_for_larger_and_tighter_problems(monkeypatch):
    monkeypatch.setattr("sato.compare.measure.WARM_UP_TIMEOUT", 1.0)
    monkeypatch.setattr("sato.compare.measure.HANG_FACTOR", 1.0)
    found = measure("hanging", families=[box_family(), box_family("medium")], patience=0.7)
    assert {m.first.verdict for m in found} == {"skipped"}
    assert {m.first.reason for m in found} == {"it took more than 0.7 s at small, 1e-4"}


def test_no_answer_within_ten_times_the_patience_counts_as_crashed():
    one, two, three = measure(
        "hangingat10", families=[box_family(with_10=2)], repeats=1, tolerances=(1e-4,), patience=0.5
    )
    assert one.first.verdict == two.first.verdict == two.second.verdict == "solved"
    assert three.first.verdict == "skipped" and three.second.verdict == "crashed"
    assert three.second.reason == "no answer within 5 s" and three.second.seconds == 5


def test_process_that_ends_after_its_answer_is_restarted():
    family = box_family()
    request = SolveRequest(family.instances[0], family.instances[1], 1e-6)
    worker = Worker(fake_solvers, "honest", request, 60.0)
    try:
        assert not worker.solve(request, 60.0).crashed
        [process] = multiprocessing.active_children()
        process.kill()
        process.join()
        with pytest.raises(WorkerError, match="Killed"):
            worker.solve(request, 60.0)
        assert not worker.solve(request, 60.0).crashed  # in a new process
    finally:
        worker.close()


@pytest.mark.parametrize(
    ("instance", "verdicts"),
    [
        # The second request ends in its second solve, the third in its first, without a second.
        (2, [("solved", "crashed"), ("solved", "solved"), ("crashed", "crashed")]),
        # A crash in the warm-up excludes no solver.
        (0, [("crashed", "crashed"), ("solved", "crashed"), ("solved", "solved")]),
    ],
)
def test_crash_counts_in_the_solve_in_which_it_happened(instance, verdicts):
    family = box_family(with_10=instance)
    found = measure("crashingat10", families=[family], repeats=1, tolerances=(1e-4,))
    assert not any(m.is_correct for m in found if "crashed" in {o.verdict for o in m.outcomes})
    assert [(m.first.verdict, m.second.verdict) for m in found] == verdicts


def test_warm_up_includes_both_solves():
    found = measure("crashingat10", families=[box_family(with_10=2)], repeats=1)
    for m in (m for m in found if m.instance.name == "small/0"):
        assert m.first.iterations == 3  # each tolerance has a process of its own


def test_worker_does_not_check_again_what_a_solver_supports():
    assert all(m.is_correct for m in measure("selective", repeats=1, tolerances=(1e-4,)))


def test_memory_is_the_growth_with_one_instance():
    found = measure("hoarding", "honest", tolerances=(1e-6,), repeats=1)
    hoarding, honest = (next(m for m in found if m.solver == n) for n in ("hoarding", "honest"))
    assert 60 < hoarding.memory_growth < 110  # the second solve takes as much again
    assert honest.memory_growth < 20


def test_progress_counts_the_planned_solves():
    reported = []
    solvers = tuple(fake_solvers()[name] for name in ("honest", "wrong"))
    plan = ComparisonPlan((box_family(),), solvers, (1e-4, 1e-6), 3, 10.0)
    measure_solvers(
        plan, np.random.default_rng(0), lambda *counts: reported.append(counts), fake_solvers
    )
    assert reported == [(k, plan.solve_count) for k in range(2, plan.solve_count + 1, 2)]
    assert plan.solve_count == 2 * 2 * 3 * 3


def test_next_instance_differs_in_b_alone():
    family = box_family()
    one, two, three = family.instances
    other = replace(three.problem, A=three.problem.A.copy())
    mixed = replace(family, instances=(one, two, replace(three, problem=other)))
    assert next_with_same_matrix(family) == (two, three, one)
    assert next_with_same_matrix(mixed) == (two, one, None)


def test_profile_is_relative_to_the_fastest_correct_solver():
    # Solver a is the fastest on the first problem and wrong, though faster still, on the second.
    some = [
        made_up("a", 1.0, instance=0),
        made_up("b", 3.0, instance=0),
        made_up("a", 0.1, "wrong claim", instance=1),
        made_up("b", 2.0, instance=1),
        made_up("a", 0.1, "failed", instance=2),
        made_up("b", 0.1, "failed", instance=2),
    ]
    assert performance_ratios(some) == {"a": [1.0, np.inf, np.inf], "b": [3.0, 1.0, np.inf]}


def test_summary_counts_correct_answers_at_each_tolerance():
    some = [
        made_up("a", 1.0, tolerance=1e-4),
        made_up("a", 3.0, tolerance=1e-6, instance=0),
        made_up("a", 5.0, tolerance=1e-6, instance=1),
        made_up("a", 9.0, "wrong claim", tolerance=1e-6, instance=2),
        made_up("a", 9.0, "skipped", tolerance=1e-8),
    ]
    right_4, right_6, right_8, wrong, unsolved, first, second, *_ = summarize(
        some, reference_tolerance({1e-4, 1e-6, 1e-8})
    )
    assert (right_4, right_6, right_8) == ("1/1", "2/3", "0/1")
    assert "1" in wrong and unsolved == "1"
    assert (first, second) == ("4000", "–")


@pytest.mark.parametrize(
    ("measurement", "violations"),
    [
        (made_up("clarabel"), 0),
        (made_up("clarabel", verdict="failed"), 1),
        (made_up("clarabel", verdict="failed", tolerance=1e-8), 0),  # tighter than is guaranteed
        (made_up("osqp", verdict="wrong claim"), 0),
        (made_up("osqp", gap=1e-5), 1),
        (made_up("osqp", dual_residual=float("nan")), 1),
        (made_up("osqp", cost_error=0.5), 1),
        (made_up("osqp", cost_error=float("nan")), 1),
    ],
)
def test_violations_concern_the_default_solver_and_accepted_answers(measurement, violations):
    assert len(find_violations([measurement])) == violations


def test_comparison_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    found = measure("honest", "wrong")
    machine = describe_machine([fake_solvers()["honest"]])
    files = write_comparison(found, machine, tmp_path / "new")
    assert sorted(file.name for file in files) == sorted(os.listdir(tmp_path / "new"))
    with open(tmp_path / "new" / "measurements.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found) and tuple(rows[0]) == COLUMNS
    assert {row["solver"]: row["first_verdict"] for row in rows} == {
        "honest": "solved",
        "wrong": "wrong claim",
    }
    assert json.loads((tmp_path / "new" / "machine.json").read_text()) == machine

    def fails(measurements, folder):
        raise OSError("no space left")

    monkeypatch.setattr(sato.compare.figures, "draw_comparison", fails)
    with pytest.raises(OSError, match="no space left"):
        write_comparison(found, machine, tmp_path / "half")
    assert os.listdir(tmp_path / "half") == []


def test_machine_is_described_without_names_and_paths():
    text = json.dumps(describe_machine(KNOWN.values()))
    assert "clarabel" in text and platform.python_version() in text
    assert platform.node() not in text
    assert os.sep + "home" not in text and os.getcwd() not in text


REFUSED = {
    "an unknown solver": ({"solvers": ["clarbel"]}, "clarbel.*did you mean clarabel"),
    "an unknown family": ({"families": ["transfer-pl"]}, "transfer-pl.*did you mean transfer-lp"),
    "an unknown size": ({"sizes": ["smal"]}, "smal.*did you mean small"),
    "a tolerance that is none": ({"tolerances": [0.0]}, "between 0 and 1, got 0"),
    "no tolerance at all": ({"tolerances": [float("nan")]}, "between 0 and 1, got nan"),
    "no repeats": ({"repeats": 0}, "at least one repeat, got 0"),
    "a patience of none": ({"patience": 0.0}, "a time above 0 s, at most a day, got 0"),
    "a patience without end": ({"patience": float("inf")}, "at most a day, got inf"),
    "a solver that is missing": (
        {"solvers": ["absent"]},
        "absent is not installed; pip install absent would do",
    ),
    "a cone that a solver does not know": (
        {"solvers": ["highs"], "families": ["transfer-socp"]},
        "highs cannot take second-order cones, which transfer-socp has; .*clarabel.* can",
    ),
    "a form that a solver does not know": (
        {"solvers": ["batched"], "families": ["avoidance-5"], "sizes": ["small"]},
        "batched cannot take .*avoidance-5.*; .*clarabel.* can",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_impossible_comparison_is_refused(case):
    options, message = REFUSED[case]
    absent = SolverAdapter("absent", frozenset({"linear"}), False, Honest, "absent_", "absent")
    with pytest.raises(ValueError, match=message):
        make_plan(KNOWN | {"absent": absent}, **options)


def test_missing_solver_is_left_out_with_a_reason_unless_it_is_named():
    absent = SolverAdapter("absent", frozenset({"linear"}), False, Honest, "absent_", "absent")
    plan = make_plan({"clarabel": KNOWN["clarabel"], "absent": absent}, sizes=["small"])
    assert [solver.name for solver in plan.solvers] == ["clarabel"]
    assert plan.exclusions == ("absent is not installed; pip install absent would do",)
    assert plan.tolerances == (1e-4, 1e-6, 1e-8)


def call(*args):
    return CliRunner().invoke(app, ["compare", *args])


ONE = ("--family", "transfer-lp", "--size", "small", "--solver", "highs", "--tolerance", "1e-6")


def test_command_prints_and_writes_a_comparison(tmp_path):
    result = call(*ONE, "--repeats", "1", "--out", str(tmp_path))
    assert result.exit_code == 0, result.stderr
    assert "transfer-lp (small)" in result.stdout and "highs" in result.stdout
    assert "Python" in result.stdout and str(tmp_path) in result.stdout
    assert sorted(os.listdir(tmp_path)) == [
        "accuracy.png",
        "machine.json",
        "measurements.csv",
        "profile.png",
    ]


def test_violation_exits_with_1(tmp_path, monkeypatch):
    monkeypatch.setattr("sato.compare.report.find_violations", lambda found: ["clarabel: off by 1"])
    result = call(*ONE, "--repeats", "1", "--out", str(tmp_path))
    assert result.exit_code == 1
    assert "sato: clarabel: off by 1" in result.stderr


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--solver", "clarbel"), "did you mean clarabel?"),
        (("--patience", "nan"), "--patience takes a time above 0 s, at most a day, got nan"),
        (("--out", "file/below"), "cannot be written to"),
    ],
)
def test_refusal_is_one_line_and_nothing_is_written(tmp_path, monkeypatch, args, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    result = call(*args)
    assert result.exit_code == 2
    assert result.stderr.startswith("sato: ") and result.stderr.count("\n") == 1
    assert message in result.stderr and "Traceback" not in result.stderr
    assert os.listdir(tmp_path) == ["file"]


def test_failures_are_listed_once_each_with_an_example():
    some = [
        made_up("a", verdict="failed"),
        made_up("a", verdict="unproven", instance=1),
        made_up("a", verdict="unproven", instance=2),
    ]
    assert list_failures(some) == [
        "a: failed, small/0 at 1e-6: reason",
        "a: unproven 2 times, small/1 at 1e-6: reason",
    ]
