"""A comparison from the command line: asked, measured, told, kept."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from problems.solvers import load_adapters
from sato.compare.files import write_comparison
from sato.compare.machine import describe_machine
from sato.compare.measure import measure_solvers
from sato.compare.plan import ComparisonPlan, make_plan
from sato.compare.summary import find_violations
from sato.compare.tables import print_comparison, print_plan
from sato.console import progress_bar

MAX_PATIENCE = 86400.0  # patience; ten times that can be waited for in 32 bits of milliseconds [s]


def plan_from_options(
    solvers: Iterable[str],
    names: Iterable[str],
    sizes: Iterable[str],
    tolerances: Iterable[float],
    repeats: int,
    patience: float,
) -> ComparisonPlan:
    """What the words of the command line mean; `sato.compare.plan.plan` says what is refused."""
    if not 0 < patience <= MAX_PATIENCE:
        raise ValueError(f"--patience takes a time above 0 s, at most a day, got {patience:g}")
    return make_plan(load_adapters(), solvers, names, sizes, tolerances, repeats)


def run_comparison(what: ComparisonPlan, folder: Path, patience: float, seed: int) -> list[str]:
    """Compare, tell, and write everything into a folder.

    Returns:
        What the toolkit promises and is broken.
    """
    on = describe_machine(what.solvers)
    print_plan(what, on)
    with progress_bar("asking") as progress:
        measurements = measure_solvers(what, np.random.default_rng(seed), patience, progress)
    files = write_comparison(measurements, on, folder)
    print_comparison(what, measurements)
    for path in files:
        print(path)
    return find_violations(measurements)
