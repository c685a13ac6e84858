"""Gains by splitting: the nearest that fits, and the nearest that is faster, in turns."""

import numpy as np
from jaxtyping import Inexact
from numpy import ndarray as Array
from scipy.linalg import eigh

from problems.gain_problem import MIN_RATE, GainProblem, GainSolution

RATE_TOLERANCE = 5e-4  # between the rate and its bound, relative
MAX_ITERATIONS = 3000  # at most
CHECK_INTERVAL = 5  # rounds between two looks at rate and bound
OVER_RELAXATION = 1.7  # of a step; less than 2
ANDERSON_MEMORY = 20  # steps from which the next is foretold …
MAX_STORED_NUMBERS = 4_000_000  # … or fewer, so that no more numbers than these are kept
RESTART_FACTOR = 2.0  # times the least mismatch so far: what was foretold was wrong


def solve(
    question: GainProblem, tolerance: float = RATE_TOLERANCE, max_iterations: int = MAX_ITERATIONS
) -> GainSolution:
    """Gains whose rate is proven to be within a tolerance of the best.

        maximise t  subject to  L ⪰ t (I − K Kᴴ),  L K = 0,  tr L = m,  L_ij = 0 at non-edges

    by Douglas–Rachford splitting, which is ADMM seen from the dual [Eckstein1992]:

        X ← raise the smallest eigenvalues of W to a common level, ρ in all
        L ← the nearest to 2X − W that fits; Y ← what that drops at the non-edges
        W ← W + 1.7 (L − X)

    The first line is the proximal step of −λ_min on the complement of K. The second is one
    system in n × r unknowns, factored once, however many non-edges there are
    (`Question.split`). At the fixed point, the projection drops just what makes X − W, the
    dual, a multiple of the identity on what fits; so Y gives the bound with nothing to be
    repaired, and it holds wherever the method is stopped (`Question.bound`).

    ρ is the scale of L − (I − K Kᴴ) against that of a matrix of trace one, and is kept. The
    next W is foretold from the last mismatches [Walker2011], and where that leads astray it
    is taken back; it saves half of the rounds on sparse graphs.

    Args:
        question: Kernel and graph.
        tolerance: Share of the bound by which the rate may be less.
        rounds: When to give up; what was best by then is returned.

    Returns:
        The fastest L seen, by its own rate, and the Y of the least bound. The first of each
        are those of the projection of I − K Kᴴ. The bound is below `NO_RATE` where no gains
        stabilise.

    Raises:
        NoMatrix: Graph and kernel leave no matrix with a trace.
    """
    K = question.kernel
    ideal = np.eye(len(K)) - K @ K.conj().T
    L, Y = question.project_with_remainder(ideal)
    best = BestSolution(question, GainSolution(L, Y))
    strength = float(np.sqrt(question.m) * np.linalg.norm(L - ideal))
    if strength <= 1e-12 * question.m:
        return best.solution
    W, course = L, _AndersonAcceleration(L)
    for k in range(1, max_iterations + 1):
        if k % CHECK_INTERVAL == 1 and best.is_within(tolerance):
            break
        X = _prox_least_eigenvalue(question, W, strength)
        L, Y = question.project_with_remainder(2 * X - W)
        if k % CHECK_INTERVAL == 0:
            best.update(GainSolution(L, Y))
        W = course.next_iterate(W, L - X)
    return best.solution


class BestSolution:
    """The best of both sides so far; they need not be of the same round."""

    def __init__(self, question: GainProblem, first: GainSolution) -> None:
        self.question, self.solution = question, first
        self.rate, self.bound = question.convergence_rate(first.L), question.rate_bound(first.Y)

    def update(self, answer: GainSolution) -> None:
        """Compare."""
        rate, bound = self.question.convergence_rate(answer.L), self.question.rate_bound(answer.Y)
        if rate > self.rate:
            self.rate, self.solution = rate, self.solution._replace(L=answer.L)
        if bound < self.bound:
            self.bound, self.solution = bound, self.solution._replace(Y=answer.Y)

    def is_within(self, tolerance: float) -> bool:
        """Whether there is no more to be had."""
        return self.bound <= MIN_RATE or self.bound - self.rate <= tolerance * self.bound


class _AndersonAcceleration:
    """Where to go next, from where the last steps led (Anderson's acceleration)."""

    def __init__(self, W: Array) -> None:
        size = W.size * (2 if np.iscomplexobj(W) else 1)
        memory = max(2, min(ANDERSON_MEMORY, MAX_STORED_NUMBERS // size))
        self.iterate_changes, self.residual_changes = np.empty((2, memory, size))
        self.gram = np.zeros((memory, memory))
        self.count = 0
        self.least_residual = np.inf
        self.last: tuple[Array, Array] | None = None  # where a plain step led, and its mismatch

    def next_iterate(self, W: Inexact[Array, "n n"], mismatch: Inexact[Array, "n n"]) -> Array:
        """The next point, from this one and the mismatch at it."""
        if (
            self.last is not None
            and np.linalg.norm(mismatch) > RESTART_FACTOR * self.least_residual
        ):
            plain, mismatch = self.last
            self.count, self.last, self.least_residual = 0, None, float(np.linalg.norm(mismatch))
            return plain
        plain = W + OVER_RELAXATION * mismatch
        if self.last is not None:
            self._store(plain - self.last[0], mismatch - self.last[1])
        self.last = plain, mismatch
        self.least_residual = min(self.least_residual, float(np.linalg.norm(mismatch)))
        return self._extrapolate(plain, mismatch) if self.count else plain

    def _store(self, move: Array, change: Array) -> None:
        at = self.count % len(self.iterate_changes)
        self.iterate_changes[at], self.residual_changes[at] = (
            _to_real_vector(move),
            _to_real_vector(change),
        )
        self.count += 1
        known = min(self.count, len(self.iterate_changes))
        along = self.residual_changes[:known] @ self.residual_changes[at]
        self.gram[at, :known] = self.gram[:known, at] = along

    def _extrapolate(self, plain: Array, mismatch: Array) -> Array:
        # The mixture of steps with the least mismatch, were the mismatch linear.
        known = min(self.count, len(self.iterate_changes))
        G = self.gram[:known, :known]
        G = G + 1e-10 * G.trace() * np.eye(known)
        shares = np.linalg.solve(G, self.residual_changes[:known] @ _to_real_vector(mismatch))
        ahead = (shares @ self.iterate_changes[:known]).view(plain.dtype)
        return np.asarray(plain - ahead.reshape(plain.shape))


def _to_real_vector(M: Array) -> Array:
    return np.ascontiguousarray(M).view(np.float64).ravel()


def _prox_least_eigenvalue(question: GainProblem, W: Array, strength: float) -> Array:
    # argmin of −λ_min(X) + ‖X − W‖² / (2 ρ): as water fills a basin.
    m = question.m
    λ, V = eigh(question.shift_kernel(W), driver="evd", check_finite=False)
    levels = (np.cumsum(λ[:m]) + strength) / np.arange(1, m + 1)
    wet = int(np.count_nonzero(levels > λ[:m]))
    lifted = V[:, :wet] * (levels[wet - 1] - λ[:wet])
    return np.asarray(W + lifted @ V[:, :wet].conj().T)
