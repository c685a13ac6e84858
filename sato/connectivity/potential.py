"""Potential of λ₂, and repulsion of agents and obstacles.

[Bernard2023] shows both in figures and states their limits; the formulas are ours.
"""

from typing import Annotated, NamedTuple

import numpy as np

from dynamics.units import Key, Length
from problems.interaction_graph import Numbers
from sato.scenario.definition import NotNegative, Positive

ASYMPTOTE_OFFSET = 1e-3  # least distance to an asymptote at which to evaluate


class Potential(NamedTuple):
    """Potential V(λ₂) [Bernard2023, Fig. 2]."""

    lambda2_min: Annotated[float, NotNegative, "λ₂^min, at which the potential is infinite"] = 0.01
    lambda2_max: Annotated[float, Positive, "λ₂^max, from which on the potential is zero"] = 3.01
    strength: Annotated[float, NotNegative, "gain of the action that keeps λ₂ large"] = 0.1


class Repulsion(NamedTuple):
    """Repulsion of a point that the range sensor measures [Bernard2023, Sec. III-D]."""

    min_distance: Annotated[
        Length, Key("nearest"), Positive, "distance d_min^obs, at which repulsion is infinite"
    ] = 1.0
    max_distance: Annotated[
        Length, Key("farthest"), Positive, "distance d_max^obs, from which on repulsion is zero"
    ] = 3.5
    strength: Annotated[float, NotNegative, "gain of repulsion [1/s]"] = 0.5


def evaluate_potential(lambda2: Numbers, potential: Potential) -> Numbers:
    """Compute V = k (m − x)² / x with x = λ₂ − λ₂^min and m = λ₂^max − λ₂^min; 0 beyond."""
    m = potential.lambda2_max - potential.lambda2_min
    x = np.maximum(lambda2 - potential.lambda2_min, ASYMPTOTE_OFFSET)
    return np.where(x < m, potential.strength * (m - x) ** 2 / x, 0.0)[()]


def negative_slope(lambda2: Numbers, potential: Potential) -> Numbers:
    """Compute −V′(λ₂) = k (m²/x² − 1), which is 0 at λ₂^max, as V is, and for NaN."""
    m = potential.lambda2_max - potential.lambda2_min
    x = np.maximum(lambda2 - potential.lambda2_min, ASYMPTOTE_OFFSET)
    return np.where(x < m, potential.strength * (m * m / (x * x) - 1), 0.0)[()]


def repulsion_gain(distance: Numbers, repulsion: Repulsion) -> Numbers:
    """Compute k_obs, the speed away from a point over its distance [1/s]."""
    m = repulsion.max_distance - repulsion.min_distance
    x = np.maximum(distance - repulsion.min_distance, ASYMPTOTE_OFFSET)
    return np.where(x < m, repulsion.strength * (m - x) ** 2 / (m * x), 0.0)[()]
