"""Reach of the legs after the first: refused before the flight where no choice of targets helps."""

from dataclasses import replace

import numpy as np
import pytest
from reconfiguration_runs import make_mission, row

import sato
from sato import InputError, Join, Leg, Loss

LIMITS = {"comm_radius": 20.0, "max_control": 0.2, "allow_undetectable": True}
NEAR, FAR = row(3, 3.0), row(3, 30.0)
ONE_FAR = np.array([[-1.0, 3.0], [1.0, 3.0], [60.0, 3.0]])  # where two can stay


def draw(*legs, **changes):
    return make_mission(row(3, 0.0), Leg(NEAR, 20), *legs, **(LIMITS | changes))


@pytest.mark.parametrize("assignment", ["auction", "central", "given"])
def test_a_leg_out_of_reach_is_refused_with_its_number_and_steps(assignment):
    least = draw(Leg(FAR, "auto", time_factor=1.0), assignment=assignment).legs[1].steps
    with pytest.raises(InputError, match=rf"leg\.1\.steps: .* in 20 steps .*steps = {least} "):
        draw(Leg(FAR, 20), assignment=assignment)
    assert draw(Leg(FAR, least), assignment=assignment)
    third = Leg(NEAR, least - 1)
    with pytest.raises(InputError, match=rf"leg\.2\.steps: .*steps = {least} "):
        draw(Leg(FAR, least), third, assignment=assignment)


def test_a_target_that_none_can_reach_is_refused_where_all_hear_each_other():
    with pytest.raises(InputError, match=r"target \d of leg 0 is left without a target, for"):
        draw(Leg(ONE_FAR, 20))
    # Apart, all may bid on the same target, and find out later.
    assert draw(Leg(ONE_FAR, 20), comm_radius=0.6)


def test_losses_and_joins_change_who_has_to_reach_a_target():
    for loss in (Loss("middle", share=0.4), Loss("agents", agents=(1,), at_step=7)):
        assert draw(Leg(ONE_FAR, 20, losses=[loss]))
    beside = [[60.0, 5.0]]
    assert draw(
        Leg(np.vstack([ONE_FAR[:2], [[0.0, 5.0]], [[60.0, 3.0]]]), 20, joins=[Join(1, beside)])
    )
    two_far = np.vstack([ONE_FAR[:2], [[60.0, 3.0]], [[62.0, 3.0]]])
    with pytest.raises(InputError, match=r"leg\.1\.steps: .*without a target"):
        draw(Leg(two_far, 20, joins=[Join(1, beside)]), assignment="central")
    with pytest.raises(InputError, match=r"leg\.1\.steps: agent 3 can reach none"):
        draw(Leg(row(4, 3.0), 20, joins=[Join(1, [[0.0, 60.0]])]))
    # After a late loss it is not known who is there, but that none is near.
    lost = Leg(NEAR, 20, losses=[Loss("random", share=0.3)])
    with pytest.raises(InputError, match=r"leg\.1\.steps: .*can reach none"):
        make_mission(row(3, 0.0), lost, Leg(FAR, 20), **LIMITS)


def test_the_first_leg_counts_those_that_join_at_once_and_not_the_lost():
    far, near = row(1, 60.0), row(1, 6.0)
    legs = {y: Leg(row(4, 3.0), 20, joins=[Join(1, row(1, y))]) for y in (60.0, 6.0)}
    assert make_mission(row(3, 0.0), legs[6.0], **LIMITS)
    with pytest.raises(InputError, match=r"leg\.0\.steps: agent 3 can reach none"):
        make_mission(row(3, 0.0), legs[60.0], **LIMITS)
    for loss in (Loss("agents", agents=(1,), at_step=7), Loss("random", share=0.4, at_step=7)):
        assert make_mission(np.vstack([near, far]), Leg(row(2, 3.0), 20, losses=[loss]), **LIMITS)
        with pytest.raises(InputError, match=r"leg\.0\.steps: .*can reach none"):
            start = np.vstack([near, far, far + 2.0])
            make_mission(start, Leg(row(3, 3.0), 20, losses=[loss]), **LIMITS)
    near_one_is_lost = Leg(row(2, 3.0), 20, losses=[Loss("agents", agents=(0,), at_step=7)])
    for assignment in ("auction", "given"):
        with pytest.raises(InputError, match=r"leg\.0\.steps: agent 1 can reach none"):
            start = np.vstack([near, far])
            make_mission(start, near_one_is_lost, assignment=assignment, **LIMITS)


