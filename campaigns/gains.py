"""Designs of gains for random formations."""

from time import perf_counter
from typing import Any

import numpy as np

from problems.desired_formation import DesiredFormation
from problems.gain_design import GainDesignUndecided, GainMethod, design_gains
from sato.shapes.formation_library import random_dense_graph

BOX_SIZE = 5.0  # [m]


def design(
    rng: np.random.Generator, vehicles: int, graph: str, method: GainMethod
) -> dict[str, Any]:
    """Time a design; rates are the least of −A's eigenvalues outside the kernel, with mean 1.

    Args:
        rng: Generator of points, uniform in a box, and of the graph.
        vehicles: Number n of vehicles.
        graph: "complete", or "dense", which lacks n − 3 random pairs.
        method: Method of the design; `paper` is our implementation of the paper's ADMM.
    """
    points = rng.uniform(0, BOX_SIZE, (vehicles, 3))
    dense = random_dense_graph(vehicles, vehicles - 3, rng)
    edges = dense if graph == "dense" else ~np.eye(vehicles, dtype=bool)
    design_gains(DesiredFormation(points[:5], ~np.eye(5, dtype=bool)), method=method)  # imports
    began = perf_counter()
    try:
        gains = design_gains(DesiredFormation(points, edges), method=method)
    except GainDesignUndecided:
        return {"decided": False, "design_s": perf_counter() - began}
    seconds = perf_counter() - began
    gap = max(gains.gap_xy, gains.gap_z)  # to the least rate that is proven to be unattainable
    return {"decided": True, "design_s": seconds, "rate": gains.convergence_rate, "gap": gap}
