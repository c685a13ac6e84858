"""The equations of [Bernard2023] as printed, against central differences.

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

from problems.graph import (
    Graph,
    Sight,
    bearings,
    connectivity,
    gradient,
    graph,
    range_weight,
    rise,
    slope,
)
from sato.connectivity.yaw import Tracking, by_bearings, correct

N = 6
SIGHT = Sight()
AXIS = np.array(SIGHT.axis)
BOX = np.array([8.0, 8.0, 3.0])  # [m]
H = 1e-6  # of central differences [m, rad, s]


class Pairs(NamedTuple):
    """Every ordered pair i, j of every state, and what moving and turning i does to it."""

    state: Int[Array, " m"]
    d: Float[Array, " m"]  # [m]
    mine: Float[Array, "m 3"]  # β_ij
    theirs: Float[Array, "m 3"]  # β_ji
    yaw: Float[Array, "m 2"]  # ψ_i, ψ_j [rad]
    value: Float[Array, "m 4"]  # γ, f*_ij, f*_ji, A_ij
    by: Float[Array, "m 4 4"]  # their differences by p_i, in the world frame, and ψ_i

    @property
    def turn(self) -> Float[Array, " m"]:
        """ψ_ij [rad]."""
        return np.asarray(self.yaw[:, 1] - self.yaw[:, 0])

    @property
    def frame(self) -> Float[Array, "m 3 3"]:
        """R_i."""
        return rotation(self.yaw[:, 0])

    @property
    def between(self) -> Float[Array, "m 3 3"]:
        """ⁱR_j."""
        return rotation(self.turn)

    @property
    def truth(self) -> Float[Array, "m 3"]:
        """R_iᵀ ∂A_ij/∂p_i by differences [1/m]."""
        return times(self.frame.swapaxes(1, 2), self.by[:, 3, :3])


def rotation(yaw: Float[Array, " m"]) -> Float[Array, "m 3 3"]:
    """R_z."""
    c, s, o = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    return np.stack([c, -s, o, s, c, o, o, o, o + 1], axis=-1).reshape(-1, 3, 3)


def times(matrix: Float[Array, "m 3 3"], vector: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
    """Each matrix times its vector."""
    return np.asarray(np.einsum("mab,mb->ma", matrix, vector))


def stand(states: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Positions and yaws at random."""
    return rng.uniform(0, 1, (states, N, 3)) * BOX, rng.uniform(-pi, pi, (states, N))


def shifted(i: int, axis: int, way: float) -> tuple[Array, Array]:
    """Robot i a little elsewhere along one of its four coordinates."""
    move = np.zeros((N, 4))
    move[i, axis] = way
    return move[:, :3], move[:, 3]


def differences(position: Array, yaw: Array, i: int) -> Float[Array, "states n 4 4"]:
    """Of γ, f*_ij, f*_ji and A_ij for every j, by the four coordinates of robot i."""

    def values(axis: int, way: float) -> Array:
        move, spin = shifted(i, axis, way)
        return of(graph(position + move, yaw + spin, SIGHT), i)

    each = [(values(axis, H) - values(axis, -H)) / (2 * H) for axis in range(4)]
    return np.stack(each, axis=-1)


def of(known: Graph, i: int) -> Float[Array, "states n 4"]:
    """γ, f*_ij, f*_ji and A_ij of robot i with every other."""
    return np.stack(
        [known.reach[:, i], known.seen[:, i], known.seen[:, :, i], known.weight[:, i]], axis=-1
    )


def pair_up(position: Array, yaw: Array) -> Pairs:
    """All pairs of all states."""
    known = graph(position, yaw, SIGHT)
    value = np.stack([of(known, i) for i in range(N)], axis=1)
    by = np.stack([differences(position, yaw, i) for i in range(N)], axis=1)
    k, i, j = np.nonzero(np.broadcast_to(~np.eye(N, dtype=bool), (len(yaw), N, N)))
    mine, theirs, d = np.zeros((len(k), 3)), np.zeros((len(k), 3)), np.zeros(len(k))
    for m in range(len(k)):
        d[m] = bearings(position[k[m]], yaw[k[m]], i[m], j[m], mine[m], theirs[m])
    both = np.stack([yaw[k, i], yaw[k, j]], axis=-1)
    return Pairs(k, d, mine, theirs, both, value[k, i, j], by[k, i, j])


