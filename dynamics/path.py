"""What happens between the samples: cubic pieces, and how close they come.

A path over [0, h] is held as the Bézier points of the cubic with the same positions
and velocities at both ends,

    b₀ = p₀,  b₁ = p₀ + v₀ h/3,  b₂ = p₁ − v₁ h/3,  b₃ = p₁,

and it never leaves their convex hull. For a double integrator under a held input it
is the path itself; for other models it is off by at most max |p⁗| h⁴/384, which
`error_bound` bounds.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from dynamics.closest import closest_pair
from dynamics.discretise import Steps
from dynamics.model import LinearModel


class Closest(NamedTuple):
    """Where two agents come closest."""

    distance: float  # [m]; infinite where there are no two agents
    piece: int  # k, between instants k and k + 1; −1 where there are no two agents
    fraction: float  # of the piece, in [0, 1]
    pair: tuple[int, int]


class Separations(NamedTuple):
    """The closest two agents of every piece."""

    distance: Float[Array, " K"]  # [m]; infinite where fewer than two agents fly
    fraction: Float[Array, " K"]  # of the piece, in [0, 1]
    pair: Int[Array, "K 2"]  # −1 where fewer than two agents fly

    @property
    def least(self) -> Closest:
        """The closest of all."""
        if not len(self.distance):
            return Closest(np.inf, -1, 0.0, (-1, -1))
        k = int(np.argmin(self.distance))
        i, j = (int(a) for a in self.pair[k])
        piece = k if i >= 0 else -1
        return Closest(float(self.distance[k]), piece, float(self.fraction[k]), (i, j))


def between(
    fine: Steps, x: Float[Array, "*agents instants n"], u: Float[Array, "*agents T m"]
) -> Float[Array, "*agents fine_instants n"]:
    """States at finer instants, each step flown from its own start.

    The given states are kept as they are. Exact where `fine` is.

    Args:
        fine: The same dynamics in steps s times shorter: `hold(model, dt / s, T * s)`.
        x: States at the coarse instants.
        u: Inputs held over the coarse steps.

    Raises:
        ValueError: The fine steps do not divide the coarse ones.
    """
    T = u.shape[-2]
    s = len(fine) // T if T else 1
    if s * T != len(fine) or (T and s == 0):
        raise ValueError(f"{len(fine)} fine steps do not divide {T} steps evenly")
    found = np.empty((*x.shape[:-2], T * s + 1, x.shape[-1]))
    found[..., ::s, :] = x
    state = x[..., :-1, :]
    for j in range(s - 1):
        A, B, z = fine.A[j::s], fine.B[j::s], fine.z[j::s]
        state = np.einsum("kab,...kb->...ka", A, state) + np.einsum("kab,...kb->...ka", B, u) + z
        found[..., j + 1 :: s, :] = state
    return found


def controls(
    position: Float[Array, "*agents instants d"],
    velocity: Float[Array, "*agents instants d"],
    h: float | Float[Array, " instants-1"],
) -> Float[Array, "*agents instants-1 4 d"]:
    """Bézier points of every piece.

    Args:
        position: At the instants [m].
        velocity: At the instants [m/s].
        h: Length of the pieces, one for all or one each [s].
    """
    third = (np.asarray(h) / 3)[..., None]
    first, last = position[..., :-1, :], position[..., 1:, :]
    return np.stack(
        [first, first + velocity[..., :-1, :] * third, last - velocity[..., 1:, :] * third, last],
        axis=-2,
    )


def at(
    points: Float[Array, "*k 4 d"], fraction: float | Float[Array, "*k"]
) -> Float[Array, "*k d"]:
    """Position on a piece, at a fraction of its time."""
    t = np.asarray(fraction)[..., None]
    s = 1 - t
    b = np.moveaxis(points, -2, 0)
    return np.asarray(s**3 * b[0] + 3 * s**2 * t * b[1] + 3 * s * t**2 * b[2] + t**3 * b[3])


def hull_distance(
    points: Float[Array, "*k 4 d"],
) -> tuple[Float[Array, "*k"], Float[Array, "*k d"]]:
    """Least-norm point of the convex hull of four points, in the plane or in space.

    The distance is max over unit n of min_i n·b_i, and the best n stands square on a
    vertex, an edge or a face: all are tried. Whatever n rounding leaves, the law
    n·b_i ≥ distance holds for it, also where points coincide or lie on a line.

    Returns:
        The distance, 0 where the hull holds the origin, and the point, distance × n.
    """
    d = points.shape[-1]
    if d not in (2, 3):
        raise ValueError(f"points have 2 or 3 axes, got {d}")
    flat = np.ascontiguousarray(points, dtype=float).reshape(-1, 4, d)
    distance, nearest = _hulls(flat)
    return distance.reshape(points.shape[:-2]), nearest.reshape(*points.shape[:-2], d)


def separations(
    position: Float[Array, "instants agents d"],
    velocity: Float[Array, "instants agents d"],
    alive: Bool[Array, "instants agents"],
    h: float | Float[Array, " instants-1"],
) -> Separations:
    """Least distance of any two agents along every piece, exact for cubic pieces.

    An agent flies a piece when it is alive at its start; one that is lost at its end
    has still flown it, if it left its state there.
    """
    K = len(position) - 1
    b = np.moveaxis(controls(np.moveaxis(position, 0, 1), np.moveaxis(velocity, 0, 1), h), 0, 1)
    found = Separations(np.full(K, np.inf), np.zeros(K), np.full((K, 2), -1))
    for k in range(K):
        flies = np.flatnonzero(alive[k] & np.isfinite(b[k]).all(axis=(1, 2)))
        if len(flies) > 1:
            distance, fraction, pair = _closest(np.ascontiguousarray(b[k, flies]))
            found.distance[k], found.fraction[k], found.pair[k] = distance, fraction, flies[pair]
    return found


def least_separation(
    position: Float[Array, "instants agents d"],
    velocity: Float[Array, "instants agents d"],
    alive: Bool[Array, "instants agents"],
    h: float | Float[Array, " instants-1"],
) -> Closest:
    """Least distance of any two agents along the whole path."""
    return separations(position, velocity, alive, h).least


def sampled_separations(
    position: Float[Array, "instants agents d"], alive: Bool[Array, "instants agents"]
) -> Float[Array, " instants"]:
    """Least distance of any two live agents at every instant; infinite for fewer than two."""
    there = alive & np.isfinite(position).all(axis=2)
    return np.array([_nearest(p[a]) for p, a in zip(position, there, strict=True)])


def error_bound(
    model: LinearModel,
    x: Float[Array, "*agents instants n"],
    u: Float[Array, "*agents K m"],
    h: float,
    start: float = 0.0,
) -> float:
    """How far a path may be from its cubic pieces, at most [m].

    With ẋ = A x + B u + z and the input held, p⁗(t) is the position part of
    A³ e^{At} ẋ(0), whose Taylor series is summed term by term in norm; the cubic
    misses at most max |p⁗| h⁴/384. Two agents may be closer than their pieces by
    twice as much. A model whose matrices vary is taken as `hold` flies it, frozen
    at the middle of each piece.
    """
    K, d = u.shape[-2], model.axes
    worst = 0.0
    for k in range(K):
        t = start + (k + 0.5) * h
        A = model.A(t)
        rate = x[..., k, :] @ A.T + u[..., k, :] @ model.B(t).T + model.z(t)
        rate = np.where(np.isfinite(rate), rate, 0.0)  # nobody there
        term = rate @ np.linalg.matrix_power(A, 3).T
        total = np.linalg.norm(term[..., :d], axis=-1)
        for j in range(1, 40):
            if not term.any():
                break
            term = term @ A.T * (h / j)
            total = total + np.linalg.norm(term[..., :d], axis=-1)
        worst = max(worst, float(np.max(total, initial=0.0)))
    return worst * h**4 / 384


def _nearest(points: Float[Array, "k d"]) -> float:
    if len(points) < 2:
        return np.inf
    return float(cKDTree(points).query(points, k=2)[0][:, 1].min())


def _closest(b: Float[Array, "flies 4 d"]) -> tuple[float, float, Int[Array, " 2"]]:
    # No path leaves the ball about the middle of its ends that holds its four points,
    # so pairs whose balls are further apart than a distance already met are left out.
    bound = min(_nearest(b[:, 0]), _nearest(b[:, 3]))
    middle = (b[:, 0] + b[:, 3]) / 2
    reach = float(np.linalg.norm(b - middle[:, None], axis=2).max())
    radius = (bound + 2 * reach) * (1 + 1e-12)
    pairs = cKDTree(middle).query_pairs(radius, output_type="ndarray")
    distance, fraction, best = closest_pair(b, pairs)
    return float(distance), float(fraction), pairs[best]


@numba.njit(cache=True)
@no_type_check
def _hulls(points):
    count, _, d = points.shape
    distance, nearest = np.zeros(count), np.zeros((count, d))
    best, n = np.empty(d), np.empty(d)
    for q in range(count):
        b = points[q]
        least = 0.0
        best[:] = 0.0
        for i in range(4):
            n[:] = b[i]
            least = _try(b, n, least, best)
            for j in range(i):
                if d == 2:
                    n[0], n[1] = b[j, 1] - b[i, 1], b[i, 0] - b[j, 0]
                    least = _try(b, n, least, best)
                    continue
                n[:] = b[i]
                _square(n, b[j] - b[i])
                least = _try(b, n, least, best)
                for m in range(j):
                    e, f = b[j] - b[i], b[m] - b[i]
                    n[0] = e[1] * f[2] - e[2] * f[1]
                    n[1] = e[2] * f[0] - e[0] * f[2]
                    n[2] = e[0] * f[1] - e[1] * f[0]
                    least = _try(b, n, least, best)
        distance[q] = least
        nearest[q] = least * best
    return distance, nearest


@numba.njit(cache=True)
@no_type_check
def _square(n, e):
    # Take from n what lies along e; twice, so that what is left is square to rounding.
    size = (e * e).sum()
    if size > 0.0:
        for _ in range(2):
            n -= e * ((n * e).sum() / size)


@numba.njit(cache=True)
@no_type_check
def _try(b, n, least, best):
    # Both sides of the line or plane square to n.
    size = np.sqrt((n * n).sum())
    if size < 1e-150:
        return least
    low, high = np.inf, -np.inf
    for i in range(4):
        along = 0.0
        for a in range(len(n)):
            along += n[a] / size * b[i, a]
        low, high = min(low, along), max(high, along)
    if low > least:
        best[:] = n / size
        return low
    if -high > least:
        best[:] = -n / size
        return -high
    return least
