"""Comparison of solvers, with fake ones that are wrong, crash, hang and print."""

import csv
import json
import multiprocessing
import os
import platform
from dataclasses import replace

import numpy as np
import pytest
from fake_solvers import Honest, fake_solver
from scipy.sparse import csc_array
from typer.testing import CliRunner

from problems.conic import ConicProgram
from problems.families import Family, Instance
from problems.solvers import SolverAdapter, load_adapters
from sato.cli import app
from sato.compare.figures import performance_ratios
from sato.compare.measure import Measurement, SolveOutcome, SolverProcess, measure_solvers
from sato.compare.plan import ComparisonPlan, make_plan
from sato.compare.report import (
    describe_machine,
    find_violations,
    list_failures,
    summarize,
    write_comparison,
)

KNOWN = load_adapters()
ABSENT = SolverAdapter("absent", frozenset({"linear"}), False, Honest, "absent_", "absent")


def box_family(size="small", feasible=True, with_10=None):
    """Return three instances of x ≥ lower with different limits, in one of which b₀ is 10."""
    rng = np.random.default_rng(0)
    q, A = rng.uniform(1, 2, 4), csc_array(-np.eye(4))
    instances = []
    for i in range(3):
        lower = rng.normal(size=4)
        lower[0] = -10 if i == with_10 else lower[0]
        problem = ConicProgram(q, A, -lower, 0, 4)
        reference = float(q @ lower) if feasible else float("nan")
        instances.append(Instance(f"{size}/{i}", problem, feasible, reference, 0.0, lower, q))
    return Family("box", size, 0, "drawn here", ("none",), tuple(instances))


FAMILY, INFEASIBLE = box_family(), box_family(feasible=False)


def measure(*names, families=(FAMILY,), repeats=1, tolerances=(1e-4,), patience=10.0, **options):
    """Measure fake solvers."""
    plan = ComparisonPlan(families, tuple(map(fake_solver, names)), tolerances, repeats, patience)
    return measure_solvers(plan, np.random.default_rng(0), **options)


def verdicts(measurements):
    return [tuple(outcome.verdict for outcome in m.outcomes) for m in measurements]


def made_up(solver="a", seconds=1.0, verdict="solved", instance=0, tolerance=1e-6, **numbers):
    """Return a made-up measurement."""
    exact = dict.fromkeys(("cost_error", "primal_residual", "dual_residual", "gap"), 0.0)
    outcome = SolveOutcome(verdict, "reason", seconds, 5, **exact | numbers)
    return Measurement(solver, FAMILY, FAMILY.instances[instance], tolerance, (outcome,))


def test_correct_solver_is_solved_in_both_solves(capfd):
    found = measure("printing", repeats=2, tolerances=(1e-4, 1e-6))
    assert capfd.readouterr() == ("", "")  # what a library prints stays in its process
    assert verdicts(found) == 2 * 3 * [("solved", "solved")]
    for outcome in (outcome for m in found for outcome in m.outcomes):
        assert outcome.cost_error < 1e-14
        assert outcome.iterations == 7 and outcome.seconds > 0


def test_claims_are_verified_and_other_solvers_go_on():
    expected = {
        "wrong": ("wrong claim", "primal residual"),
        "pessimist": ("wrong claim", "infeasible (there is none)"),
        "raising": ("crashed", "ValueError: no idea"),
        "honest": ("solved", "done"),
    }
    found = measure(*expected)
    assert len(found) == 3 * len(expected)
    for m in found:
        verdict, reason = expected[m.solver]
        assert m.outcomes[0].verdict == verdict and reason in m.outcomes[0].reason
        assert m.is_correct == (m.solver == "honest")
    assert not multiprocessing.active_children()


def test_second_solve_is_verified_too():
    found = measure("constant", repeats=2)
    assert verdicts(found) == 3 * [("solved", "wrong claim")]
    assert not any(m.is_correct for m in found)


def test_only_instances_with_the_same_matrix_are_solved_in_one_session():
    one, two, three = FAMILY.instances
    other = replace(three, problem=replace(three.problem, A=three.problem.A.copy()))
    family = replace(FAMILY, instances=(one, two, other))
    assert [len(m.outcomes) for m in measure("honest", families=(family,))] == [2, 2, 1]


def test_answers_to_infeasible_problems_are_wrong_or_unproven():
    found = measure("honest", "pessimist", families=(INFEASIBLE,))
    assert verdicts(found) == 3 * [("solved", "solved")] + 3 * [("unproven", "unproven")]
    assert "known to be infeasible" in find_violations(found)[0]
    assert not any(m.is_correct for m in found)


def test_hang_is_ended_and_larger_or_tighter_problems_are_skipped():
    families = box_family(with_10=2), box_family("medium")
    found = measure("hangingat10", families=families, tolerances=(1e-4, 1e-6), patience=0.2)
    assert verdicts(found)[:3] == [
        ("solved", "skipped"),
        ("solved", "solved"),
        ("skipped", "crashed"),
    ]
    assert found[2].outcomes[1] == SolveOutcome("crashed", "no answer within 2 s", 2.0)
    skipped = SolveOutcome("skipped", "it took more than 0.2 s at small, 1e-4")
    assert [m.outcomes for m in found[3:]] == 9 * [(skipped, skipped)]


