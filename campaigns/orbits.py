"""Errors of orbital models, of velocities that shall not drift, and of plans in the open loop."""

from typing import Any

import numpy as np
from numpy import ndarray as Array

import sato
from dynamics import ClohessyWiltshire
from dynamics.circular_orbit import SchweighartSedwick
from dynamics.coordinate_frames import LVLH, inertial_state, to_polar_nodal
from dynamics.discretize import discretize_zoh
from dynamics.j2 import J2, invariant_velocity
from dynamics.model import LinearizedModel, LinearModel
from dynamics.orbit import Orbit
from dynamics.plant import NonlinearPlant
from dynamics.propagation import propagate
from dynamics.tschauner_hempel import TschaunerHempel

INCLINATION = np.pi / 4
DEPUTIES, REACH = 20, 1e3  # at random in the chief's plane, within so much each way [m]
LINEARIZATION_STEPS = 30  # into which each span is divided for the linearized equations
MINUTES = 8.0, 16.0, 24.0
ORBITS, PHASES = 15, 16  # flown, and in each the instants of a mean


def predict(
    _: np.random.Generator, semi_major_axis_m: float, eccentricity: float, model: str
) -> dict[str, Any]:
    """Compare free flight from the node, with J2-invariant velocities, to a linear model's.

    Returns:
        Largest error of any coordinate of the position of any deputy after some times [m].
    """
    orbit = Orbit.from_elements(semi_major_axis_m, eccentricity, INCLINATION)
    linear: LinearModel = {
        "clohessy_wiltshire": ClohessyWiltshire.from_orbit,
        "schweighart_sedwick": SchweighartSedwick.from_orbit,
        "eccentric": TschaunerHempel,
        "j2": lambda orbit: LinearizedModel(J2(orbit)),
    }[model](orbit)
    x = np.zeros((DEPUTIES, 6))
    x[:, :2] = np.random.default_rng(1).uniform(-REACH, REACH, (DEPUTIES, 2))
    x[:, 3:] = invariant_velocity(orbit, x[:, :3])
    predicted, time, errors = x, 0.0, {}
    spans = {f"{minutes:g}_min": 60 * minutes for minutes in MINUTES}
    for name, end in (spans | {"orbit": orbit.period}).items():
        x = NonlinearPlant(J2(orbit)).propagate(x, np.zeros((DEPUTIES, 3)), time, end - time)[-1]
        step = (end - time) / LINEARIZATION_STEPS
        for A in discretize_zoh(linear, step, LINEARIZATION_STEPS, time).A:
            predicted = predicted @ A.T
        errors[f"error_{name}_m"] = np.abs(predicted - x)[:, :3].max()
        time = end
    return errors


def drift(_: np.random.Generator, latitude_deg: float) -> dict[str, Any]:
    """Fly eight points on a circle of a kilometer in the chief's plane, from a latitude on.

    Returns:
        Drift of the mean along-track position with velocities of two models [m per orbit].
    """
    at = float(np.radians(latitude_deg))
    orbit, angle = (
        Orbit.from_elements(6878e3, 0.0, INCLINATION, true_anomaly=at),
        np.arange(8) * np.pi / 4,
    )
    ring = 1e3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    return {
        "invariant_m": _along_track_drift(orbit, ring, invariant_velocity(orbit, ring)),
        "clohessy_wiltshire_m": _along_track_drift(
            orbit, ring, ClohessyWiltshire.from_orbit(orbit).centered_velocity(ring)
        ),
    }


def _along_track_drift(orbit: Orbit, place: Array, velocity: Array) -> float:
    phase = np.arange(PHASES) / PHASES
    times = orbit.period * np.concatenate([phase, ORBITS - 1 + phase])
    start = np.array(orbit.initial_elements)
    deputies = LVLH.from_polar_nodal(start, orbit.k_J2).to_inertial(np.hstack([place, velocity]))
    flown = propagate(np.vstack([inertial_state(start), deputies]), times, accuracy=1e-12)
    frames = LVLH.from_polar_nodal(to_polar_nodal(flown[:, 0]), orbit.k_J2)
    along = frames.from_inertial(flown[:, 1:])[..., 1].reshape(2, PHASES, -1).mean(axis=1)
    return float(np.abs(along[1] - along[0]).max()) / (ORBITS - 1)


def measure_misses(run: sato.Run) -> dict[str, Any]:
    """Return mean and largest error of the final positions, and the largest of the velocities."""
    held = run.data["target_index"].values[-1]
    place, speed = (
        np.linalg.norm(
            run.data[name].values[-1] - run.data[f"target_{name}"].values[0, held], axis=1
        )
        for name in ("position", "velocity")
    )
    return {"miss_m": place.mean(), "worst_m": place.max(), "worst_mm_s": 1e3 * speed.max()}
