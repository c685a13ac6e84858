"""Reach and margins where messages are lost or late: how far and how fast vehicles may fly on."""

import numpy as np
import pytest
import scipy
from reconfiguration_runs import make_mission, row

import sato
from sato.network.link import Link

LIMITS = {"max_control": 0.3, "max_speed": 0.9, "horizon_steps": 2, "auction_steps": 2}
LINKS = (
    {"loss_probability": 0.2},
    {"late": 3, "round": 0.01},
    {"loss_probability": 0.2, "outage": 0.05, "outage_share": 0.3, "round": 0.01},
    {"skew": 0.5},
    {"loss_probability": 0.1, "skew": 0.4, "round": 0.02},
)


def two_vehicles(link, steps=80, **changes):
    leg = sato.Leg(row(2, 12.0), steps)
    return make_mission(row(2, 0.0), leg, link=link, **(LIMITS | {"comm_radius": 20.0} | changes))


def delays(link, step=1.0, period=2):
    """Times in which vehicles come nearer unheard, and before they fly by what they decide."""
    return 2 * (link.silent_rounds * link.round + link.skew) + (period * step) * (link.round > 0)


@pytest.mark.parametrize("noise", [{}, {"position_noise": 0.01, "velocity_noise": 0.005}])
@pytest.mark.parametrize("faults", LINKS)
def test_plans_stop_within_the_reach_that_is_left_at_their_own_speed(faults, noise):
    link = Link(**faults)
    mission = two_vehicles(link, comm_radius=6.5, **noise)
    kept = mission.largest_separation + mission.margin * (2 if noise else 1)
    ways = (mission.comm_radius - kept) / (3 if link.skew else 2)
    h, U = mission.step, mission.planned_control_limit(0).least_length

    def left(V):
        return ways - V * delays(link) - (V * 2 * h + V**2 / (2 * U) + V * h / 2)

    fastest = min(0.9, scipy.optimize.brentq(left, 0, 10))
    assert mission.planned_speed_limit(0).largest_length == pytest.approx(fastest)
    assert mission.reach_unheard(mission.margin) == pytest.approx(ways - fastest * delays(link))
    model = mission.discretize(4)
    assert mission.make_transfer(model, 0).max_speed == mission.planned_speed_limit(0).bound


@pytest.mark.parametrize("faults", LINKS)
def test_a_radius_for_full_speed_is_enough_and_hardly_more(faults):
    slow = two_vehicles(Link(**faults), comm_radius=5.0)
    radius = slow.radius_for_full_speed
    assert slow.planned_speed_limit(0).largest_length < 0.9
    for factor, is_full in ((1.0 + 1e-9, True), (0.93, False)):
        mission = two_vehicles(Link(**faults), comm_radius=factor * radius)
        assert (mission.slow_speed is None) == is_full


def test_two_that_come_unheard_at_full_speed_stop_apart():
    # Worst case: both decide just out of hearing, fly on for all the delays there are, and stop.
    link = Link(loss_probability=0.2, outage=0.05, outage_share=0.3, round=0.01)
    mission = two_vehicles(link)
    V, reach = 0.9, mission.reach_unheard(mission.margin)
    assert mission.slow_speed is None
    gap = mission.comm_radius - 2 * V * delays(link) - 2 * reach
    assert gap == pytest.approx(mission.largest_separation)


@pytest.mark.parametrize("skew", [0.2, 0.5])
@pytest.mark.parametrize("noise", [{}, {"position_noise": 0.01, "velocity_noise": 0.005}])
def test_the_margin_holds_what_clocks_that_differ_move(skew, noise):
    link, noise = Link(skew=skew), {"collision_radius": 0.4, **noise}
    mission, calm = (two_vehicles(one, **noise) for one in (link, Link()))
    assert mission.margin == pytest.approx(calm.margin + skew * 0.9)
    with pytest.raises(sato.InputError, match=r'plan\.margin_m: 0\.1 is less.*"auto", or 0\.') as e:
        two_vehicles(link, margin=0.1)
    least = float(str(e.value).split(", or ")[1].split()[0])
    assert two_vehicles(link, margin=least).margin == least


def test_a_radius_that_leaves_nothing_is_refused_with_one_that_does():
    link = Link(loss_probability=0.2, round=0.02)
    slow = {"max_speed": 0.02, "margin": 0.2}
    with pytest.raises(
        sato.InputError, match=r"0\.6 is no more than the 0\.7 m .*_m = "
    ) as refused:
        two_vehicles(link, 800, comm_radius=0.6, **slow)
    radius = float(str(refused.value).split("comm_radius_m = ")[1].split()[0])
    assert two_vehicles(link, 800, comm_radius=radius, **slow).slow_speed is None


def test_starts_faster_than_plans_are_refused_over_a_link():
    link, leg = Link(loss_probability=0.2, round=0.02), sato.Leg(row(2, 12.0), 80)
    start = np.array([[0.0, 0.0, 0.6, 0.0], [0.0, 3.0, 0.0, 0.0]])
    with pytest.raises(sato.InputError, match=r"swarm\.start: agent 0 .*comm_radius_m = ") as e:
        make_mission(start, leg, link=link, comm_radius=5.5, **LIMITS)
    radius = float(str(e.value).split("comm_radius_m = ")[1].split()[0])
    make_mission(start, leg, link=link, comm_radius=radius, **LIMITS)
    slower = float(str(e.value).split("speed of ")[1].split()[0])
    start[0, 2] = slower
    make_mission(start, leg, link=link, comm_radius=5.5, **LIMITS)


def test_the_period_is_as_long_as_delays_leave_room_for():
    changes = {"horizon_steps": 6, "replan_steps": None, "auction_steps": None, "max_speed": 0.4}
    links = Link(), Link(round=0.01), Link(round=0.01, skew=0.3)
    missions = [two_vehicles(link, comm_radius=6.0, **changes) for link in links]
    assert [mission.replan_steps for mission in missions] == [3, 2, 1]
