"""Errors of the linear models: python scripts/linear_model_errors.py [--help].

Twenty deputies, at random in the chief's plane within 1 km each way, start at the ascending
node with J2-invariant velocities and move without control. The positions that each model
predicts are compared with the exact motion under J2. The table shows the largest error of any
coordinate of any deputy.
"""

from typing import Annotated

import numpy as np
import typer

from dynamics.circular_orbit import ClohessyWiltshire, SchweighartSedwick
from dynamics.discretize import discretize_zoh
from dynamics.j2 import J2, invariant_velocity
from dynamics.model import LinearizedModel, LinearModel
from dynamics.orbit import Orbit
from dynamics.plant import NonlinearPlant
from dynamics.tschauner_hempel import TschaunerHempel

INCLINATION = np.radians(45)
ORBITS = {
    "Circular, a = 6878 km": Orbit.from_elements(6878e3, 0.0, INCLINATION),
    "Eccentric, a = 8600 km, e = 0.2, from the perigee on": Orbit.from_elements(
        8600e3, 0.2, INCLINATION
    ),
}
MINUTES = 8.0, 16.0, 24.0
LINEARIZATION_STEPS = 30  # into which each span is divided for the linearized equations


def transition_matrices(orbit: Orbit, times: np.ndarray) -> dict[str, np.ndarray]:
    """Return Φ(t, 0) of each model at the times."""
    models = {
        "Clohessy–Wiltshire": ClohessyWiltshire.from_orbit(orbit),
        "Schweighart–Sedwick": SchweighartSedwick.from_orbit(orbit),
        "Tschauner–Hempel": TschaunerHempel(orbit),
        "linearized J2": LinearizedModel(J2(orbit)),
    }
    return {name: integrate_transitions(model, times) for name, model in models.items()}


def integrate_transitions(model: LinearModel, times: np.ndarray) -> np.ndarray:
    """Return Φ(t, 0) of a linear model."""
    transitions, time = [np.eye(6)], 0.0
    for end in times:
        dt = (end - time) / LINEARIZATION_STEPS
        steps = discretize_zoh(model, dt, LINEARIZATION_STEPS, time)
        transitions.append(np.linalg.multi_dot([*steps.A[::-1], transitions[-1]]))
        time = end
    return np.array(transitions[1:])


def integrate_exactly(orbit: Orbit, x: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the positions of free motion under J2."""
    positions, time = [], 0.0
    for end in times:
        x = NonlinearPlant(J2(orbit)).propagate(x, np.zeros((len(x), 3)), time, end - time)[-1]
        positions.append(x[:, :3])
        time = end
    return np.array(positions)


def format_three_digits(error: float) -> str:
    """Format an error with three significant digits."""
    return np.format_float_positional(error, precision=3, fractional=False, trim="-")


def main(
    seed: Annotated[int, typer.Option(help="Of the deputies' positions.")] = 1,
    count: Annotated[int, typer.Option(help="Deputies.")] = 20,
    reach: Annotated[float, typer.Option(help="How far off they start, in meters.")] = 1000.0,
    distance: Annotated[
        bool, typer.Option("--distance", help="Errors as distances, not the largest coordinate.")
    ] = False,
) -> None:
    """Print the largest error of each linear model for each orbit, in meters."""
    for title, orbit in ORBITS.items():
        position = np.zeros((count, 3))
        position[:, :2] = np.random.default_rng(seed).uniform(-reach, reach, (count, 2))
        start = np.hstack([position, invariant_velocity(orbit, position)])
        times = np.array([*(60 * m for m in MINUTES), orbit.period])
        exact = integrate_exactly(orbit, start, times)

        columns = [*(f"{m:.0f} min" for m in MINUTES), f"one orbit, {orbit.period / 60:.1f} min"]
        print(f"\n{title}: position error [m]\n")
        print("| model |", " | ".join(columns), "|")
        print("|---" * (1 + len(columns)) + "|")
        for name, Phi in transition_matrices(orbit, times).items():
            error = np.einsum("tij,kj->tki", Phi, start)[..., :3] - exact
            size = np.linalg.norm(error, axis=-1) if distance else np.abs(error).max(axis=-1)
            print(f"| {name} |", " | ".join(map(format_three_digits, size.max(axis=1))), "|")


if __name__ == "__main__":
    typer.run(main)
