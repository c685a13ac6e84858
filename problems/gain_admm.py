"""Formation gains by Douglas–Rachford splitting with a proven bound on their rate."""

import numpy as np
from jaxtyping import Inexact
from numpy import ndarray as Array

from problems.gain_problem import MIN_RATE, GainProblem, GainSolution

RATE_TOLERANCE = 5e-4  # between the rate and its bound, relative
MAX_ITERATIONS = 3000
MAX_CHECK_INTERVAL = 5  # iterations between two computations of rate and bound
OVER_RELAXATION = 1.7  # of a step; less than 2
ANDERSON_MEMORY = 20  # steps that the extrapolation uses …
MAX_STORED_NUMBERS = 4_000_000  # … or fewer, to store no more numbers than these
RESTART_FACTOR = 2.0  # times the least residual so far: the extrapolation has failed


def solve(
    problem: GainProblem, tolerance: float = RATE_TOLERANCE, max_iterations: int = MAX_ITERATIONS
) -> GainSolution:
    """Find gains whose rate is within a tolerance of a proven bound.

        maximize t  subject to  L ⪰ t (I − K Kᴴ),  L K = 0,  tr L = m,  L_ij = 0 at non-edges

    by Douglas–Rachford splitting, which is ADMM on the dual [Eckstein1992]:

        X ← raise the smallest eigenvalues of W to a common level, by ρ in total
        L ← projection of 2X − W onto the equations;  Y ← what it removes at the non-edges
        W ← W + 1.7 (L − X)

    The first line is the proximal step of −λ_min on the complement of K. The second is one
    linear system in n × r unknowns, factored once, for any number of non-edges
    (`GainProblem.project`). At the fixed point Y is the dual solution without correction,
    and it proves a bound wherever the iteration stops (`GainProblem.rate_bound`).

    ρ is fixed: the norm of L − (I − K Kᴴ) against that of a matrix of trace one, by the root of
    twice the share of edges, which saves a fifth of the iterations with 20 %. Anderson
    acceleration [Walker2011] extrapolates W and is undone where the residual grows; it saves
    half of the iterations on sparse graphs.

    Args:
        problem: Kernel and graph.
        tolerance: Largest gap between rate and bound, relative to the bound.
        max_iterations: Limit after which the best result so far is returned.

    Returns:
        The fastest L so far and the Y of the least bound. The first of each are those of
        the projection of I − K Kᴴ. The bound is below `MIN_RATE` where no gains stabilize.

    Raises:
        NoGainMatrix: The graph and the kernel admit matrices of trace 0 only.
    """
    ideal = problem.complete_solution
    L, Y = problem.project(ideal)
    best = BestSolution(problem, GainSolution(L, Y))
    strength = float(np.sqrt(2 * problem.edge_share * problem.m) * np.linalg.norm(L - ideal))
    if strength <= 1e-12 * problem.m or best.is_within(tolerance):
        return best.solution
    W, acceleration, interval, unchecked = L, _AndersonAcceleration(L), MAX_CHECK_INTERVAL, 0
    for _ in range(max_iterations):
        X = _prox_least_eigenvalue(problem, W, strength)
        L, Y = problem.project(2 * X - W)
        unchecked += 1
        if unchecked == interval:
            gap, unchecked = best.gap, 0
            best.update(GainSolution(L, Y))
            if best.is_within(tolerance):
                break
            interval = _iterations_left(tolerance, best.gap, gap, interval)
        W = acceleration.next_iterate(W, L - X)
    if unchecked:
        best.update(GainSolution(L, Y))
    return best.solution


def _iterations_left(tolerance: float, gap: float, gap_before: float, interval: int) -> int:
    # Until the next check, as if the gap closed geometrically.
    if not 0 < tolerance < gap < 0.999 * gap_before:
        return MAX_CHECK_INTERVAL
    left = interval * np.log(gap / tolerance) / np.log(gap_before / gap)
    return int(min(left, MAX_CHECK_INTERVAL - 1)) + 1


