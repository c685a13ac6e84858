"""The whole loop on small missions: who arrives, what is promised, what is heard."""

from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
import pytest

from dynamics import ClohessyWiltshire, DoubleIntegrator, LinearModel, discretize_zoh
from dynamics.plant import LinearPlant
from dynamics.trajectory_geometry import separations
from problems.transfer import TransferProblem
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.state import AgentMemory
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.mission import Join, Leg, Loss, Reconfiguration
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.planning import NO_PLANS, plan_trajectories
from sato.reconfiguration.solo_trajectories import TIE_BREAK_RISE, solve_solo_transfers

SPACING = 1.0


def at_rest(points):
    return np.concatenate([points, np.zeros_like(points)], axis=1)


def row(count, y, d=2):
    points = np.zeros((count, d))
    points[:, 0] = SPACING * (np.arange(count) - (count - 1) / 2)
    points[:, 1] = y
    return points


def mission_of(start, *legs, d=2, **changes):
    given = {
        "model": DoubleIntegrator(d),
        "start": at_rest(start),
        "alive": np.ones(len(start), dtype=bool),
        "legs": legs,
        "step": 1.0,
        "comm_radius": 4.0,
        "collision_radius": 0.5,
        "max_control": 0.1,
        "max_speed": 0.4,
        "horizon_steps": 4,
        "replan_steps": 2,
        "auction_steps": 4,
    }
    return Reconfiguration(**{**given, **changes})


def flown(mission, seed=0):
    return list(simulate(mission, np.random.default_rng(seed)))


def leg_ends(frames):
    return [(f, e) for f in frames for e in f.events if e["kind"] == "leg_end"]


def kinds(frames):
    return [e["kind"] for f in frames for e in f.events]


def assert_reached(mission, frames, tolerance=1e-9):
    for frame, end in leg_ends(frames):
        live = np.array(end["agents"])
        held = np.array(end["target"])[live]
        assert len(set(held)) == len(held)
        states = np.concatenate([frame.position, frame.velocity], axis=1)[live]
        goals = mission.legs[end["leg"]].targets[held]
        np.testing.assert_allclose(states, goals, atol=tolerance)


def least_separation(mission, frames, parts=1):
    x = np.array([np.concatenate([f.position, f.velocity], axis=1) for f in frames])
    u = np.nan_to_num([f.applied_control for f in frames[:-1]])
    alive = np.array([f.alive for f in frames])
    plant, h = LinearPlant(mission.model), mission.step
    fine = [plant.propagate(x[k], u[k], k * h, h, parts)[:-1] for k in range(len(u))]
    x = np.concatenate([*fine, x[-1:]])
    d = mission.model.axes
    alive = np.concatenate([np.repeat(alive[:-1], parts, axis=0), alive[-1:]])
    return separations(x[..., :d], x[..., d:], alive, mission.step / parts).minimum.distance


def gathering(count, **changes):
    """Two groups, out of hearing at first, that gather in two rows and meet on the way."""
    rng = np.random.default_rng(count)
    start = np.concatenate([row(count, -3.0), row(count, 3.0)])
    start += rng.uniform(-0.1, 0.1, start.shape)
    goal = np.concatenate([row(count, -0.5), row(count, 0.5)])[:, ::-1]
    return mission_of(start, Leg(at_rest(goal), 30), **changes)


def test_everybody_arrives_and_keeps_the_distance(rng):
    start = rng.permutation(np.concatenate([row(5, y) for y in (-2.0, -1.0, 1.0)]))
    goal = np.concatenate([row(5, y) for y in (0.0, 1.5, 3.0)])
    aside = start + np.array([3.0, 0.0])
    mission = mission_of(start, Leg(at_rest(goal), 40), Leg(at_rest(aside), 40))
    frames = flown(mission)
    assert [f.time for f in frames] == list(range(81))
    assert_reached(mission, frames)
    assert least_separation(mission, frames) >= 0.5
    assert not {"slack", "braked", "infeasible", "reset"} & set(kinds(frames))
    speeds = np.linalg.norm([f.velocity for f in frames], axis=2)
    controls = np.abs([f.control for f in frames[:-1]])
    assert speeds.max() <= 0.4 * (1 + 1e-9) and controls.max() <= 0.1 * (1 + 1e-9)


