"""Loop of a reconfiguration: arrival, separation, losses, joins and noise on small missions."""

from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
import pytest
from graphs import complete
from reconfiguration_runs import at_rest, fly, leg_to, make_mission, min_separation, row

from dynamics import ClohessyWiltshire, DoubleIntegrator, LinearModel, discretize_zoh
from problems.transfer import Trajectory, TransferProblem
from sato.network.graph import CommunicationGraph
from sato.reconfiguration import census, loop
from sato.reconfiguration.assignment import assign_targets
from sato.reconfiguration.census import Hello
from sato.reconfiguration.leg import Join, Loss
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.plan import Plan, give_up_missed, has_changed_network
from sato.reconfiguration.planning import plan_trajectories
from sato.reconfiguration.solo_trajectories import TIE_BREAK_RISE, solve_solo_transfers
from sato.reconfiguration.state import AgentMemory, DecisionContext
from sato.reconfiguration.stopping import Commitment, controls_at


def leg_ends(frames):
    return [(f, e) for f in frames for e in f.events if e["kind"] == "leg_end"]


def event_kinds(frames):
    return [e["kind"] for f in frames for e in f.events]


def assert_reached(mission, frames, tolerance=1e-9):
    for frame, end in leg_ends(frames):
        live = np.array(end["agents"])
        held = np.array(end["target"])[live]
        assert len(set(held)) == len(held)
        states = np.concatenate([frame.position, frame.velocity], axis=1)[live]
        targets = mission.legs[end["leg"]].targets[held]
        np.testing.assert_allclose(states, targets, atol=tolerance)


def gathering(count, **changes):
    """Two groups, out of hearing at first, that gather in two rows and meet on the way."""
    rng = np.random.default_rng(count)
    start = np.concatenate([row(count, -3.0), row(count, 3.0)])
    start += rng.uniform(-0.1, 0.1, start.shape)
    targets = np.concatenate([row(count, -0.5), row(count, 0.5)])[:, ::-1]
    return make_mission(start, leg_to(at_rest(targets), 30), **changes)


def test_agents_reach_two_shapes_within_all_limits(rng):
    start = rng.permutation(np.concatenate([row(5, y) for y in (-2.0, -1.0, 1.0)]))
    targets = np.concatenate([row(5, y) for y in (0.0, 1.5, 3.0)])
    aside = start + np.array([3.0, 0.0])
    mission = make_mission(start, leg_to(at_rest(targets), 40), leg_to(at_rest(aside), 40))
    frames = fly(mission)
    assert [f.time for f in frames] == list(range(81))
    assert_reached(mission, frames)
    assert min_separation(mission, frames) >= 0.5
    assert not {"slack", "braked", "infeasible", "reset"} & set(event_kinds(frames))
    speeds = np.linalg.norm([f.velocity for f in frames], axis=2)
    controls = np.abs([f.control for f in frames[:-1]])
    assert speeds.max() <= 0.4 * (1 + 1e-9) and controls.max() <= 0.1 * (1 + 1e-9)


def test_states_follow_from_the_applied_controls():
    frames = fly(gathering(3))
    for a, b in pairwise(frames):
        p, v, u = a.position, a.velocity, a.applied_control
        np.testing.assert_allclose(b.position, p + v + u / 2, atol=1e-12)
        np.testing.assert_allclose(b.velocity, v + u, atol=1e-12)
        np.testing.assert_array_equal(a.control, a.applied_control)
    assert np.isnan(frames[-1].control).all()


def test_same_seed_gives_the_same_flight_and_another_seed_another():
    mission = gathering(2, disturbance=1e-3, position_noise=1e-3)
    one, two, other = fly(mission, 7), fly(mission, 7), fly(mission, 8)
    assert len(one) == len(two)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.position, b.position)
        assert a.events == b.events
    assert not np.array_equal(one[-1].position, other[-1].position)