def of_weights(pairs: Pairs) -> dict[str, float]:
    """(6)–(13) and (22)–(30): the largest error of each."""
    gamma, f, g, weight = pairs.value.T
    a, b = pairs.mine @ AXIS, pairs.theirs @ AXIS
    view = f + g - f * g
    steep = np.array([range_weight(d, SIGHT)[1] for d in pairs.d])[:, None]
    df, dg = (
        np.array([slope(x, SIGHT.a_min, SIGHT.a_max) for x in facing])[:, None] for facing in (a, b)
    )
    across = (AXIS - a[:, None] * pairs.mine) / pairs.d[:, None]  # P_ij o_C / d
    theirs = (AXIS - b[:, None] * pairs.theirs) / pairs.d[:, None]  # P_ji o_C / d
    spun = AXIS[1] * pairs.mine[:, 0] - AXIS[0] * pairs.mine[:, 1]  # o_Cᵀ S β_ij
    column = [x[:, None] for x in (gamma, f, g, view)]
    p24 = -steep * times(pairs.frame, pairs.mine)
    p26 = -df * times(pairs.frame, across)
    p27 = dg * times(rotation(pairs.yaw[:, 1]), theirs)
    p25 = (1 - column[2]) * p26 + (1 - column[1]) * p27
    p28 = -df[:, 0] * spun
    p29 = -column[3] * steep * pairs.mine + column[0] * (
        (1 - column[1]) * dg * times(pairs.between, theirs) - (1 - column[2]) * df * across
    )
    by = pairs.by
    near = (pairs.d > SIGHT.d_min) & (pairs.d < SIGHT.d_max)  # beyond it, f* goes unasked
    off = f - printed_rise(a, SIGHT.a_min, SIGHT.a_max)
    return {
        "(6), (10), (11): weights": worst(weight - gamma * view, off[near]),
        "(24): ∂γ_ij/∂p_i": worst(p24 - by[:, 0, :3], by[:, 0, 3]),
        "(26): ∂f*_ij/∂p_i": worst((p26 - by[:, 1, :3])[near]),
        "(27): ∂f*_ji/∂p_i": worst((p27 - by[:, 2, :3])[near]),
        "(28): ∂f*_ij/∂ψ_i, and ∂f*_ji/∂ψ_i = 0": worst((p28 - by[:, 1, 3])[near], by[:, 2, 3]),
        "(22), (25): ∂A_ij/∂p_i in the world frame": worst(
            column[3] * p24 + column[0] * p25 - by[:, 3, :3]
        ),
        "(12), (29), with ⁱR_j": worst(p29 - pairs.truth),
        "(13), (23), (30)": worst(gamma * (1 - g) * p28 - by[:, 3, 3]),
    }


def printed_rise(x: Float[Array, " m"], low: float, high: float) -> Float[Array, " m"]:
    """(7), with a and b as printed."""
    a = pi / (high - low)
    b = -a * low
    return np.where(x <= low, 0, np.where(x <= high, (1 - np.cos(a * x + b)) / 2, 1))


def worst(*errors: Array) -> float:
    """The largest of all."""
    return max(float(np.abs(e).max()) for e in errors)


def of_ramps() -> float:
    """(7)–(9): the ramps fit together, and (8) is what (7) lacks of 1."""
    x = np.linspace(0, 12, 10_001)
    a = pi / (SIGHT.d_max - SIGHT.d_far)
    falling = (1 + np.cos(a * x - a * SIGHT.d_far)) / 2  # (8)
    falling = np.where(x <= SIGHT.d_far, 1, np.where(x <= SIGHT.d_max, falling, 0))
    product = printed_rise(x, SIGHT.d_min, SIGHT.d_near) * falling
    ours = np.array([range_weight(d, SIGHT)[0] for d in x])
    rising = np.array([rise(d, SIGHT.d_far, SIGHT.d_max) for d in x])
    return worst(product - ours, 1 - falling - rising)


