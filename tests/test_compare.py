"""Comparing solvers, tried with solvers that lie, crash, hang and chatter."""

import csv
import json
import multiprocessing
import os
import platform
import runpy
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from compare_cast import Honest, cast
from scipy.sparse import csc_array
from typer.testing import CliRunner

import sato.compare.figures
from problems.conic import ConicProgram
from problems.families import Family, Instance
from problems.solvers import SolverAdapter, load_adapters
from sato.cli import app
from sato.compare.figures import performance_ratios
from sato.compare.files import COLUMNS, write_comparison
from sato.compare.machine import describe_machine
from sato.compare.measure import Measurement, measure_solvers
from sato.compare.plan import ComparisonPlan, make_plan, next_with_same_matrix
from sato.compare.summary import find_violations, reference_tolerance, summarize
from sato.compare.worker import SolveOutcome, SolveRequest, Worker, WorkerError

KNOWN = load_adapters()
TABULATE = str(Path(__file__).parents[1] / "scripts" / "tabulate_comparison.py")


def questions(size="small", feasible=True, seed=0, poisoned=None):
    """Three instances of x ≥ lower, which share all but the lower limits; in one there is a 10."""
    rng = np.random.default_rng(seed)
    q, A = rng.uniform(1, 2, 4), csc_array(-np.eye(4))
    found = []
    for i in range(3):
        low = rng.normal(size=4)
        low[0] = -10 if i == poisoned else low[0]
        problem = ConicProgram(q, A, -low, 0, 4)
        reference = float(q @ low) if feasible else float("nan")
        found.append(Instance(f"{size}/{i}", problem, feasible, reference, 0.0, low, q))
    return Family("box", size, seed, "drawn here", ("nobody",), tuple(found))


def ask(*names, families=None, repeats=2, tolerances=(1e-4, 1e-6), patience=10.0):
    """What is measured of some of the cast."""
    some = tuple(cast()[name] for name in names)
    what = ComparisonPlan(tuple(families or [questions()]), some, tolerances, repeats)
    return measure_solvers(what, np.random.default_rng(0), patience, solvers=cast)


def measured(solver="a", seconds=1.0, verdict="solved", instance=0, tolerance=1e-6, **numbers):
    """A measurement, made up."""
    exact = dict.fromkeys(("cost_error", "primal_residual", "dual_residual", "gap"), 0.0)
    outcome = SolveOutcome(verdict, "words", seconds, 5, **exact | numbers)
    family = questions()
    return Measurement(
        solver, "box", "small", family.instances[instance], tolerance, outcome, None, 1.0
    )


def test_who_is_right_is_solved_at_first_and_again(capfd):
    found = ask("chatterer")
    assert capfd.readouterr() == ("", "")  # what a library prints stays in its process
    assert len(found) == 2 * 3
    for m in found:
        assert m.is_correct and m.first.verdict == m.second.verdict == "solved"
        assert m.first.cost_error < 1e-14 and m.second.cost_error < 1e-14
        assert m.first.iterations == 7
        assert m.first.seconds > 0 and m.second.seconds > 0


def test_nobody_is_taken_at_their_word_and_others_go_on():
    expected = {
        "liar": ("wrong claim", "primal residual"),
        "prophet": ("wrong claim", "but there is a point"),
        "crasher": ("crashed", "Aborted"),
        "raiser": ("crashed", "ValueError: no idea"),
        "honest": ("solved", "done"),
    }
    found = ask(*expected, tolerances=(1e-4,))
    assert len(found) == 3 * len(expected)
    for m in found:
        verdict, words = expected[m.solver]
        assert m.first.verdict == verdict
        assert words in m.first.reason


