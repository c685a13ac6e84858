"""The speed of plans: from which vehicles stop within reach, in automatic steps and refusals."""

import numpy as np
import pytest
from reconfiguration_runs import fly, make_mission, row

import sato
from dynamics import discretize_zoh
from problems.auction_cost import solve_transfer
from problems.transfer import TransferProblem

NORMS = (1, 2, "inf")


def slow_speed(mission):
    """The speed from which all stop within reach after a period: V n h + V²/2U + V h/2 = r."""
    margins = mission.margin * (2 if mission.has_noise else 1)  # of references, and of hearing
    h, r = mission.step, (mission.comm_radius - mission.largest_separation - margins) / 2
    U = mission.planned_control_limit(0).least_length
    return max(np.roots([1 / (2 * U), (mission.replan_steps + 0.5) * h, -r]))


def far_and_fast(rng, steps, **more):
    """Two vehicles far from their targets, which could not stop within reach from full speed."""
    d, far = int(rng.integers(2, 4)), rng.uniform(9, 15)
    leg = sato.Leg(row(2, far, d), steps, time_factor=1.0 if steps == "auto" else None)
    norm, speed = NORMS[rng.integers(3)], rng.uniform(0.9, 1.0)
    speed /= d**0.5 if norm == "inf" else 1
    limits = {"comm_radius": 4.5, "max_speed": speed, "speed_norm": norm, "horizon_steps": 2}
    limits |= {"max_control": rng.uniform(0.1, 0.3), "auction_steps": 2}
    limits |= {"control_norm": NORMS[rng.integers(3)]}
    return make_mission(row(2, 0.0, d), leg, **(limits | more))


@pytest.mark.parametrize("seed", range(6))
def test_automatic_steps_are_the_least_at_the_speed_that_is_flown(seed):
    mission = far_and_fast(np.random.default_rng([5, seed]), "auto")
    least, slow = mission.legs[0].steps, slow_speed(mission)
    assert slow < mission.top_speeds.max()
    factor = slow / mission.top_speeds.max()
    found = []
    for steps in (least, least - 1):
        transfer = TransferProblem(
            discretize_zoh(mission.linear_model, mission.step, steps),
            mission.max_control,
            mission.max_speed * factor,
            control_norm=mission.control_norm,
            speed_norm=mission.speed_norm,
        )
        ends = mission.initial_states[0], mission.legs[0].targets[0]
        found.append(solve_transfer(transfer, *ends) is not None)
    assert found == [True, False]
    message = rf"in {least - 1} steps of 1 s, at {slow:.3g} m/s.*; steps = {least}"
    with pytest.raises(sato.InputError, match=message):
        far_and_fast(np.random.default_rng([5, seed]), least - 1)


def test_a_radius_that_is_suggested_lets_vehicles_fly_at_full_speed():
    leg = sato.Leg(row(2, 12.0), 20)
    limits = {"max_control": 0.3, "max_speed": 0.9, "horizon_steps": 2, "auction_steps": 2}
    with pytest.raises(sato.InputError, match=r"swarm\.comm_radius_m = ") as refused:
        make_mission(row(2, 0.0), leg, comm_radius=4.5, **limits)
    radius = float(str(refused.value).split("comm_radius_m = ")[1].split()[0])
    mission = make_mission(row(2, 0.0), leg, comm_radius=radius, **limits)
    assert 0.9 <= slow_speed(mission) <= 1.02 * 0.9


@pytest.mark.parametrize("seed", range(4))
def test_vehicles_below_full_speed_arrive_in_their_automatic_steps(seed):
    mission = far_and_fast(np.random.default_rng([6, seed]), "auto", assignment="given")
    frames = fly(mission)
    assert len(frames) - 1 == mission.legs[0].steps
    away = np.linalg.norm(frames[-1].position - mission.legs[0].targets[:, : mission.axes], axis=1)
    assert away.max() <= mission.position_tolerance


@pytest.mark.parametrize("noise", [{}, {"position_noise": 0.02, "velocity_noise": 0.01}])
def test_a_margin_makes_the_automatic_time_longer(noise):
    without, given = ({"comm_radius": 4.5, "margin": margin} for margin in (0.0, 0.4))
    other = {"disturbance": 1e-3} | noise if noise else given
    other = {"comm_radius": 4.5} | other
    rng = np.random.default_rng
    calm, wide = (far_and_fast(rng(1), "auto", **own) for own in (without, other))
    assert wide.margin > 0 and slow_speed(wide) < slow_speed(calm)
    assert wide.legs[0].steps > calm.legs[0].steps
    # The steps found are enough with the margin, which follows from them.
    assert wide.planned_speed_limit(0).largest_length == pytest.approx(slow_speed(wide))


def test_the_default_period_leaves_room_for_the_margin():
    changes = {"horizon_steps": 6, "comm_radius": 5.4, "max_control": 0.06}
    changes |= {"replan_steps": None, "auction_steps": None}
    periods = []
    for more in ({}, {"margin": 0.4}, {"position_noise": 0.01, "velocity_noise": 0.003}):
        mission = make_mission(row(2, 0.0), sato.Leg(row(2, 2.0), 30), **changes, **more)
        periods.append(mission.replan_steps)
        assert slow_speed(mission) >= 0.4
    assert periods == [2, 1, 1]


def test_a_start_faster_than_plans_is_not_refused():
    # It brakes at first: 0.8 m/s are more than plans may have.
    start = np.array([[0.0, 0.0, 0.8, 0.0], [0.0, 3.0, 0.0, 0.0]])
    leg = sato.Leg(sato.Points([[6.0, 0.0], [6.0, 3.0]], keep_order=True), "auto")
    limits = {"comm_radius": 4.5, "max_speed": 0.9, "horizon_steps": 2, "auction_steps": 2}
    mission = make_mission(start, leg, max_control=0.25, assignment="given", **limits)
    assert slow_speed(mission) < 0.8
    away = np.linalg.norm(fly(mission)[-1].position - mission.legs[0].targets[:, :2], axis=1)
    assert away.max() <= mission.position_tolerance


@pytest.mark.parametrize("link", [[], ["plan.horizon_steps=8", "link.round_s=0.02"]])
def test_limits_are_known_before_a_mission_is_drawn(link):
    automatic = ["plan.replan_steps=none", "plan.auction_steps=none"]
    mission = sato.read("crossing", [*automatic, *link])
    drawn = mission.draw(np.random.default_rng(0))
    for name in ("radius_for_full_speed", "lag_steps", "decision_rounds"):
        assert getattr(mission, name) == pytest.approx(getattr(drawn, name))
