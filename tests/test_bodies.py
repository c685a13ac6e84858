"""Orbits about other bodies than the Earth: gravity travels along, and motion is right."""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import sato
from dynamics import Atmosphere, InertialPlant, NonlinearPlant, invariant_velocity, propagate
from dynamics.bodies import BODIES, EARTH_J2, find_body
from dynamics.forces import Forces
from dynamics.orbit import K_J2, Orbit
from sato.export import iterate_ephemerides

VENUS, MARS, MOON, PEBBLE = 3.2486e14, 4.2828e13, 4.9028e12, 4.89
ORBITS = {
    "Venus, round": sato.Orbit.from_elements(1.0e7, 0.0, 0.8, mu=VENUS, k_J2=0.0),
    "Venus": sato.Orbit.from_elements(1.0e7, 0.05, 0.8, 0.3, 0.4, 0.5, mu=VENUS),
    "Mars": sato.Orbit.from_elements(3.8e6, 0.01, 1.2, 0.1, 0.2, 0.3, mu=MARS),
    "Moon": sato.Orbit.from_elements(1.84e6, 0.01, 0.5, mu=MOON),
    "pebble": sato.Orbit.from_elements(
        1.0e3, 0.02, 0.7, mu=PEBBLE, k_J2=1.5 * 0.02 * PEBBLE * 245.0**2, body_radius=245.0
    ),
}


def fly_inertially(orbit, offset, times):
    """Integrate a chief and a deputy in inertial axes; return the deputy in the chief's LVLH."""
    mu, k = orbit.mu, orbit.k_J2

    def gravity(R):
        r = np.linalg.norm(R)
        pole = np.array([R[0] * (1 - 5 * R[2] ** 2 / r**2), R[1] * (1 - 5 * R[2] ** 2 / r**2),
                         R[2] * (3 - 5 * R[2] ** 2 / r**2)])  # fmt: skip
        return -mu * R / r**3 - k * pole / r**5

    def rate(_, y):
        return np.concatenate([y[3:6], gravity(y[:3]), y[9:], gravity(y[6:9])])

    def axes(y):
        x = y[:3] / np.linalg.norm(y[:3])
        h = np.cross(y[:3], y[3:6])
        z = h / np.linalg.norm(h)
        turn = h / (y[:3] @ y[:3]) + x * np.linalg.norm(y[:3]) * (gravity(y[:3]) @ z) / sqrt(h @ h)
        return np.array([x, np.cross(z, x), z]), turn

    r, v_x, h, node, i, latitude = orbit.initial_elements
    (cn, sn), (ci, si) = (np.cos(node), np.sin(node)), (np.cos(i), np.sin(i))
    line, up = np.array([cn, sn, 0]), np.array([-sn * ci, cn * ci, si])
    x = np.cos(latitude) * line + np.sin(latitude) * up
    y = np.cos(latitude) * up - np.sin(latitude) * line
    chief = np.concatenate([r * x, v_x * x + h / r * y])
    matrix, turn = axes(chief)
    place = offset[:3] @ matrix
    deputy = chief + np.concatenate([place, offset[3:] @ matrix + np.cross(turn, place)])
    start, scale = np.concatenate([chief, deputy]), np.repeat([r, h / r, r, h / r], 3)
    found = solve_ivp(rate, (0, times[-1]), start, "DOP853", times, rtol=1e-13, atol=1e-14 * scale)
    path = []
    for state in found.y.T:
        matrix, turn = axes(state)
        place = state[6:9] - state[:3]
        speed = state[9:] - state[3:6] - np.cross(turn, place)
        path.append(np.concatenate([matrix @ place, matrix @ speed]))
    return np.array(path), np.linalg.norm(found.y[:3], axis=0)


@pytest.mark.parametrize("name", ORBITS)
def test_bodies_are_flown_as_inertial_space_has_it(name):
    orbit = ORBITS[name]
    size = 1e-5 * orbit.r
    v = orbit.mean_motion * size
    start, still = np.array([[size, -size, size / 2, v / 2, -2 * v, v / 3]]), np.zeros((1, 3))
    end = orbit.period / 4
    expected, _ = fly_inertially(orbit, start[0], np.array([end]))
    digits = 3e-8 * orbit.r * 1e-5 + 1e-15 * orbit.r * 30  # of differences of large positions
    for plant in (InertialPlant(orbit), NonlinearPlant(sato.J2(orbit))):
        flown = plant.propagate(start, still, 0.0, end)[-1, 0]
        assert np.abs(flown - expected[0])[:3].max() < digits, type(plant)
    linear = [sato.TschaunerHempel(orbit)]
    if orbit.eccentricity < 0.03:
        linear += [
            make.from_orbit(orbit) for make in (sato.ClohessyWiltshire, sato.SchweighartSedwick)
        ]
    for model in linear:  # eccentricity or J2 are left out
        flown = sato.LinearPlant(model).propagate(start, still, 0.0, end)[-1, 0]
        assert np.abs(flown - expected[0])[:3].max() < 0.15 * size, type(model)


