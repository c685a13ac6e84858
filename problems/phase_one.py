"""Least violation of the cones of a program: its duals certify that there is no feasible point."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_array, hstack, vstack

from dynamics.doors import checked
from problems.conic import ConicProgram, svec


@checked
def relax_cones(problem: ConicProgram) -> ConicProgram:
    """Pose the program of the least violation of the cones.

        minimize t  subject to  b − A x + t e ∈ K,  t ≥ 0

    e is the unit of each cone: 1 for inequalities, (1, 0, …) for second-order cones, the identity
    for matrices. Equations become two inequalities each, b − A x ± t. So every program has a
    feasible point, and an optimum. Where it is above 0, the duals have Aᵀy = 0 and bᵀy = −t, see
    `read_ray`.
    """
    zero, linear, (rows, columns) = problem.zero, problem.linear, problem.A.shape
    e = np.zeros(rows)
    e[:linear] = 1.0
    e[[cone.start for cone in problem.soc_rows]] = 1.0
    for order, cone in zip(problem.psd_orders, problem.psd_rows, strict=True):
        e[cone] = svec(np.eye(order))
    least = csc_array(([-1.0], ([0], [columns])), shape=(1, columns + 1))
    above = hstack([problem.A, -e[:, None]]).tocsr()
    below = hstack([-problem.A[:zero], -e[:zero, None]])
    q, A = np.append(np.zeros(columns), 1.0), csc_array(vstack([below, least, above]))
    b = np.concatenate([-problem.b[:zero], [0.0], problem.b])
    return ConicProgram(q, A, b, 0, zero + 1 + linear, problem.soc_sizes, problem.psd_orders)


def read_ray(problem: ConicProgram, duals: Float[Array, " rows"]) -> Float[Array, " m"]:
    """Return the ray of a program from duals of its relaxation."""
    zero = problem.zero
    ray = duals[zero + 1 :].copy()
    ray[:zero] -= duals[:zero]
    return ray
