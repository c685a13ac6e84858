"""Command `sato gains`: design, certify and write the gains of a formation."""

import sys
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, get_args

import numpy as np
from rich.console import Console
from rich.table import Table

from problems.desired_formation import DesiredFormation
from problems.gain_design import GainMatrix, GainMethod, design_gains
from problems.rigidity import Dimension, is_globally_rigid, is_redundantly_rigid, is_rigid
from sato.atomic import replace_atomically
from sato.console import progress_bar
from sato.scenario.errors import InputError
from sato.shapes.formation_library import formation_names, load_formation, read_formation
from sato.shapes.graphs import read_graph

METHODS: tuple[Any, ...] = get_args(GainMethod)
MAX_RIGIDITY_EDGES = 3000  # beyond which tests of rigidity take minutes


def print_formations() -> None:
    """Print the names of the library, a line each."""
    width = max(map(len, formation_names()))
    for name in formation_names():
        formation = load_formation(name)
        flat = ", flat" if formation.is_flat else ""
        print(f"{name:{width}}  {_format_size(formation)}{flat}")


def resolve_formation(name: str, graph: str) -> DesiredFormation:
    """Load the formation that the arguments of the command mean.

    Args:
        name: Name in the library, or a file of points.
        graph: "own", "complete", or a file of pairs of vertices.

    Raises:
        ValueError: There is no such formation or graph.
    """
    if Path(name).suffix.lower() == ".csv" or Path(name).is_file():
        formation = read_formation(name)
    else:
        formation = load_formation(name, "complete" if graph == "complete" else "own")
    if graph in ("own", "complete"):
        return formation
    if not Path(graph).is_file():
        raise ValueError(f'--graph takes complete, own or a file, and there is no file "{graph}"')
    adjacency = read_graph(graph, len(formation.points))
    try:
        return replace(formation, graph=adjacency)
    except ValueError as error:
        raise ValueError(f"{graph}: {error}") from error


def default_path(formation: DesiredFormation) -> Path:
    """Return the path at which gains are written unless another is given."""
    return Path("gains", formation.name.replace("/", "-").replace(" ", "-") + ".npz")


def design_and_save(formation: DesiredFormation, method: str, out: Path) -> None:
    """Design gains, print their certificate, and write them, whole or not at all.

    Raises:
        ValueError: There is no such method.
        NoStabilizingGain: The formation has no stabilizing gains.
    """
    if method not in METHODS:
        raise InputError("", f'--method takes one of {", ".join(METHODS)}, not "{method}"')
    began = perf_counter()
    with progress_bar("designing the gains"):
        gains = design_gains(formation, method)  # type: ignore[arg-type]
    time = perf_counter() - began
    with replace_atomically(out) as file:
        gains.save(file)
    with progress_bar("testing for rigidity"):
        rigidity = [_rigidity_label(formation, dimension) for dimension in (2, 3)]
    _print_report(gains, time, rigidity)
    print(out)


def _print_report(gains: GainMatrix, time: float, rigidity: list[str]) -> None:
    console = Console(file=sys.stdout)
    rates = Table(title=gains.formation.name or None, title_justify="left")
    for head in ("", "in the plane", "vertical"):
        rates.add_column(head, justify="right" if head else "left")
    for label, planar, vertical in (
        ("rate, 1/s", gains.rate_xy, gains.rate_z),
        ("no rate exceeds, 1/s", gains.bound_xy, gains.bound_z),
        ("short of it by, %", 100 * gains.gap_xy, 100 * gains.gap_z),
    ):
        rates.add_row(label, f"{planar:.4f}", f"{vertical:.4f}")
    table = Table(show_header=False)
    for label, text in (
        ("graph", _format_size(gains.formation)),
        ("method", gains.method),
        ("time, s", f"{time:.3g}"),
        ("largest entry of A N", f"{gains.residual_kernel:.1e}"),
        ("structure, off by", f"{gains.residual_structure:.1e}"),
        ("largest entry off the graph", f"{gains.residual_graph:.1e}"),
        ("graph in the plane, in space", ", ".join(rigidity)),
    ):
        table.add_row(label, text)
    console.print(rates)
    console.print(table)


def _format_size(formation: DesiredFormation) -> str:
    share = "all" if formation.density == 1 else f"{100 * formation.density:.3g} %"
    return f"{len(formation.points)} vertices, {formation.edge_count} edges ({share})"


def _rigidity_label(formation: DesiredFormation, dimension: Dimension) -> str:
    if formation.density == 1:
        return "globally rigid"
    if formation.edge_count > MAX_RIGIDITY_EDGES:
        return f"not tested with more than {MAX_RIGIDITY_EDGES} edges"
    tests = {
        "globally rigid": is_globally_rigid,
        "redundantly rigid": is_redundantly_rigid,
        "rigid": is_rigid,
    }
    # The answer holds for points in general position, whichever they are.
    rng = np.random.default_rng(0)
    found = (label for label, test in tests.items() if test(formation.graph, dimension, rng))
    return next(found, "flexible")
