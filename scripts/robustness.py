"""The law when commands come out wrong: python scripts/robustness.py --cases 100.

What a vehicle does may be what the law asks of it scaled by any positive factor and turned by
less than 90°, other ones for each vehicle and every second: the formation still forms
[Lusk2020, Sec. III-C]. Random formations on complete and on sparse graphs, from random starts.
"""

import argparse
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from rich.progress import track
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from problems.formation import Formation
from problems.formation_gain import Gains, design
from sato.formation.law import Law, size_weights, wanted
from sato.formation.shape import likeness
from sato.shapes.random_formation import random_formation, sparse_graph

FACTORS = (0.1, 10.0)  # by which commands are scaled
PIECE = 1.0  # for which factors and turns stay [s]
FORMED = 1e-3  # error of the shape [m]
LIMIT = 600.0  # [s]


class Outcome(NamedTuple):
    """What came of a case."""

    time: float  # until the shape was formed [s]
    error: float  # of the shape in the end [m]
    inverted: bool


def commands(position: Float[Array, "n 3"], gains: Gains, law: Law) -> Float[Array, "n 3"]:
    """What the law asks of everybody [m/s]."""
    graph, points = gains.formation.graph, gains.formation.points
    weight = size_weights(graph)
    asked = np.zeros_like(position)
    for i, u in enumerate(asked):
        near = np.flatnonzero(graph[i])
        wanted(i, position - position[i], near, gains.xy[i], gains.z[i], points, weight[i], law, u)
    return asked


def case(rng: np.random.Generator) -> tuple[Gains, Float[Array, "n 3"]]:
    """Gains and a start."""
    n = int(rng.integers(6, 13))
    points = random_formation(n, (8.0, 8.0, 3.0), 1.5, rng)
    least = 4 / (n - 1)  # of the ring that every sparse graph has
    share = 1.0 if rng.random() < 0.3 else rng.uniform(least, 1)
    shape = Formation(points, sparse_graph(points, share, rng))
    return design(shape), rng.uniform(0, 10, (n, 3))


def distort(count: int, worst: float, rng: np.random.Generator) -> Float[Array, "n 3 3"]:
    """A factor and a turn about any axis by up to `worst` [rad] for everybody."""
    axis = rng.standard_normal((count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = Rotation.from_rotvec(axis * rng.uniform(0, worst, (count, 1))).as_matrix()
    low, high = np.log(FACTORS).tolist()
    factor = np.exp(rng.uniform(low, high, count))
    return np.asarray(factor[:, None, None] * turn)


def settle(
    gains: Gains,
    start: Float[Array, "n 3"],
    rng: np.random.Generator,
    law: Law | None = None,
    worst: float = np.pi / 2,
) -> Outcome:
    """Follow the distorted law until the shape is formed."""
    law = law or Law()
    position, time = start, 0.0
    found = likeness(position, gains.formation.points)
    while found.error > FORMED and time < LIMIT:
        way = distort(len(start), worst, rng)

        def rate(_: float, q: Array, way: Array = way) -> Array:
            return np.asarray((way @ commands(q.reshape(-1, 3), gains, law)[..., None]).ravel())

        flown = solve_ivp(rate, (0, PIECE), position.ravel(), rtol=1e-6, atol=1e-8)
        position, time = flown.y[:, -1].reshape(-1, 3), time + PIECE
        found = likeness(position, gains.formation.points)
    return Outcome(time, found.error, found.inverted)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=100)
    cases = parser.parse_args().cases
    done, plain = [], []
    for seed in track(range(cases), "settling"):
        rng = np.random.default_rng(seed)
        gains, start = case(rng)
        done.append(settle(gains, start, rng))
        plain.append(settle(gains, start, rng, worst=0.0))
    good = [o for o in done if o.error <= FORMED and not o.inverted]
    print(
        f"{len(good)} of {cases} formed to {1000 * FORMED:g} mm with factors from {FACTORS[0]:g} "
        f"to {FACTORS[1]:g} and turns up to 90°"
    )
    for name, outcomes in (("turned", done), ("only scaled", plain)):
        time = [o.time for o in outcomes if o.error <= FORMED]
        print(
            f"{name}: median {np.median(time):.0f} s, longest {max(time):.0f} s, largest error "
            f"{max(o.error for o in outcomes):.4f} m"
        )


if __name__ == "__main__":
    main()
