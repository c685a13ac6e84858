"""Equations of [Bernard2023] as printed, checked against central differences.

Six robots stand and look at random, many times over. Weights are the product's; derivatives are
written down here as the paper has them, with ⁱR_j in (12) and (29), as the text below them says.
"""

from math import pi
from typing import Annotated, NamedTuple

import numpy as np
import typer
from jaxtyping import Float, Int
from numpy import ndarray as Array
from rich.console import Console
from rich.table import Table

from problems.interaction_graph import (
    Camera,
    EdgeWeights,
    algebraic_connectivity,
    bearings,
    cosine_ramp,
    cosine_ramp_and_slope,
    interaction_graph,
    lambda2_gradient,
    range_weight,
    range_weight_and_slope,
)
from sato.connectivity.settings import YawTracking
from sato.connectivity.yaw_estimator import update_yaw_estimate, yaw_from_bearings

N = 6
SIGHT = Camera()
AXIS = np.array(SIGHT.optical_axis)
BOX_SIZE = np.array([8.0, 8.0, 3.0])  # [m]
H = 1e-6  # of central differences [m, rad, s]


class Pairs(NamedTuple):
    """Ordered pairs i, j of every state, with their derivatives by the pose of i."""

    state: Int[Array, " m"]
    d: Float[Array, " m"]  # [m]
    bearing_ij: Float[Array, "m 3"]  # β_ij
    bearing_ji: Float[Array, "m 3"]  # β_ji
    yaw: Float[Array, "m 2"]  # ψ_i, ψ_j [rad]
    weights: Float[Array, "m 4"]  # γ, f*_ij, f*_ji, A_ij
    weight_derivatives: Float[
        Array, "m 4 4"
    ]  # their differences by p_i, in the world frame, and ψ_i

    @property
    def relative_yaw(self) -> Float[Array, " m"]:
        """Return ψ_ij [rad]."""
        return np.asarray(self.yaw[:, 1] - self.yaw[:, 0])

    @property
    def rotation_i(self) -> Float[Array, "m 3 3"]:
        """Return R_i."""
        return rotation(self.yaw[:, 0])

    @property
    def rotation_ij(self) -> Float[Array, "m 3 3"]:
        """Return ⁱR_j."""
        return rotation(self.relative_yaw)

    @property
    def weight_gradient(self) -> Float[Array, "m 3"]:
        """Return R_iᵀ ∂A_ij/∂p_i by differences [1/m]."""
        return matvec(self.rotation_i.swapaxes(1, 2), self.weight_derivatives[:, 3, :3])


def rotation(yaw: Float[Array, " m"]) -> Float[Array, "m 3 3"]:
    """Return R_z."""
    c, s, o = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    return np.stack([c, -s, o, s, c, o, o, o, o + 1], axis=-1).reshape(-1, 3, 3)