def test_components_that_claim_one_target_resolve_it_when_they_meet():
    # [Morgan2016, Fig. 3b]: out of hearing both choose the only target that they know of.
    start = np.array([[-5.0, 0.0], [5.0, 0.0]])
    targets = at_rest(np.array([[0.0, 0.0], [0.0, 2.0]]))
    mission = make_mission(start, leg_to(targets, 40), target_count=1, reset="change")
    frames = fly(mission)
    assert frames[0].target_index.tolist() == [0, 0]
    assert frames[0].component.tolist() == [0, 1]
    assert "reset" in event_kinds(frames)
    assert_reached(mission, frames)
    assert sorted(frames[-1].target_index.tolist()) == [0, 1]
    assert min_separation(mission, frames) >= 0.5


def test_agent_leaves_the_target_of_a_holder_that_went_out_of_hearing():
    # Out of hearing and with a new clock, the nearer target would be the cheaper one.
    start = np.array([[-0.5, 0.0], [0.5, 0.0]])
    targets = at_rest(np.array([[3.0, 6.0], [14.0, 0.0]]))
    frames = fly(make_mission(start, leg_to(targets, 40)))
    assert frames[-1].component.tolist() == [0, 1]
    assert frames[-1].target_index.tolist() == [0, 1]
    assert event_kinds(frames).count("assignment") == 1


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_recount_takes_the_target_count_from_the_bids_before(share):
    start = np.concatenate([row(6, 0.0), row(6, 1.0)])
    targets = at_rest(np.concatenate([row(6, 4.0), row(6, 5.0)]))
    loss = Loss("random", share)
    legs = (
        leg_to(targets, 40),
        leg_to(targets - [0, 4, 0, 0], 40, losses=loss),
        leg_to(targets, 40, recount=True),
    )
    mission = make_mission(start, *legs)
    frames = fly(mission)
    believed = [np.array(e["believed"])[e["agents"]] for _, e in leg_ends(frames)]
    left = round(12 * (1 - share))
    assert [set(b.tolist()) for b in believed] == [{12}, {12}, {left}]
    assert len(leg_ends(frames)[-1][1]["agents"]) == left
    assert_reached(mission, frames)
    assert max(leg_ends(frames)[-1][1]["target"]) < left  # no hole among the first m


def test_more_agents_than_believed_find_a_target_each():
    mission = make_mission(row(8, 0.0), leg_to(at_rest(row(10, 3.0)), 40), target_count=2)
    frames = fly(mission)
    assert_reached(mission, frames)
    assert frames[-1].target_count.tolist() == [8] * 8
    assert sorted(frames[-1].target_index.tolist()) == list(range(8))


def test_agents_lost_on_the_way_leave_the_others_to_arrive():
    loss = Loss("agents", agents=(1, 6), at_step=10)
    mission = make_mission(row(8, 0.0), leg_to(at_rest(row(8, 4.0)), 40, losses=loss))
    frames = fly(mission)
    assert frames[9].alive.all() and frames[10].alive.sum() == 6
    assert np.isnan(frames[10].control[[1, 6]]).all()
    assert frames[10].component[1] == frames[10].component[6] == -1
    assert frames[-1].target_index[[1, 6]].tolist() == [-1, -1]
    assert_reached(mission, frames)


def test_loss_of_the_middle_splits_the_graph():
    leg = leg_to(at_rest(row(9, 4.0)), 40, losses=Loss("middle", share=1 / 3))
    frames = fly(make_mission(row(9, 0.0), leg, comm_radius=3.8))
    assert np.flatnonzero(~frames[0].alive).tolist() == [3, 4, 5]
    assert len(set(frames[0].component[frames[0].alive].tolist())) == 2


def test_agents_that_join_get_targets():
    joining = row(2, -2.0)
    leg = leg_to(at_rest(row(10, 3.0)), 40, joins=Join(2, joining, at_step=6))
    mission = make_mission(row(6, 0.0), leg)
    frames = fly(mission)
    assert not frames[5].alive[6:].any() and frames[6].alive.all()
    np.testing.assert_array_equal(frames[5].position[6:], joining)
    assert_reached(mission, frames)
    assert frames[-1].target_count.tolist() == [8] * 8


