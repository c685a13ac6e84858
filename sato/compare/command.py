"""A comparison from the command line: asked, measured, told, kept."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from problems.solvers import adapters
from sato.compare.files import write
from sato.compare.machine import machine
from sato.compare.measure import measure
from sato.compare.plan import Plan, plan
from sato.compare.summary import broken
from sato.compare.tables import tell, tell_plan
from sato.terminal import counted

LONGEST = 86400.0  # patience; ten times that can be waited for in 32 bits of milliseconds [s]


def asked(
    solvers: Iterable[str],
    names: Iterable[str],
    sizes: Iterable[str],
    tolerances: Iterable[float],
    repeats: int,
    patience: float,
) -> Plan:
    """What the words of the command line mean; `sato.compare.plan.plan` says what is refused."""
    if not 0 < patience <= LONGEST:
        raise ValueError(f"--patience takes a time above 0 s, at most a day, got {patience:g}")
    return plan(adapters(), solvers, names, sizes, tolerances, repeats)


def make(what: Plan, folder: Path, patience: float, seed: int) -> list[str]:
    """Compare, tell, and write everything into a folder.

    Returns:
        What the toolkit promises and is broken.
    """
    on = machine(what.solvers)
    tell_plan(what, on)
    with counted("asking") as progress:
        measurements = measure(what, np.random.default_rng(seed), patience, progress)
    files = write(measurements, on, folder)
    tell(what, measurements)
    for path in files:
        print(path)
    return broken(measurements)
