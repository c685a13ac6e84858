"""Check of a reconfiguration in orbit, where the plant differs from the model."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from recorded_run import altered, broken, check, recorded, with_data

from dynamics import ClohessyWiltshire, DoubleIntegrator, LinearizedModel, discretize_zoh
from dynamics.atmosphere import Atmosphere
from dynamics.inertial import InertialPlant
from dynamics.j2 import J2, invariant_velocity
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant
from sato.reconfiguration.check.prediction import bound_speed_excess, redraw
from sato.reconfiguration.check.promises import (
    check_applied_control,
    check_fuel,
    check_propagation,
    check_speed_limit,
)
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.estimator import GATE_SIGMAS
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.mission import Reconfiguration
from sato.runs import Run, run
from sato.shapes import Points

ORBIT = Orbit.from_elements(6878e3, inclination=np.pi / 4)
CIRCLE, EXACT = ClohessyWiltshire.from_orbit(ORBIT), LinearizedModel(J2(ORBIT))
STEP, STEPS = 60.0, 5
TRUTH = InertialPlant(ORBIT)


def mission(**changed: object) -> Reconfiguration:
    """Draw four agents in a row that change places, so that two pairs meet halfway."""
    place = np.array([[0.0, -400, 0], [30, -200, 0], [0, 200, 0], [30, 400, 0]])
    goal = place[[1, 0, 3, 2]]
    goals = Points(goal, invariant_velocity(ORBIT, goal, STEP * STEPS), keep_order=True)
    plain = Reconfiguration(
        model=EXACT,
        start=np.hstack([place, invariant_velocity(ORBIT, place)]),
        legs=(Leg(goals, STEPS),),
        step=STEP,
        comm_radius=2e3,
        collision_radius=10.0,
        max_control=0.02,
        max_speed=4.0,
        horizon_steps=2,
        replan_steps=1,
        auction_steps=1,
        plant=TRUTH,
        position_tolerance=0.5,
        velocity_tolerance=0.01,
    )
    return replace(plain.draw(np.random.default_rng(0)), **changed)


def straight(about: Reconfiguration) -> Run:
    """Record the flight of least-norm controls by the model, each agent to its own target."""
    return recorded(about, own_targets=True)


def record_of(run: Run, about: Reconfiguration | None = None) -> ReconfigurationRecord:
    return ReconfigurationRecord.from_data(run.recorded, about or run.mission)


@pytest.fixture(scope="module")
def flown():
    return straight(mission())


AIR = InertialPlant(ORBIT, np.array([0.01, 0.012, 0.008, 0.01]), 0.01, Atmosphere())
DISTURBED = mission(
    model=J2(ORBIT),
    plant=AIR,
    disturbance=1e-6,
    position_noise=0.1,
    velocity_noise=1e-4,
    thrust_error=0.05,
    pointing_error=0.02,
    freeze_steps=2,
    position_tolerance=20.0,
    velocity_tolerance=0.5,
)


@pytest.fixture(scope="module")
def disturbed():
    return recorded(DISTURBED, list(simulate(DISTURBED, np.random.default_rng(8))))


@pytest.mark.parametrize("model", [EXACT, CIRCLE], ids=["J2", "circle"])
def test_closed_loop_run_keeps_all_promises(model):
    about = mission(model=model, position_tolerance=5.0, velocity_tolerance=0.1)
    report = check(recorded(about, list(simulate(about, np.random.default_rng(1)))), seed=1)
    assert report.kept, report.broken


def test_thruster_errors_are_those_of_the_seed(disturbed):
    report = check(disturbed, seed=8)
    assert report.kept, report.broken
    assert "applied" in {promise.name for promise in check(disturbed, seed=9).broken}
    for name in ("control", "applied_control"):
        record = record_of(altered(disturbed, name, (3, 2, 1), by=1e-10))
        *_, applied = redraw(record, np.random.default_rng(8))
        assert not check_applied_control(record, applied).kept


@pytest.mark.parametrize("name", ["position", "velocity", "control", "applied_control"])
def test_altered_state_or_control_is_found(flown, name):
    by = 1e-6 * float(np.nanmax(np.abs(flown.data[name].values)))
    last = STEPS if name in ("position", "velocity") else STEPS - 1
    for k, axis in product((0, 1, 3, last), range(3)):
        record = record_of(altered(flown, name, (k, 1, axis), by=by))
        *_, applied = redraw(record, np.random.default_rng(0))
        promises = check_applied_control(record, applied), check_propagation(record)
        assert not all(promise.kept for promise in promises), (k, axis)


def test_both_controls_altered_together_are_found(flown):
    assert broken(flown) == set()
    by = 1e-6 * float(flown.data["control"][2, 0, 1])
    assert broken(altered(flown, "control applied_control", (2, 0, 1), by=by)) == {"flight"}


def test_run_is_propagated_by_the_plant_and_not_the_model(flown):
    assert "flight" in broken(flown, mission(plant=LinearPlant(EXACT)))
    assert "flight" in broken(flown, mission(plant=AIR))


@pytest.mark.parametrize("element", range(6))
def test_altered_chief_is_found(flown, element):
    value = abs(float(flown.data["chief"][4, element]))
    run = altered(flown, "chief", (4, element), by=1e-6 * (value if value > 1e-3 else 1.0))
    assert broken(run) == {"chief"}


def test_chief_is_recorded_where_the_plant_has_one(flown):
    lacking = with_data(flown, flown.data.drop_vars(["chief", "element"]))
    assert broken(lacking) == {"chief"}
    names = flown.data["element"].values[::-1]
    assert broken(with_data(flown, flown.data.assign_coords(element=names))) == {"chief"}
    free = straight(mission(plant=LinearPlant(EXACT)))
    assert broken(free) == set()
    orbiting = free.data.assign(element=flown.data["element"], chief=flown.data["chief"])
    assert broken(with_data(free, orbiting)) == {"chief"}


def test_gravity_in_the_attributes_is_that_of_the_plant(flown):
    heavier = flown.data.assign_attrs(mu_m3_s2=flown.data.attrs["mu_m3_s2"] * (1 + 1e-9))
    assert broken(with_data(flown, heavier)) == {"attributes"}


@pytest.mark.parametrize(
    "plant", [TRUTH, LinearPlant(EXACT, ORBIT), LinearPlant(CIRCLE)], ids=["truth", "J2", "circle"]
)
def test_least_separation_is_within_its_error_bound(plant):
    run = straight(mission(plant=plant))
    evidence, report = record_of(run), check(run)
    assert any(" wrong, " in promise.message for promise in report.promises)
    found, missed = evidence.separations
    dense = densely(evidence)
    assert 0 < missed < 1e-6
    assert found.minimum.distance - missed <= dense + 1e-9
    assert found.minimum.distance == pytest.approx(dense, abs=1e-6)
    assert dense < 0.9 * report.summary["min_separation_at_samples_m"]


def densely(evidence: ReconfigurationRecord) -> float:
    """Least distance of the two pairs, every half second, then 500 times around the least."""

    def apart(x):
        return np.linalg.norm(x[:, [0, 2], :3] - x[:, [1, 3], :3], axis=2).min(axis=1)

    plant, u = evidence.mission.flown_plant, evidence.frames.applied_control
    coarse = [
        plant.propagate(x, u[k], k * STEP, STEP, 120) for k, x in enumerate(evidence.state[:-1])
    ]
    k = int(np.argmin([apart(path).min() for path in coarse]))
    j = int(np.argmin(apart(coarse[k])))
    assert 0 < j < 120
    before = coarse[k][j - 1]
    return float(apart(plant.propagate(before, u[k], k * STEP + (j - 1) / 2, 1.0, 500)).min())


def test_pieces_last_a_second_at_most_and_are_even_in_number(flown):
    for step, pieces in [(60.0, 60), (59.5, 60), (61.0, 62), (0.7, 2)]:
        assert record_of(flown, mission(step=step)).pieces_per_step == pieces


@pytest.mark.parametrize(("replan", "commit"), [(1, 0), (2, 0), (2, 3), (1, 2)])
def test_speed_may_exceed_the_limit_by_the_prediction_error(replan, commit):
    about = mission(
        model=CIRCLE, replan_steps=replan, auction_steps=2, horizon_steps=3, freeze_steps=commit
    )
    evidence = record_of(straight(about))
    found = bound_speed_excess(evidence)
    steps, expected = discretize_zoh(CIRCLE, STEP, STEPS), np.zeros((STEPS + 1, 4))
    kept = {(1, 0): 0, (2, 0): 0, (2, 3): 2, (1, 2): 1}[replan, commit]
    for j in range(1, STEPS + 1):
        oldest = max((j - 1) // replan * replan - kept, 0)
        for k in range(oldest, j):
            u = np.moveaxis(evidence.frames.control[k:j], 0, 1)
            end = steps.simulate(evidence.state[k], u)[:, -1]
            off = np.linalg.norm((evidence.state[j] - end)[:, 3:], axis=1)
            expected[j] = np.maximum(expected[j], off)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)
    assert (found[1:] > 1e-6).all() and found.max() < 1e-2


def test_speed_limit_is_exact_where_the_plant_is_the_model():
    about = mission(plant=LinearPlant(EXACT, ORBIT))
    evidence = record_of(straight(about))
    assert bound_speed_excess(evidence).max() < 1e-10
    fastest = float(np.linalg.norm(evidence.frames.velocity, axis=2).max())
    for limit, kept in [(fastest * (1 + 1e-6), True), (fastest * (1 - 1e-6), False)]:
        assert (
            check_speed_limit(replace(evidence, mission=replace(about, max_speed=limit))).kept
            == kept
        )


def test_measurement_noise_adds_to_the_speed_allowance(flown):
    evidence = record_of(flown, mission(velocity_noise=1e-3))
    quiet = bound_speed_excess(record_of(flown))
    added = bound_speed_excess(evidence) - quiet
    np.testing.assert_allclose(added[1:], (8 + GATE_SIGMAS) * 1e-3 * 3**0.5, rtol=1e-2)
    assert (added[0] == 0).all()


def drifting() -> Reconfiguration:
    """Draw a mission whose targets are reached by free motion of the plant, not of the model."""
    about = mission(model=DoubleIntegrator(3), plant=TRUTH, velocity_tolerance=1e-6)
    x = about.initial_states
    for k in range(STEPS):
        x = about.flown_plant.propagate(x, np.zeros((4, 3)), k * STEP, STEP)[1]
    return replace(about, legs=(Leg(x, STEPS),), position_tolerance=1e-6)


def test_fuel_may_fall_below_the_bound_by_the_model_correction():
    about = drifting()
    report = check(recorded(about, own_targets=True, controls=np.zeros((4, STEPS, 3))))
    assert report.kept, report.broken
    assert report.summary["fuel_m_s"] == 0 < 0.1 < report.summary["fuel_lower_bound_m_s"]


def with_fuel_bound(record: ReconfigurationRecord, **changes: object) -> ReconfigurationRecord:
    """Return the record as if the lower bound on the fuel of its leg were another."""
    other = replace(record)
    vars(other)["fuel_bounds"] = [record.fuel_bounds[0]._replace(**changes)]
    return other


def test_fuel_may_not_fall_below_the_bound_by_more():
    about = drifting()
    record = record_of(recorded(about, own_targets=True, controls=np.zeros((4, STEPS, 3))))
    [bound] = record.fuel_bounds
    own = bound.per_agent.sum()
    assert bound.correction_fuel.sum() == pytest.approx(own, rel=1e-9)  # all of it was given
    assert check_fuel(record).kept
    less = bound.correction_fuel * (1 - 1e-5)
    assert not check_fuel(with_fuel_bound(record, correction_fuel=less)).kept


def test_fuel_may_fall_below_the_bound_where_limits_bind():
    # About the chief, the plant saves 5e-6 of a bound that its binding limit makes larger.
    orbit, angle = Orbit.from_elements(7000e3, inclination=np.radians(51.6)), -2.0 / 7000
    target = 7000e3 * np.array([[np.cos(angle) - 1, np.sin(angle), 0.0, 0.0, 0.0, 0.0]])
    about = Reconfiguration(
        model=J2(orbit), start=np.zeros((1, 6)), legs=[Leg(target, steps=24)], step=60.0,
        comm_radius=1e6, collision_radius=50.0, max_control=5e-3, max_speed=50.0, tie_break=0.0,
    )  # fmt: skip
    flown = run(about)
    assert flown.summary["fuel_m_s"] < flown.summary["fuel_lower_bound_m_s"]
    assert flown.verdict == "kept"


def test_fuel_bound_is_strict_where_the_plant_is_the_model():
    run = straight(mission(plant=LinearPlant(EXACT, ORBIT)))
    record, burnt = record_of(run), check(run).summary["fuel_m_s"]
    [bound] = record.fuel_bounds
    assert bound.correction_fuel.max() < 1e-10
    assert bound.total <= burnt
    assert not check_fuel(with_fuel_bound(record, total=burnt * (1 + 1e-5))).kept


def test_summary_has_model_error_and_fuel_per_agent(flown):
    said = check(flown).summary
    u, x = np.moveaxis(flown.data["control"].values[:-1], 0, 1), mission().initial_states
    by_model = discretize_zoh(EXACT, STEP, STEPS).simulate(x, u)[:, -1, :3]
    off = np.linalg.norm(flown.data["position"].values[-1] - by_model, axis=1)
    assert said["model_error_m"] == pytest.approx(off.max(), rel=1e-9)
    assert 1e-4 < off.max() < 0.5
    each = STEP * np.abs(u).sum(axis=(1, 2))
    expected = {"mean": each.mean(), "least": each.min(), "most": each.max()}
    assert said["fuel_per_agent_m_s"] == pytest.approx(expected, rel=1e-12)
    nowhere = check(straight(mission(plant=LinearPlant(EXACT)))).summary
    assert not {"model_error_m", "fuel_per_agent_m_s"} & nowhere.keys()