def test_agents_that_know_of_no_loss_choose_among_as_many_targets():
    only_first_is_far = Leg(np.vstack([row(1, 60.0), row(2, 3.0)]), 20, choose="prefix")
    lost = replace(only_first_is_far, losses=(Loss("random", share=0.4),))
    run = sato.run(make_mission(row(3, 0.0), lost, **LIMITS))
    assert run.check().kept and not run.events("infeasible")
    with pytest.raises(InputError, match=r"leg\.0\.steps: agent \d is left without a target"):
        make_mission(row(3, 0.0), only_first_is_far, **LIMITS)


def test_given_targets_are_held_against_the_limit_of_their_own_vehicle():
    legs = [Leg(row(2, 3.0), 20), Leg(row(2, 3.0) + np.array([[0.0, 0.0], [0.0, 6.0]]), 20)]
    given = {"assignment": "given", "max_control": [0.02, 0.2], "comm_radius": 20.0}
    assert make_mission(row(2, 2.0), *legs, **(LIMITS | given))
    with pytest.raises(InputError, match=r"leg\.1\.steps: agent 1 can reach none"):
        make_mission(row(2, 2.0), *legs, **(LIMITS | given | {"max_control": [0.2, 0.02]}))
    moving = np.hstack([row(2, 3.0), [[0.0, 0.1], [0.0, 0.3]]])
    speeds = {"max_speed": [0.2, 0.4], "max_control": 0.2}
    assert make_mission(row(2, 0.0), Leg(moving, 20), **(LIMITS | given | speeds))
    with pytest.raises(InputError, match=r"target 1 has to be reached at 0.3 m/s"):
        swapped = {"max_speed": [0.4, 0.2]}
        make_mission(row(2, 0.0), Leg(moving, 20), **(LIMITS | given | speeds | swapped))


def test_a_share_that_is_nobody_is_warned_of():
    leg = Leg(NEAR, 20, losses=[Loss("middle", share=0.34), Loss("random", share=0.1)])
    (warning,) = make_mission(row(3, 0.0), leg, **LIMITS).warnings()
    assert warning == "leg.0.lose.share: 0.1 of 3 agents is nobody"


def test_an_agent_that_is_lost_before_it_has_joined_is_refused():
    join = Join(1, row(1, 6.0), at_step=4)
    for at_step in (5, 7):
        leg = Leg(
            row(4, 3.0), 20, joins=[join], losses=[Loss("agents", agents=(3,), at_step=at_step)]
        )
        assert make_mission(row(3, 0.0), leg, **LIMITS)
    early = replace(leg, losses=[Loss("agents", agents=(3,), at_step=4)])
    twice = [Loss("agents", agents=(0,), at_step=step) for step in (1, 5)]
    leg = Leg(row(3, 3.0), 20, losses=twice, recount=True, choose="prefix")
    never, again = make_mission(row(3, 0.0), leg, **LIMITS).warnings()
    assert never == "leg.0.recount: there is no leg before, whose bids would count"
    assert again == "leg.0.lose.agents: agent 0 is lost before"
    with pytest.raises(InputError, match=r"share: has no effect with kind = .agents."):
        Loss("agents", agents=(0,), share=0.5)
    with pytest.raises(
        InputError, match=r"leg\.0\.lose\.at_step: 4 is not after agent 3 joins; 5 "
    ):
        make_mission(row(3, 0.0), early, **LIMITS)
