"""Gains compared with those of a general solver, on random sparse graphs, rigid in the plane.

A rate is the least of −A's eigenvalues outside the kernel. Where a formation can have no
stabilizing gains, both must say so; nothing unstable may come out. A method may also leave it
undecided: then the rate of the general solver must not be above what it says is proven.
"""

import sys
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from problems import gain_sdp as sdp
from problems.desired_formation import DesiredFormation
from problems.gain_design import GainDesignUndecided, GainMethod, NoStabilizingGain, design_gains
from problems.gain_problem import GainProblem, NoGainMatrix
from problems.rigidity import is_rigid

DECIMALS = 3  # that must agree
BOX_SIZE = 5.0  # [m]


def draw_sparse_formation(least: int, most: int, rng: np.random.Generator) -> DesiredFormation:
    """Draw a formation with a random graph, until it is rigid, often minimally."""
    while True:
        n = int(rng.integers(least, most + 1))
        enough = (2 * n - 3) / (n * (n - 1) / 2)
        upper = np.triu(rng.random((n, n)) < rng.uniform(enough, max(enough, 0.6)), 1)
        graph = upper | upper.T
        if is_rigid(graph, 2, rng):
            return DesiredFormation(rng.uniform(0, BOX_SIZE, (n, 3)), graph)


def sdp_rate(kernel: np.ndarray, graph: np.ndarray) -> float:
    """Return the best rate by the general solver; −∞ if no gain matrix exists."""
    question = GainProblem(kernel, graph)
    try:
        return question.convergence_rate(sdp.solve(question)[0])
    except NoGainMatrix:
        return -np.inf


def design_rates(
    formation: DesiredFormation, method: GainMethod
) -> dict[str, float] | NoStabilizingGain | GainDesignUndecided:
    """Return the rates in the plane and along the vertical, or the verdict."""
    try:
        gains = design_gains(formation, method=method)
    except (NoStabilizingGain, GainDesignUndecided) as verdict:
        return verdict
    return {"xy": gains.rate_xy, "z": gains.rate_z}


def main(
    count: Annotated[int, typer.Option(help="graphs")] = 50,
    least: Annotated[int, typer.Option(help="vehicles")] = 5,
    most: Annotated[int, typer.Option(help="vehicles")] = 15,
    method: Annotated[GainMethod, typer.Option(help="auto, admm, …")] = "auto",
    seed: int = 0,
) -> None:
    """Compare; exit with 1 if any rate differs, or is not positive."""
    rng = np.random.default_rng(seed)
    table = Table("n", "edges", "xy: SDP", "ours", "z: SDP", "ours", "")
    refused = undecided = wrong = 0
    apart = 0.0
    for _ in track(range(count), "graphs", console=Console(stderr=True), transient=True):
        formation = draw_sparse_formation(least, most, rng)
        best = {
            "xy": sdp_rate(formation.kernel_xy, formation.graph),
            "z": sdp_rate(formation.kernel_z, formation.graph),
        }
        found = design_rates(formation, method)
        size = [str(len(formation.points)), str(formation.graph.sum() // 2)]
        if isinstance(found, NoStabilizingGain):
            refused += 1
            right = best[found.axes] <= 10**-DECIMALS / 2
            rates = [f"{best['xy']:.4f}", "none", f"{best['z']:.4f}", "none"]
            table.add_row(*size, *rates, f"{found.axes}: at most {found.bound:.1e}")
        elif isinstance(found, GainDesignUndecided):
            undecided += 1
            right = best[found.axes] <= found.bound + 10**-DECIMALS / 2
            rates = [f"{best['xy']:.4f}", "undecided", f"{best['z']:.4f}", "undecided"]
            table.add_row(*size, *rates, f"{found.axes}: up to {found.bound:.1e}")
        else:
            off = max(abs(found[which] - best[which]) for which in best)
            apart = max(apart, off)
            right = off < 10**-DECIMALS / 2 and min(found.values()) > 0
            rates = [f"{rate:.4f}" for which in best for rate in (best[which], found[which])]
            table.add_row(*size, *rates, "" if right else "[red]differs")
        wrong += not right
    Console().print(table)
    print(
        f"{count - refused - undecided} designed, largest difference {apart:.1e}; "
        f"{refused} refused, by proof; {undecided} undecided"
    )
    print(f"{wrong} of {count} wrong")
    sys.exit(int(wrong > 0))


if __name__ == "__main__":
    with threadpool_limits(1):
        typer.run(main)