def test_process_that_ends_after_its_answer_is_restarted():
    worker = SolverProcess(fake_solver("honest"), 60.0)
    try:
        request = FAMILY, 1e-6, list(FAMILY.instances[:2])
        before = worker.solve(*request)
        [process] = multiprocessing.active_children()
        process.kill()
        process.join()
        ended = worker.solve(*request)
        after = worker.solve(*request)
    finally:
        worker.close()
    assert [outcome.verdict for outcome in before + after] == 4 * ["solved"]
    assert [outcome[:2] for outcome in ended] == 2 * [("crashed", "Killed")]


@pytest.mark.parametrize(
    ("instance", "expected"),
    [
        # The second request ends in its second solve, the third in its first, without a second.
        (2, [("solved", "crashed"), ("solved", "solved"), ("crashed", "crashed")]),
        # A crash in the warm-up excludes no solver.
        (0, [("crashed", "crashed"), ("solved", "crashed"), ("solved", "solved")]),
    ],
)
def test_crash_counts_in_the_solve_in_which_it_happened(instance, expected):
    found = measure("crashingat10", families=(box_family(with_10=instance),))
    assert verdicts(found) == expected
    assert [m.is_correct for m in found] == [pair == ("solved", "solved") for pair in expected]
    assert found[instance].outcomes[0].reason == "Aborted"
    assert found[1].outcomes[0].iterations == 3 + 2 * (instance == 2)  # warm-up is both solves


def test_progress_counts_families_and_tolerances():
    reported = []
    families = FAMILY, box_family("medium")
    measure("honest", families=families, progress=lambda *counts: reported.append(counts))
    assert reported == [(1, 2), (2, 2)]


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
    cells = ["1/1", "2/3", "0/1", "1", "1", "4000", "–", "5", "0e+00"]
    assert list(summarize(some, 1e-6).values()) == cells


def test_failures_are_listed_once_each_with_an_example():
    some = [
        made_up("a", verdict="failed"),
        made_up("a", verdict="unproven", instance=1),
        made_up("a", verdict="unproven", instance=2),
    ]
    assert list_failures(some) == [
        "a: failed (1), small/0 at 1e-6: reason",
        "a: unproven (2), small/1 at 1e-6: reason",
    ]


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
    found, machine = [made_up("a"), made_up("b", verdict="failed")], describe_machine([])
    files = write_comparison(found, machine, tmp_path / "new")
    assert sorted(file.name for file in files) == sorted(os.listdir(tmp_path / "new"))
    with open(tmp_path / "new" / "measurements.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["solver"], row["solve"], row["verdict"]) for row in rows] == [
        ("a", "first", "solved"),
        ("b", "first", "failed"),
    ]
    assert json.loads((tmp_path / "new" / "machine.json").read_text()) == machine

    def fails(*_):
        raise OSError("no space left")

    monkeypatch.setattr("sato.compare.figures.draw_comparison", fails)
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
    "no tolerance": ({"tolerances": [1e-6, float("nan")]}, "between 0 and 1, got nan"),
    "a patience without end": ({"patience": float("inf")}, "at most a day, got inf"),
    "a solver that is missing": (
        {"solvers": ["absent"], "families": ["transfer-lp"]},
        "absent is not installed; pip install absent would do; .*clarabel.* can take transfer-lp",
    ),
    "a cone that a solver does not know": (
        {"solvers": ["highs"], "families": ["transfer-socp"]},
        "highs cannot take second-order cones; .*clarabel.* can take transfer-socp",
    ),
    "a form that a solver does not know": (
        {"solvers": ["batched"], "families": ["avoidance-5"], "sizes": ["small"]},
        "batched takes only .*; .*clarabel.* can take avoidance-5",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_impossible_comparison_is_refused(case):
    options, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        make_plan(KNOWN | {"absent": ABSENT}, **options)


def test_missing_solver_is_left_out_with_a_reason_unless_it_is_named():
    plan = make_plan({"clarabel": KNOWN["clarabel"], "absent": ABSENT}, sizes=["small"])
    assert [solver.name for solver in plan.solvers] == ["clarabel"]
    assert plan.exclusions == ("absent is not installed; pip install absent would do",)
    assert plan.tolerances == (1e-6,) and plan.patience < 1
    assert {family.size for family in plan.families} == {"small"}
    everything = make_plan(KNOWN, solvers=["clarabel"], takes_all=True)
    assert everything.tolerances == (1e-4, 1e-6, 1e-8) and everything.patience == 1
    assert {family.size for family in everything.families} == {"small", "medium", "large"}


def call(*args):
    return CliRunner().invoke(app, ["compare", *args])


@pytest.mark.parametrize("violations", [[], ["clarabel: off by 1"]])
def test_command_prints_and_writes_and_exits_with_1_on_a_violation(
    tmp_path, monkeypatch, violations
):
    monkeypatch.setattr("sato.compare.report.find_violations", lambda found: violations)
    one = ("--family", "infeasible", "--size", "small", "--solver", "highs", "--tolerance", "1e-6")
    result = call(*one, "--repeats", "1", "--out", str(tmp_path))
    assert result.exit_code == len(violations), result.stderr
    assert ("sato: clarabel: off by 1" in result.stderr) == bool(violations)
    for text in ("infeasible (small)", "highs", "10/10", "Python", str(tmp_path)):
        assert text in result.stdout
    written = ["accuracy.png", "machine.json", "measurements.csv", "profile.png"]
    assert sorted(os.listdir(tmp_path)) == written


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
