"""Scenarios in orbit: chiefs, models and plants, what they start with, and what is refused."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from orbit_examples import transition_matrix
from scipy.spatial.distance import pdist

import sato
from dynamics import ClohessyWiltshire, LinearizedModel, discretize_zoh
from dynamics.atmosphere import Atmosphere
from dynamics.circular_orbit import SchweighartSedwick
from dynamics.coordinate_frames import inertial_state
from dynamics.inertial import InertialPlant
from dynamics.j2 import J2, invariant_velocity
from dynamics.orbit import EARTH_J2, EARTH_MU, EARTH_RADIUS, Orbit
from dynamics.plant import LinearPlant
from dynamics.tschauner_hempel import TschaunerHempel
from sato.reconfiguration.estimator import GATE_SIGMAS
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.models import MODELS
from sato.reconfiguration.tolerances import compute_margin
from sato.scenario.errors import InputError, ScenarioError
from sato.scenario.file import parse, read

ORBITS = ("eccentric", "orbit", "orbit200", "orbit3d", "random_cw")

FEW = """
system = "reconfiguration"
name = "few"

[swarm]
agents = 4
start = { kind = "random", box_km = 2, depth_m = 0, separation_m = 150 }
comm_radius_km = 2
collision_radius_m = 50

[chief]
semi_major_axis_km = 6878
inclination_deg = 45

[model]
kind = "j2"
max_control_mm_s2 = 10
max_speed_m_s = 4

[plan]
step_min = 1
horizon_steps = 4
tie_break = 5e-4
margin_m = 0

