"""Judge of campaigns against closed forms and forged runs, and the families of random missions."""

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import sato

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "campaigns"))  # as a worker of a campaign has it

import judge  # noqa: E402
import missions  # noqa: E402
import motion  # noqa: E402

TRUTH = json.loads((HERE / "j2_truth.json").read_text())  # in km
SCENARIO = """
[swarm]
collision_radius_m = 1.0
[model]
kind = "double_integrator"
max_control_m_s2 = 0.5
max_speed_m_s = 2.0
[plan]
step_s = 0.5
"""
FAMILIES = tomllib.loads((HERE.parent / "campaigns" / "missions.toml").read_text())["campaign"][
    "scenario"
]


def flown(start, control, events=(), scenario=SCENARIO, **changed):
    """Record vehicles in the plane that fly controls from their starts to where that leads."""
    control = np.asarray(control, dtype=float)
    states, h = [np.asarray(start, dtype=float)], 0.5
    for u in control:
        p, v = np.split(states[-1], 2, axis=1)
        states.append(np.hstack([p + h * v + h**2 / 2 * u, v + h * u]))
    x, none = np.array(states), np.full_like(control[:1], np.nan)
    instants, agents = x.shape[:2]
    values = {
        "time": (("time",), h * np.arange(instants)),
        "position": (("time", "agent", "axis"), x[..., :2]),
        "velocity": (("time", "agent", "axis"), x[..., 2:]),
        "control": (("time", "agent", "axis"), np.concatenate([control, none])),
        "applied_control": (("time", "agent", "axis"), np.concatenate([control, none])),
        "alive": (("time", "agent"), np.ones((instants, agents), dtype=bool)),
        "leg_index": (("time",), np.zeros(instants, dtype=int)),
        "target_index": (("time", "agent"), np.tile(np.arange(agents), (instants, 1))),
        "target_position": (("leg", "target", "axis"), x[-1:, :, :2]),
        "event": (("event",), np.array([json.dumps(e) for e in events], dtype=object)),
        "axis": (("axis",), ["x", "y"]),
    }
    values |= {name: (values[name][0], value) for name, value in changed.items()}
    return judge.judge(xr.Dataset(values, attrs={"scenario": scenario, "complete": 1}))


def passing(offset, steps=12):
    """Two that pass each other at an offset, at rest relative to neither."""
    return [[-3, 0, 1, 0], [3, offset, -1, 0]], np.zeros((steps, 2, 2))


@pytest.mark.parametrize("offset", [0.25, 0.9, 1.5])
def test_judge_finds_how_close_two_pass_between_the_instants(offset):
    start, control = passing(offset)
    found = flown(np.add(start, [[0.1, 0, 0, 0], [0, 0, 0, 0]]), control)
    assert found["separation_ratio"] == pytest.approx(offset, rel=1e-12)
    assert found["collisions"] == found["silent"] == (offset < 1)
    assert found["follows"] and found["within_limits"] and found["arrived"]


def test_least_lengths_of_cubics_are_those_of_dense_samples(rng):
    cubics = rng.normal(size=(300, 4, 3)) * rng.choice([0.0, 1e-9, 1.0], (300, 4, 1))
    cubics[:, 0] += 1.0
    s = np.linspace(0, 1, 20001)[:, None] ** np.arange(4)
    sampled = np.array([np.linalg.norm(s @ each, axis=1).min() for each in cubics])
    found = judge.least_lengths(cubics)
    assert (found <= sampled + 1e-15).all()
    np.testing.assert_allclose(found, sampled, atol=1e-7)


