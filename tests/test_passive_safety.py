"""Passive safety: after a loss of all thrust at any step, drifts keep clear of all others."""

import sys
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import sato
from problems.drifts import Drifts
from sato.reconfiguration.check.drifts import find_drift_approaches
from sato.reconfiguration.check.promises import check_drifts
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.passive_safety import OfferedDrifts, make_horizon

sys.path.append(str(Path(__file__).parent.parent / "campaigns"))  # as a worker of a campaign has it

import losses

SAFE = ["swarm.agents=6", "plan.passive_safety_m=50", "plan.passive_safety_min=100"]


@cache
def fly(scenario="orbit", seed=2, *changes):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return sato.run(scenario, seed=seed, overrides=[*SAFE, *changes])


@pytest.fixture(scope="module")
def safe():
    return fly()


@pytest.fixture(scope="module")
def safe_samples(safe):
    return sample_drifts(safe)


@pytest.fixture(scope="module")
def unsafe_samples(unsafe):
    return sample_drifts(unsafe)


@pytest.fixture(scope="module")
def unsafe():
    """The same without passive safety, and with a mission that asks for it."""
    run = fly("orbit", 2, "plan.passive_safety_m=0.001")
    return replace(run, mission=replace(run.mission, passive_safety=50.0))


def sample_drifts(run, every=20.0, duration=6000.0):
    """Least sampled distance after each loss: steps, agents, by propagation one by one."""
    mission, data = run.drawn_mission, run.data
    x = np.concatenate([data.position, data.velocity], axis=2)
    u, (T, N) = data.applied_control.values, (len(x) - 1, x.shape[1])
    grid = np.arange(0.0, T * mission.step + duration + every, every)
    plans = [x[0]]
    for t in grid[:-1]:
        k = int(t // mission.step + 1e-9)
        state = x[k] if k <= T and abs(t - k * mission.step) < 1e-6 else plans[-1]
        control = u[k] if k < T else np.zeros((N, 3))
        plans.append(mission.flown_plant.propagate(state, control, t, every)[1])
    plans, least = np.array(plans), np.empty((T, N))
    for k in range(T):
        first = round(k * mission.step / every)
        times = grid[first : first + round(duration / every)]
        moved = mission.flown_plant.propagate(
            x[k], np.zeros((N, 3)), times[0], times[-1] - times[0], len(times) - 1
        )
        away = np.linalg.norm(
            moved[:, :, None, :3] - plans[first : first + len(times), None, :, :3], axis=3
        )
        away[:, np.arange(N), np.arange(N)] = np.inf
        least[k] = away.min(axis=(0, 2))
    return least


def read(run):
    return ReconfigurationRecord.from_data(run.recorded, run.drawn_mission)


def test_all_drifts_after_a_thrust_keep_the_distance(safe, safe_samples):
    least = safe_samples
    thrusts = np.abs(safe.data.applied_control.values[:-1]).max(axis=2) > 1e-8
    after = np.vstack([np.zeros_like(thrusts[:1]), np.logical_or.accumulate(thrusts)[:-1]])
    assert after.sum() > 100 and (least[after] >= 50.0).all()
    assert safe.summary["reached"] and safe.check().kept


def test_without_passive_safety_drifts_come_nearer(unsafe_samples):
    assert unsafe_samples[1:].min() < 20.0


def test_least_distance_of_drifts_is_that_of_samples(safe, unsafe, safe_samples, unsafe_samples):
    for run, samples in ((safe, safe_samples), (unsafe, unsafe_samples)):
        found = find_drift_approaches(read(run)).nearest
        sampled = samples[found.step, found.agent]
        # Two pass each other by up to 10 m/s between samples.
        assert found.distance <= sampled <= np.hypot(found.distance, 120.0)


def test_check_refuses_a_flight_that_is_not_passively_safe(safe, unsafe):
    assert check_drifts(read(safe)).kept
    promise = check_drifts(read(unsafe))
    assert not promise.kept and promise.value < 20.0


def test_judge_of_campaigns_finds_the_distance_of_the_check(safe, unsafe):
    for run in (safe, unsafe):
        text = (
            run.mission.to_toml() if hasattr(run.mission, "to_toml") else run.data.attrs["scenario"]
        )
        data = run.data.assign_attrs(scenario=text)
        judged, own = losses.judge_drifts(data), find_drift_approaches(read(run)).nearest
        assert judged["least_m"] == pytest.approx(own.distance, abs=0.1)
        assert (judged["below"] > 0) == (own.distance < 50.0)


def test_passive_safety_costs_little_fuel(safe, unsafe):
    assert (
        unsafe.summary["fuel_m_s"] <= safe.summary["fuel_m_s"] <= 1.01 * unsafe.summary["fuel_m_s"]
    )


@pytest.mark.parametrize(("scenario", "seed"), [("eccentric", 2), ("orbit3d", 1)])
def test_drifts_about_an_ellipse_and_out_of_the_plane_keep_the_distance(scenario, seed):
    run = fly(scenario, seed)
    assert run.summary["reached"] and run.summary["min_drift_separation_m"] >= 50.0
    assert losses.judge_drifts(run.data)["below"] == 0


CHANGED = {
    "loss": ['leg.0.lose=[{kind="agents",agents=[2],at_step=6,body="coast"}]', "swarm.agents=7"],
    "join": ['leg.0.join=[{at_step=5,start={kind="points",positions_m=[[0,2500,0]]}}]'],
    "given": ['plan.assignment="given"'],
    "coarse": [
        "plan.step_min=4",
        "leg.0.steps=7",
        "plan.horizon_steps=1",
        "plan.auction_steps=1",
        "plan.freeze_steps=1",
    ],
    "alone": ["swarm.agents=1"],
}


@pytest.mark.parametrize("changes", CHANGED.values(), ids=CHANGED)
def test_vehicles_are_passively_safe_in_missions_of_any_kind(changes):
    run = fly("orbit", 3, *changes)
    assert run.check().kept and run.summary["reached"]
    judged = losses.judge_drifts(run.data)
    assert judged["below"] == 0 and judged["losses"] == run.summary["drift_losses"]
    assert run.summary["drift_losses"] > (0 if changes == CHANGED["alone"] else 5)


def test_losses_up_to_a_change_of_plans_are_left_out_and_counted():
    run = fly("orbit", 3, *CHANGED["join"])
    found, judged = find_drift_approaches(read(run)), losses.judge_drifts(run.data)
    assert found.left_out == judged["left_out"] > 0
    assert f"{found.left_out} more" in check_drifts(read(run)).message


def test_linear_model_that_is_flown_can_be_passively_safe():
    run = fly("random_cw", 2, "plan.passive_safety_m=1", "swarm.agents=12")
    assert run.check().kept and run.summary["min_drift_separation_m"] >= 1.0


def test_offers_are_safe_where_no_drift_meets_the_other_path(safe):
    mission = replace(safe.drawn_mission, passive_safety=400.0)
    horizon, rng = make_horizon(mission, 0.0, 4), np.random.default_rng(1)
    d, found = mission.axes, []
    for _ in range(60):
        x = np.repeat(mission.initial_states[:2, None], 5, axis=1)
        x[1, :, 1] = x[0, :, 1] + 500.0
        x[..., d : d + 2] += rng.normal(0, 0.3, (2, 1, 2)) * (np.arange(5) > 0)[:, None]
        drifts = horizon.follow(x, np.zeros((2, 4, d)))
        own = OfferedDrifts(horizon, Drifts(*(part[:, None] for part in drifts)))
        is_safe = own.are_safe(np.zeros(2, int), np.array([0]), np.array([1]))[0]
        paths = drifts.path[:, horizon.piece]
        apart = np.linalg.norm(drifts.drifts - paths[::-1], axis=3)[:, horizon.step > 0]
        found.append(is_safe)
        assert not is_safe or apart.min() >= 400.0
        assert is_safe == own.are_safe(np.zeros(2, int), np.array([1]), np.array([0]))[0]
    assert 5 < sum(found) < 55


def test_agent_by_messages_refuses_passive_safety(safe):
    with pytest.raises(ValueError, match="drifts lead beyond hearing"):
        sato.Agent(safe.mission, 0)


@pytest.mark.parametrize(
    ("scenario", "changes", "reason"),
    [
        ("orbit", ["plan.passive_safety_min=9"], "has no effect without plan.passive_safety_m"),
        ("crossing", ["plan.passive_safety_m=1"], "is for orbits"),
        ("orbit", [*SAFE, "disturbance.velocity_mm_s=1"], "an error of 1 mm/s"),
        ("orbit", [*SAFE, "model.kind=clohessy_wiltshire"], 'model.kind = "j2"'),
        ("orbit", [*SAFE, "plant.drag=true", "plant.ballistic_m2_kg=0.01"], "with neither drag"),
        (
            "orbit",
            [*SAFE, "swarm.comm_radius_m=300", "plan.allow_undetectable=true"],
            "needs all vehicles in one network",
        ),
        ("orbit", [*SAFE, "plan.passive_safety_min=2e4"], "up to 15 orbits"),
        ("orbit", [*SAFE, "plan.orders=2"], "plan.orders = 1 would do"),
        ("orbit", [*SAFE, "plan.passive_safety_m=900"], "targets . and . of leg 0 come within"),
        ("orbit", ["swarm.agents=6", "plan.passive_safety=50"], "write passive_safety_m"),
    ],
)
def test_passive_safety_that_cannot_be_is_refused_with_a_reason(scenario, changes, reason):
    with pytest.raises(ValueError, match=reason):
        sato.run(scenario, overrides=changes)
