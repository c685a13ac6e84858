"""Missions in orbit: planned on a model, flown on a truth that it does not know."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics import J2, Atmosphere, InertialPlant, LinearizedModel, Orbit, invariant_velocity
from dynamics.trajectory_geometry import separations
from sato.reconfiguration.disturbances import apply_thruster_errors
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.planning import make_horizon

STEP, STEPS, RADIUS = 60.0, 12, 50.0
ORBIT = Orbit.from_elements(6878e3, inclination=np.pi / 4)
TRUTH = J2(ORBIT)


def states(places, t=0.0):
    places = np.asarray(places, dtype=float)
    return np.hstack([places, invariant_velocity(ORBIT, places, t)])


def ring(count, radius=400.0):
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)


def mission_of(start, goals, **changes):
    given = {
        "model": LinearizedModel.at_origin(TRUTH),
        "nonlinear": TRUTH,
        "plant": InertialPlant(ORBIT),
        "start": states(start),
        "alive": np.ones(len(start), dtype=bool),
        "legs": (Leg(states(goals, STEPS * STEP), STEPS),),
        "step": STEP,
        "comm_radius": 5e3,
        "collision_radius": RADIUS,
        "max_control": 0.01,
        "max_speed": 4.0,
        "foresight_steps": STEPS,
        "replan_steps": 1,
        "commit_steps": 3,
        "reset": "need",
        "tie_break": 5e-4,
        "position_tolerance": 0.1,
        "velocity_tolerance": 1e-3,
    }
    return Reconfiguration(**{**given, **changes})


def flown(mission):
    return list(simulate(mission, np.random.default_rng(0)))


def miss(mission, frames):
    """How far each spacecraft ends from its target, in space and in speed."""
    last = frames[-1]
    end = np.hstack([last.position, last.velocity])
    off = end - mission.legs[0].targets[last.target]
    return np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)


def least_separation(mission, frames):
    """Along the truth, every second."""
    least = np.inf
    for frame in frames[:-1]:
        x = np.hstack([frame.position, frame.velocity])
        y = mission.truth.simulate(x, frame.applied_control, frame.time, STEP, 60)
        alive = np.ones(y.shape[:2], dtype=bool)
        least = min(least, separations(y[..., :3], y[..., 3:], alive, 1.0).minimum.distance)
    return least


CROSSING = [
    [600.0, 0, 0],
    [-600, 30, 0],
    [0, 700, 0],
    [20, -700, 0],
    [450, 450, 0],
    [-450, -400, 0],
]


def test_in_a_closed_loop_all_arrive_and_keep_the_distance():
    mission = mission_of(CROSSING, ring(6))
    frames = flown(mission)
    place, speed = miss(mission, frames)
    assert place.max() <= 1e-3 and speed.max() <= 1e-5
    assert least_separation(mission, frames) >= RADIUS
    assert len(set(frames[-1].target_index)) == 6


def test_one_plan_flown_blind_is_good_about_each_path_and_poor_about_the_chief():
    far = np.array([[1500.0, 800, 0], [-1200, 1400, 0], [900, -1500, 0]])
    goals = np.array([[1000.0, 0, 0], [0, 1000, 0], [-700, -700, 0]])
    once = mission_of(far, goals, commit_steps=STEPS)
    own = miss(once, flown(once))[0].max()
    shared = replace(once, nonlinear=None)
    chief = miss(shared, flown(shared))[0].max()
    assert own <= 1e-4
    assert 0.02 <= chief <= 1.0


def test_plans_are_kept_in_the_last_steps():
    frames = flown(mission_of(CROSSING[:3], ring(3)))
    replans = [round(f.time / STEP) for f in frames for e in f.events if e["kind"] == "replan"]
    assert replans == list(range(STEPS - 2))


def test_what_is_foreseen_ends_with_the_leg_and_never_before_the_horizon():
    mission = mission_of(CROSSING[:2], ring(2), foresight_steps=8)
    lengths = [make_horizon(mission, STEP * k, STEPS - k).steps for k in range(STEPS)]
    assert lengths == [8, 8, 8, 8, 8, 7, 6, 5, 4, 4, 4, 4]


def test_drag_that_nobody_planned_for_is_mended_on_the_way():
    air = Atmosphere.from_altitude(400e3)
    plant = InertialPlant(ORBIT, np.array([0.02, 0.01, 0.03]), 0.02, air)
    mission = mission_of(CROSSING[:3], ring(3), plant=plant, margin=1.0)
    frames = flown(mission)
    assert 1e-9 < miss(mission, frames)[0].max() <= 0.1


vectors = st.tuples(*[st.floats(-0.01, 0.01) for _ in range(3)]).map(np.array)
draws = st.tuples(*[st.floats(-3, 3) for _ in range(4)]).map(np.array)


def rough(thrust, pointing):
    return mission_of(CROSSING[:1], ring(1), thrust_error=thrust, pointing_error=pointing)


@given(vectors, draws)
def test_thrust_errors_change_size_and_direction_as_drawn(u, draw):
    size = np.linalg.norm(u)
    pushed = apply_thruster_errors(rough(0.05, 0.02), u[None], draw[None])[0]
    assert np.linalg.norm(pushed) == pytest.approx(abs(1 + 0.05 * draw[0]) * size, rel=1e-9)
    if size > 1e-6:
        cosine = pushed @ u / (np.linalg.norm(pushed) * size)
        aside = draw[1:] - (draw[1:] @ u) * u / size**2
        assert np.arccos(np.clip(cosine, -1, 1)) == pytest.approx(
            np.arctan(0.02 * np.linalg.norm(aside)), abs=1e-6
        )


@given(vectors, draws)
def test_exact_thrusters_do_as_they_are_told(u, draw):
    np.testing.assert_allclose(
        apply_thruster_errors(rough(0.0, 0.0), u[None], draw[None])[0], u, atol=1e-16
    )
