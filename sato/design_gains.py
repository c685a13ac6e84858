"""Gains for a formation from the command line: what is asked, what is certified, what is kept."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import get_args

import numpy as np
from rich.console import Console
from rich.table import Table

from problems.desired_formation import DesiredFormation
from problems.gain_design import GainMatrix, GainMethod, design_gains
from problems.rigidity import Dimension, is_globally_rigid, is_redundantly_rigid, is_rigid
from sato.atomic import replace_atomically
from sato.console import spinner
from sato.scenario.errors import InputError
from sato.shapes.formation_library import formation_names, load_formation, read_formation
from sato.shapes.graphs import read_graph

METHODS: dict[str, GainMethod] = {method: method for method in get_args(GainMethod)}
MAX_RIGIDITY_EDGES = 3000  # edges, beyond which what rigidity takes grows out of proportion


def print_formations() -> None:
    """The names of the library, a line each."""
    width = max(map(len, formation_names()))
    for name in formation_names():
        shape = load_formation(name)
        print(f"{name:{width}}  {_format_size(shape)}{', flat' if shape.is_flat else ''}")


def resolve_formation(name: str, graph: str) -> DesiredFormation:
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
        shape = load_formation(name, "complete" if graph == "complete" else "own")
    if graph in ("own", "complete"):
        return shape
    if not Path(graph).is_file():
        raise ValueError(f'--graph takes complete, own or a file, and there is no file "{graph}"')
    adjacency = read_graph(graph, len(shape.points))
    try:
        return replace(shape, graph=adjacency)
    except ValueError as error:
        raise ValueError(f"{graph}: {error}") from error


def default_path(shape: DesiredFormation) -> Path:
    """Where gains are written when nothing else is said."""
    return Path("gains", shape.name.replace("/", "-").replace(" ", "-") + ".npz")


def design_and_save(shape: DesiredFormation, method: str, out: Path) -> None:
    """Design gains, tell what is certain of them, and write them, whole or not at all.

    Raises:
        ValueError: There is no such method.
        NoStabilisingGain: The formation cannot have any.
    """
    if method not in METHODS:
        raise InputError("", f'--method takes one of {", ".join(METHODS)}, not "{method}"')
    began = perf_counter()
    with spinner("designing the gains"):
        gains = design_gains(shape, METHODS[method])
    took = perf_counter() - began
    with replace_atomically(out) as file:
        gains.save(file)
    with spinner("asking for rigidity"):
        rigidity = [_rigidity_label(shape, dimension) for dimension in (2, 3)]
    _print_report(gains, took, rigidity)
    print(out)


def _print_report(gains: GainMatrix, took: float, rigidity: list[str]) -> None:
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
        ("graph", _format_size(gains.formation)),
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


def _format_size(shape: DesiredFormation) -> str:
    n = len(shape.points)
    edges, every = int(shape.graph.sum()) // 2, n * (n - 1) // 2
    share = "all" if edges == every else f"{100 * edges / every:.3g} %"
    return f"{n} vertices, {edges} edges ({share})"


def _rigidity_label(shape: DesiredFormation, dimension: Dimension) -> str:
    n, edges = len(shape.points), int(shape.graph.sum()) // 2
    if edges == n * (n - 1) // 2:
        return "globally rigid"
    if edges > MAX_RIGIDITY_EDGES:
        return f"not asked of more than {MAX_RIGIDITY_EDGES} edges"
    questions: dict[str, Callable[..., bool]] = {
        "globally rigid": is_globally_rigid,
        "redundantly rigid": is_redundantly_rigid,
        "rigid": is_rigid,
    }
    # The verdict is of points in general position, whichever they are.
    rng = np.random.default_rng(0)
    return next(
        (word for word, holds in questions.items() if holds(shape.graph, dimension, rng)),
        "flexible",
    )