def test_nothing_is_left_of_those_who_crash(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ask("crasher", "raiser", repeats=1, tolerances=(1e-4,))
    assert not multiprocessing.active_children()
    assert not list(tmp_path.glob("sato-compare-*"))


def test_an_answer_to_another_right_hand_side_is_judged_too():
    for m in ask("forgetful"):
        assert m.first.verdict == "solved"
        assert m.second.verdict == "wrong claim"
        assert not m.is_correct


def test_a_point_that_is_accepted_where_there_is_none_breaks_a_promise():
    for m in ask("honest", families=[questions(feasible=False)]):
        assert m.first.verdict == "solved" and not m.is_correct
        assert "known to be infeasible" in find_violations([m])[0]


def test_who_is_right_that_there_is_no_point_and_cannot_show_it_tells_no_lie():
    assert {m.first.verdict for m in ask("prophet", families=[questions(feasible=False)])} == {
        "unproven"
    }
    assert {m.first.verdict for m in ask("prophet")} == {"wrong claim"}


def test_who_never_answers_is_ended_and_asked_for_nothing_larger_or_tighter(monkeypatch):
    monkeypatch.setattr("sato.compare.measure.WARMS", 1.0)
    monkeypatch.setattr("sato.compare.measure.HANGS", 1.0)
    found = ask("sleeper", families=[questions(), questions("medium")], patience=0.7)
    assert {m.first.verdict for m in found} == {"skipped"}
    assert {m.first.reason for m in found} == {"it took more than 0.7 s at small, 1e-4"}


def test_who_does_not_answer_within_ten_times_the_patience_has_crashed_there():
    one, two, three = ask(
        "dozer", families=[questions(poisoned=2)], repeats=1, tolerances=(1e-4,), patience=0.5
    )
    assert one.first.verdict == two.first.verdict == two.second.verdict == "solved"
    assert three.first.verdict == "skipped" and three.second.verdict == "crashed"
    assert three.second.reason == "no answer within 5 s" and three.second.seconds == 5


def test_a_process_that_ends_after_its_answer_is_an_outcome_like_others():
    family = questions()
    question = SolveRequest(family.instances[0], family.instances[1], 1e-6)
    worker = Worker(cast, "honest", question, 60.0)
    try:
        assert not worker.solve(question, 60.0).crashed
        [process] = multiprocessing.active_children()
        process.kill()
        process.join()
        with pytest.raises(WorkerError, match="Killed"):
            worker.solve(question, 60.0)
        assert not worker.solve(question, 60.0).crashed  # in a new one
    finally:
        worker.close()


def crashes(poisoned):
    """How each solve of three instances ended, at first and again; one of them is deadly."""
    found = ask("faint", families=[questions(poisoned=poisoned)], repeats=1, tolerances=(1e-4,))
    assert not any(m.is_correct for m in found if "crashed" in {o.verdict for o in m.outcomes})
    return [(m.first.verdict, m.second.verdict) for m in found]


def test_a_crash_belongs_to_the_solve_in_which_it_happened():
    # The second question ends in its second solve, the third in its first, and so has no second.
    assert crashes(2) == [("solved", "crashed"), ("solved", "solved"), ("crashed", "crashed")]


def test_who_crashes_in_the_warm_up_is_asked_all_the_same():
    assert crashes(0) == [("crashed", "crashed"), ("solved", "crashed"), ("solved", "solved")]


def test_whatever_is_measured_both_ways_of_solving_were_tried_before_in_that_process():
    found = ask("faint", families=[questions(poisoned=2)], repeats=1)
    for m in (m for m in found if m.instance.name == "small/0"):
        assert m.first.iterations == 3  # the process of the tighter tolerance is another


def test_what_a_solver_can_take_is_no_part_of_its_time():
    assert all(m.is_correct for m in ask("fussy", repeats=1, tolerances=(1e-4,)))


def test_memory_is_what_one_instance_takes_more():
    found = ask("glutton", "honest", tolerances=(1e-6,), repeats=1)
    glutton, honest = (next(m for m in found if m.solver == n) for n in ("glutton", "honest"))
    assert 60 < glutton.memory_growth < 110  # the second solve takes as much again
    assert honest.memory_growth < 20


def test_everybody_is_asked_as_often_as_was_planned():
    told = []
    what = ComparisonPlan((questions(),), (cast()["honest"], cast()["liar"]), (1e-4, 1e-6), 3)
    measure_solvers(what, np.random.default_rng(0), 10.0, lambda *of: told.append(of), solvers=cast)
    assert told == [(k, what.solve_count) for k in range(2, what.solve_count + 1, 2)]
    assert what.solve_count == 2 * 2 * 3 * 3


def test_only_who_differs_in_b_alone_follows():
    family = questions()
    one, two, three = family.instances
    other = replace(three.problem, A=three.problem.A.copy())
    mixed = replace(family, instances=(one, two, replace(three, problem=other)))
    assert next_with_same_matrix(family) == (two, three, one)
    assert next_with_same_matrix(mixed) == (two, one, None)


def test_a_profile_counts_from_the_fastest_who_is_right():
    # The first is fastest at one question and wrong at the other, where it is faster still.
    some = [
        measured("a", 1.0, instance=0),
        measured("b", 3.0, instance=0),
        measured("a", 0.1, "wrong claim", instance=1),
        measured("b", 2.0, instance=1),
        measured("a", 0.1, "failed", instance=2),
        measured("b", 0.1, "failed", instance=2),
    ]
    assert performance_ratios(some) == {"a": [1.0, np.inf, np.inf], "b": [3.0, 1.0, np.inf]}


def test_a_line_says_how_often_a_solver_was_right_at_each_tolerance():
    some = [
        measured("a", 1.0, tolerance=1e-4),
        measured("a", 3.0, tolerance=1e-6, instance=0),
        measured("a", 5.0, tolerance=1e-6, instance=1),
        measured("a", 9.0, "wrong claim", tolerance=1e-6, instance=2),
        measured("a", 9.0, "skipped", tolerance=1e-8),
    ]
    [line] = summarize(some, reference_tolerance({1e-4, 1e-6, 1e-8}))
    assert line.correct == ("1/1", "2/3", "0/1")
    assert (line.wrong_claims, line.skipped, line.failed) == (1, 1, 0)
    assert line.first == (4.0,) and line.second == (None,)


@pytest.mark.parametrize(
    ("some", "promises"),
    [
        (measured("clarabel"), 0),
        (measured("clarabel", verdict="failed"), 1),
        (measured("clarabel", verdict="failed", tolerance=1e-8), 0),  # more than is promised
        (measured("osqp", verdict="wrong claim"), 0),
        (measured("osqp", gap=1e-5), 1),
        (measured("osqp", dual_residual=float("nan")), 1),
        (measured("osqp", cost_error=0.5), 1),
        (measured("osqp", cost_error=float("nan")), 1),
    ],
)
def test_a_promise_is_of_the_default_solver_or_of_every_accepted_answer(some, promises):
    assert len(find_violations([some])) == promises


def test_a_whole_comparison_is_written_or_nothing(tmp_path, monkeypatch):
    found = ask("honest", "liar")
    on = describe_machine([cast()["honest"]])
    files = write_comparison(found, on, tmp_path / "new")
    assert sorted(file.name for file in files) == sorted(os.listdir(tmp_path / "new"))
    with open(tmp_path / "new" / "measurements.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found) and tuple(rows[0]) == COLUMNS
    assert {row["solver"]: row["first_verdict"] for row in rows} == {
        "honest": "solved",
        "liar": "wrong claim",
    }
    assert json.loads((tmp_path / "new" / "machine.json").read_text()) == on

    def fails(measurements, folder):
        raise OSError("no space left")

    monkeypatch.setattr(sato.compare.figures, "draw", fails)
    with pytest.raises(OSError, match="no space left"):
        write_comparison(found, on, tmp_path / "half")
    assert os.listdir(tmp_path / "half") == []


def test_a_machine_is_described_without_whose_it_is():
    said = json.dumps(describe_machine(KNOWN.values()))
    assert "clarabel" in said and platform.python_version() in said
    assert platform.raan() not in said
    assert os.sep + "home" not in said and os.getcwd() not in said


REFUSED = {
    "an unknown solver": ({"solvers": ["clarbel"]}, "clarbel.*did you mean clarabel"),
    "an unknown family": ({"names": ["transfer-pl"]}, "transfer-pl.*did you mean transfer-lp"),
    "an unknown size": ({"sizes": ["smal"]}, "smal.*did you mean small"),
    "a tolerance that is none": ({"tolerances": [0.0]}, "between 0 and 1, got 0"),
    "no tolerance at all": ({"tolerances": [float("nan")]}, "between 0 and 1, got nan"),
    "no repeats": ({"repeats": 0}, "at least one repeat, got 0"),
    "a solver that is missing": (
        {"solvers": ["absent"]},
        "absent is not installed; pip install absent would do",
    ),
    "a cone that a solver does not know": (
        {"solvers": ["highs"], "names": ["transfer-socp"]},
        "highs cannot take second-order cones, which transfer-socp has; .*clarabel.* can",
    ),
    "a form that a solver does not know": (
        {"solvers": ["batched"], "names": ["avoidance-5"], "sizes": ["small"]},
        "batched cannot take .*avoidance-5.*; .*clarabel.* can",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_compared_is_refused(case):
    words, sentence = REFUSED[case]
    absent = SolverAdapter("absent", frozenset({"linear"}), False, Honest, "absent_", "absent")
    with pytest.raises(ValueError, match=sentence):
        make_plan(KNOWN | {"absent": absent}, **words)


def test_who_is_missing_is_told_where_everybody_was_asked():
    absent = SolverAdapter("absent", frozenset({"linear"}), False, Honest, "absent_", "absent")
    what = make_plan({"clarabel": KNOWN["clarabel"], "absent": absent}, sizes=["small"])
    assert [solver.name for solver in what.solvers] == ["clarabel"]
    assert what.excluded == ("absent is not installed; pip install absent would do",)
    assert what.tolerances == (1e-4, 1e-6, 1e-8)


def call(*words):
    return CliRunner().invoke(app, ["compare", *words])


ONE = ("--family", "transfer-lp", "--size", "small", "--solver", "highs", "--tolerance", "1e-6")


def test_a_comparison_from_the_command_line_says_what_it_found(tmp_path):
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


def test_a_broken_promise_is_an_exit_code(tmp_path, monkeypatch):
    monkeypatch.setattr("sato.compare.command.broken", lambda found: ["clarabel: off by 1"])
    result = call(*ONE, "--repeats", "1", "--out", str(tmp_path))
    assert result.exit_code == 1
    assert "sato: clarabel: off by 1" in result.stderr


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--solver", "clarbel"), "did you mean clarabel?"),
        (("--patience", "0"), "--patience takes a time above 0 s, at most a day, got 0"),
        (("--patience", "inf"), "--patience takes a time above 0 s, at most a day, got inf"),
        (("--patience", "nan"), "--patience takes a time above 0 s, at most a day, got nan"),
        (("--out", "file/below"), "cannot be written to"),
    ],
)
def test_what_is_refused_is_one_sentence_and_nothing_is_written(
    tmp_path, monkeypatch, words, sentence
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    result = call(*words)
    assert result.exit_code == 2
    assert result.stderr.startswith("sato: ") and result.stderr.count("\n") == 1
    assert sentence in result.stderr and "Traceback" not in result.stderr
    assert os.listdir(tmp_path) == ["file"]


def tabulated(folder):
    script = typer.Typer()
    script.command()(runpy.run_path(TABULATE)["main"])
    return CliRunner().invoke(script, [str(folder)])


def test_the_tables_of_a_comparison_know_every_family_and_kind_of_trouble(tmp_path):
    some = [
        measured("a", verdict="failed"),
        measured("a", verdict="unproven", instance=1),
        measured("a", verdict="unproven", instance=2),
    ]
    write_comparison(some, {}, tmp_path)
    result = tabulated(tmp_path)
    assert result.exit_code == 0, result.stderr
    heads, _, cells = result.stdout.splitlines()[:3]
    row = dict(zip(heads.split(" | "), cells.split(" | "), strict=True))
    assert (row["failed"], row["unproven"], row["crashed"]) == ("1", "2", "0")
    assert "| solver | box |" in result.stdout  # a family that no other name is known of


def test_where_nothing_was_compared_there_is_nothing_to_tabulate(tmp_path):
    result = tabulated(tmp_path)
    assert result.exit_code == 2 and not result.stdout
    assert result.stderr.count("\n") == 1 and "measurements.csv cannot be read" in result.stderr