def test_the_states_follow_from_the_controls():
    mission = gathering(3)
    frames = flown(mission)
    for a, b in pairwise(frames):
        p, v, u = a.position, a.velocity, a.applied_control
        np.testing.assert_allclose(b.position, p + v + u / 2, atol=1e-12)
        np.testing.assert_allclose(b.velocity, v + u, atol=1e-12)
        np.testing.assert_array_equal(a.control, a.applied_control)
    assert np.isnan(frames[-1].control).all()


def test_the_same_seed_gives_the_same_flight_and_another_gives_another():
    mission = replace(gathering(2), disturbance=1e-3, position_noise=1e-3)
    one, two, other = flown(mission, 7), flown(mission, 7), flown(mission, 8)
    assert len(one) == len(two)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.position, b.position)
        assert a.events == b.events
    assert not np.array_equal(one[-1].position, other[-1].position)


def test_two_networks_that_claim_one_target_settle_it_on_contact():
    # [Morgan2016, Fig. 3b]: out of hearing both choose the only target that they know of.
    start = np.array([[-5.0, 0.0], [5.0, 0.0]])
    targets = at_rest(np.array([[0.0, 0.0], [0.0, 2.0]]))
    mission = mission_of(start, Leg(targets, 40), believed=1)
    frames = flown(mission)
    assert frames[0].target_index.tolist() == [0, 0]
    assert frames[0].component.tolist() == [0, 1]
    assert "reset" in kinds(frames)
    assert_reached(mission, frames)
    assert sorted(frames[-1].target_index.tolist()) == [0, 1]
    assert least_separation(mission, frames) >= 0.5


def test_who_loses_sight_of_a_holder_does_not_come_back_for_its_target():
    # Out of hearing and with a new clock, the nearer target would be the cheaper one.
    start = np.array([[-0.5, 0.0], [0.5, 0.0]])
    targets = at_rest(np.array([[3.0, 6.0], [14.0, 0.0]]))
    mission = mission_of(start, Leg(targets, 40))
    frames = flown(mission)
    assert frames[-1].component.tolist() == [0, 1]
    assert frames[-1].target_index.tolist() == [0, 1]
    assert kinds(frames).count("assignment") == 1


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_m_is_corrected_from_the_bids_that_were_heard(share):
    start = np.concatenate([row(6, 0.0), row(6, 1.0)])
    shape = Leg(at_rest(np.concatenate([row(6, 4.0), row(6, 5.0)])), 40)
    losing = replace(shape, targets=shape.targets - [0, 4, 0, 0], losses=(Loss("random", share),))
    counted = replace(shape, recount=True)
    mission = mission_of(start, shape, losing, counted)
    frames = flown(mission)
    believed = [np.array(e["believed"])[e["agents"]] for _, e in leg_ends(frames)]
    left = round(12 * (1 - share))
    assert [set(b.tolist()) for b in believed] == [{12}, {12}, {left}]
    assert len(leg_ends(frames)[-1][1]["agents"]) == left
    assert_reached(mission, frames)
    assert max(leg_ends(frames)[-1][1]["target"]) < left  # no hole among the first m


def test_more_agents_than_they_believe_find_a_target_each():
    mission = mission_of(row(8, 0.0), Leg(at_rest(row(10, 3.0)), 40), believed=2)
    frames = flown(mission)
    assert_reached(mission, frames)
    assert frames[-1].target_count.tolist() == [8] * 8
    assert sorted(frames[-1].target_index.tolist()) == list(range(8))


