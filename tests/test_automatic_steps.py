"""Automatic numbers of steps: the least in which each vehicle can arrive, times a factor."""

from math import ceil

import numpy as np
import pytest
from reconfiguration_runs import make_mission, row

from dynamics import ClohessyWiltshire, discretize_zoh
from problems.auction_cost import solve_transfer
from problems.transfer import TransferProblem
from sato import InputError, Join, Lattice, Leg, Loss, Ring, run
from sato.reconfiguration.departure import Departure
from sato.reconfiguration.reach import find_stranded

LIMITS = {"comm_radius": 60.0, "max_control": 0.2, "max_speed": 0.4, "allow_undetectable": True}


def random_mission(rng, steps, factor=1.0, **more):
    """One leg from rest or in motion to targets of a list or a shape."""
    agents, axes = int(rng.integers(2, 6)), int(rng.integers(2, 4))
    moving = rng.random() < 0.5
    start = np.zeros((agents, 2 * axes))
    start[:, 0], start[:, 1:axes] = 2 * np.arange(agents), rng.uniform(-3, 3, (agents, axes - 1))
    start[:, axes:] = rng.uniform(-0.2, 0.2, (agents, axes)) * moving
    targets = rng.permutation(row(agents + int(rng.integers(4)), rng.uniform(2, 12), axes))
    norm = "inf" if moving else [1, 2, "inf"][rng.integers(3)]  # others are solved one by one
    changes = {"control_norm": norm, "max_speed": rng.choice([0.4, 1e3])}
    leg = Leg(targets, steps, time_factor=factor if steps == "auto" else None)
    return make_mission(start, leg, **(LIMITS | changes | more))


@pytest.mark.parametrize("seed", range(8))
def test_one_step_less_than_the_least_is_refused(seed):
    least = random_mission(np.random.default_rng(seed), "auto").legs[0].steps
    assert random_mission(np.random.default_rng(seed), least).legs[0].steps == least
    with pytest.raises(InputError, match=rf"in {least - 1} steps .*; steps = {least}"):
        random_mission(np.random.default_rng(seed), least - 1)
    longer = random_mission(np.random.default_rng(seed), "auto", 1.7).legs[0].steps
    assert longer == ceil(1.7 * least - 1e-9)


@pytest.mark.parametrize("norm", [1, 2, "inf"])
@pytest.mark.parametrize(("speed", "of_speed"), [(0.3, 2), (0.3, 1), (0.3, "inf"), (np.inf, 2)])
def test_reach_with_a_speed_limit_is_that_of_the_transfer_problem(norm, speed, of_speed, rng):
    changes = {"control_norm": norm, "max_speed": speed, "speed_norm": of_speed, "max_control": 0.1}
    mission = make_mission(row(1, 0.0), Leg([[3.0, 9.0]], 99), **(LIMITS | changes))
    both = set()
    for _ in range(25):
        way, steps = rng.uniform(-2, 2, 2), int(rng.integers(4, 16))
        start, target = np.zeros((1, 4)), np.array([[*way, 0.0, 0.0]])
        fault = find_stranded(Departure(mission, np.arange(1), start), target, steps)
        model = discretize_zoh(mission.linear_model, 1.0, steps)
        transfer = TransferProblem(model, 0.1, speed, control_norm=norm, speed_norm=of_speed)
        found = solve_transfer(transfer, start[0], target[0])
        assert (fault is None) == (found is not None)
        both.add(fault is None)
    assert len(both) == 2


@pytest.mark.parametrize("assignment", ["given", "auction"])
def test_least_steps_of_many_in_motion_keep_the_speed_limit(assignment):
    # Too many pairs for programs: 60 on a ring fly at its center, and on to the other side.
    angle = 2 * np.pi * np.arange(60) / 60
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    start, speed = np.hstack([20 * unit, -0.1 * unit]), 0.4
    far = -20 * unit if assignment == "given" else -20 * unit + [60.0, 0.0]
    leg, changes = Leg(far, "auto", time_factor=1.0), LIMITS | {"comm_radius": 200.0}
    mission = make_mission(start, leg, assignment=assignment, **changes)
    least = 40 if assignment == "given" else 20  # [m], of any of them
    assert mission.legs[0].steps >= least / speed


