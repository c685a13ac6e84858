"""Method 2 of [Morgan2016] as printed, for vehicles that cross, double integrators in the plane."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import linprog

STEPS, STEP, RADIUS, CONTROL = 20, 1.0, 0.5, 0.2  # T, Δt [s], R_col [m], U_max [m/s²]
VEHICLES, RING, JITTER = 4, 3.0, 0.4  # that cross a ring of this radius, starts off by as much [m]
TOLERANCE = 1e-6  # ε_SCP, and of a distance [m]
MAX_ITERATIONS = 60
FINE = 50  # instants a step at which continuous paths are looked at

Trajectories = Float[Array, "vehicles instants 2"]


class Encounter(NamedTuple):
    """Vehicles at rest, and their targets at rest."""

    start: Float[Array, "vehicles 2"]  # [m]
    target: Float[Array, "vehicles 2"]  # [m]


class Crossing(NamedTuple):
    """Outcome of Method 2; no distances where a program is infeasible."""

    iterations: int  # `MAX_ITERATIONS` where it never ends
    separation: float = np.nan  # least distance at samples [m]
    between: float = np.nan  # least distance in continuous time [m]


def _propagators() -> tuple[Float[Array, "instants steps"], Float[Array, "instants steps"]]:
    # Positions and velocities at all instants by the controls, from rest.
    lag = np.arange(STEPS + 1)[:, None] - np.arange(STEPS)
    return np.where(lag > 0, (lag - 0.5) * STEP**2, 0.0), np.where(lag > 0, STEP, 0.0)


POSITION, VELOCITY = _propagators()
# Controls are the difference of two parts, each not negative: columns x⁺, y⁺, x⁻, y⁻.
SIGNS = np.array([[1.0, 0, -1, 0], [0, 1, 0, -1]])
FINAL = np.vstack([np.kron(SIGNS, POSITION[-1]), np.kron(SIGNS, VELOCITY[-1])])


def draw_encounter(rng: np.random.Generator) -> Encounter:
    """Draw vehicles on a ring that fly to the other side, off by a little."""
    angle = 2 * np.pi * np.arange(VEHICLES) / VEHICLES
    ring = RING * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    off = rng.uniform(-JITTER, JITTER, (2, VEHICLES, 2))
    return Encounter(ring + off[0], -ring + off[1])


def solve_problem_5(
    start: Array, target: Array, own: Array, others: Array
) -> Float[Array, "steps 2"] | None:
    """Solve (33)-(38), k = 1 … T, about the nominals of the vehicle and of those it avoids.

    Returns:
        The controls; nothing where there are none.
    """
    apart = own - others
    reach = RADIUS * np.linalg.norm(apart, axis=-1) + (apart * (others - start)).sum(axis=-1)
    rows = [np.kron(normal @ SIGNS, POSITION[k]) for each in apart for k, normal in enumerate(each)]
    found = linprog(
        np.ones(4 * STEPS),
        A_ub=-np.array(rows) if rows else None,
        b_ub=-reach.ravel() if rows else None,
        A_eq=FINAL,
        b_eq=[*(target - start), 0, 0],
        bounds=(0, CONTROL),
    )
    if not found.success:
        return None
    positive, negative = found.x.reshape(2, 2, STEPS)
    return np.asarray((positive - negative).T)


def fly(encounter: Encounter, may_leave: Callable[[Trajectories, int], bool]) -> Crossing:
    """Run Method 2; a vehicle leaves the iteration once it rests and `may_leave` says so.

    Those of smaller numbers have the higher priority (63).
    """
    start, target = encounter
    nobody = np.zeros((0, STEPS + 1, 2))
    alone = [solve_problem_5(*pair, nobody, nobody) for pair in zip(start, target, strict=True)]
    controls = np.array(alone)
    nominal = _positions(start, controls)
    active, iteration = set(range(len(start))), 0
    while active and iteration < MAX_ITERATIONS:
        iteration += 1
        new = controls.copy()
        for j in active:
            found = solve_problem_5(start[j], target[j], nominal[j], nominal[:j])
            if found is None:
                return Crossing(iteration)
            new[j] = found
        flown = _positions(start, new)
        rests = np.abs(flown - nominal).max(axis=(1, 2)) < TOLERANCE
        active = {j for j in active if not (rests[j] and may_leave(flown, j))}
        controls, nominal = new, flown
    return Crossing(iteration, closest(nominal), closest(_densely(start, controls)))


def as_printed(flown: Trajectories, j: int) -> bool:
    """Tell by line 14: farther than R_col from all neighbors."""
    return all(
        np.linalg.norm(flown[j] - other, axis=-1).min() > RADIUS for other in np.delete(flown, j, 0)
    )


def with_tolerance(flown: Trajectories, j: int) -> bool:
    """Tell by the distance, up to a tolerance, from those of higher priority alone."""
    near = np.linalg.norm(flown[j] - flown[:j], axis=-1)
    return bool((near >= RADIUS - TOLERANCE).all())


def closest(flown: Trajectories) -> float:
    """Return the least distance of two vehicles [m]."""
    i, j = np.triu_indices(len(flown), 1)
    return float(np.linalg.norm(flown[i] - flown[j], axis=-1).min())


def _positions(start: Array, controls: Array) -> Trajectories:
    return np.asarray(start[:, None] + np.einsum("ks,nsd->nkd", POSITION, controls))


def _densely(start: Array, controls: Array) -> Trajectories:
    within = np.arange(FINE) / FINE * STEP
    position = _positions(start, controls)[:, :-1, None]
    velocity = np.einsum("ks,nsd->nkd", VELOCITY, controls)[:, :-1, None]
    t = within[:, None]
    dense = position + t * velocity + t**2 / 2 * controls[:, :, None]
    return np.asarray(dense.reshape(len(start), -1, 2))
