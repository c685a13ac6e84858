"""Tolerances of arrival: what a wrong model leaves after the last plan that can correct it."""

from dataclasses import replace

import numpy as np
import pytest
from reconfiguration_runs import fly, make_mission, row

from problems.transfer import Trajectory
from sato import Leg
from sato.reconfiguration.models import OrbitalModel, PlantSettings
from sato.reconfiguration.orbit import Chief
from sato.reconfiguration.tolerances import _uncorrected_steps


def random_mission(kind, rng, **changes):
    """One vehicle or two in an eccentric orbit, with few long steps and much or little room."""
    steps, size, step = int(rng.integers(5, 9)), rng.uniform(20, 500), rng.uniform(10, 120)
    agents = int(rng.integers(1, 3))
    start = rng.uniform(-0.3, 0.3, (agents, 3)) * size
    start[:, 1] += np.arange(agents) * size
    target = start + rng.uniform(-1, 1, 3) * size
    options = {
        "model": OrbitalModel(kind, relinearize=False),
        "chief": Chief(semi_major_axis=9.0e6, eccentricity=rng.choice([0.0, 0.2]), inclination=0.7),
        "step": step,
        "max_control": 10 * size / (steps * step) ** 2 * rng.uniform(0.8, 4),
        "comm_radius": 50 * size,
        "collision_radius": size / 50,
        "max_speed": 1e4,
        "allow_undetectable": True,
        "replan_steps": int(rng.integers(1, 3)),
        "auction_steps": None,
        "objective": rng.choice(["fuel", "energy"]),
    }
    return make_mission(start, Leg(target, steps), **options | changes)


@pytest.mark.parametrize("kind", ["clohessy_wiltshire", "schweighart_sedwick", "eccentric"])
def test_agents_arrive_within_their_tolerances_in_inertial_space(kind):
    mission = random_mission(kind, np.random.default_rng(1), replan_steps=1, objective="energy")
    last, d = fly(mission)[-1], mission.legs[0].targets
    error = np.hstack([last.position, last.velocity]) - d[last.target_index]
    position, velocity = np.linalg.norm(error.reshape(-1, 2, 3), axis=2).max(axis=0)
    # Of two steps, which correct both; half of it where there is nobody to give way to.
    assert 0.1 < position / mission.position_tolerance < 0.6
    assert 0.1 < velocity / mission.velocity_tolerance < 0.6


def test_a_plant_that_is_the_model_adds_nothing_to_the_tolerances(rng):
    mission = random_mission("eccentric", rng, plant=PlantSettings(kind="model"))
    spacing = mission.target_spacing if mission.agents > 1 else mission.largest_separation
    assert mission.position_tolerance == pytest.approx(1e-6 * spacing)


def test_agents_that_brake_correct_nothing_before():
    u = np.r_[np.full(3, 1.0), 0.0, 0.0, np.full(3, -1.0)][:, None] * [1.0, 0.0]
    mission = make_mission(row(1, 0.0), Leg(row(1, 1.0), 8), max_control=1.0)
    paths = [Trajectory(np.zeros((9, 4)), u, 0.0)]
    assert _uncorrected_steps(mission, paths) == 3 + 2 + mission.replan_steps - 1
    assert _uncorrected_steps(replace(mission, max_control=2.0), paths) == 2 + 1