def test_agents_lost_on_the_way_leave_the_others_to_arrive():
    leg = Leg(at_rest(row(8, 4.0)), 40, losses=(Loss("agents", agents=(1, 6), at_step=10),))
    mission = mission_of(row(8, 0.0), leg)
    frames = flown(mission)
    assert frames[9].alive.all() and frames[10].alive.sum() == 6
    assert np.isnan(frames[10].control[[1, 6]]).all()
    assert frames[10].component[1] == frames[10].component[6] == -1
    assert frames[-1].target_index[[1, 6]].tolist() == [-1, -1]
    assert_reached(mission, frames)


def test_the_middle_is_lost_from_the_middle():
    leg = Leg(at_rest(row(9, 4.0)), 40, losses=(Loss("middle", share=1 / 3),))
    frames = flown(mission_of(row(9, 0.0), leg))
    assert np.flatnonzero(~frames[0].alive).tolist() == [3, 4, 5]
    assert len(set(frames[0].component[frames[0].alive].tolist())) == 2 - (4 * SPACING <= 4.0)


def test_agents_that_join_are_given_targets_too():
    start = np.concatenate([row(6, 0.0), row(2, -2.0)])
    alive = np.arange(8) < 6
    leg = Leg(at_rest(row(10, 3.0)), 40, joins=(Join((6, 7), at_step=6),))
    mission = mission_of(start, leg, alive=alive)
    frames = flown(mission)
    assert not frames[5].alive[6:].any() and frames[6].alive.all()
    np.testing.assert_array_equal(frames[5].position[6:], start[6:])
    assert_reached(mission, frames)
    assert frames[-1].target_count.tolist() == [8] * 8


def test_noise_and_disturbance_are_flown_against():
    mission = replace(
        gathering(2), disturbance=2e-4, position_noise=1e-4, velocity_noise=1e-4, replan_steps=1
    )
    frames = flown(mission)
    assert frames[3].measured_position is not None
    error = frames[3].measured_position - frames[3].position
    assert 0 < np.abs(error).max() < 1e-3
    assert_reached(mission, frames, tolerance=5e-3)
    assert least_separation(mission, frames) >= 0.5 - 2e-3
    assert not np.array_equal(frames[3].control, frames[3].applied_control)


@pytest.mark.parametrize("norms", [(2, 2), ("inf", "inf")])
def test_other_norms_fly_by_the_statement(norms):
    mission = replace(gathering(1), fuel_norm=norms[0], control_norm=norms[1], replan_steps=4)
    frames = flown(mission)
    assert_reached(mission, frames, tolerance=1e-5)
    assert least_separation(mission, frames) >= 0.5 - 1e-6


def test_in_space_too(rng):
    start = rng.permutation(np.concatenate([row(4, y, 3) for y in (-1.0, 1.0)]))
    mission = mission_of(start, Leg(at_rest(start[:, [0, 2, 1]] + [0, 3, 0]), 30), d=3)
    frames = flown(mission)
    assert_reached(mission, frames)
    assert least_separation(mission, frames) >= 0.5


def test_about_a_circular_orbit(rng):
    model = ClohessyWiltshire(1.1e-3)
    angle = 2 * np.pi * np.arange(8) / 8
    ring = 500 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    start = rng.permutation(ring * [-0.6, 0.9, 1] + [0, 50, 0])
    bounded = [np.concatenate([p, model.bounded_velocity(p)], axis=1) for p in (start, ring)]
    mission = mission_of(
        start, Leg(bounded[1], 24), model=model, step=60.0, comm_radius=2e3,
        collision_radius=50.0, max_control=0.01, max_speed=4.0, tie_break=5e-4, replan_steps=1,
    )  # fmt: skip
    mission = replace(mission, start=bounded[0])
    frames = flown(mission)
    assert_reached(mission, frames, tolerance=1e-6)
    assert least_separation(mission, frames, parts=12) >= 50