def test_far_given_targets_of_many_in_motion_have_automatic_steps():
    angle = 2 * np.pi * np.arange(120) / 120
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    leg = Leg(60 * unit + [60.0, 0.0], "auto", time_factor=1.0)
    changes = LIMITS | {"comm_radius": 400.0, "max_control": 0.1}
    start = np.hstack([60 * unit, -0.1 * unit])
    mission = make_mission(start, leg, assignment="given", **changes)
    assert 60 / 0.4 <= mission.legs[0].steps <= 170


def test_later_legs_begin_at_the_targets_of_the_leg_before():
    legs = [Leg(row(2, y), "auto", time_factor=1.0) for y in (2.0, 20.0, 21.0)]
    drawn = make_mission(row(2, 0.0), *legs, **LIMITS)
    # Half a meter a ramp and 0.4 m/s between: 18 m take 45 s, and 2 s for the two ramps.
    assert [leg.steps for leg in drawn.legs] == [7, 47, 5]


def test_losses_joins_shapes_and_given_targets_have_automatic_steps():
    events = {"losses": [Loss("middle", share=0.3)], "joins": [Join(1, [[0.0, -30.0]], 90)]}
    legs = [
        Leg(Ring(spacing=2.0), "auto", **events),
        Leg(row(9, 30.0), "auto"),
        Leg(Ring(spacing=2.0), "auto"),
    ]
    for assignment in ("auction", "given"):
        mission = make_mission(row(8, 0.0), *legs, assignment=assignment, **LIMITS)
        steps = [leg.steps for leg in mission.legs]
        assert steps[0] > 90 and steps[1] >= 1.5 * 28 / 0.4 and steps[2] >= 1.5 * 24 / 0.4


def test_in_orbit_the_steps_follow_the_model():
    start, target = np.zeros((2, 3)), np.zeros((2, 3))
    start[:, 1], target[:, 1], target[:, 0] = (0.0, 200.0), (500.0, 800.0), 100.0
    model, limits = ClohessyWiltshire(1.1e-3), {"max_control": 1e-3, "step": 60.0}
    common = {"comm_radius": 1e4, "max_speed": np.inf, "collision_radius": 20.0}
    leg = Leg(target, "auto", time_factor=1.0)
    more = limits | common | {"allow_undetectable": True, "model": model}
    least = make_mission(start, leg, **more).legs[0].steps
    with pytest.raises(InputError, match=f"steps = {least} or"):
        make_mission(start, Leg(target, least - 1), **more)


def test_targets_out_of_reach_at_any_time_are_refused():
    far = {"max_control": 1e-30, "max_speed": 1e3}
    with pytest.raises(InputError, match=r"leg\.0\.steps: no time of up to \d+ steps is found"):
        make_mission(row(2, 0.0), Leg(row(2, 9.0), "auto"), **(LIMITS | far))
    with pytest.raises(InputError, match="time_factor: must be at least 1, got"):
        Leg(row(2, 9.0), "auto", time_factor=0.5)


def test_a_time_factor_beside_a_number_of_steps_is_refused():
    with pytest.raises(InputError, match="time_factor: 2 has no effect beside steps = 30; leave"):
        Leg(row(2, 9.0), 30, time_factor=2.0)


def test_agents_lost_before_others_join_need_no_target_of_their_own():
    loss, join = Loss("agents", agents=(0,), at_step=4), Join(1, [[5.0, 0.0]], at_step=8)
    leg = Leg(Lattice(spacing=1.5), "auto", losses=[loss], joins=[join])
    drawn = make_mission(np.array([[0.0, 0.0], [2.0, 0.0]]), leg, comm_radius=20.0)
    assert len(drawn.legs[0].targets) == 2 and drawn.legs[0].steps > 8


def test_legs_without_vehicles_have_automatic_steps():
    lost = Loss("agents", agents=(0, 1, 2), at_step=0)
    legs = [Leg(row(3, 4.0), "auto", losses=(lost,)), Leg(row(3, 0.0), "auto")]
    mission = make_mission(row(3, 0.0), *legs)
    assert mission.legs[1].steps >= 1
    assert not run(mission).summary["reached"]
