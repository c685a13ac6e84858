"""A comparison as files: every measurement as a line, the machine, and the figures."""

import csv
import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from sato.compare.measure import Measurement
from sato.compare.worker import SolveOutcome

MEASUREMENTS_FILE, MACHINE_FILE = "measurements.csv", "machine.json"
OUTCOME_COLUMNS = (
    "verdict",
    "why",
    "s",
    "iterations",
    "cost_error",
    "primal_residual",
    "dual_residual",
    "gap",
)
COLUMNS = (
    "solver",
    "family",
    "size",
    "instance",
    "tolerance",
    "feasible",
    "right",
    *(f"first_{name}" for name in OUTCOME_COLUMNS),
    *(f"again_{name}" for name in OUTCOME_COLUMNS),
    "memory_mib",
)


def write_comparison(
    measurements: Sequence[Measurement], machine: Mapping[str, object], folder: Path
) -> list[Path]:
    """Write everything, or nothing.

    Args:
        measurements: All of them.
        machine: What they were measured on.
        folder: Made where it is missing; what is there of an earlier comparison is replaced.

    Returns:
        The files.
    """
    from sato.compare.figures import draw_comparison

    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".saving-", dir=folder) as name:
        workshop = Path(name)
        with open(workshop / MEASUREMENTS_FILE, "w", newline="", encoding="utf-8") as file:
            lines = csv.writer(file)
            lines.writerow(COLUMNS)
            lines.writerows(_rows(measurements))
        text = json.dumps(machine, indent=2, ensure_ascii=False)
        (workshop / MACHINE_FILE).write_text(text + "\n", encoding="utf-8")
        made = [
            workshop / MEASUREMENTS_FILE,
            workshop / MACHINE_FILE,
            *draw_comparison(measurements, workshop),
        ]
        for path in made:
            os.replace(path, folder / path.name)
    return [folder / path.name for path in made]


def _rows(measurements: Iterable[Measurement]) -> Iterable[list[object]]:
    for m in measurements:
        yield [
            m.solver,
            m.family,
            m.size,
            m.instance.name,
            m.tolerance,
            m.instance.is_feasible,
            m.is_correct,
            *_outcome_cells(m.first),
            *(_outcome_cells(m.second) if m.second else [""] * len(OUTCOME_COLUMNS)),
            _blank_if_nan(m.memory_growth),
        ]


def _outcome_cells(outcome: SolveOutcome) -> list[object]:
    return [
        outcome.verdict,
        " ".join(outcome.reason.split()),
        *(_blank_if_nan(n) for n in outcome[2:]),
    ]


def _blank_if_nan(number: float | int | None) -> object:
    return "" if number is None or number != number else number
