"""Reconfigurations in orbit: planned on a model, flown on a plant that differs from it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reconfiguration_runs import fly, leg_to, make_mission, min_separation

from dynamics import J2, Atmosphere, InertialPlant, LinearizedModel, Orbit, invariant_velocity
from sato.reconfiguration.disturbances import apply_thruster_errors
from sato.reconfiguration.planning import make_horizon

STEP, STEPS, RADIUS = 60.0, 12, 50.0
ORBIT = Orbit.from_elements(6878e3, inclination=np.pi / 4)
START = np.array(
    [[600.0, 0, 0], [-600, 30, 0], [0, 700, 0], [20, -700, 0], [450, 450, 0], [-450, -400, 0]]
)


def drift_free(positions, t=0.0):
    return np.hstack([positions, invariant_velocity(ORBIT, positions, t)])


def ring(count, radius=400.0):
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)


def orbit_mission(start, targets, **changes):
    values = {
        "model": J2(ORBIT),
        "plant": InertialPlant(ORBIT),
        "step": STEP,
        "comm_radius": 5e3,
        "collision_radius": RADIUS,
        "max_control": 0.01,
        "max_speed": 4.0,
        "foresight_steps": STEPS,
        "replan_steps": 1,
        "auction_steps": 1,
        "freeze_steps": 3,
        "reset": "need",
        "tie_break": 5e-4,
        "margin": 0.0,
        "position_tolerance": 0.1,
        "velocity_tolerance": 1e-3,
    }
    leg = leg_to(drift_free(targets, STEPS * STEP), STEPS)
    return make_mission(drift_free(start), leg, **(values | changes))


def arrival_error(mission, frames):
    """Distance and relative speed of each spacecraft to its target at the end."""
    last = frames[-1]
    end = np.hstack([last.position, last.velocity])
    error = end - mission.legs[0].targets[last.target_index]
    return np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1)


def test_closed_loop_arrives_and_keeps_the_separation():
    mission = orbit_mission(START, ring(6))
    frames = fly(mission)
    distance, speed = arrival_error(mission, frames)
    assert distance.max() <= 1e-3 and speed.max() <= 1e-5
    assert min_separation(mission, frames, pieces=60) >= RADIUS
    assert len(set(frames[-1].target_index)) == 6


def test_open_loop_is_exact_about_own_trajectories_and_not_about_the_chief():
    start = np.array([[1500.0, 800, 0], [-1200, 1400, 0], [900, -1500, 0]])
    targets = np.array([[1000.0, 0, 0], [0, 1000, 0], [-700, -700, 0]])
    relinearized, shared = (
        orbit_mission(start, targets, freeze_steps=STEPS, model=model)
        for model in (J2(ORBIT), LinearizedModel(J2(ORBIT)))
    )
    assert arrival_error(relinearized, fly(relinearized))[0].max() <= 1e-4
    assert 0.02 <= arrival_error(shared, fly(shared))[0].max() <= 1.0


def test_plans_are_kept_in_the_last_steps():
    frames = fly(orbit_mission(START[:3], ring(3)))
    replans = [round(f.time / STEP) for f in frames for e in f.events if e["kind"] == "replan"]
    assert replans == list(range(STEPS - 2))


def test_foresight_ends_with_the_leg_and_not_before_the_horizon():
    mission = orbit_mission(START[:2], ring(2), foresight_steps=8)
    lengths = [make_horizon(mission, STEP * k, STEPS - k).steps for k in range(STEPS)]
    assert lengths == [8, 8, 8, 8, 8, 7, 6, 5, 4, 4, 4, 4]


def test_replanning_corrects_drag_that_the_model_leaves_out():
    air = Atmosphere.from_altitude(400e3)
    plant = InertialPlant(ORBIT, np.array([0.02, 0.01, 0.03]), 0.02, air)
    mission = orbit_mission(START[:3], ring(3), plant=plant, margin=1.0)
    assert 1e-9 < arrival_error(mission, fly(mission))[0].max() <= 0.1


vectors = st.tuples(*[st.floats(-0.01, 0.01) for _ in range(3)]).map(np.array)
draws = st.tuples(*[st.floats(-3, 3) for _ in range(4)]).map(np.array)
INEXACT = orbit_mission(START[:1], ring(1), thrust_error=0.05, pointing_error=0.02)
EXACT = orbit_mission(START[:1], ring(1))


@given(vectors, draws)
def test_thruster_errors_change_size_and_direction_as_drawn(u, draw):
    size = np.linalg.norm(u)
    applied = apply_thruster_errors(INEXACT, u[None], draw[None])[0]
    assert np.linalg.norm(applied) == pytest.approx(abs(1 + 0.05 * draw[0]) * size, rel=1e-9)
    if size > 1e-6:
        cosine = applied @ u / (np.linalg.norm(applied) * size)
        across = draw[1:] - (draw[1:] @ u) * u / size**2
        assert np.arccos(np.clip(cosine, -1, 1)) == pytest.approx(
            np.arctan(0.02 * np.linalg.norm(across)), abs=1e-6
        )


@given(vectors, draws)
def test_exact_thrusters_apply_the_commanded_control(u, draw):
    np.testing.assert_allclose(apply_thruster_errors(EXACT, u[None], draw[None])[0], u, atol=1e-16)