def test_the_printed_auction_flies_as_well(rng):
    mission = replace(gathering(3), bidder_ids=False, tie_break=0.0)
    frames = flown(mission)
    assert_reached(mission, frames)


def test_a_loss_is_noticed_when_the_next_auction_is_due():
    # Silence is all there is to hear: until then nobody changes what it does.
    leg = Leg(at_rest(row(6, 4.0)), 40, losses=(Loss("agents", agents=(2,), at_step=9),))
    whole = Leg(at_rest(row(6, 4.0)), 40)
    with_loss, without = flown(mission_of(row(6, 0.0), leg)), flown(mission_of(row(6, 0.0), whole))
    others = [0, 1, 3, 4, 5]
    for k in range(12):
        np.testing.assert_array_equal(with_loss[k].control[others], without[k].control[others])
    assert "reset" in [e["kind"] for e in with_loss[12].events]


def test_when_all_are_lost_the_flight_ends():
    leg = Leg(at_rest(row(3, 2.0)), 20, losses=(Loss("random", share=1.0, at_step=4),))
    frames = flown(mission_of(row(3, 0.0), leg))
    assert not frames[-1].alive.any() and leg_ends(frames)[0][1]["agents"] == []


class Swing(LinearModel):
    """A double integrator that is swung to and fro: its drift depends on the time of day."""

    axes = 2

    def A(self, t):
        return DoubleIntegrator(2).A(t)

    def z(self, t):
        return np.array([0.0, 0.0, 0.02 * np.sin(2 * np.pi * t / 50), 0.0])


def test_a_model_that_varies_in_time_is_planned_at_the_time_it_is_flown():
    goal = at_rest(row(3, 2.0))
    mission = mission_of(row(3, 0.0), Leg(goal, 20), Leg(goal[:, [0, 1, 2, 3]] + [1, 0, 0, 0], 20))
    frames = flown(replace(mission, model=Swing()))
    assert_reached(mission, frames, tolerance=1e-9)


def test_flights_from_rest_are_straight_and_all_keep_the_same_pace(rng):
    # What the slope of the weights is for; without it these optima are far from unique.
    transfer = TransferProblem(
        discretize_zoh(DoubleIntegrator(2), 1.0, 30), 0.3, tie_break_rise=TIE_BREAK_RISE
    )
    start, goal = at_rest(rng.uniform(-3, 3, (20, 2))), at_rest(rng.uniform(-3, 3, (20, 2)))
    flights, _ = solve_solo_transfers(transfer, start, goal)
    for flight, x, y in zip(flights, start, goal, strict=True):
        pace = np.linspace(0, 1, 31)[:, None] * (y - x)[:2] + x[:2]
        assert np.abs(flight.x[:, :2] - pace).max() < 0.6  # a burn or two at each end
        assert np.flatnonzero(np.abs(flight.u).sum(axis=1) > 1e-9).tolist()[1:-1] in ([], [1, 28])


def test_burns_that_could_be_anywhere_are_at_the_ends():
    # Half the speed is to go: any braking that covers the distance costs the same fuel.
    transfer = TransferProblem(
        discretize_zoh(DoubleIntegrator(2), 1.0, 20), 0.5, tie_break_rise=TIE_BREAK_RISE
    )
    [flight], _ = solve_solo_transfers(
        transfer, np.array([[0.0, 0.0, 0.4, 0.0]]), np.array([[4.0, 0.0, 0.0, 0.0]])
    )
    braking = np.flatnonzero(np.abs(flight.u[:, 0]) > 1e-9)
    assert set(braking.tolist()) <= {0, 19} and flight.fuel == pytest.approx(0.4, rel=1e-6)