def test_replanning_corrects_noise_and_disturbances():
    mission = gathering(
        2, disturbance=2e-4, position_noise=1e-4, velocity_noise=1e-4, replan_steps=1
    )
    frames = fly(mission)
    assert frames[3].measured_position is not None
    error = frames[3].measured_position - frames[3].position
    assert 0 < np.abs(error).max() < 1e-3
    assert_reached(mission, frames, tolerance=5e-3)
    assert min_separation(mission, frames) >= 0.5 - 2e-3
    assert not np.array_equal(frames[3].control, frames[3].applied_control)


@pytest.mark.parametrize("norm", [2, "inf"])
def test_swarm_arrives_in_other_norms(norm):
    mission = gathering(1, fuel_norm=norm, control_norm=norm, replan_steps=4)
    frames = fly(mission)
    assert_reached(mission, frames, tolerance=1e-5)
    assert min_separation(mission, frames) >= 0.5 - 1e-6


def test_swarm_arrives_in_space(rng):
    start = rng.permutation(np.concatenate([row(4, y, 3) for y in (-1.0, 1.0)]))
    mission = make_mission(start, leg_to(at_rest(start[:, [0, 2, 1]] + [0, 3, 0]), 30))
    frames = fly(mission)
    assert_reached(mission, frames)
    assert min_separation(mission, frames) >= 0.5


def test_swarm_arrives_about_a_circular_orbit(rng):
    model = ClohessyWiltshire(1.1e-3)
    angle = 2 * np.pi * np.arange(8) / 8
    ring = 500 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    start = rng.permutation(ring * [-0.6, 0.9, 1] + [0, 50, 0])
    bounded = [np.concatenate([p, model.bounded_velocity(p)], axis=1) for p in (start, ring)]
    mission = make_mission(
        bounded[0], leg_to(bounded[1], 24), model=model, step=60.0, comm_radius=2e3,
        collision_radius=50.0, max_control=0.01, max_speed=4.0, tie_break=5e-4, replan_steps=1,
    )  # fmt: skip
    frames = fly(mission)
    assert_reached(mission, frames, tolerance=1e-6)
    assert min_separation(mission, frames, pieces=12) >= 50


def test_auction_as_printed_reaches_all_targets():
    mission = gathering(3, bidder_ids=False, tie_break=0.0)
    assert_reached(mission, fly(mission))


def test_loss_is_noticed_at_the_next_decision():
    # Silence is all there is to hear: until then no agent changes its control.
    loss = Loss("agents", agents=(2,), at_step=9)
    legs = [leg_to(at_rest(row(6, 4.0)), 40, losses=losses) for losses in (loss, ())]
    with_loss, without = (fly(make_mission(row(6, 0.0), leg, reset="change")) for leg in legs)
    others = [0, 1, 3, 4, 5]
    for k in range(10):
        np.testing.assert_array_equal(with_loss[k].control[others], without[k].control[others])
    assert "reset" in [e["kind"] for e in with_loss[10].events]


def test_flight_ends_when_all_agents_are_lost():
    loss = Loss("agents", agents=(0, 1, 2), at_step=4)
    frames = fly(make_mission(row(3, 0.0), leg_to(at_rest(row(3, 2.0)), 20, losses=loss)))
    assert not frames[-1].alive.any() and leg_ends(frames)[0][1]["agents"] == []


class PeriodicDrift(LinearModel):
    """A double integrator whose drift depends on the time."""

    axes = 2

    def A(self, t):
        return DoubleIntegrator(2).A(t)

    def z(self, t):
        return np.array([0.0, 0.0, 0.02 * np.sin(2 * np.pi * t / 50), 0.0])


