"""Command `sato gains`: design, certify and write the gains of a formation."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, get_args

import numpy as np
from rich.table import Table

from problems.desired_formation import DesiredFormation
from problems.gain_design import GainMethod, design_gains
from problems.rigidity import Dimension, is_globally_rigid, is_redundantly_rigid, is_rigid
from sato.atomic import replace_atomically
from sato.console import TextConsole, progress_bar
from sato.scenario.errors import InputError
from sato.shapes import formation_library as library

METHODS: tuple[Any, ...] = get_args(GainMethod)
MAX_RIGIDITY_EDGES = 3000  # beyond which tests of rigidity take minutes


def print_formations() -> None:
    """Print the names of the library, a line each."""
    names = library.formation_names()
    for name in names:
        formation = library.load_formation(name)
        flat = ", flat" if formation.is_flat else ""
        print(f"{name:{max(map(len, names))}}  {_format_size(formation)}{flat}")


def resolve_formation(name: str, graph: str) -> DesiredFormation:
    """Load the formation of a name in the library, or of a file of points.

    Its graph is the "own" one, the "complete" one, or of a file of pairs of vertices.
    """
    if Path(name).suffix.lower() == ".csv" or Path(name).is_file():
        formation = library.read_formation(name)
    else:
        formation = library.load_formation(name, "complete" if graph == "complete" else "own")
    if graph in ("own", "complete"):
        return formation
    if not Path(graph).is_file():
        raise ValueError(f'--graph takes complete, own or a file, and there is no file "{graph}"')
    adjacency = library.read_graph(graph, len(formation.points))
    try:
        return replace(formation, graph=adjacency)
    except ValueError as error:
        raise ValueError(f"{graph}: {error}") from error


def design_and_save(
    formation: DesiredFormation, method: str, out: Path, joint: bool = False
) -> None:
    """Design gains, print their certificate, and write them, whole or not at all."""
    if method not in METHODS:
        raise InputError("", f'--method takes one of {", ".join(METHODS)}, not "{method}"')
    began = perf_counter()
    with progress_bar("designing the gains"):
        gains = design_gains(formation, method, joint=joint)  # type: ignore[arg-type]
    time = perf_counter() - began
    with replace_atomically(out) as file:
        gains.save(file)
    with progress_bar("testing for rigidity"):
        plane, space = (_rigidity_label(formation, dimension) for dimension in (2, 3))
    table = Table("", "in the plane", "vertical", "both", title=formation.name or None)
    for label, values in (
        ("rate, 1/s", (gains.rate_xy, gains.rate_z, gains.convergence_rate)),
        ("no rate exceeds, 1/s", (gains.bound_xy, gains.bound_z, gains.joint_bound)),
        ("short of it by, %", (100 * gains.gap_xy, 100 * gains.gap_z, 100 * gains.joint_gap)),
    ):
        table.add_row(label, *(f"{value:.4f}" for value in values))
    console = TextConsole(highlight=False, soft_wrap=True)
    console.print(table)
    cure = "" if joint else "; --joint has the best"
    console.print(f"both: for any shares of the two directions in one trace{cure}")
    console.print(f"graph: {_format_size(formation)}, {plane} in the plane, {space} in space")
    console.print(f"method: {gains.method}, {time:.3g} s")
    console.print(
        f"largest entry of A N: {gains.residual_kernel:.1e}, off the structure: "
        f"{gains.residual_structure:.1e}, off the graph: {gains.residual_graph:.1e}"
    )
    console.print(str(out))


def _format_size(formation: DesiredFormation) -> str:
    share = "all" if formation.density == 1 else f"{100 * formation.density:.3g} %"
    return f"{len(formation.points)} vertices, {formation.edge_count} edges ({share})"


def _rigidity_label(formation: DesiredFormation, dimension: Dimension) -> str:
    if formation.density == 1:
        return "globally rigid"
    if formation.edge_count > MAX_RIGIDITY_EDGES:
        return f"not tested with more than {MAX_RIGIDITY_EDGES} edges"
    # The answer holds for points in general position, whichever they are.
    rng = np.random.default_rng(0)
    graph = formation.graph
    if is_globally_rigid(graph, dimension, rng):
        return "globally rigid"
    if is_redundantly_rigid(graph, dimension, rng):
        return "redundantly rigid"
    return "rigid" if is_rigid(graph, dimension, rng) else "flexible"