def test_circular_orbit_about_venus_stays_circular():
    orbit = ORBITS["Venus, round"]
    radius = orbit.elements_at(np.linspace(0, 3 * orbit.period, 50))[:, 0]
    assert np.ptp(radius) < 1e-4
    assert orbit.period == pytest.approx(2 * pi * sqrt(1e7**3 / VENUS), rel=1e-12)
    period = orbit.period
    _, radii = fly_inertially(orbit, np.zeros(6), np.linspace(period / 8, period, 9))
    np.testing.assert_allclose(radii, 1e7, rtol=1e-11)


@pytest.mark.parametrize("name", ORBITS)
def test_gravity_radius_and_oblateness_travel_with_an_orbit(name):
    orbit = ORBITS[name]
    spread = orbit.r * 1e-5
    start = spread * np.array([[0.0, 0, 0], [0, 2, 0], [0, 4, 0]])
    rest = {
        "start": start,
        "legs": [sato.Leg(start + spread * np.eye(3)[1], steps=8)],
        "step": orbit.period / 60,
        "comm_radius": 1e3 * spread,
        "collision_radius": spread / 3,
        "max_control": spread * orbit.mean_motion**2 * 20,
        "max_speed": spread * orbit.mean_motion * 40,
    }
    models = [sato.J2(orbit), sato.ClohessyWiltshire.from_orbit(orbit)]
    models += [sato.TschaunerHempel(orbit), sato.SchweighartSedwick.from_orbit(orbit)]
    for model in models:
        mission = sato.Reconfiguration(model=model, chief=orbit, **rest)
        assert mission.chief.orbit == orbit
        again = sato.parse(mission.to_toml())
        assert again == mission and again.chief.orbit == orbit
        assert 'kind = "own"' not in mission.to_toml()
        assert mission.flown_plant.chief_orbit == orbit
    assert sato.Reconfiguration(model=models[0], **rest).chief.orbit == orbit


def test_a_model_about_the_chief_in_other_elements_is_held_by_a_file():
    chief = sato.Chief(semi_major_axis=3.8e6, eccentricity=0.01, mu=MARS)
    start = np.array([[0.0, 0, 0], [0, 200, 0]])
    mission = sato.Reconfiguration(
        model=sato.J2(chief.orbit), chief=chief, start=start, legs=[sato.Leg(start, steps=6)],
        step=60.0, comm_radius=2e3, collision_radius=50.0, max_control=0.01, max_speed=4.0,
    )  # fmt: skip
    assert mission.model.kind == "j2" and mission.chief == chief
    assert sato.parse(mission.to_toml()) == mission


def test_a_run_about_mars_is_loaded_and_exported_as_of_mars(tmp_path):
    orbit = ORBITS["Mars"]
    start = np.array([[0.0, 0, 0], [0, 200, 0]])
    mission = sato.Reconfiguration(
        model=sato.J2(orbit), start=start, legs=[sato.Leg(start + 60 * np.eye(3)[1], steps=6)],
        step=60.0, comm_radius=2e3, collision_radius=50.0, max_control=0.01, max_speed=4.0,
    )  # fmt: skip
    run = sato.run(mission)
    assert run.check().kept and run.recorded.attrs["mu_m3_s2"] == MARS
    run.save(tmp_path / "run")
    again = sato.load(tmp_path / "run")
    assert again.mission == mission and again.check().kept
    text = (again.export(tmp_path / "oem") / "chief.oem").read_text()
    assert "CENTER_NAME = MARS\n" in text and "EME2000\n" not in text
    chief = next(iterate_ephemerides(run.recorded)).inertial
    _, radii = fly_inertially(orbit, np.zeros(6), run.recorded["time"][1:])
    np.testing.assert_allclose(np.linalg.norm(chief[1:, :3], axis=1), radii, rtol=1e-10)