[[leg]]
shape = { kind = "ring", radius_km = 1 }
steps = 24
"""


def few(*overrides: str) -> Reconfiguration:
    return parse(FEW, overrides)


def drawn(*overrides: str, seed: int = 0) -> Reconfiguration:
    return few(*overrides).draw(np.random.default_rng(seed))


def refusal(*overrides: str, name: str = "") -> str:
    with pytest.raises((ScenarioError, InputError)) as caught:
        mission = read(name, overrides) if name else few(*overrides)
        mission.draw(np.random.default_rng(0))
    return str(caught.value)


@cache
def builtin(name: str) -> Reconfiguration:
    return read(name).draw(np.random.default_rng(1))


def cure(said: str, key: str) -> str:
    """The value of a key that is said to do."""
    found = re.search(rf"{key} = ([-\d.]+)", said)
    assert found, said
    return found[1].rstrip(".")


# Models, plants and velocities.


@pytest.mark.parametrize("name", ORBITS)
@pytest.mark.parametrize("kind", MODELS)
def test_every_model_serves_every_orbit_scenario(name, kind):
    mission = read(name, [f"model.kind={kind}", "agents=6"]).draw(np.random.default_rng(0))
    assert mission.linear_model.axes == 3
    assert (mission.nonlinear_model is not None) == (kind == "j2" and name != "random_cw")


def test_every_model_is_about_the_orbit_of_the_chief():
    orbit = few("chief.eccentricity=0.05").chief.orbit
    kinds = {
        "clohessy_wiltshire": ClohessyWiltshire,
        "schweighart_sedwick": SchweighartSedwick,
        "eccentric": TschaunerHempel,
        "j2": LinearizedModel,
    }
    assert set(kinds) == set(MODELS)
    for kind, model in kinds.items():
        found = drawn(f"model.kind={kind}", "chief.eccentricity=0.05").linear_model
        assert type(found) is model
        np.testing.assert_array_equal(found.A(100.0), MODELS[kind](orbit).A(100.0))


@pytest.mark.parametrize("name", ORBITS)
def test_starts_and_targets_do_not_drift_under_j2(name):
    mission, orbit = builtin(name), read(name).chief.orbit
    arrival = mission.legs[0].steps * mission.step
    for states, t in ((mission.initial_states, 0.0), (mission.legs[0].targets, arrival)):
        expected = invariant_velocity(orbit, states[:, :3], t)
        np.testing.assert_array_equal(states[:, 3:], expected)


def test_velocities_are_the_same_for_every_model():
    missions = [drawn(f"model.kind={kind}", "agents=6") for kind in MODELS]
    for other in missions[1:]:
        np.testing.assert_array_equal(other.initial_states, missions[0].initial_states)
        np.testing.assert_array_equal(other.legs[0].targets, missions[0].legs[0].targets)


def test_models_without_a_chief_have_the_velocities_of_their_equations():
    orbit = sato.Orbit.from_elements(7e6, 0.05, 0.7, true_anomaly=0.4)
    place, goal = np.array([[100.0, 0.0, 30.0]]), np.array([[0.0, 300.0, 0.0]])
    for make in (sato.TschaunerHempel, sato.SchweighartSedwick.from_orbit):
        mission = sato.Reconfiguration(
            model=(model := make(orbit)),
            start=place,
            legs=[sato.Leg(goal, 40)],
            step=20.0,
            comm_radius=1000.0,
            collision_radius=3.0,
            max_control=0.1,
            max_speed=5.0,
        ).draw(np.random.default_rng(0))
        assert_array_equal(mission.start.velocities, model.bounded_velocity(place))
        assert_array_equal(mission.legs[0].targets[:, 3:], model.bounded_velocity(goal, 800.0))


def test_velocities_are_those_of_the_time_of_join_or_arrival():
    join = "{agents=2,at_step=5,start={kind='points',positions_m=[[1500,0,0],[0,1900,0]]}}"
    ring = "{kind='ring',radius_km=1}"
    tilted = "{kind='ring',radius_km=1,normal=[-0.5,0,1]}"
    legs = f"leg=[{{shape={ring},steps=24}},{{shape={tilted},steps=30,join={join}}}]"
    scenario = few("chief.eccentricity=0.05", "chief.anomaly_deg=-100", legs)
    mission, orbit = scenario.draw(np.random.default_rng(0)), scenario.chief.orbit
    at = [(mission.initial_states[:4], 0), (mission.initial_states[4:], 29)]
    at += [(mission.legs[0].targets, 24), (mission.legs[1].targets, 54)]
    for states, steps in at:
        expected = invariant_velocity(orbit, states[:, :3], 60.0 * steps)
        np.testing.assert_array_equal(states[:, 3:], expected)
    assert np.ptp(mission.legs[1].targets[:, 2]) > 500


def test_depth_bounds_the_third_axis_alone():
    mission, flat = builtin("orbit3d"), builtin("orbit")
    assert not flat.initial_states[:, 2].any() and not flat.legs[0].targets[:, 2].any()
    assert np.abs(mission.initial_states[:, :2]).max() > 1000
    assert 400 < np.abs(mission.initial_states[:, 2]).max() <= 500
    assert np.ptp(mission.legs[0].targets[:, 2]) > 500
    # Without it a box is a cube, drawn as it always was.
    cube = read("random3d").draw(np.random.default_rng(0)).initial_states[:, :3]
    assert np.ptp(cube[:, 2]) == pytest.approx(np.ptp(cube[:, 0]), rel=0.5)


def test_orbit200_targets_stay_separated_over_an_orbit():
    mission = builtin("orbit200")
    assert len(mission.initial_states) == len(mission.legs[0].targets) == 200
    assert pdist(mission.initial_states[:, :3]).min() >= 150
    # On drift-free paths, (x, y) is (y/2, −2x) a quarter of an orbit later.
    x, y = mission.legs[0].targets[:, :2].T
    assert pdist(np.stack([y / 2, -2 * x], axis=1)).min() > mission.collision_radius


def test_model_and_plant_are_as_the_tables_say():
    mission = drawn()
    assert isinstance(mission.nonlinear_model, J2)
    assert isinstance(mission.flown_plant, InertialPlant)
    assert mission.flown_plant.ballistic_coefficient is None
    assert drawn("relinearize=false").nonlinear_model is None
    assert drawn("model.kind=eccentric").nonlinear_model is None
    planned = drawn("plant.kind=model")
    assert isinstance(planned.flown_plant, LinearPlant)
    assert planned.nonlinear_model is None
    plant = planned.flown_plant
    np.testing.assert_array_equal(plant.chief_elements(60.0), plant.chief_orbit.elements_at(60.0))
    assert isinstance(read("uiuc").draw(np.random.default_rng(0)).flown_plant, LinearPlant)


def test_disturbed_motion_is_replanned_every_step_by_default():
    assert drawn().replan_steps == 1
    assert drawn("plant.kind=model").replan_steps == 2
    assert drawn("replan_steps=2").replan_steps == 2


# Chiefs.


def test_chief_has_its_classical_elements():
    angles = "chief.node_deg=10", "chief.perigee_deg=20", "chief.anomaly_deg=30"
    orbit = few("chief.eccentricity=0.02", *angles).chief.orbit
    assert (orbit.semi_major_axis, orbit.eccentricity) == pytest.approx((6878e3, 0.02))
    found = np.degrees([orbit.inclination, orbit.raan, orbit.arg_latitude])
    assert found == pytest.approx([45, 10, 50])
    # Period of a circular orbit at 6878 km: 94.6 min [Vallado2013, sec. 1.3].
    assert few().chief.orbit.period / 60 == pytest.approx(94.6, abs=0.05)


def test_chief_may_be_given_by_its_state():
    elements = few("chief.eccentricity=0.02", "chief.anomaly_deg=30").chief.orbit
    state = inertial_state(np.array(elements.initial_elements))
    position, velocity = state[:3].tolist(), state[3:].tolist()
    given = few(f"chief={{position_m={position},velocity_m_s={velocity}}}")
    np.testing.assert_allclose(
        given.chief.orbit.initial_elements, elements.initial_elements, rtol=1e-12, atol=1e-9
    )
    again = parse(given.to_toml())
    assert again.chief.orbit == given.chief.orbit


def test_oblateness_is_that_of_the_earth_by_default():
    assert few().chief.orbit == Orbit.from_elements(6878e3, inclination=np.radians(45))
    assert few("chief.j2=0").chief.orbit.k_J2 == 0
    assert few().chief.j2 == EARTH_J2


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("2027-03-01T12:00:00", "2027-03-01T12:00:00"),
        ('"2027-03-01T12:00:00"', "2027-03-01T12:00:00"),
        ("2027-03-01", "2027-03-01T00:00:00"),
        ("2027-03-01T12:00:00Z", "2027-03-01T12:00:00"),
        ("2027-03-01T12:00:00+02:00", "2027-03-01T10:00:00"),
    ],
)
def test_epoch_is_read_as_utc(written, meant):
    assert few(f"chief.epoch={written}").chief.epoch == meant


# Drag.

DRAG = ("plant.drag=true", "plant.ballistic_m2_kg=0.01")


def test_drag_uses_the_air_at_the_perigee_by_default():
    plant = drawn(*DRAG).flown_plant
    assert plant.atmosphere == Atmosphere.from_altitude(6878e3 - EARTH_RADIUS)
    np.testing.assert_array_equal(plant.ballistic_coefficient, 0.01)
    assert plant.chief_ballistic_coefficient == 0.01
    air = "plant.density_kg_m3=1e-13", "plant.altitude_km=600", "plant.scale_height_km=70"
    thin = drawn(*DRAG, *air, "plant.chief_ballistic_m2_kg=0.02").flown_plant
    assert thin.atmosphere == Atmosphere(1e-13, 600e3, 70e3)
    assert thin.chief_ballistic_coefficient == 0.02


def test_ballistic_coefficients_are_drawn_after_the_starts():
    spread = (*DRAG, "plant.ballistic_spread=0.2")
    missions = [drawn(*spread, seed=seed) for seed in (3, 3, 4)]
    first, again, other = (mission.flown_plant.ballistic_coefficient for mission in missions)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert np.abs(first / 0.01 - 1).max() <= 0.2 and np.ptp(first) > 0
    np.testing.assert_array_equal(missions[0].initial_states, drawn(seed=3).initial_states)


# The margin.

AUTO = "margin_m=auto"


def test_margin_is_zero_where_the_plant_is_the_model():
    assert drawn(AUTO, "plant.kind=model").margin == 0.0
    # Between the samples paths are those of the shared model, also where agents re-linearize.
    assert 0 < drawn(AUTO).margin == drawn(AUTO, "model.relinearize=false").margin < 5e-3
    assert read("uiuc").draw(np.random.default_rng(0)).margin == 0.0


def test_margin_is_twice_the_model_error_until_the_next_plan():
    wrong = (AUTO, "model.kind=clohessy_wiltshire", "chief.eccentricity=0.05")
    coarse = drawn(*wrong)
    shared = discretize_zoh(coarse.linear_model, 60.0, 1, 0.0)
    still = np.zeros((4, 3))
    off = coarse.flown_plant.propagate(coarse.initial_states, still, 0.0, 60.0)[-1]
    off = (off - shared.simulate(coarse.initial_states, still[:, None])[:, -1])[:, :3]
    assert coarse.margin >= 2 * np.linalg.norm(off, axis=1).max() > 0.01
    longer = drawn(*wrong, "replan_steps=2")
    assert 4 < longer.margin / coarse.margin < 8  # between t² and t³
    # Drag adds no more than ½ a t² of the difference between two craft.
    mission = drawn(AUTO, *DRAG, "plant.ballistic_spread=0.5")
    dragged, plant = mission.margin, mission.flown_plant
    density, speed = plant.atmosphere.density_at(np.array([6878e3, 0.0, 0.0])), 7400.0
    worst = np.abs(plant.ballistic_coefficient - 0.01).max()
    expected = 2 * (0.5 * density * worst * speed**2) * 60.0**2 / 2
    assert drawn(AUTO).margin < dragged <= drawn(AUTO).margin + 1.2 * expected


TWO_STEPS = np.hypot(1.5, 0.5) * 60**2  # way of accelerations of two steps [m/(m/s²)]


@pytest.mark.parametrize(
    ("noise", "each"),
    [
        ({"thrust_error": 0.05, "pointing_error": 0.02}, 0.01 * 3**0.5 * 0.05 * TWO_STEPS),
        ({"disturbance": 1e-4}, 1e-4 * TWO_STEPS),
    ],
)
def test_margin_has_five_sigmas_of_random_errors(noise, each):
    calm = drawn("plant.kind=model", "replan_steps=2")
    assert compute_margin(replace(calm, **noise)) == pytest.approx(5 * 2**0.5 * each, rel=0.02)


@pytest.mark.parametrize(
    ("noise", "each"),
    [
        ({"position_noise": 2.0}, 2.0),
        ({"velocity_noise": 0.01}, 0.01 * 120),
        ({"position_noise": 1.0, "velocity_noise": 0.05}, np.hypot(1.0, 6.0)),
    ],
)
def test_margin_for_measurements_has_five_sigmas_and_at_most_the_gate(noise, each):
    calm = drawn("plant.kind=model", "replan_steps=2")
    two = 5 * 2**0.5
    assert (
        two * each < compute_margin(replace(calm, **noise)) < 1.02 * (two + 2 * GATE_SIGMAS) * each
    )


def test_margin_beyond_the_target_spacing_is_refused_with_a_cure():
    near = "leg.0.shape={kind='ring',spacing_m=60}"
    said = refusal(AUTO, near, "disturbance.position_m=2")
    assert "plan.margin_m: auto gives 14." in said
    drawn(near, "disturbance.position_m=2", f"margin_m={cure(said, 'margin_m')}")
    assert "takes 30 m beyond the collision radius" in refusal(near, "margin_m=30")


def test_margin_without_a_chief_is_zero_unless_there_is_noise():
    def margin(*changes):
        return read("random", changes).draw(np.random.default_rng(0)).margin

    assert margin() == margin("margin_m=auto") == 0.0
    assert margin("disturbance.acceleration_m_s2=0.01") == pytest.approx(5 * 2**0.5 * 0.015, 1e-3)
    assert margin("disturbance.acceleration_m_s2=0.01", "margin_m=0.0") == 0.0


# Tolerances.


def test_tolerance_grows_with_thrust_errors_and_frozen_steps():
    given = "disturbance.thrust=0.05"
    calm, shaken = drawn(), drawn(given)
    assert shaken.position_tolerance > 100 * calm.position_tolerance
    few, more, most = (drawn(given, f"freeze_steps={k}").position_tolerance for k in (0, 6, 9))
    assert few < more < most
    pointing = drawn("disturbance.pointing_rad=0.05")
    assert pointing.position_tolerance == pytest.approx(shaken.position_tolerance)


# Warnings.


def test_warning_states_the_error_of_a_wrong_model():
    scenario = read("orbit", ["model.kind=clohessy_wiltshire", "box_km=3.5"])
    mission = scenario.draw(np.random.default_rng(0))
    (said,) = mission.warnings()
    stated = re.fullmatch(
        r"clohessy_wiltshire is wrong by ([\d.]+) m after 1440 s of free flight for agent (\d+), "
        r"which starts ([\d.]+) m from the chief: more than a tenth of the collision radius of "
        r'50 m; model.kind = "j2" would do',
        said,
    )
    assert stated, said
    error, agent, away = float(stated[1]), int(stated[2]), float(stated[3])
    assert np.linalg.norm(mission.initial_states[agent, :3]) == pytest.approx(away, rel=1e-3)
    state = mission.initial_states[[agent]]
    exact = InertialPlant(scenario.chief.orbit).propagate(state, np.zeros((1, 3)), 0.0, 1440.0)[-1]
    told = transition_matrix(mission.linear_model, 1440.0) @ state[0]
    assert np.linalg.norm((exact[0] - told)[:3]) == pytest.approx(error, rel=1e-2)
    assert error > 5


@pytest.mark.parametrize(
    ("overrides", "cure"),
    [
        (["model.kind=eccentric", "chief.eccentricity=0.2", "semi_major_axis_km=8600"], None),
        (["model.kind=clohessy_wiltshire", "chief.eccentricity=0.02"], 'model.kind = "j2"'),
        (["model.kind=schweighart_sedwick", "chief.eccentricity=0.02"], 'model.kind = "j2"'),
        (["relinearize=false"], None),
        (["relinearize=false", "collision_radius_m=0.1"], "model.relinearize = true"),
        (["collision_radius_m=0.1"], None),
    ],
)
def test_warning_only_beyond_a_tenth_of_the_radius(overrides, cure):
    found = drawn(*overrides).warnings()
    assert len(found) == (cure is not None)
    assert all(sentence.endswith(f"{cure} would do") for sentence in found)


# Refusals, and their proposed cures.


@pytest.mark.parametrize(
    ("overrides", "key"),
    [
        (["chief.eccentricity=1.2"], "eccentricity"),
        (["chief.eccentricity=1"], "eccentricity"),
        (["chief.eccentricity=0.2"], "eccentricity"),
        (["chief.eccentricity=0.2"], "semi_major_axis_km"),
        (["chief.semi_major_axis_km=500"], "semi_major_axis_km"),
        (["chief.semi_major_axis_km=6000", "chief.eccentricity=0.1"], "semi_major_axis_km"),
    ],
)
def test_impossible_orbit_is_refused_with_a_cure(overrides, key):
    said = refusal(*overrides)
    assert said.startswith("scenario: chief.")
    found = few(*overrides, f"chief.{key}={cure(said, key)}").chief.orbit
    assert found.semi_major_axis * (1 - found.eccentricity) > EARTH_RADIUS


REFUSED = [
    ("chief.eccentricity=1.2", "chief.eccentricity: 1.2 is no ellipse"),
    ("chief.eccentricity=0.1", "eccentricity: puts the perigee 6190.2 km from the Earth's center"),
    ("semi_major_axis_km=500", "semi_major_axis_m: puts the perigee 500 km from the Earth's"),
    ("chief.position_km=[6878,0,0]", "chief.semi_major_axis_m: gives the orbit, and so does pos"),
    ("chief={eccentricity=0.1}", "chief.semi_major_axis_m: is missing; an orbit is given by"),
    ("chief={position_km=[6878,0,0]}", "chief.velocity_m_s: is missing; an orbit is given by"),
    ("chief={position_km=[6878,0],velocity_m_s=[0,7612]}", "chief.position_m: needs 3 coordinat"),
    ("chief={position_km=[6878,0,0],velocity_m_s=[0,12e3,0]}", "; perpendicular to position_m,"),
    ("chief={position_km=[6000,0,0],velocity_m_s=[0,7612,0]}", "is 6000 km from the Earth's cen"),
    ("chief={position_km=[6878,0,0],velocity_m_s=[100,0,0]}", "chief.velocity_m_s: "),
    ("chief.inclination_deg=200", "chief.inclination_rad: must be between 0 and 180 degrees, got"),
    ("chief.j2=0.3", "chief.j2: must be less than 0.05, got 0.3"),
    ("chief.epoch=tomorrow", 'chief.epoch: must be a date and time in UTC; "2026-01-01T00:00:00"'),
    ("model.kind=double_integrator", 'model.kind: "double_integrator" has no orbit, and this'),
    ("model={kind='j2',semi_major_axis_km=6878}", "model.semi_major_axis_km: there is no such key"),
    (
        "plant.drag=true",
        "plant.ballistic_m2_kg: is missing, and drag needs the coefficient C_D A/m",
    ),
    ("plant.ballistic_m2_kg=0.01", "plant.ballistic_m2_kg: has no effect without drag; drag = tru"),
    ("plant.ballistic_spread=0.2", "plant.ballistic_spread: has no effect"),
    ("plant.altitude_km=500", "plant.altitude_m: has no effect without drag"),
    (
        f"{' '.join(DRAG)} plant.kind=model",
        'plant.drag: this model has no drag; kind = "inertial" would do',
    ),
    (
        f"{' '.join(DRAG)} plant.altitude_km=500",
        "plant.density_kg_m3: is missing; density_kg_m3, altitude_m",
    ),
    (
        f"{' '.join(DRAG)} semi_major_axis_km=6500",
        "plant.drag: there is no air at the chief's perigee: ",
    ),
    ("plant.drag=true plant.ballistic=0.01", "ballistic: has no unit; write ballistic_m2_kg"),
    ("disturbance.thrust=5", "disturbance.thrust: 5 is 500 % of the thrust; 0.05 would be 5 %"),
    ("disturbance.pointing_rad=1", "1 is 57.3 degrees; at most pointing_deg = 30 would do"),
    ("disturbance.position_m=60", "60 is not less than swarm.collision_radius_m = 50; 1 would do"),
    ("margin_m=-1", "plan.margin_m: must be at least 0"),
    ("margin_m=large", 'or "auto", got "large"'),
    ("epsilon=0", 'plan.epsilon: must be positive, or "auto", got 0'),
    ("freeze_steps=25", "plan.freeze_steps: 25 is more than the 24 steps of leg 0; at most 24"),
    ("start={kind='random',separation_m=150,depth_m=0}", "swarm.start.depth_m: needs a box_m"),
    ("box_km=0.1", "swarm.start.box_m: a box of 100 m is full after 1 of 4 agents"),
]


@pytest.mark.parametrize(("overrides", "words"), REFUSED)
def test_bad_input_is_refused_by_its_key(overrides, words):
    assert words in refusal(*overrides.split())


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["plant.kind=inertial"], "plant.kind: takes place about the Earth, and this mission has"),
        (DRAG, "plant.drag: takes place about the Earth, and this mission has no [chief]"),
        (["depth_m=1"], "swarm.start.depth_m: needs a model in space"),
        *(
            (f"model.kind={k}".split(), f'model.kind: "{k}" is motion about an orbit')
            for k in MODELS
        ),
    ],
)
def test_orbital_motion_or_depth_is_refused_in_the_plane(overrides, words):
    assert words in refusal(*overrides, name="random")


@pytest.mark.parametrize("depth", ["depth_m=0", "depth_m=100", "depth_m=900"])
def test_proposed_flat_box_suffices(depth):
    crowd = ("agents=40", depth)
    enough = cure(refusal(*crowd, "box_km=0.3"), "box_m")
    drawn(*crowd, f"box_m={enough}")


def test_proposed_anomaly_allows_points_out_of_the_plane():
    high = ("start={kind='points',positions_m=[[0,0,500],[0,500,0],[0,-500,0],[500,0,0]]}",)
    said = refusal(*high, "chief.anomaly_deg=90")
    assert "swarm.start: lies out of the plane of the chief's orbit, and 0 s after" in said
    assert "at 90° of argument of latitude, too near 90° or 270°" in said
    drawn(*high, f"chief.anomaly_deg={cure(said, 'chief.anomaly_deg')}")
    tilted = "leg.0.shape={kind='ring',radius_km=1,normal=[-0.5,0,1]}"
    said = refusal(tilted, "chief.anomaly_deg=-1.4")
    assert "leg.0.shape: lies out of the plane of the chief's orbit, and 1440 s after" in said
    drawn(tilted, f"chief.anomaly_deg={cure(said, 'chief.anomaly_deg')}")
    said = refusal(tilted, "chief.anomaly_deg=0")
    assert re.search(r"leg.0.shape: target \d+ has to be reached at [\d.]+ m/s, faster", said)
    drawn(tilted, f"chief.anomaly_deg={cure(said, 'chief.anomaly_deg')}")
    by_state = f"chief={{position_km=[0,0,6878],velocity_m_s=[{(EARTH_MU / 6878e3) ** 0.5},0,0]}}"
    assert "another start along the orbit would do" in refusal(*high, by_state)


@pytest.mark.parametrize("weak", ["max_control_mm_s2=0.5", "max_control_mm_s2=0.1"])
def test_proposed_thrust_and_time_suffice(weak):
    said = refusal(weak)
    thrust = cure(said, r"model\.max_control_m_s2")
    drawn(f"max_control_m_s2={thrust}")
    weaker = refusal(f"max_control_m_s2={0.98 * float(thrust)}")
    assert "can reach none" in weaker or "is left without" in weaker
    if "leg.0.steps: agent" in said and " steps = " in said:
        drawn(weak, f"leg.0.steps={cure(said, ' steps')}")