def test_time_varying_model_is_planned_at_the_time_of_flight():
    targets = at_rest(row(3, 2.0))
    legs = leg_to(targets, 20), leg_to(np.array([1.0, 0, 0, 0]) + targets, 20)
    mission = make_mission(row(3, 0.0), *legs, model=PeriodicDrift())
    assert_reached(mission, fly(mission), tolerance=1e-9)


def test_solo_trajectories_from_rest_are_straight_at_one_pace(rng):
    # The slope of the weights is for this; without it these optima are far from unique.
    transfer = TransferProblem(
        discretize_zoh(DoubleIntegrator(2), 1.0, 30), 0.3, tie_break_rise=TIE_BREAK_RISE
    )
    start, targets = at_rest(rng.uniform(-3, 3, (20, 2))), at_rest(rng.uniform(-3, 3, (20, 2)))
    found, _ = solve_solo_transfers(transfer, start, targets)
    for trajectory, x, y in zip(found, start, targets, strict=True):
        pace = np.linspace(0, 1, 31)[:, None] * (y - x)[:2] + x[:2]
        assert np.abs(trajectory.x[:, :2] - pace).max() < 0.6  # a burn or two at each end
        burns = np.flatnonzero(np.abs(trajectory.u).sum(axis=1) > 1e-9).tolist()
        assert burns[1:-1] in ([], [1, 28])


def test_solo_burns_that_are_not_unique_are_at_the_ends():
    # Half the speed is left: any braking that covers the distance costs the same fuel.
    transfer = TransferProblem(
        discretize_zoh(DoubleIntegrator(2), 1.0, 20), 0.5, tie_break_rise=TIE_BREAK_RISE
    )
    [trajectory], _ = solve_solo_transfers(
        transfer, np.array([[0.0, 0.0, 0.4, 0.0]]), np.array([[4.0, 0.0, 0.0, 0.0]])
    )
    braking = np.flatnonzero(np.abs(trajectory.u[:, 0]) > 1e-9)
    assert set(braking.tolist()) <= {0, 19} and trajectory.fuel == pytest.approx(0.4, rel=1e-6)


def test_batched_solo_trajectories_equal_single_transfers(rng):
    transfer = TransferProblem(
        discretize_zoh(DoubleIntegrator(2), 1.0, 15), 0.2, 0.45, tie_break_rise=TIE_BREAK_RISE
    )
    start, targets = at_rest(rng.uniform(-2, 2, (8, 2))), at_rest(rng.uniform(-2, 2, (8, 2)))
    found, _ = solve_solo_transfers(transfer, start, targets)
    for trajectory, x, y in zip(found, start, targets, strict=True):
        np.testing.assert_allclose(trajectory.u, transfer.solve(x, y).u, atol=1e-5)


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("was_kept_from_its_target", [False, True])
def test_agent_that_burned_more_or_was_held_up_has_priority(first, was_kept_from_its_target):
    # [Morgan2016, Remark 5]: two vehicles that must exchange places head-on.
    start = np.array([[-2.0, 0.0], [2.0, 0.0]])
    leg, options = leg_to(at_rest(start[::-1]), 20), {"horizon_steps": 20, "comm_radius": 20.0}
    mission = make_mission(start, leg, assignment="central", **options)
    graph = CommunicationGraph.from_positions(start, 10.0, np.ones(2, dtype=bool))
    memory = replace(AgentMemory.initial(np.full(2, 2)), target_index=np.array([0, 1]))
    leg, x = mission.legs[0], mission.initial_states
    context = DecisionContext(mission, leg, graph, x, memory, 0, 0.0)
    fuel_used, previous = np.eye(2)[first], {}
    if was_kept_from_its_target:
        fuel_used = fuel_used[::-1]
        astray = Trajectory(x[[first]], np.zeros((0, 2)), 0.0)
        previous = {first: Plan(astray, None, 0, 0, failure_count=1)}
    plans, *_ = plan_trajectories(context, fuel_used, previous)
    sideways = [np.abs(plans[i].trajectory.x[:, 1]).max() for i in range(2)]
    assert sideways[first] < 1e-9 < 0.4 < sideways[1 - first]