def test_least_of_all_pairs_is_that_of_dense_samples(rng):
    control = rng.uniform(-0.5, 0.5, (20, 6, 2))
    start = rng.uniform(-5, 5, (6, 4)) * [1, 1, 0.2, 0.2]
    radii = rng.uniform(0.1, 0.3, 6)
    radius = f"collision_radius_m = {radii.tolist()}"
    found = flown(start, control, scenario=SCENARIO.replace("collision_radius_m = 1.0", radius))
    least, x = np.inf, start
    first, second = np.triu_indices(6, 1)
    for u in control:
        for t in np.linspace(0, 0.5, 401):
            p = x[:, :2] + t * x[:, 2:] + t**2 / 2 * u
            apart = np.linalg.norm(p[first] - p[second], axis=1)
            least = min(least, (apart / (radii[first] + radii[second]) * 2).min())
        x = np.hstack([p, x[:, 2:] + 0.5 * u])
    assert found["separation_ratio"] == pytest.approx(least, rel=1e-3)
    assert found["separation_ratio"] <= least * (1 + 1e-12)


def test_collision_is_silent_unless_one_of_the_two_is_named_by_then():
    start, control = passing(0.5)
    for named, time, silent in [([1], 1.0, 0), ([1], 6.0, 1), ([], 1.0, 1)]:
        event = {"kind": "braked", "agents": named, "time": time}
        assert flown(start, control, [event])["silent"] == silent


def test_lost_vehicle_is_no_collision_but_a_wreck_that_coasts_on():
    start, control = passing(0.5)
    alive = np.ones((13, 2), dtype=bool)
    alive[3:, 0] = False  # at 1.5 s, with 3 m to go
    found = flown(start, control, alive=alive)
    assert found["collisions"] == 0
    assert found["separation_ratio"] == pytest.approx((3**2 + 0.5**2) ** 0.5)
    assert found["wreck_ratio"] == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(("more", "excused"), [(-1e-3, 1), (1e-3, 0)])
def test_pair_that_no_control_keeps_apart_is_excused(more, excused):
    # They close at 1 m/s, and part by √2 · 0.5 m/s² each: least 1 m if 1/(2 √2) m beyond it.
    distance = 1.0 + 1 / (2 * 2**0.5) + more
    found = flown([[0, 0, 0.5, 0], [distance, 0, -0.5, 0]], np.zeros((4, 2, 2)))
    assert (found["excused"], found["collisions"]) == (excused, 1 - excused)