class BestSolution:
    """Fastest gains and least bound so far, possibly of different iterations."""

    def __init__(self, problem: GainProblem, first: GainSolution) -> None:
        self.problem, self.solution = problem, first
        self.rate, self.bound = problem.convergence_rate(first.L), problem.rate_bound(first.Y)

    def update(self, solution: GainSolution) -> None:
        """Keep the better gains and the better bound."""
        rate, bound = self.problem.convergence_rate(solution.L), self.problem.rate_bound(solution.Y)
        if rate > self.rate:
            self.rate, self.solution = rate, self.solution._replace(L=solution.L)
        if bound < self.bound:
            self.bound, self.solution = bound, self.solution._replace(Y=solution.Y)

    @property
    def gap(self) -> float:
        """Gap between rate and bound, relative to the bound."""
        return (self.bound - self.rate) / abs(self.bound)

    def is_within(self, tolerance: float) -> bool:
        """Return True where rate and bound agree, or the bound excludes stable gains."""
        return self.bound <= MIN_RATE or self.gap <= tolerance


class _AndersonAcceleration:
    """Extrapolation of a fixed-point iteration from its last steps [Walker2011]."""

    def __init__(self, W: Array) -> None:
        size = W.size * (2 if np.iscomplexobj(W) else 1)
        memory = max(2, min(ANDERSON_MEMORY, MAX_STORED_NUMBERS // size))
        self.iterate_changes, self.residual_changes = np.empty((2, memory, size))
        self.gram = np.zeros((memory, memory))
        self.count = 0
        self.least_residual = np.inf
        self.last: tuple[Array, Array] | None = None  # last plain iterate and its residual

    def next_iterate(self, W: Inexact[Array, "n n"], residual: Inexact[Array, "n n"]) -> Array:
        """Extrapolate, or return to the last plain iterate where the residual has grown."""
        size = float(np.linalg.norm(residual))
        if self.last is not None and size > RESTART_FACTOR * self.least_residual:
            plain, residual = self.last
            self.count, self.last = 0, None
            self.least_residual = float(np.linalg.norm(residual))
            return plain
        plain = W + OVER_RELAXATION * residual
        if self.last is not None:
            self._store(plain - self.last[0], residual - self.last[1])
        self.last = plain, residual
        self.least_residual = min(self.least_residual, size)
        return self._extrapolate(plain, residual) if self.count else plain

    def _store(self, iterate_change: Array, residual_change: Array) -> None:
        at = self.count % len(self.iterate_changes)
        self.iterate_changes[at] = _to_real_vector(iterate_change)
        self.residual_changes[at] = _to_real_vector(residual_change)
        self.count += 1
        known = min(self.count, len(self.iterate_changes))
        products = self.residual_changes[:known] @ self.residual_changes[at]
        self.gram[at, :known] = self.gram[:known, at] = products

    def _extrapolate(self, plain: Array, residual: Array) -> Array:
        # The combination of the last steps with the least residual, were it linear.
        known = min(self.count, len(self.iterate_changes))
        G = self.gram[:known, :known]
        G = G + 1e-10 * G.trace() * np.eye(known)
        shares = np.linalg.solve(G, self.residual_changes[:known] @ _to_real_vector(residual))
        ahead = (shares @ self.iterate_changes[:known]).view(plain.dtype)
        return np.asarray(plain - ahead.reshape(plain.shape))


def _to_real_vector(M: Array) -> Array:
    return np.ascontiguousarray(M).view(np.float64).ravel()


def _prox_least_eigenvalue(problem: GainProblem, W: Array, strength: float) -> Array:
    # argmin of −λ_min(X) + ‖X − W‖² / (2 ρ): fill the spectrum from below, as water a basin.
    m = problem.m
    λ, V = np.linalg.eigh(problem.shift_kernel(W))
    levels = (np.cumsum(λ[:m]) + strength) / np.arange(1, m + 1)
    count = int(np.count_nonzero(levels > λ[:m]))
    raised = V[:, :count] * (levels[count - 1] - λ[:count])
    return np.asarray(W + raised @ V[:, :count].conj().T)