def test_bodies_are_found_by_their_gravity():
    for body in BODIES:
        assert find_body(body.mu * 1.0005) == body
        orbit = sato.Orbit.from_elements(1.2 * body.radius, mu=body.mu)
        k = 1.5 * body.J2 * body.mu * body.radius**2
        assert (orbit.k_J2, orbit.body_radius) == (k, body.radius)
    chief = sato.Chief(semi_major_axis=3.8e6, mu=MARS)
    assert chief.orbit == sato.Orbit.from_elements(3.8e6, mu=MARS, k_J2=chief.orbit.k_J2)
    assert chief.perigee_altitude == pytest.approx(3.8e6 - 3396.2e3)


@pytest.mark.parametrize("factor", [1.0, 1.0 + 2**-52, 0.0, 1e-3])
def test_chief_takes_any_oblateness_of_an_orbit(factor):
    mu, radius = 1.26686534e17, 7.1492e7  # Jupiter's, of which k_J2 is 1.4e31
    k = factor * 1.5 * 0.014736 * mu * radius**2
    orbit = sato.Orbit.from_elements(1e8, 0.01, 0.5, mu=mu, k_J2=k, body_radius=radius)
    chief = sato.Chief.from_orbit(orbit)
    assert chief.orbit == orbit and replace(chief).orbit == orbit
    with pytest.raises(ValueError, match="k_j2_m5_s2: must be at most"):
        replace(chief, j2=None, k_j2=1.1e40)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sato.Orbit.from_elements(7e6, mu=4.1e14), "k_J2: is missing, and mu = 4.1e"),
        (lambda: sato.Orbit.from_elements(3e6, mu=MARS), "is inside Mars, whose radius is 3396"),
        (lambda: sato.Chief(semi_major_axis=3e6, mu=MARS), "inside Mars, whose radius is 3396 km"),
        (lambda: sato.Chief(semi_major_axis=7e6, mu=4.1e14), "j2: is missing, and mu = 4.1e"),
        (lambda: sato.Chief(semi_major_axis=7e6, mu=4.1e14, j2=1e-3), "body_radius_m: is missing"),
        (lambda: sato.Chief(semi_major_axis=7e6, j2=1e-3, k_j2=1e25), "k_j2_m5_s2: gives the obl"),
        (lambda: sato.Chief(semi_major_axis=7e6, mu=MARS, j2=EARTH_J2), "is the Earth's, and mu"),
        (lambda: replace(sato.Chief(semi_major_axis=7e6), mu=MARS), "is the Earth's, and mu"),
        (lambda: Forces(MARS, atmosphere=Atmosphere()), "the air is the Earth's.*Mars"),
        (lambda: propagate(np.array([[3e6, 0, 0, 0, 4e3, 0.0]]), np.ones(1), Forces(MARS)), "Mars"),
        (lambda: replace(ORBITS["Mars"], k_J2=K_J2), "is the Earth's, and mu is that of Mars"),
        (lambda: sato.SchweighartSedwick(3e6, 0.5, MARS), "above Mars's, 3396 km"),
    ],
)
def test_gravity_that_contradicts_itself_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_drag_about_another_body_is_refused():
    with pytest.raises(sato.ScenarioError, match=r"plant\.drag: the air is .*about Venus"):
        sato.read("orbit", ["chief={semi_major_axis_km=7000, mu_km3_s2=324859.0}",
                            "plant={drag=true, ballistic_m2_kg=0.01}"])  # fmt: skip
    earth, venus = sato.Orbit.from_elements(7e6), ORBITS["Venus"]
    for orbit, other in ((earth, venus), (venus, earth)):
        with pytest.raises(sato.InputError, match="one orbit for both would do"):
            sato.Reconfiguration(
                model=sato.J2(orbit), chief=other, start=np.array([[0.0, 0, 0], [0, 200, 0]]),
                legs=[sato.Leg(np.array([[0.0, 60, 0], [0, 260, 0]]), steps=6)], step=60.0,
                comm_radius=2e3, collision_radius=50.0, max_control=0.01, max_speed=4.0,
            )  # fmt: skip


def test_bodies_as_large_as_the_sun_have_orbits():
    jupiter = Orbit.from_elements(8e7, mu=1.26686534e17, k_J2=1.43125e31, body_radius=71492e3)
    sun = Orbit.from_elements(1.5e11, mu=1.32712440018e20, k_J2=0.0)
    assert jupiter.mean_motion**2 * 8e7**3 == pytest.approx(jupiter.mu)
    assert sun.period == pytest.approx(365.25 * 86400, rel=0.01)


