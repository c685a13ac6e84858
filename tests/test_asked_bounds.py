"""Lower bounds of the fuel over the time that was asked for, recomputed by linear programs."""

import numpy as np
import pytest
from reconfiguration_runs import make_mission, row
from scipy.optimize import linear_sum_assignment, linprog

import sato


def least_fuel(mission, start, target, steps):
    """Least fuel of a double integrator from a state to a state; infinite out of reach."""
    h, U, V, d = mission.step, mission.max_control, mission.max_speed, mission.axes
    k = np.arange(steps)
    total = 0.0
    # Limits and fuel are those of each axis alone, in the norms 1 and ∞.
    for p, v, p_end, v_end in zip(start[:d], start[d:], target[:d], target[d:], strict=True):
        drift = np.array([h**2 * (steps - k - 0.5), np.full(steps, h)])
        ends = [p_end - p - v * h * steps, v_end - v]
        speeds = h * np.tril(np.ones((steps - 1, steps)))
        both = np.hstack([speeds, -speeds])
        found = linprog(
            np.full(2 * steps, h),
            np.vstack([both, -both]),
            np.concatenate([np.full(steps - 1, V - v), np.full(steps - 1, V + v)]),
            np.hstack([drift, -drift]),
            ends,
            bounds=(0, U),
        )
        total += found.fun if found.status == 0 else np.inf
    return total


def least_fuel_asked(run):
    """The sum over legs, each from its states at its start, or from where agents join."""
    mission, data, total = run.mission, run.data, 0.0
    x = np.concatenate([data.position.values, data.velocity.values], axis=-1)
    begins = [round(event["time"] / mission.step) for event in run.events("leg_start")]
    for number, (begin, end) in enumerate(zip(begins, run.events("leg_end"), strict=True)):
        leg, entry = mission.legs[number], dict.fromkeys(end["agents"], 0)
        entry |= {i: k for agents, k in mission.joining(number) for i in agents if i in entry}
        cost = np.array(
            [
                [least_fuel(mission, x[begin + k, i], y, leg.steps - k) for y in leg.targets]
                for i, k in entry.items()
            ]
        )
        cost = np.minimum(cost, 1e6)
        rows, columns = linear_sum_assignment(cost)
        total += cost[rows, columns].sum()
    return total


def late_mission(rng, **changes):
    """Two legs, of which the first takes longer than asked, as clocks go back with a join."""
    n = int(rng.integers(2, 4))
    start = row(n, 0.0) + rng.uniform(-0.2, 0.2, (n, 2))
    join = sato.Join(1, [[rng.uniform(-1, 1), -4.0]], at_step=int(rng.integers(1, 5)))
    first = row(n + 1, 4.0) + rng.uniform(-0.2, 0.2, (n + 1, 2))
    second = row(n + 2, 1.0) + rng.uniform(-0.2, 0.2, (n + 2, 2))
    legs = sato.Leg(first, 40, joins=[join]), sato.Leg(second, 30)
    limits = {"reset": "change", "speed_norm": "inf", "max_speed": 0.35, "comm_radius": 12.0}
    return make_mission(start, *legs, **(limits | {"replan_steps": 2} | changes))


@pytest.mark.parametrize("seed", range(4))
def test_bound_over_the_time_asked_is_the_optimum_of_linear_programs(seed):
    run = sato.run(late_mission(np.random.default_rng([23, seed])))
    steps = [leg["steps"] for leg in run.summary["legs"]]
    assert steps[0] > 40 and steps[1] == 30 and run.summary["reached"]
    asked, took = (run.summary[f"fuel_lower_bound_{name}m_s"] for name in ("asked_", ""))
    assert asked == pytest.approx(least_fuel_asked(run), rel=1e-6)
    assert took < asked * (1 - 1e-3)
    assert run.check().kept


def test_both_bounds_are_equal_where_legs_take_the_time_asked():
    legs = sato.Leg(row(4, 4.0), 40), sato.Leg(row(5, 1.0), 30)
    run = sato.run(make_mission(row(3, 0.0), *legs, speed_norm="inf", max_speed=0.3))
    assert [leg["steps"] for leg in run.summary["legs"]] == [40, 30]
    asked, took = (run.summary[f"fuel_lower_bound_{name}m_s"] for name in ("asked_", ""))
    assert asked == took <= run.summary["fuel_m_s"]
    assert asked == pytest.approx(least_fuel_asked(run), rel=1e-6)


def test_vehicles_that_waited_count_from_the_step_asked():
    leg = sato.Leg(row(3, 4.0), 40, joins=[sato.Join(None, row(2, 0.2)[:1], at_step=1)])
    run = sato.run(make_mission(row(2, 0.0), leg, speed_norm="inf", max_speed=0.3))
    (join,) = run.events("join")
    assert join["time"] > 1.0 and run.summary["legs"][0]["steps"] == 40
    asked = run.summary["fuel_lower_bound_asked_m_s"]
    assert asked == pytest.approx(least_fuel_asked(run), rel=1e-6)


def test_there_is_no_bound_where_the_time_asked_is_not_enough():
    join = sato.Join(1, [[0.0, -9.0]], at_step=35)
    run = sato.run(make_mission(row(2, 0.0), sato.Leg(row(3, 4.0), 40, joins=[join])))
    assert run.summary["reached"] and run.summary["legs"][0]["steps"] > 40
    assert "fuel_lower_bound_m_s" in run.summary
    assert "fuel_lower_bound_asked_m_s" not in run.summary