@pytest.mark.parametrize(
    ("change", "broken"),
    [
        ({"position": 1e-4}, "follows"),
        ({"velocity": 1e-4}, "follows"),
        ({"time": 1e-4}, "follows"),
        ({"applied_control": 1e-4}, "follows"),
        ({"target_position": 0.2}, "arrived"),
    ],
)
def test_forged_record_is_noticed(change, broken):
    start, control = passing(1.5)
    assert flown(start, control)[broken]
    (name, by), (state, *_) = *change.items(), [np.array(start, dtype=float)]
    steps = np.arange(13)[:, None, None]
    true = {
        "position": state[:, :2] + 0.5 * steps * state[:, 2:],
        "velocity": np.tile(state[:, 2:], (13, 1, 1)),
        "time": 0.5 * np.arange(13),
        "applied_control": np.zeros((13, 2, 2)),
        "target_position": (state[:, :2] + 6 * state[:, 2:])[None],
    }[name]
    true[true.shape[0] // 2] += by
    assert not flown(start, control, **{name: true})[broken]


def test_limits_are_judged_in_their_norms():
    start, control = passing(1.5)
    most = np.full_like(control, 0.5)
    assert flown(start, most)["control_usage"] == pytest.approx(1.0)
    ball = SCENARIO.replace("[plan]", "control_norm = 2\n[plan]")
    found = flown(start, most, scenario=ball)
    assert found["control_usage"] == pytest.approx(2**0.5) and not found["within_limits"]
    assert flown(np.multiply(start, [[1, 1, 3, 1]]), control)["speed_usage"] == pytest.approx(1.5)


def test_clohessy_wiltshire_motion_agrees_with_an_integration(rng):
    n, h = 1.1e-3, 60.0
    x, u = rng.normal(size=6) * [500, 500, 500, 1, 1, 1], rng.normal(size=3) * 0.01

    def rate(_, y):
        a = [3 * n**2 * y[0] + 2 * n * y[4], -2 * n * y[3], -(n**2) * y[2]]
        return [*y[3:], *(u + a)]

    path = motion.Motion(h, n).sample(x[None, None], u[None, None])[0, :, 0]
    times = np.linspace(0, h, len(path))
    exact = solve_ivp(rate, (0, h), x, "DOP853", times, rtol=1e-12, atol=1e-12).y.T
    np.testing.assert_allclose(path, exact, atol=1e-9)
    middle = judge.hermite(path[:, None], times[1])[:, 0].swapaxes(1, 2) @ 0.5 ** np.arange(4)
    between = times[:-1] + times[1] / 2
    exact = solve_ivp(rate, (0, h), x, "DOP853", between, rtol=1e-12, atol=1e-12).y.T
    np.testing.assert_allclose(middle, exact[:, :3], atol=1e-7)


@pytest.mark.parametrize("minutes", [8, 24])
def test_motion_under_j2_agrees_with_states_to_80_bits(minutes):
    r, _, _, node, _, latitude = (TRUTH["reference_initial"][k] for k in TRUTH["reference_keys"])
    gravity = TRUTH["mu"] * 1e9, TRUTH["kJ2"] * 1e15
    h = (gravity[0] * r * 1e3) ** 0.5
    chief = np.array([[r * 1e3, 0.0, h, node, np.pi / 4, latitude]])
    flight = motion.Motion(60.0 * minutes, h / (r * 1e3) ** 2, chief, gravity)
    state = 1e3 * np.array([[each["initial"] for each in TRUTH["deputies"]]])
    path = flight.sample(state, np.zeros((1, 2, 3)))[0, -1]
    exact = [each[f"{minutes}min"] for each in TRUTH["deputies"]]
    np.testing.assert_allclose(path, 1e3 * np.array(exact), atol=1e-6)


def test_motion_under_j2_with_thrust_is_that_of_inertial_space(rng):
    orbit = sato.Chief(semi_major_axis=7e6, eccentricity=0.03, inclination=1.0).orbit
    plant, h = sato.InertialPlant(orbit), 60.0
    chief = np.array([plant.chief_elements(h * k) for k in range(4)])
    flight = motion.Motion(h, 1.1e-3, chief, (orbit.mu, orbit.k_J2))
    x = rng.normal(size=(3, 5, 6)) * np.repeat([500.0, 1.0], 3)
    u = rng.normal(size=(3, 5, 3)) * 0.02
    exact = [plant.propagate(x[k], u[k], h * k, h)[-1] for k in range(3)]
    np.testing.assert_allclose(flight.sample(x, u)[:, -1], exact, atol=1e-6)
    assert flight.chief_error() < 1e-4
    forged = flight._replace(chief=chief + np.outer(np.arange(4) == 2, [0.1, 0, 0, 0, 0, 0]))
    assert forged.chief_error() > 0.09


@pytest.mark.parametrize("name", FAMILIES)
def test_missions_of_a_family_are_drawn_or_refused_by_a_key(name):
    draw = getattr(missions, name.partition(":")[2])
    asked = [draw(np.random.default_rng(seed)) for seed in range(20)]
    assert all(2 <= mission.agents <= 60 for mission in asked)
    few = sorted(asked, key=lambda mission: mission.agents)  # others take long
    for mission in few[:1] if name.endswith("j2") else few[:2]:
        try:
            drawn = mission.draw(np.random.default_rng(0))
        except sato.InputError as error:
            assert name != "missions:default" and str(error)[0].islower()
        else:
            assert np.isfinite(drawn.initial_states).all()


@pytest.mark.parametrize("name", ["default", "clohessy_wiltshire"])
def test_judge_agrees_with_the_summary_of_a_flight(name):
    asked = [getattr(missions, name)(np.random.default_rng(seed)) for seed in range(60)]
    run = sato.run(min(asked, key=lambda mission: mission.agents))
    found = judge.judge_run(run)["judged"]
    least = run.summary["min_separation_m"] / run.summary["collision_radius_m"]
    assert found["separation_ratio"] == pytest.approx(least, rel=1e-3)
    assert found["follows"] and found["within_limits"]
    assert found["arrived"] == run.summary["reached"]
