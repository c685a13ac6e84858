"""Lessons: each runs in small size, draws, and has three exercises with answers."""

import runpy
from pathlib import Path

import jupytext
import matplotlib.pyplot as plt
import pytest

FOLDER = Path(__file__).parents[1] / "docs/lessons"
LESSONS = sorted(FOLDER.glob("lesson_*.py"))


@pytest.mark.parametrize("lesson", LESSONS, ids=lambda lesson: lesson.stem)
def test_lesson_runs_without_a_display_and_draws(lesson, monkeypatch, tmp_path):
    figures = []

    def show():
        figures.extend(plt.get_fignums())
        plt.close("all")

    plt.switch_backend("Agg")
    monkeypatch.setattr(plt, "show", show)
    monkeypatch.setenv("SATO_LESSON_SIZE", "small")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(lesson), run_name="__main__")
    assert figures
    assert plt.get_fignums() == []


@pytest.mark.parametrize("lesson", LESSONS, ids=lambda lesson: lesson.stem)
def test_lesson_has_three_exercises_with_answers_that_assert(lesson):
    cells = jupytext.read(lesson, fmt="py:percent").cells
    first = next(k for k, cell in enumerate(cells) if "\n## Exercises\n" in "\n" + cell.source)
    answers = {}
    for cell in cells[first:]:
        if cell.cell_type == "markdown":
            exercise = cell.source.rpartition("## Exercises\n")[2].strip()
            name = exercise.partition("\n")[0]
            assert name not in answers, name
            answers[name] = ""
        else:
            assert cell.metadata.get("tags") == ["hide-cell"], cell.source
            answers[name] += cell.source
    assert [f"### Exercise {k}" for k in (1, 2, 3)] == list(answers)
    assert all("assert " in answer for answer in answers.values())


def test_index_links_to_every_lesson_once():
    page = (FOLDER / "index.md").read_text(encoding="utf-8")
    assert all(page.count(f"({lesson.name})") == 1 for lesson in LESSONS)
