"""`sato compare`: measure, print and write."""

from pathlib import Path

import numpy as np

from sato.compare.files import write_comparison
from sato.compare.machine import describe_machine
from sato.compare.measure import measure_solvers
from sato.compare.plan import ComparisonPlan
from sato.compare.summary import find_violations
from sato.compare.tables import print_comparison, print_plan
from sato.console import progress_bar


def run_comparison(plan: ComparisonPlan, folder: Path, seed: int) -> list[str]:
    """Compare solvers, print the tables, and write everything into a folder.

    Returns:
        Guarantees of the toolkit that the comparison violates.
    """
    machine = describe_machine(plan.solvers)
    print_plan(plan, machine)
    with progress_bar("solving") as progress:
        measurements = measure_solvers(plan, np.random.default_rng(seed), progress)
    files = write_comparison(measurements, machine, folder)
    print_comparison(plan, measurements)
    for path in files:
        print(path)
    return find_violations(measurements)
