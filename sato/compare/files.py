"""A comparison as files: every measurement as a line, the machine, and the figures."""

import csv
import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from sato.compare.measure import Measurement
from sato.compare.worker import Outcome

MEASUREMENTS, MACHINE = "measurements.csv", "machine.json"
OF_AN_OUTCOME = (
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
    *(f"first_{name}" for name in OF_AN_OUTCOME),
    *(f"again_{name}" for name in OF_AN_OUTCOME),
    "memory_mib",
)


def write(
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
    from sato.plots.compare import draw

    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".saving-", dir=folder) as name:
        workshop = Path(name)
        with open(workshop / MEASUREMENTS, "w", newline="", encoding="utf-8") as file:
            lines = csv.writer(file)
            lines.writerow(COLUMNS)
            lines.writerows(_rows(measurements))
        text = json.dumps(machine, indent=2, ensure_ascii=False)
        (workshop / MACHINE).write_text(text + "\n", encoding="utf-8")
        made = [workshop / MEASUREMENTS, workshop / MACHINE, *draw(measurements, workshop)]
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
            m.instance.feasible,
            m.right,
            *_cells(m.first),
            *(_cells(m.again) if m.again else [""] * len(OF_AN_OUTCOME)),
            _number(m.memory),
        ]


def _cells(outcome: Outcome) -> list[object]:
    return [outcome.verdict, " ".join(outcome.why.split()), *(_number(n) for n in outcome[2:])]


def _number(number: float | int | None) -> object:
    return "" if number is None or number != number else number