def test_lone_flights_are_those_of_the_statement(rng):
    transfer = TransferProblem(
        discretize_zoh(DoubleIntegrator(2), 1.0, 15), 0.2, 0.45, tie_break_rise=TIE_BREAK_RISE
    )
    start, goal = at_rest(rng.uniform(-2, 2, (8, 2))), at_rest(rng.uniform(-2, 2, (8, 2)))
    for flight, x, y in zip(
        solve_solo_transfers(transfer, start, goal)[0], start, goal, strict=True
    ):
        np.testing.assert_allclose(flight.u, transfer.solve(x, y).u, atol=1e-5)


@pytest.mark.parametrize("spent", [(0.0, 1.0), (1.0, 0.0)])
def test_who_has_spent_more_goes_first(spent):
    # [Morgan2016, Remark 5]: two vehicles that must exchange places head-on.
    start = np.array([[-2.0, 0.0], [2.0, 0.0]])
    mission = mission_of(start, Leg(at_rest(start[::-1]), 20), horizon_steps=20, max_speed=np.inf)
    network = CommunicationGraph.from_positions(start, 10.0, np.ones(2, dtype=bool))
    moment = DecisionContext(mission, mission.legs[0], network, mission.initial_states, 0, 0.0)
    minds = replace(AgentMemory.initial(np.full(2, 2)), target_index=np.array([0, 1]))
    plans, _ = plan_trajectories(moment, minds, np.array(spent), NO_PLANS)
    sideways = [np.abs(plans.trajectories[i].x[:, 1]).max() for i in range(2)]
    goes_first = int(np.argmax(spent))
    assert sideways[goes_first] < 1e-9 < 0.4 < sideways[1 - goes_first]


@pytest.mark.parametrize("change", ["loss", "join"])
def test_what_happens_out_of_hearing_changes_nothing(change):
    here, far = row(4, 0.0), row(4, 0.0) + np.array([200.0, 0.0])
    start = np.concatenate([here, far])
    goal = at_rest(np.concatenate([here, far]) + np.array([1.0, 3.0]))
    alive = np.ones(8, dtype=bool)
    if change == "loss":
        event = {"losses": (Loss("agents", agents=(6,), at_step=7),)}
    else:
        alive[6] = False
        event = {"arrivals": (Join((6,), at_step=7),)}
    quiet = flown(mission_of(start, Leg(goal, 40), alive=alive))
    # Those far away may take long over it; here all is over with the last of the quiet frames.
    mission = mission_of(start, Leg(goal, 40, **event), alive=alive)
    noisy = islice(simulate(mission, np.random.default_rng(0)), len(quiet))
    for a, b in zip(quiet, noisy, strict=True):
        np.testing.assert_array_equal(a.position[:4], b.position[:4])
        np.testing.assert_array_equal(a.target_index[:4], b.target_index[:4])


def test_a_leg_that_outlasts_its_steps_says_why():
    start = np.concatenate([row(4, 0.0), row(1, -2.0)])
    leg = Leg(at_rest(row(6, 3.0)), 30, joins=(Join((4,), at_step=13),))
    frames = flown(mission_of(start, leg, alive=np.arange(5) < 4))
    assert len(frames) > 31
    reset = [(f.time, e["agents"]) for f in frames for e in f.events if e["kind"] == "reset"]
    assert reset[0] == (13.0, [0, 1, 2, 3])


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"auction_steps": 8}, "must not exceed horizon_steps"),
        ({"replan_steps": 3}, "multiple"),
        ({"legs": ()}, "at least one leg"),
        ({"step": 0.0}, "must be positive"),
        ({"horizon_steps": 0}, "at least one step"),
        ({"orders": 0}, "at least one order of priority"),
        ({"orders": 2, "bargains": -1}, "cannot be fewer than none"),
        ({"bargains": 1}, "only with orders of 2 or more"),
        ({"start": np.full((4, 4), np.nan)}, "finite start"),
    ],
)
def test_what_no_flight_could_mean_is_refused(wrong, says):
    with pytest.raises(ValueError, match=says):
        replace(gathering(2), **wrong)
