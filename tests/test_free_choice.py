"""Legs whose targets are a free choice: any of all M, and the order of the user's list."""

from dataclasses import replace

import numpy as np
import pytest
from reconfiguration_runs import make_mission

import sato
from problems.assignment import solve_assignment
from sato import InputError, Join, Leg, Loss, Points, Ring
from sato.reconfiguration.bidding_rules import compute_epsilon

NEAR = np.array([[4.0, 0.0], [4.0, 3.0]])
FAR, ABOVE = NEAR + np.array([40.0, 0.0]), NEAR + np.array([0.0, 6.0])
LIMITS = {"comm_radius": 1e3, "max_speed": np.inf, "allow_undetectable": True}


def spread(rng, count, side):
    """Points at least 1 m apart."""
    cells = np.stack(np.divmod(np.arange(side**2), side), axis=1)
    return 2.0 * rng.permutation(cells)[:count] + rng.uniform(0, 1, (count, 2))


def test_two_vehicles_take_the_two_targets_near_them():
    targets = np.concatenate([FAR, NEAR])
    run = sato.run(make_mission(NEAR - [4.0, 0.0], Leg(targets, 40), **LIMITS))
    assert run.data.target_index[-1].values.tolist() == [2, 3]
    np.testing.assert_array_equal(run.data.target_position[0], targets)
    assert run.check().kept and run.summary["fuel_m_s"] < 1
    leg = run.summary["legs"][0]
    assert leg["reached"] and "holes" not in leg and "gap" not in leg


@pytest.mark.parametrize("cost", ["fuel", "distance"])
def test_any_of_all_targets_within_n_epsilon_of_the_optimum(cost, rng):
    for _ in range(10):
        agents = int(rng.integers(2, 9))
        start, targets = spread(rng, agents, 5), spread(rng, int(rng.integers(agents, 25)), 5)
        leg = Leg(targets, 60, choose="nearest")
        mission = make_mission(start, leg, cost=cost, **LIMITS)
        held = next(sato.simulate(mission)).target_index
        way = np.abs(targets - start[:, None])
        meters = way.sum(axis=2) if cost == "fuel" else np.linalg.norm(way, axis=2)
        price = meters + 0.2 * (way**2).sum(axis=2)
        rows, bound = np.arange(agents), agents * compute_epsilon(mission, mission.legs[0])
        if cost == "fuel":  # in whole steps a meter costs a little more than in continuous time
            bound += 1e-3 * meters.max() * agents
        assert len(set(held)) == agents
        least = price[rows, solve_assignment(price)].sum()
        assert price[rows, held].sum() <= least + bound


def test_losses_and_joins_leave_each_a_target_and_later_legs_their_m():
    targets = np.concatenate([NEAR, ABOVE, FAR])
    events = {
        "losses": [Loss("agents", agents=(1,), at_step=8)],
        "joins": [Join(1, [[0.0, 9.0]], 4)],
    }
    last = Leg(Ring(spacing=2.0), 60)
    mission = make_mission(NEAR - [4.0, 0.0], Leg(targets, 40, **events), last, **LIMITS)
    run = sato.run(mission)
    assert run.summary["reached"] and run.check().kept
    assert run.data.target_count[0, 0] == 6 and run.data.target_count[-1, 0] == 2
    first = run.data.target_index.values[run.data.leg_index.values == 0]
    assert len({first[-1, 0], first[-1, 2]}) == 2 and first[-1, 2] < 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shape": Points(NEAR, keep_order=True)}, "shape.keep_order: has no meaning with choose"),
        ({"recount": True}, "recount: has no meaning with choose"),
        ({"choose": "nearst"}, 'choose: must be "prefix" or "nearest", got "nearst"'),
    ],
)
def test_contradictory_choices_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        Leg(**({"shape": NEAR, "steps": 9, "choose": "nearest"} | changes))


def test_choice_is_free_for_lists_and_a_prefix_for_shapes(tmp_path):
    file = tmp_path / "list.csv"
    np.savetxt(file, np.concatenate([FAR, NEAR]), delimiter=",")
    shapes = [
        NEAR,
        Points(NEAR),
        Points(file=str(file)),
        Points(NEAR, keep_order=True),
        Ring(radius=1),
    ]
    assert [Leg(shape, 9).is_free for shape in shapes] == [True, True, True, False, False]
    drawn = make_mission(NEAR - 4, Leg(shapes[2], 40), **LIMITS)
    np.testing.assert_array_equal(drawn.legs[0].targets[:, :2], np.concatenate([FAR, NEAR]))
    kept = replace(drawn, legs=Leg(shapes[2], 40)).without_files().legs[0]
    assert kept.is_free and len(kept.shape.positions) == 4
