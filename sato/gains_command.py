"""Gains for a formation from the command line: what is asked, what is certified, what is kept."""

import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import get_args

import numpy as np
from rich.console import Console
from rich.table import Table

from problems.formation import Formation
from problems.formation_gain import Gains, Method, design
from problems.rigidity import Dimension, globally_rigid, redundantly_rigid, rigid
from sato.shapes.formation_files import read_formation, with_graph
from sato.shapes.formations import formation, formations
from sato.terminal import waiting

METHODS: dict[str, Method] = {method: method for method in get_args(Method)}
MANY = 3000  # edges, beyond which what rigidity takes grows out of proportion


def tell_formations() -> None:
    """The names of the library, a line each."""
    width = max(map(len, formations()))
    for name in formations():
        shape = formation(name)
        print(f"{name:{width}}  {_count(shape)}{', flat' if shape.flat else ''}")


def asked(name: str, graph: str) -> Formation:
    """The formation that the words mean.

    Args:
        name: In the library, or a file of points.
        graph: "own", "complete", or a file of pairs of vertices.

    Raises:
        ValueError: There is no such formation or graph.
    """
    if Path(name).suffix.lower() == ".csv" or Path(name).is_file():
        shape = read_formation(name)
    else:
        shape = formation(name, "complete" if graph == "complete" else "own")
    if graph in ("own", "complete"):
        return shape
    if not Path(graph).is_file():
        raise ValueError(f'--graph takes complete, own or a file, and there is no file "{graph}"')
    return with_graph(shape, graph)


def home_of(shape: Formation) -> Path:
    """Where gains are written when nothing else is said."""
    return Path("gains", shape.name.replace("/", "-").replace(" ", "-") + ".npz")


def make(shape: Formation, method: str, out: Path) -> None:
    """Design gains, tell what is certain of them, and write them, whole or not at all.

    Raises:
        ValueError: There is no such method.
        NoStabilisingGain: The formation cannot have any.
    """
    if method not in METHODS:
        raise ValueError(f'--method takes one of {", ".join(METHODS)}, not "{method}"')
    began = perf_counter()
    with waiting("designing the gains"):
        gains = design(shape, METHODS[method])
    took = perf_counter() - began
    _keep(gains, out)
    with waiting("asking for rigidity"):
        rigidity = [_rigidity(shape, dimension) for dimension in (2, 3)]
    _tell(gains, took, rigidity)
    print(out)


def _keep(gains: Gains, out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".saving-", dir=out.parent) as workshop:
        whole = Path(workshop, "gains.npz")
        gains.save(whole)
        os.replace(whole, out)


def _tell(gains: Gains, took: float, rigidity: list[str]) -> None:
    console = Console(file=sys.stdout)
    rates = Table(title=gains.formation.name or None, title_justify="left")
    for head in ("", "in the plane", "upwards"):
        rates.add_column(head, justify="right" if head else "left")
    for what, plane, upwards in (
        ("rate, 1/s", gains.rate_xy, gains.rate_z),
        ("no rate exceeds, 1/s", gains.bound_xy, gains.bound_z),
        ("short of it by, %", 100 * gains.gap_xy, 100 * gains.gap_z),
    ):
        rates.add_row(what, f"{plane:.4f}", f"{upwards:.4f}")
    whole = Table(show_header=False)
    for what, said in (
        ("graph", _count(gains.formation)),
        ("method", gains.method),
        ("time, s", f"{took:.3g}"),
        ("largest entry of A N", f"{gains.residual_kernel:.1e}"),
        ("structure, off by", f"{gains.residual_structure:.1e}"),
        ("largest entry off the graph", f"{gains.residual_graph:.1e}"),
        ("graph from above, in space", ", ".join(rigidity)),
    ):
        whole.add_row(what, said)
    console.print(rates)
    console.print(whole)


def _count(shape: Formation) -> str:
    n = len(shape.points)
    edges, every = int(shape.graph.sum()) // 2, n * (n - 1) // 2
    share = "all" if edges == every else f"{100 * edges / every:.3g} %"
    return f"{n} vertices, {edges} edges ({share})"


def _rigidity(shape: Formation, dimension: Dimension) -> str:
    n, edges = len(shape.points), int(shape.graph.sum()) // 2
    if edges == n * (n - 1) // 2:
        return "globally rigid"
    if edges > MANY:
        return f"not asked of more than {MANY} edges"
    questions: dict[str, Callable[..., bool]] = {
        "globally rigid": globally_rigid,
        "redundantly rigid": redundantly_rigid,
        "rigid": rigid,
    }
    # The verdict is of points in general position, whichever they are.
    rng = np.random.default_rng(0)
    return next(
        (word for word, holds in questions.items() if holds(shape.graph, dimension, rng)),
        "flexible",
    )