def test_plan_from_which_an_agent_has_strayed_is_given_up():
    mission = make_mission(row(2, 0.0), leg_to(at_rest(row(2, 4.0)), 20))
    x = np.linspace(mission.initial_states, mission.legs[0].targets, 21)
    plans = {i: Plan(Trajectory(x[:, i], np.zeros((20, 2)), 0.0), i, 0, 20) for i in range(2)}
    strayed = x[7] + [[0.0, 0.0, 0.0, 0.0], [0.0, 1e-3, 0.0, 0.0]]
    graph, memory = complete(2), AgentMemory.initial(np.full(2, 2))
    context = DecisionContext(mission, mission.legs[0], graph, strayed, memory, 7, 7.0)
    left = give_up_missed(context, plans)
    assert [left[i].target_index for i in range(2)] == [0, None]


@pytest.mark.parametrize(("hearing", "foresight"), [(4.0, 40), (20.0, 0), (20.0, 40)])
def test_plan_is_kept_only_while_it_was_found_clear(hearing, foresight):
    # Of each two that exchange places, none would plan again before it arrives.
    start = np.array([[-3.5, 0.0], [3.5, 0.1], [0.1, -3.5], [0.0, 3.5]])
    leg = leg_to(at_rest(start[[1, 0, 3, 2]]), 40)
    ahead = {"foresight_steps": foresight, "freeze_steps": 40}
    mission = make_mission(start, leg, assignment="given", comm_radius=hearing, **ahead)
    frames = fly(mission)
    assert_reached(mission, frames, 1e-6)
    is_clear = min_separation(mission, frames) >= 0.5 * (1 - 1e-6)
    assert is_clear or "slack" in event_kinds(frames)
    if hearing == 20 and foresight:
        assert is_clear and event_kinds(frames).count("replan") == 1


def count_auctions(monkeypatch, mission):
    """Return the numbers of decisions and of auctions in a flight."""
    auctions = []

    def assign(context, *known):
        auctions.append(context.step_index)
        return assign_targets(context, *known)

    monkeypatch.setattr(loop, "assign_targets", assign)
    frames = fly(mission)
    assert_reached(mission, frames, 1e-6)
    return event_kinds(frames).count("replan"), auctions


def test_network_whose_plans_lead_to_targets_does_not_bid_again(monkeypatch):
    mission = make_mission(row(9, 0.0), leg_to(at_rest(row(9, 4.0)), 40), max_speed=0.4)
    decisions, auctions = count_auctions(monkeypatch, mission)
    assert decisions > 3 and auctions == [0]


def test_loss_in_a_network_that_keeps_its_plans_calls_for_an_auction(monkeypatch):
    loss = Loss("agents", agents=(4,), at_step=9)
    mission = make_mission(row(9, 0.0), leg_to(at_rest(row(9, 4.0)), 40, losses=loss))
    period = mission.replan_steps
    _, auctions = count_auctions(monkeypatch, mission)
    assert auctions[:2] == [0, -(-9 // period) * period]


def test_network_of_the_same_size_with_another_member_has_changed():
    # 0 and 1 decided in step 6, and before that 1 and 2 in step 4.
    claim_step = np.array([[6, 6, 4], [6, 6, 4], [-1, 4, 4]])
    beside = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]], dtype=bool)
    np.testing.assert_array_equal(has_changed_network(claim_step, beside), [False, False, True])
    exchanged = np.array([[1, 0, 1], [0, 1, 0], [1, 0, 1]], dtype=bool)
    assert has_changed_network(claim_step, exchanged).all()
    assert not has_changed_network(np.full((3, 3), -1), beside).any()
    for changed, numbers in ((False, (0, 1)), (True, (0, 2)), (True, (1,)), (True, (0, 1, 2))):
        hellos = []
        for i in numbers:
            own = claim_step[i, i]
            together = census.checksum_members(np.flatnonzero(claim_step[i] == own).tolist())
            hellos.append(Hello(i, (0, 0), False, False, False, 0, int(own), together))
        assert census.has_changed_network(hellos) is changed


