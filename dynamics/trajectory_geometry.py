"""What happens between the samples: cubic pieces, and how close they come.

A path over [0, h] is held as the Bézier points of the cubic with the same positions
and velocities at both ends,

    b₀ = p₀,  b₁ = p₀ + v₀ h/3,  b₂ = p₁ − v₁ h/3,  b₃ = p₁,

and it never leaves their convex hull. For a double integrator under a held input it
is the path itself; for other models it is off by at most max |p⁗| h⁴/384, which
`error_bound` bounds for constant matrices, and `missed_by_halves` measures for any path.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from dynamics.bezier_kernels import closest_pair
from dynamics.discretize import DiscreteModel, discretize_zoh
from dynamics.hull import min_norm_points
from dynamics.model import LinearModel


class ClosestApproach(NamedTuple):
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
    def minimum(self) -> ClosestApproach:
        """The closest of all."""
        if not len(self.distance):
            return ClosestApproach(np.inf, -1, 0.0, (-1, -1))
        k = int(np.argmin(self.distance))
        i, j = (int(a) for a in self.pair[k])
        piece = k if i >= 0 else -1
        return ClosestApproach(float(self.distance[k]), piece, float(self.fraction[k]), (i, j))


def resample(
    fine: DiscreteModel, x: Float[Array, "*agents instants n"], u: Float[Array, "*agents T m"]
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


def control_points(
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


def evaluate_bezier(
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
    distance, nearest = min_norm_points(flat)
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
    b = np.moveaxis(
        control_points(np.moveaxis(position, 0, 1), np.moveaxis(velocity, 0, 1), h), 0, 1
    )
    found = Separations(np.full(K, np.inf), np.zeros(K), np.full((K, 2), -1))
    for k in range(K):
        flies = np.flatnonzero(alive[k] & np.isfinite(b[k]).all(axis=(1, 2)))
        if len(flies) > 1:
            distance, fraction, pair = _closest_approach(np.ascontiguousarray(b[k, flies]))
            found.distance[k], found.fraction[k], found.pair[k] = distance, fraction, flies[pair]
    return found


def min_separation(
    position: Float[Array, "instants agents d"],
    velocity: Float[Array, "instants agents d"],
    alive: Bool[Array, "instants agents"],
    h: float | Float[Array, " instants-1"],
) -> ClosestApproach:
    """Least distance of any two agents along the whole path."""
    return separations(position, velocity, alive, h).minimum


def sampled_separations(
    position: Float[Array, "instants agents d"], alive: Bool[Array, "instants agents"]
) -> Float[Array, " instants"]:
    """Least distance of any two live agents at every instant; infinite for fewer than two."""
    there = alive & np.isfinite(position).all(axis=2)
    return np.array([min_distance(p[a]) for p, a in zip(position, there, strict=True)])


def min_distance(points: Float[Array, "k d"]) -> float:
    """Least distance of any two points; infinite for fewer than two."""
    if len(points) < 2:
        return np.inf
    return float(cKDTree(points).query(points, k=2)[0][:, 1].min())


def interpolation_error(
    model: LinearModel,
    x: Float[Array, "*agents instants n"],
    u: Float[Array, "*agents K m"],
    h: float,
    t0: float = 0.0,
) -> float:
    """How far a path may be from its cubic pieces, at most [m].

    Two agents may be closer than their pieces by twice as much. For a model whose matrices
    are constant it is `error_bound`, which is proven. For others it is measured: every piece
    is flown from its start in two halves, and its cubic compared with the middle, as in
    `missed_by_halves`.

    Args:
        model: What moves the agents.
        x: States at the start of each piece; one at the end of the last is not needed.
        u: Inputs, held over each piece.
        h: Length of the pieces [s].
        start: Time of the first instant [s].
    """
    if model.is_time_invariant:
        return interpolation_error_bound(model, x, u, h)
    K, d = u.shape[-2], model.axes
    halves = discretize_zoh(model, h / 2, 2 * K, t0)
    states = [x[..., :K, :]]
    for j in range(2):
        A, B, z = halves.A[j::2], halves.B[j::2], halves.z[j::2]
        moved = np.einsum("kab,...kb->...ka", A, states[-1]) + z
        states.append(moved + np.einsum("kab,...kb->...ka", B, u))
    path = np.stack(states, axis=-2)
    return _midpoint_error(path[..., :d], path[..., d:], h / 2)


def sampled_interpolation_error(
    position: Float[Array, "*agents instants d"],
    velocity: Float[Array, "*agents instants d"],
    h: float,
) -> float:
    """How far a path may be from its cubic pieces, as pieces of twice the length show [m].

    Those miss p⁗ (2h)⁴/384 at their middles, which are instants of the path, and pieces of
    length h a sixteenth of it. It is a measurement, good while p⁗ hardly changes over two
    pieces and the input stays the same in both. Nobody is there where numbers are not finite.
    Two agents may be closer than their pieces by twice as much.

    Args:
        position: At the instants, an odd number of them [m].
        velocity: At the instants [m/s].
        h: Time between them [s].

    Raises:
        ValueError: Some instant is the end of half a piece.
    """
    if position.shape[-2] % 2 == 0:
        raise ValueError(
            f"{position.shape[-2]} instants do not make pieces of twice the length: "
            "an odd number does"
        )
    return _midpoint_error(position, velocity, h) / 16


def interpolation_error_bound(
    model: LinearModel,
    x: Float[Array, "*agents instants n"],
    u: Float[Array, "*agents K m"],
    h: float,
) -> float:
    """How far a path may be from its cubic pieces, proven for constant matrices [m].

    With ẋ = A x + B u + z and the input held, p⁗(t) is the position part of
    A³ e^{At} ẋ(0), whose Taylor series is summed term by term in norm; the cubic
    misses at most max |p⁗| h⁴/384. Two agents may be closer than their pieces by
    twice as much.

    Raises:
        ValueError: The matrices change in time.
    """
    if not model.is_time_invariant:
        raise ValueError(
            f"{type(model).__name__} changes in time, so nothing is proven of its cubic pieces: "
            "ask `missed`, which measures"
        )
    d, A = model.axes, model.A(0.0)
    rate = x[..., : u.shape[-2], :] @ A.T + u @ model.B(0.0).T + model.z(0.0)
    rate = np.where(np.isfinite(rate), rate, 0.0)  # nobody there
    term = rate @ np.linalg.matrix_power(A, 3).T
    total = np.linalg.norm(term[..., :d], axis=-1)
    for j in range(1, 40):
        if not term.any():
            break
        term = term @ A.T * (h / j)
        total = total + np.linalg.norm(term[..., :d], axis=-1)
    return float(np.max(total, initial=0.0)) * h**4 / 384


def _midpoint_error(position: Array, velocity: Array, h: float) -> float:
    """What cubic pieces from every other instant to the next such miss between them."""
    pieces = control_points(position[..., ::2, :], velocity[..., ::2, :], 2 * h)
    off = np.linalg.norm(evaluate_bezier(pieces, 0.5) - position[..., 1::2, :], axis=-1)
    return float(np.max(off, initial=0.0, where=np.isfinite(off)))


def _closest_approach(b: Float[Array, "flies 4 d"]) -> tuple[float, float, Int[Array, " 2"]]:
    # No path leaves the ball about the middle of its ends that holds its four points,
    # so pairs whose balls are further apart than a distance already met are left out.
    bound = min(min_distance(b[:, 0]), min_distance(b[:, 3]))
    middle = (b[:, 0] + b[:, 3]) / 2
    reach = float(np.linalg.norm(b - middle[:, None], axis=2).max())
    radius = (bound + 2 * reach) * (1 + 1e-12)
    pairs = cKDTree(middle).query_pairs(radius, output_type="ndarray")
    distance, fraction, best = closest_pair(b, pairs)
    return float(distance), float(fraction), pairs[best]
