"""Files of a comparison: measurements, machine, tables and figures."""

import csv
import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from sato.compare.measure import Measurement
from sato.compare.tables import format_markdown
from sato.compare.worker import SolveOutcome

MEASUREMENTS_FILE, MACHINE_FILE, TABLES_FILE = "measurements.csv", "machine.json", "tables.md"
OUTCOME_COLUMNS = ("verdict", "why", "s", *SolveOutcome._fields[3:])
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
    """Write all files of a comparison, or none.

    Args:
        measurements: All measurements.
        machine: The machine that they were taken on.
        folder: Folder, which is created if missing; files of an earlier comparison are replaced.

    Returns:
        The files.
    """
    from sato.compare.figures import draw_comparison

    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".saving-", dir=folder) as name:
        tmp_dir = Path(name)
        with open(tmp_dir / MEASUREMENTS_FILE, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows(_rows(measurements))
        machine_text = json.dumps(machine, indent=2, ensure_ascii=False) + "\n"
        (tmp_dir / MACHINE_FILE).write_text(machine_text, encoding="utf-8")
        (tmp_dir / TABLES_FILE).write_text(format_markdown(measurements), encoding="utf-8")
        draw_comparison(measurements, tmp_dir)
        paths = [folder / path.name for path in sorted(tmp_dir.iterdir())]
        for path in paths:
            os.replace(tmp_dir / path.name, path)
    return paths


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
    reason = " ".join(outcome.reason.split())
    return [outcome.verdict, reason, *map(_blank_if_nan, outcome[2:])]


def _blank_if_nan(number: float | int | None) -> object:
    return "" if number is None or number != number else number
