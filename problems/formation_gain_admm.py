"""Gains by splitting: the nearest that fits, and the nearest that is faster, in turns."""

import numpy as np
from jaxtyping import Inexact
from numpy import ndarray as Array
from scipy.linalg import eigh

from problems.gain_question import NO_RATE, Answer, Question

TOLERANCE = 5e-4  # between the rate and its bound, relative
ROUNDS = 3000  # at most
CHECK = 5  # rounds between two looks at rate and bound
RELAXED = 1.7  # of a step; less than 2
MEMORY = 20  # steps from which the next is foretold …
NUMBERS = 4_000_000  # … or fewer, so that no more numbers than these are kept
ASTRAY = 2.0  # times the least mismatch so far: what was foretold was wrong


def solve(question: Question, tolerance: float = TOLERANCE, rounds: int = ROUNDS) -> Answer:
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
    L, Y = question.split(ideal)
    best = Best(question, Answer(L, Y))
    strength = float(np.sqrt(question.m) * np.linalg.norm(L - ideal))
    if strength <= 1e-12 * question.m:
        return best.answer
    W, course = L, _Course(L)
    for k in range(1, rounds + 1):
        if k % CHECK == 1 and best.within(tolerance):
            break
        X = _raised(question, W, strength)
        L, Y = question.split(2 * X - W)
        if k % CHECK == 0:
            best.see(Answer(L, Y))
        W = course.next(W, L - X)
    return best.answer


class Best:
    """The best of both sides so far; they need not be of the same round."""

    def __init__(self, question: Question, first: Answer) -> None:
        self.question, self.answer = question, first
        self.rate, self.bound = question.rate(first.L), question.bound(first.Y)

    def see(self, answer: Answer) -> None:
        """Compare."""
        rate, bound = self.question.rate(answer.L), self.question.bound(answer.Y)
        if rate > self.rate:
            self.rate, self.answer = rate, self.answer._replace(L=answer.L)
        if bound < self.bound:
            self.bound, self.answer = bound, self.answer._replace(Y=answer.Y)

    def within(self, tolerance: float) -> bool:
        """Whether there is no more to be had."""
        return self.bound <= NO_RATE or self.bound - self.rate <= tolerance * self.bound


class _Course:
    """Where to go next, from where the last steps led (Anderson's acceleration)."""

    def __init__(self, W: Array) -> None:
        size = W.size * (2 if np.iscomplexobj(W) else 1)
        memory = max(2, min(MEMORY, NUMBERS // size))
        self.moves, self.changes = np.empty((2, memory, size))
        self.products = np.zeros((memory, memory))
        self.count = 0
        self.least = np.inf
        self.last: tuple[Array, Array] | None = None  # where a plain step led, and its mismatch

    def next(self, W: Inexact[Array, "n n"], mismatch: Inexact[Array, "n n"]) -> Array:
        """The next point, from this one and the mismatch at it."""
        if self.last is not None and np.linalg.norm(mismatch) > ASTRAY * self.least:
            plain, mismatch = self.last
            self.count, self.last, self.least = 0, None, float(np.linalg.norm(mismatch))
            return plain
        plain = W + RELAXED * mismatch
        if self.last is not None:
            self._learn(plain - self.last[0], mismatch - self.last[1])
        self.last = plain, mismatch
        self.least = min(self.least, float(np.linalg.norm(mismatch)))
        return self._foretold(plain, mismatch) if self.count else plain

    def _learn(self, move: Array, change: Array) -> None:
        at = self.count % len(self.moves)
        self.moves[at], self.changes[at] = _flat(move), _flat(change)
        self.count += 1
        known = min(self.count, len(self.moves))
        along = self.changes[:known] @ self.changes[at]
        self.products[at, :known] = self.products[:known, at] = along

    def _foretold(self, plain: Array, mismatch: Array) -> Array:
        # The mixture of steps with the least mismatch, were the mismatch linear.
        known = min(self.count, len(self.moves))
        G = self.products[:known, :known]
        G = G + 1e-10 * G.trace() * np.eye(known)
        shares = np.linalg.solve(G, self.changes[:known] @ _flat(mismatch))
        ahead = (shares @ self.moves[:known]).view(plain.dtype)
        return np.asarray(plain - ahead.reshape(plain.shape))


def _flat(M: Array) -> Array:
    return np.ascontiguousarray(M).view(np.float64).ravel()


def _raised(question: Question, W: Array, strength: float) -> Array:
    # argmin of −λ_min(X) + ‖X − W‖² / (2 ρ): as water fills a basin.
    m = question.m
    λ, V = eigh(question.lift(W), driver="evd", check_finite=False)
    levels = (np.cumsum(λ[:m]) + strength) / np.arange(1, m + 1)
    wet = int(np.count_nonzero(levels > λ[:m]))
    lifted = V[:, :wet] * (levels[wet - 1] - λ[:wet])
    return np.asarray(W + lifted @ V[:, :wet].conj().T)