@pytest.mark.parametrize("change", ["loss", "join"])
def test_events_out_of_hearing_change_nothing(change):
    here, far = row(4, 0.0), row(4, 0.0) + np.array([200.0, 0.0])
    targets = at_rest(np.concatenate([here, far]) + np.array([1.0, 3.0]))
    if change == "loss":
        start = np.concatenate([here, far])
        event = {"losses": Loss("agents", agents=(6,), at_step=7)}
    else:
        start = np.concatenate([here, far[[0, 1, 3]]])
        event = {"joins": Join(1, far[[2]], at_step=7)}
    quiet = fly(make_mission(start, leg_to(targets, 40)))
    # The agents far away may take long over it: compare until the last of the quiet frames.
    mission = make_mission(start, leg_to(targets, 40, **event))
    changed = islice(simulate(mission, np.random.default_rng(0)), len(quiet))
    for a, b in zip(quiet, changed, strict=True):
        np.testing.assert_array_equal(a.position[:4], b.position[:4])
        np.testing.assert_array_equal(a.target_index[:4], b.target_index[:4])


def test_leg_that_outlasts_its_steps_records_the_reset():
    leg = leg_to(at_rest(row(6, 3.0)), 30, joins=Join(1, row(1, -2.0), at_step=13))
    frames = fly(make_mission(row(4, 0.0), leg, reset="change"))
    assert len(frames) > 31
    reset = [(f.time, e["agents"]) for f in frames for e in f.events if e["kind"] == "reset"]
    assert reset[0] == (13.0, [0, 1, 2, 3, 4])


@pytest.mark.parametrize("at_step", [1, 5, 15])
def test_join_with_time_enough_keeps_the_deadline_of_the_leg(at_step):
    leg = leg_to(at_rest(row(6, 3.0)), 30, joins=Join(start=row(2, 1.0), at_step=at_step))
    mission = make_mission(row(4, 0.0), leg, comm_radius=20.0)
    frames = fly(mission)
    assert len(frames) == 31 and frames[-1].alive.all()
    assert not [e for f in frames for e in f.events if e["kind"] == "reset"]
    away = frames[-1].position - mission.legs[0].targets[frames[-1].target_index, :2]
    assert np.abs(away).max() <= mission.position_tolerance


def test_join_without_time_enough_begins_the_clock_again():
    leg = leg_to(at_rest(row(6, 3.0)), 30, joins=Join(start=row(2, 1.0), at_step=29))
    frames = fly(make_mission(row(4, 0.0), leg, comm_radius=20.0))
    assert [f.time for f in frames for e in f.events if e["kind"] == "reset"] == [29.0]
    assert len(frames) == 29 + 31


@pytest.mark.parametrize("norm", [1, 2, "inf"])
def test_flown_control_stays_within_the_limit_that_a_plan_exceeds(norm, rng):
    mission = make_mission(row(2, 0.0), leg_to(at_rest(row(2, 1.0)), 9), control_norm=norm)
    u = rng.uniform(-1, 1, (2, 2))
    u *= 0.1 * (1 + np.array([[1e-8], [-1e-3]])) / np.linalg.norm(u, float(norm), 1)[:, None]
    committed = {i: Commitment(0, u[i : i + 1]) for i in range(2)}
    flown = controls_at(committed, 0, np.ones(2, dtype=bool), mission)
    assert np.linalg.norm(flown, float(norm), 1).max() <= 0.1 * (1 + 1e-15)
    np.testing.assert_allclose(flown, u, rtol=2e-8)
    assert (flown[1] == u[1]).all()
