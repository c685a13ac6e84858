"""Trajectory geometry between samples: cubic pieces, their separation and their error.

A trajectory over [0, h] is represented by the Bézier control points of the cubic with the
same positions and velocities at both ends,

    b₀ = p₀,  b₁ = p₀ + v₀ h/3,  b₂ = p₁ − v₁ h/3,  b₃ = p₁,

whose convex hull contains the cubic. The cubic is exact for a double integrator under a
zero-order hold. Otherwise its error is at most max |p⁗| h⁴/384: `interpolation_error_bound`
bounds it for time-invariant models, `sampled_interpolation_error` estimates it from samples.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np
import scipy
from annotated_types import Ge, Le
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.closest_approach import closest_approaches
from dynamics.convex_hulls import min_norm_points
from dynamics.discretize import discretize_zoh
from dynamics.doors import MAY_BE_NAN, checked
from dynamics.model import FlownControls, FlownStates, LinearModel
from dynamics.orbit import Scalars

MAX_PAIRS = 50_000  # of agents in pieces, that are compared at once
ALL_PAIRS_AGENTS = 24  # up to which pairs of all instants are compared at once
ALL_PAIRS_POINTS = 200  # up to which all pairs are measured sooner than a tree is built

Duration = float | Float[Array, " instants-1"]  # of all pieces, or of each [s]
# Positions or velocities at the instants; those of absent agents are NaN.
AgentSamples = Annotated[Float[Array, "instants agents d"], MAY_BE_NAN]
Samples = Annotated[Float[Array, "*agents instants d"], MAY_BE_NAN]


class ClosestApproach(NamedTuple):
    """Closest approach of any two agents over a trajectory."""

    distance: float  # [m]; infinite for fewer than two agents
    piece: int  # k, between instants k and k + 1; −1 for fewer than two agents
    fraction: float  # of the piece, in [0, 1]
    pair: tuple[int, int]


class Separations(NamedTuple):
    """Closest approach of any two agents in every piece."""

    distance: Float[Array, " K"]  # [m]; infinite for fewer than two agents
    fraction: Float[Array, " K"]  # of the piece, in [0, 1]
    pair: Int[Array, "K 2"]  # −1 for fewer than two agents

    @property
    def minimum(self) -> ClosestApproach:
        """Closest approach over all pieces."""
        if not len(self.distance):
            return ClosestApproach(np.inf, -1, 0.0, (-1, -1))
        k = int(np.argmin(self.distance))
        i, j = (int(a) for a in self.pair[k])
        piece = k if i >= 0 else -1
        return ClosestApproach(float(self.distance[k]), piece, float(self.fraction[k]), (i, j))


@checked
def control_points(
    position: Samples, velocity: Samples, h: Duration
) -> Float[Array, "*agents instants-1 4 d"]:
    """Return the Bézier control points of every piece, of duration h [s]."""
    third = (np.asarray(h) / 3)[..., None]
    first, last = position[..., :-1, :], position[..., 1:, :]
    second, before_last = velocity[..., :-1, :] * third, velocity[..., 1:, :] * third
    return np.stack([first, first + second, last - before_last, last], axis=-2)


@checked
def evaluate_bezier(points: Float[Array, "*k 4 d"], fraction: Scalars) -> Float[Array, "*k d"]:
    """Return the position on a piece at a fraction of its duration."""
    t = np.asarray(fraction)[..., None]
    s = 1 - t
    b = np.moveaxis(points, -2, 0)
    return np.asarray(s**3 * b[0] + 3 * s**2 * t * b[1] + 3 * s * t**2 * b[2] + t**3 * b[3])


@checked
def divide_pieces(
    points: Float[Array, "*k 4 d"], parts: Annotated[int, Ge(1), Le(1000)]
) -> Float[Array, "*k parts 4 d"]:
    """Return the control points of equal parts of every piece."""
    return np.asarray(np.einsum("pij,...jd->...pid", division_matrices(parts), points))


@lru_cache
def division_matrices(parts: int) -> Float[Array, "parts 4 4"]:
    """Return the weights of the control points of a piece in those of its equal parts.

    A control point of a part is the value of the polar form at its two ends [Farin2002].
    """
    found = np.empty((parts, 4, 4))
    for part in range(parts):
        ends = part / parts, (part + 1) / parts
        for i in range(4):
            weights = np.ones(1)
            for t in np.repeat(ends, (3 - i, i)):
                weights = np.convolve(weights, [1 - t, t])
            found[part, i] = weights
    return found


@checked
def hull_distance(points: Float[Array, "*k 4 d"]) -> tuple[Float[Array, "*k"], Array]:
    """Return the minimum-norm point of the convex hull of four points, in 2D or 3D.

    The distance is max over unit n of min_i n·b_i, and the best n is normal to a vertex,
    an edge or a face; all are tried. n·b_i ≥ distance holds in spite of rounding, and also
    for points that coincide or are collinear. The distance is 0 where the hull contains the origin.
    """
    d = points.shape[-1]
    if d not in (2, 3):
        raise ValueError(f"points have 2 or 3 axes, got {d}")
    distance, nearest = min_norm_points(points.reshape(-1, 4, d))
    return distance.reshape(points.shape[:-2]), nearest.reshape(*points.shape[:-2], d)


@checked
def separations(
    position: AgentSamples,
    velocity: AgentSamples,
    alive: Bool[Array, "instants agents"],
    h: Duration,
    radii: Float[Array, " agents"] | None = None,
    is_adrift: Bool[Array, "instants agents"] | None = None,
) -> Separations:
    """Return the minimum distance of any two agents in every piece, exact for cubics.

    An agent counts in a piece if it is alive at the start and its states at both ends are
    finite, also where it is lost at the end. With radii R, distances are relative to that
    which a pair keeps, (R_i + R_j)/2. Lost agents that are adrift count beside live ones.
    """
    K, agents = len(position) - 1, position.shape[1]
    by_agent = np.moveaxis(position, 0, 1), np.moveaxis(velocity, 0, 1)
    b = np.moveaxis(control_points(*by_agent, h), 0, 1)
    wide = np.ones(agents) if radii is None else radii
    lost = np.zeros_like(alive) if is_adrift is None else is_adrift & ~alive
    present = (alive[:-1] | lost[:-1]) & np.isfinite(b).all(axis=(2, 3))
    list_pairs = _list_pairs_of_few if agents <= ALL_PAIRS_AGENTS else _list_pairs_by_trees
    found = Separations(np.full(K, np.inf), np.zeros(K), np.full((K, 2), -1))
    for k, i, j in list_pairs(b, wide, present, lost[:-1]):
        relative = (b[k, j] - b[k, i]) / ((wide[i] + wide[j]) / 2)[:, None, None]
        distance, fraction = closest_approaches(relative, k - k.min(initial=K))
        order = np.argsort(-distance, kind="stable")  # the last of a piece stays
        k = k[order]
        found.distance[k], found.fraction[k] = distance[order], fraction[order]
        found.pair[k] = np.stack([i, j], axis=1)[order]
    return found


@checked
def sampled_separations(
    position: AgentSamples, alive: Bool[Array, "instants agents"]
) -> Float[Array, " instants"]:
    """Return the minimum distance of two live agents per instant, infinite for fewer than two."""
    present = alive & np.isfinite(position).all(axis=2)
    if position.shape[1] > ALL_PAIRS_AGENTS:
        return np.array([min_distance(p[a]) for p, a in zip(position, present, strict=True)])
    points, least = np.where(present[..., None], position, np.nan), np.full(len(position), np.inf)
    for i in range(position.shape[1] - 1):
        far = np.linalg.norm(points[:, i + 1 :] - points[:, i, None], axis=2)
        least = np.fmin(least, np.fmin.reduce(far, axis=1))
    return least


@checked
def min_distance(points: Float[Array, "k d"]) -> float:
    """Return the minimum distance of any two points, infinite for fewer than two."""
    if not np.isfinite(points).all():
        wrong = points[~np.isfinite(points).all(axis=1)][0]
        raise ValueError(f"points must be finite, got {wrong}")
    if len(points) < 2:
        return np.inf
    if len(points) <= ALL_PAIRS_POINTS:
        return float(scipy.spatial.distance.pdist(points).min())
    return float(scipy.spatial.cKDTree(points).query(points, k=2)[0][:, 1].min())


def near_balls(middle: Float[Array, "k d"], radius: Float[Array, " k"]) -> Int[Array, "pairs 2"]:
    """List the pairs of balls that overlap, or touch but for rounding; all are finite."""
    largest = 2 * radius.max(initial=0.0) * (1 + 1e-12)
    if len(middle) <= ALL_PAIRS_AGENTS:  # all pairs, sooner than a tree is built
        i, j = np.triu_indices(len(middle), 1)
    else:
        i, j = scipy.spatial.cKDTree(middle).query_pairs(largest, output_type="ndarray").T
    between = np.linalg.norm(middle[i] - middle[j], axis=1) * (1 - 1e-12)
    near = between <= radius[i] + radius[j]
    return np.stack([i[near], j[near]], axis=1)


@checked
def interpolation_error(
    model: LinearModel, x: FlownStates, u: FlownControls, h: float, t0: float = 0.0
) -> float:
    """Return the largest distance of a trajectory from its cubic pieces [m].

    The separation of two agents may be less than that of their cubics by twice as much.
    For a time-invariant model it is `interpolation_error_bound`, which is proven. For other
    models it is measured at the middle of each piece, integrated from the state at its start.
    """
    if model.is_time_invariant:
        return interpolation_error_bound(model, x, u, h)
    K, d = u.shape[-2], model.axes
    halves = discretize_zoh(model, h / 2, 2 * K, t0)
    states = [x[..., :K, :]]
    for j in range(2):
        A, B, z = halves.A[j::2], halves.B[j::2], halves.z[j::2]
        free = np.einsum("kab,...kb->...ka", A, states[-1]) + z
        states.append(free + np.einsum("kab,...kb->...ka", B, u))
    path = np.stack(states, axis=-2)
    return _midpoint_error(path[..., :d], path[..., d:], h / 2)


@checked
def sampled_interpolation_error(position: Samples, velocity: Samples, h: float) -> float:
    """Estimate the largest distance of a trajectory from its cubic pieces [m].

    Cubics over two pieces have an error of p⁗ (2h)⁴/384 at their middles, which are samples
    of the trajectory; those of one piece have a sixteenth of it. The estimate is good while
    p⁗ changes little and the control is the same over two pieces. Entries that are not
    finite belong to absent agents. The separation of two agents may be less than that of
    their cubics by twice as much.

    Args:
        position: Positions at an odd number of instants [m].
        velocity: Velocities at these instants [m/s].
        h: Time between the instants [s].

    Raises:
        ValueError: The number of instants is even.
    """
    if position.shape[-2] % 2 == 0:
        found = f"{position.shape[-2]} instants do not pair up into pieces of twice the length"
        raise ValueError(f"{found}: an odd number is needed")
    return _midpoint_error(position, velocity, h) / 16


@checked
def interpolation_error_bound(
    model: LinearModel, x: FlownStates, u: FlownControls, h: float
) -> float:
    """Bound the distance of a trajectory from its cubic pieces, for time-invariant models [m].

    With ẋ = A x + B u + z and u held, p⁗(t) is the position part of A³ e^{At} ẋ(0), whose
    Taylor series is summed term by term in norm. The error of the cubic is at most
    max |p⁗| h⁴/384. The separation of two agents may be less than that of their cubics by
    twice as much.
    """
    if not model.is_time_invariant:
        reason = "is not time-invariant, so there is no proven bound"
        cure = "use `interpolation_error`, which measures"
        raise ValueError(f"{type(model).__name__} {reason}: {cure}")
    d, A = model.axes, model.A(0.0)
    rate = x[..., : u.shape[-2], :] @ A.T + u @ model.B(0.0).T + model.z(0.0)
    rate = np.where(np.isfinite(rate), rate, 0.0)  # absent agents
    term = rate @ np.linalg.matrix_power(A, 3).T
    total = np.linalg.norm(term[..., :d], axis=-1)
    for j in range(1, 40):
        if not term.any():
            break
        term = term @ A.T * (h / j)
        total = total + np.linalg.norm(term[..., :d], axis=-1)
    return float(np.max(total, initial=0.0)) * h**4 / 384


def _midpoint_error(position: Array, velocity: Array, h: float) -> float:
    """Return the error of cubics over two intervals at the instants in their middles."""
    pieces = control_points(position[..., ::2, :], velocity[..., ::2, :], 2 * h)
    error = np.linalg.norm(evaluate_bezier(pieces, 0.5) - position[..., 1::2, :], axis=-1)
    return float(np.max(error, initial=0.0, where=np.isfinite(error)))


_Pairs = Iterator[tuple[Array, Array, Array]]  # piece, and both agents
Pieces = Float[Array, "pieces agents 4 d"]  # control points
Radii = Float[Array, " agents"]
Present = Bool[Array, "pieces agents"]


def _list_pairs_of_few(b: Pieces, radii: Radii, present: Present, is_lost: Present) -> _Pairs:
    """List the pairs that `_near_pairs` lists, for many pieces at once."""
    i, j = np.triu_indices(b.shape[1], 1)
    kept = (radii[i] + radii[j]) / 2
    size = MAX_PAIRS // max(1, len(i))
    for first in range(0, len(b), size):
        there, lost = (part[first : first + size] for part in (present, is_lost))
        part = np.where(there[..., None, None], b[first : first + size], np.nan)
        counts = there[:, i] & there[:, j] & ~(lost[:, i] & lost[:, j])
        ends = part[:, :, [0, 3]]
        apart = np.linalg.norm(ends[:, i] - ends[:, j], axis=3).min(axis=2) / kept
        bound = np.where(counts, apart, np.inf).min(axis=1, initial=np.inf)
        middle = ends.mean(axis=2)
        reach = np.linalg.norm(part - middle[:, :, None], axis=3).max(axis=2)
        gap = np.linalg.norm(middle[:, i] - middle[:, j], axis=2) * (1 - 1e-12)
        near = gap <= bound[:, None] * kept + reach[:, i] + reach[:, j]
        piece, pair = np.nonzero(near & counts)
        yield first + piece, i[pair], j[pair]


def _list_pairs_by_trees(b: Pieces, radii: Radii, present: Present, is_lost: Present) -> _Pairs:
    pairs, count = list[Array](), 0
    for k, those in enumerate(map(np.flatnonzero, present)):
        near = those[_near_pairs(b[k, those], radii[those], is_lost[k, those])]
        pairs.append(np.insert(near, 0, k, axis=1))
        count += len(near)
        if k == len(b) - 1 or count >= MAX_PAIRS:
            piece, i, j = np.concatenate(pairs).T
            yield piece, i, j
            pairs, count = [], 0


def _near_pairs(
    b: Float[Array, "agents 4 d"], radii: Float[Array, " agents"], is_lost: Bool[Array, " agents"]
) -> Int[Array, "pairs 2"]:
    """List the pairs that may be nearest, relative to the mean of their radii; not two lost ones.

    A piece stays in the ball about the midpoint of its ends that contains its control points.
    Pairs whose balls are further apart than the ends of some pair are left out.
    """
    if len(b) - np.count_nonzero(is_lost) < (1 if is_lost.any() else 2):
        return np.zeros((0, 2), dtype=int)
    bound = np.inf
    for ends in (b[:, 0], b[:, 3]):
        distance, other = scipy.spatial.cKDTree(ends).query(ends, k=2)
        other, distance = other[:, 1], distance[:, 1] / ((radii + radii[other[:, 1]]) / 2)
        bound = min(bound, distance[~(is_lost & is_lost[other])].min(initial=np.inf))
    if bound < np.inf:
        middle = (b[:, 0] + b[:, 3]) / 2
        reach = np.linalg.norm(b - middle[:, None], axis=2).max(axis=1)
        i, j = near_balls(middle, bound * radii / 2 + reach).T
    else:
        i, j = np.triu_indices(len(b), 1)
    return np.asarray(np.stack([i, j], axis=1)[~(is_lost[i] & is_lost[j])])