@pytest.mark.parametrize("kind", [sato.ClohessyWiltshire, sato.SchweighartSedwick])
def test_model_of_another_orbit_than_that_of_the_chief_is_refused(kind):
    start = np.c_[np.zeros(3), 150.0 * np.arange(3), np.zeros(3)]
    mars = sato.Orbit.from_elements(3800e3, inclination=0.7, mu=4.282837e13)
    limits = {"comm_radius": 3e3, "collision_radius": 50.0, "max_control": 0.01, "max_speed": 4.0}
    legs, chief = [sato.Leg(start, 6)], sato.Chief(semi_major_axis=6878e3)
    with pytest.raises(sato.InputError, match=r"model: has a period of 7.* the chief 567"):
        sato.Reconfiguration(
            model=kind.from_orbit(mars), chief=chief, start=start, legs=legs, step=60.0, **limits
        )


@pytest.mark.parametrize(
    ("slip", "message"),
    [
        ({"body_radius": 6378.0}, "body_radius: 6378 m is far from that of the Earth, 6.37814e"),
        ({"k_J2": 1.0826e-3}, r"k_J2: .* rounder than any; it is 3/2 J2 mu R², 2\.63329e\+25"),
    ],
)
def test_oblateness_that_a_wrong_unit_makes_vanish_is_refused(slip, message):
    with pytest.raises(sato.InputError, match=message):
        sato.Orbit.from_elements(6878e3, inclination=0.9, **slip)
    assert Orbit.from_elements(6878e3, k_J2=0.0).k_J2 == 0


def test_air_whose_altitudes_are_in_kilometers_is_refused():
    with pytest.raises(sato.InputError, match="scale_height_m: must be at least 1000, got 60"):
        sato.PlantSettings(
            drag=True, ballistic=0.01, density=7e-13, altitude=500.0, scale_height=60.0
        )
    for altitude in (0.4, 400.0):
        with pytest.raises(sato.InputError, match=r"reference_altitude: .*4.* km are .*4.*e3 m"):
            Atmosphere(reference_altitude=altitude)
    assert Atmosphere(1.2, 0.0, 8.5e3) != Atmosphere(0.1, 9e3, 7e3)
    with pytest.raises(ValueError, match="is inside the Earth, from whose center"):
        Atmosphere().density_at(np.array([100.0, 0.0, 0.0]))
    with pytest.raises(sato.InputError, match=r"ballistic_coefficient: must be .* at least 0"):
        Atmosphere().drag_acceleration(np.array([7e6, 0.0, 0.0, 0.0, 7e3, 0.0]), -0.01)


def test_model_about_another_place_of_the_same_ellipse_is_refused():
    here = sato.Orbit.from_elements(8600e3, 0.2, 0.8)
    there = sato.Orbit.from_elements(8600e3, 0.2, 0.8, true_anomaly=3.0)
    start = np.array([[0.0, 0.0, 0.0], [0.0, 150.0, 0.0]])
    limits = {"comm_radius": 3e3, "collision_radius": 10.0, "max_control": 0.01, "max_speed": 4.0}
    legs = [sato.Leg(start - [0.0, 60.0, 0.0], 30)]
    for model in (sato.J2(there), sato.TschaunerHempel(there)):
        with pytest.raises(
            sato.InputError, match=r"model: is about an orbit 1\.71.*km from the chief"
        ):
            sato.Reconfiguration(
                model=model, chief=here, start=start, legs=legs, step=60.0, **limits
            )


def test_starts_and_targets_inside_the_body_are_refused():
    chief = sato.Chief(semi_major_axis=6878e3, inclination=0.8)
    start = np.array([[0.0, 0.0, 0.0], [0.0, 150.0, 0.0]])
    deep = start - [6e5, 0.0, 0.0]
    limits = {"comm_radius": 1e6, "collision_radius": 10.0, "max_control": 0.1, "max_speed": 900.0}
    for first, last, where in ((deep, start, "swarm.start"), (start, deep, "leg.0.shape")):
        mission = sato.Reconfiguration(
            model=sato.J2(chief.orbit),
            chief=chief,
            start=first,
            legs=[sato.Leg(last, 30)],
            step=60.0,
            **limits,
        )
        with pytest.raises(sato.InputError, match=f"{where}.*1[01]0.. km below the surface"):
            sato.run(mission)


def test_no_invariant_orbit_passes_beyond_the_reach_of_its_energy():
    orbit = sato.Orbit.from_elements(6878e3, inclination=0.8)
    with pytest.raises(ValueError, match=r"position: no orbit through it, 7e[+]06 m away, has the"):
        invariant_velocity(orbit, np.array([[7e6, 0.0, 0.0]]))
