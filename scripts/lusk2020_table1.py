"""Table I of [Lusk2020]: time of gain designs and quality of the gains.

The paper does not say on which graph; its code has a benchmark with the complete graph less
n − 3 random pairs, points uniform in a box of 5 m. Both are covered here. Rates are the
least of −A's eigenvalues outside the kernel, in the plane and along the vertical, with mean 1.
The gap is the relative distance to the least rate that is proven to be unattainable. The paper's
rows are as printed there; all others run here, on one thread. "paper's ADMM" is our
implementation of its method.
"""

import time
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from problems.desired_formation import DesiredFormation
from problems.gain_design import GainDesignUndecided, GainMethod, design_gains
from sato.shapes.formation_library import random_dense_graph

SIZES = (5, 20, 50, 100, 200)
PAPER_TIMES = {  # on an i7-7700K, in MATLAB [s]
    "paper: CVX": ("0.54", "32.48", "8684.24", "OOM", "OOM"),
    "paper: ADMM": ("0.01", "0.03", "1.31", "12.26", "134.67"),
}
METHODS: dict[str, GainMethod] = {
    "SDP, Clarabel": "sdp",
    "paper's ADMM": "paper",
    "projection": "projection",
    "design": "auto",
}
TIME_EXPONENT = 5  # power of n with which the time grows at least, where it is long
MIN_EXTRAPOLATED_TIME = 1.0  # what is shorter foretells nothing [s]
BOX_SIZE = 5.0  # [m]


def time_method(
    formations: list[DesiredFormation], method: GainMethod, minutes: float, progress: Console
) -> list[str]:
    """Time a method on ever larger formations, while the next is expected to meet the limit."""
    cells: list[str] = []
    took, n = 0.0, 1
    for formation in formations:
        last, n = n, len(formation.points)
        expected = took * (n / last) ** TIME_EXPONENT if took > MIN_EXTRAPOLATED_TIME else 0.0
        if expected > 60 * minutes:
            cells.append(f"not run,\n> {expected / 60:.0f} min")
            break
        progress.print(f"  {method}, n = {n}")
        begin = time.perf_counter()
        try:
            gains = design_gains(formation, method=method)
        except GainDesignUndecided:
            said = "undecided"
        else:
            said = f"rate {gains.convergence_rate:.3f}\ngap {max(gains.gap_xy, gains.gap_z):.0e}"
        took = time.perf_counter() - begin
        cells.append(f"{took:.3g} s\n{said}")
    return cells


def main(
    minutes: Annotated[float, typer.Option(help="at most, for each design by a slow method")] = 5,
    largest: Annotated[int, typer.Option(help="number of vehicles")] = SIZES[-1],
    seed: int = 0,
) -> None:
    """Print the paper's table with ours below, on the complete graph and on a thinned one."""
    out, progress = Console(), Console(stderr=True)
    rng = np.random.default_rng(seed)
    sizes = [n for n in SIZES if n <= largest]
    points = [rng.uniform(0, BOX_SIZE, (n, 3)) for n in sizes]
    graphs = {
        "complete graph": [~np.eye(n, dtype=bool) for n in sizes],
        "complete graph less n − 3 random pairs": [
            random_dense_graph(n, n - 3, rng) for n in sizes
        ],
    }
    for method in METHODS.values():  # what is imported at first use is not what is timed
        design_gains(DesiredFormation(points[0], graphs["complete graph"][0]), method=method)
    for name, every in graphs.items():
        progress.print(name)
        table = Table("vehicles", *map(str, sizes), title=name, show_lines=True)
        for label, times in PAPER_TIMES.items():
            table.add_row(label, *times[: len(sizes)])
        formations = [DesiredFormation(p, graph) for p, graph in zip(points, every, strict=True)]
        for label, method in METHODS.items():
            table.add_row(label, *time_method(formations, method, minutes, progress))
        out.print(table)


if __name__ == "__main__":
    with threadpool_limits(1):
        typer.run(main)