def of_lambda2(position: Array, yaw: Array) -> float:
    """(3)–(5): ∂λ₂ = Σⱼ ∂A_ij (v₂ᵢ − v₂ⱼ)², by every coordinate of every robot."""

    def lambda2(i: int, axis: int, way: float) -> Array:
        move, spin = shifted(i, axis, way)
        return connectivity(graph(position + move, yaw + spin, SIGHT).weight).lambda2

    found, off = gradient(position, yaw, SIGHT), 0.0
    for i in range(N):
        for axis in range(4):
            rate = (lambda2(i, axis, H) - lambda2(i, axis, -H)) / (2 * H)
            ours = found.position[:, i, axis] if axis < 3 else found.yaw[:, i]
            off = max(off, worst(rate - ours))
    return off


def of_motion(pairs: Pairs, rng: np.random.Generator) -> float:
    """(14): ṗ_ij = −v_i − S p_ij w_i + ⁱR_j v_j, of robots that fly as (1) says."""
    m = len(pairs.d)
    (v, w), (u, q) = ((rng.normal(0, 1, (m, 3)), rng.normal(0, 1, m)) for _ in range(2))
    p = pairs.d[:, None] * pairs.mine

    def later(t: float) -> Array:
        # Seen from where i is and looks now; half of each turn has been made on the way.
        gap = p + t * times(rotation(pairs.turn + q * t / 2), u) - t * times(rotation(w * t / 2), v)
        return times(rotation(-w * t), gap)

    rate = (later(H) - later(-H)) / (2 * H)
    spun = np.stack([-p[:, 1], p[:, 0], 0 * w], axis=-1)
    return worst(rate - (-v - spun * w[:, None] + times(pairs.between, u)))


def of_observer(rng: np.random.Generator) -> float:
    """(15)–(18): e is ⁱR_j v_j through a filter of first order."""
    k, step, off = 10.0, 1e-4, 0.0
    for _ in range(3):
        p, v, u = rng.normal(0, 3, 3), rng.normal(0, 1, 3), rng.normal(0, 1, 3)
        guess, e = p.copy(), np.zeros(3)
        for _ in range(10_000):  # the middle rule, for all three alike
            mid_p, mid_guess = p + step / 2 * (u - v), guess + step / 2 * (k * (p - guess) - v)
            mid_e = e + step / 2 * k * (u - e)
            p, guess = p + step * (u - v), guess + step * (k * (mid_p - mid_guess) - v)
            e = e + step * k * (u - mid_e)
        off = max(off, worst(k * (p - guess) - e))
    return off


def of_yaw(pairs: Pairs) -> tuple[float, float]:
    """ψ_ij from two bearings; and (19)–(21): what is left after 2 s of an error below 3 rad."""
    p, q = pairs.mine, pairs.theirs
    found = np.array([by_bearings(p[m], q[m]) for m in range(len(p))])
    track, step, left = Tracking(), 1e-3, 0.0
    for mutual in (0.0, 0.5, 1.0):
        truth, guess = 1.0, -1.99
        for _ in range(2000):
            guess = correct(guess, 0.7, mutual, truth, truth, 1.0, track, step)
            truth += 0.7 * step
        left = max(left, abs(np.sin((guess - truth) / 2)))
    return worst(np.sin((found - pairs.turn) / 2)), float(left)


def equations(position: Array, yaw: Array, pairs: Pairs, rng: np.random.Generator) -> Table:
    """Each with its largest error."""
    table = Table("equation", "largest error", title=f"{len(yaw)} states, {len(pairs.d)} pairs")
    bearings_off, left = of_yaw(pairs)
    rows = {
        "(3)–(5): ∂λ₂, v₂ of length 1": of_lambda2(position, yaw),
        "(7)–(9): ramps, with x^d in the first case of (8)": of_ramps(),
        **of_weights(pairs),
        "(1), (2), (14): ṗ_ij": of_motion(pairs, rng),
        "(15)–(18): e, while ⁱR_j v_j rests": of_observer(rng),
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
    """Print how far each equation is off."""
    rng = np.random.default_rng(seed)
    position, yaw = stand(states, rng)
    Console(markup=False).print(equations(position, yaw, pair_up(position, yaw), rng))


if __name__ == "__main__":
    typer.run(main)