def matvec(matrix: Float[Array, "m 3 3"], vector: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
    """Multiply each matrix by its vector."""
    return np.asarray(np.einsum("mab,mb->ma", matrix, vector))


def draw_poses(states: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw random positions and yaws."""
    return rng.uniform(0, 1, (states, N, 3)) * BOX_SIZE, rng.uniform(-pi, pi, (states, N))


def perturbation(i: int, axis: int, way: float) -> tuple[Array, Array]:
    """Perturb one of the four coordinates of robot i."""
    move = np.zeros((N, 4))
    move[i, axis] = way
    return move[:, :3], move[:, 3]


def central_differences(position: Array, yaw: Array, i: int) -> Float[Array, "states n 4 4"]:
    """Differentiate γ, f*_ij, f*_ji and A_ij for every j by the coordinates of robot i."""

    def values(axis: int, way: float) -> Array:
        move, spin = perturbation(i, axis, way)
        return weights_of(interaction_graph(position + move, yaw + spin, SIGHT), i)

    each = [(values(axis, H) - values(axis, -H)) / (2 * H) for axis in range(4)]
    return np.stack(each, axis=-1)


def weights_of(known: EdgeWeights, i: int) -> Float[Array, "states n 4"]:
    """Return γ, f*_ij, f*_ji and A_ij of robot i with every other."""
    return np.stack(
        [
            known.range_weights[:, i],
            known.fov_weights[:, i],
            known.fov_weights[:, :, i],
            known.weights[:, i],
        ],
        axis=-1,
    )


def make_pairs(position: Array, yaw: Array) -> Pairs:
    """Build all pairs of all states."""
    known = interaction_graph(position, yaw, SIGHT)
    value = np.stack([weights_of(known, i) for i in range(N)], axis=1)
    by = np.stack([central_differences(position, yaw, i) for i in range(N)], axis=1)
    k, i, j = np.nonzero(np.broadcast_to(~np.eye(N, dtype=bool), (len(yaw), N, N)))
    distance, bearing = bearings(position, yaw)
    d, mine, theirs = distance[k, i, j], bearing[k, i, j], bearing[k, j, i]
    both = np.stack([yaw[k, i], yaw[k, j]], axis=-1)
    return Pairs(k, d, mine, theirs, both, value[k, i, j], by[k, i, j])


def weight_errors(pairs: Pairs) -> dict[str, float]:
    """Return the largest error of each of (6)–(13) and (22)–(30)."""
    gamma, f, g, weight = pairs.weights.T
    a, b = pairs.bearing_ij @ AXIS, pairs.bearing_ji @ AXIS
    view = f + g - f * g
    steep = range_weight_and_slope(pairs.d, SIGHT)[1][:, None]
    df, dg = (
        cosine_ramp_and_slope(facing, SIGHT.a_min, SIGHT.a_max)[1][:, None] for facing in (a, b)
    )
    across = (AXIS - a[:, None] * pairs.bearing_ij) / pairs.d[:, None]  # P_ij o_C / d
    theirs = (AXIS - b[:, None] * pairs.bearing_ji) / pairs.d[:, None]  # P_ji o_C / d
    spun = AXIS[1] * pairs.bearing_ij[:, 0] - AXIS[0] * pairs.bearing_ij[:, 1]  # o_Cᵀ S β_ij
    column = [x[:, None] for x in (gamma, f, g, view)]
    p24 = -steep * matvec(pairs.rotation_i, pairs.bearing_ij)
    p26 = -df * matvec(pairs.rotation_i, across)
    p27 = dg * matvec(rotation(pairs.yaw[:, 1]), theirs)
    p25 = (1 - column[2]) * p26 + (1 - column[1]) * p27
    p28 = -df[:, 0] * spun
    p29 = -column[3] * steep * pairs.bearing_ij + column[0] * (
        (1 - column[1]) * dg * matvec(pairs.rotation_ij, theirs) - (1 - column[2]) * df * across
    )
    by = pairs.weight_derivatives
    near = (pairs.d > SIGHT.d_min) & (pairs.d < SIGHT.d_max)  # beyond it, f* goes unasked
    off = f - paper_ramp(a, SIGHT.a_min, SIGHT.a_max)
    return {
        "(6), (10), (11): weights": max_abs(weight - gamma * view, off[near]),
        "(24): ∂γ_ij/∂p_i": max_abs(p24 - by[:, 0, :3], by[:, 0, 3]),
        "(26): ∂f*_ij/∂p_i": max_abs((p26 - by[:, 1, :3])[near]),
        "(27): ∂f*_ji/∂p_i": max_abs((p27 - by[:, 2, :3])[near]),
        "(28): ∂f*_ij/∂ψ_i, and ∂f*_ji/∂ψ_i = 0": max_abs((p28 - by[:, 1, 3])[near], by[:, 2, 3]),
        "(22), (25): ∂A_ij/∂p_i in the world frame": max_abs(
            column[3] * p24 + column[0] * p25 - by[:, 3, :3]
        ),
        "(12), (29), with ⁱR_j": max_abs(p29 - pairs.weight_gradient),
        "(13), (23), (30)": max_abs(gamma * (1 - g) * p28 - by[:, 3, 3]),
    }


def paper_ramp(x: Float[Array, " m"], low: float, high: float) -> Float[Array, " m"]:
    """Evaluate (7), with a and b as printed."""
    a = pi / (high - low)
    b = -a * low
    return np.where(x <= low, 0, np.where(x <= high, (1 - np.cos(a * x + b)) / 2, 1))


def max_abs(*errors: Array) -> float:
    """Return the largest absolute value."""
    return max(float(np.abs(e).max()) for e in errors)


def ramp_error() -> float:
    """Check (7)–(9): the ramps are continuous, and (8) is 1 minus (7)."""
    x = np.linspace(0, 12, 10_001)
    a = pi / (SIGHT.d_max - SIGHT.d_far)
    falling = (1 + np.cos(a * x - a * SIGHT.d_far)) / 2  # (8)
    falling = np.where(x <= SIGHT.d_far, 1, np.where(x <= SIGHT.d_max, falling, 0))
    product = paper_ramp(x, SIGHT.d_min, SIGHT.d_near) * falling
    ours = range_weight(x, SIGHT)
    rising = cosine_ramp(x, SIGHT.d_far, SIGHT.d_max)
    return max_abs(product - ours, 1 - falling - rising)


def lambda2_error(position: Array, yaw: Array) -> float:
    """Check (3)–(5): ∂λ₂ = Σⱼ ∂A_ij (v₂ᵢ − v₂ⱼ)², by every coordinate of every robot."""

    def lambda2(i: int, axis: int, way: float) -> Array:
        move, spin = perturbation(i, axis, way)
        return algebraic_connectivity(
            interaction_graph(position + move, yaw + spin, SIGHT).weights
        ).lambda2

    found, off = lambda2_gradient(position, yaw, SIGHT), 0.0
    for i in range(N):
        for axis in range(4):
            rate = (lambda2(i, axis, H) - lambda2(i, axis, -H)) / (2 * H)
            ours = found.position[:, i, axis] if axis < 3 else found.yaw[:, i]
            off = max(off, max_abs(rate - ours))
    return off


def motion_error(pairs: Pairs, rng: np.random.Generator) -> float:
    """Check (14): ṗ_ij = −v_i − S p_ij w_i + ⁱR_j v_j, for robots that move by (1)."""
    m = len(pairs.d)
    (v, w), (u, q) = ((rng.normal(0, 1, (m, 3)), rng.normal(0, 1, m)) for _ in range(2))
    p = pairs.d[:, None] * pairs.bearing_ij

    def later(t: float) -> Array:
        # Seen from where i is and looks now; half of each turn has been made on the way.
        gap = (
            p
            + t * matvec(rotation(pairs.relative_yaw + q * t / 2), u)
            - t * matvec(rotation(w * t / 2), v)
        )
        return matvec(rotation(-w * t), gap)

    rate = (later(H) - later(-H)) / (2 * H)
    spun = np.stack([-p[:, 1], p[:, 0], 0 * w], axis=-1)
    return max_abs(rate - (-v - spun * w[:, None] + matvec(pairs.rotation_ij, u)))


def observer_error(rng: np.random.Generator) -> float:
    """Check (15)–(18): e is ⁱR_j v_j through a first-order filter."""
    k, step, off = 10.0, 1e-4, 0.0
    for _ in range(3):
        p, v, u = rng.normal(0, 3, 3), rng.normal(0, 1, 3), rng.normal(0, 1, 3)
        guess, e = p.copy(), np.zeros(3)
        for _ in range(10_000):  # the middle rule, for all three alike
            mid_p, mid_guess = p + step / 2 * (u - v), guess + step / 2 * (k * (p - guess) - v)
            mid_e = e + step / 2 * k * (u - e)
            p, guess = p + step * (u - v), guess + step * (k * (mid_p - mid_guess) - v)
            e = e + step * k * (u - mid_e)
        off = max(off, max_abs(k * (p - guess) - e))
    return off


def yaw_errors(pairs: Pairs) -> tuple[float, float]:
    """Return the errors of ψ_ij from two bearings, and by (19)–(21) after 2 s from 3 rad."""
    p, q = pairs.bearing_ij, pairs.bearing_ji
    found = yaw_from_bearings(p, q)
    track, step, left = YawTracking(), 1e-3, 0.0
    for mutual in (0.0, 0.5, 1.0):
        truth, guess = 1.0, -1.99
        for _ in range(2000):
            guess = update_yaw_estimate(guess, 0.7, mutual, truth, truth, 1.0, track, step)
            truth += 0.7 * step
        left = max(left, abs(np.sin((guess - truth) / 2)))
    return max_abs(np.sin((found - pairs.relative_yaw) / 2)), float(left)


def equation_table(position: Array, yaw: Array, pairs: Pairs, rng: np.random.Generator) -> Table:
    """Tabulate the equations with their largest errors."""
    table = Table("equation", "largest error", title=f"{len(yaw)} states, {len(pairs.d)} pairs")
    bearings_off, left = yaw_errors(pairs)
    rows = {
        "(3)–(5): ∂λ₂, v₂ of length 1": lambda2_error(position, yaw),
        "(7)–(9): ramps, with x^d in the first case of (8)": ramp_error(),
        **weight_errors(pairs),
        "(1), (2), (14): ṗ_ij": motion_error(pairs, rng),
        "(15)–(18): e, while ⁱR_j v_j rests": observer_error(rng),
        "ψ_ij from p_ij and p_ji [rad]": bearings_off,
        "(19)–(21): left of 3 rad after 2 s [rad]": left,
    }
    for name, error in rows.items():
        table.add_row(name, f"{error:.0e}")
    return table


def main(
    states: Annotated[int, typer.Option(help="how many times they stand anew")] = 200,
    seed: int = 2023,
) -> None:
    """Print the largest error of each equation."""
    rng = np.random.default_rng(seed)
    position, yaw = draw_poses(states, rng)
    Console(markup=False).print(equation_table(position, yaw, make_pairs(position, yaw), rng))


if __name__ == "__main__":
    typer.run(main)
