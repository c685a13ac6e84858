"""Plants of the user's own: whether they fly what the vehicles plan by, and what follows."""

import casadi
import numpy as np
import pytest
from reconfiguration_runs import fly, make_mission, row

import sato
from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from dynamics.model import LinearModel
from dynamics.plant import LinearPlant
from sato.reconfiguration.models import OrbitalModel, PointMass


class Linear(LinearModel):
    """Any linear model with constant matrices, but for a wind from some time on."""

    def __init__(self, axes, entries, wind=0.0, since=0.0):
        self.axes, self.entries, self.wind, self.since = axes, entries, wind, since
        self.is_time_invariant = wind == 0

    def A(self, t):
        """Velocities, and the drawn entries below them."""
        d = self.axes
        return np.vstack([np.eye(d, 2 * d, d), self.entries])

    def z(self, t):
        """The wind along all axes."""
        return np.repeat([0.0, self.wind * (t >= self.since)], self.axes)


def random_entries(rng, axes):
    """Rows of accelerations, of any scale."""
    return rng.normal(0, 0.05, (axes, 2 * axes)) * rng.choice([1e-3, 1.0], (axes, 2 * axes))


def planned_by(model, plant, **changes):
    """A small mission that is planned by one model and flown by a plant."""
    d = model.axes
    leg = sato.Leg(row(2, 2.0, d), 12)
    limits = {"comm_radius": 30.0, "max_control": 2.0, "max_speed": np.inf}
    changes = limits | {"allow_undetectable": True, "replan_steps": None} | changes
    start = row(2, 0.0, d)
    return make_mission(start, leg, model=model, plant=plant, auction_steps=None, **changes)


@pytest.mark.parametrize("seed", range(12))
def test_a_plant_flies_the_model_if_and_only_if_it_is_the_same(seed):
    rng = np.random.default_rng([41, seed])
    axes, step = int(rng.integers(2, 4)), float(rng.choice([0.5, 1.0, 2.0]))
    entries = random_entries(rng, axes)
    same = planned_by(Linear(axes, entries), LinearPlant(Linear(axes, entries.copy())), step=step)
    assert same.flies_model and same.margin == 0 and same.replan_steps == 2
    changed = entries.copy()
    i, j = rng.integers(axes), rng.integers(2 * axes)
    changed[i, j] += rng.choice([-1, 1]) * 10 ** rng.uniform(-6, -2)
    other = planned_by(Linear(axes, entries), LinearPlant(Linear(axes, changed)), step=step)
    assert not other.flies_model and other.margin > 0 and other.replan_steps == 1
    # The margin is the largest error of the model in a step, of each of two: here too.
    ends = np.concatenate([other.initial_states, other.legs[0].targets])
    worst = 0.0
    for sign in (-1, 1):
        u = np.full((len(ends), 1, axes), sign * 2.0)
        x = [
            discretize_zoh(model, step, 1).simulate(ends, u)[:, -1, :axes]
            for model in (Linear(axes, entries), Linear(axes, changed))
        ]
        worst = max(worst, np.linalg.norm(x[0] - x[1], axis=1).max())
    assert other.margin >= 2 * worst * (1 - 1e-6)


@pytest.mark.parametrize("entry", [1, 3])
def test_the_margin_covers_a_force_that_is_met_on_the_way_alone(entry):
    def push(t, x, u):
        near = casadi.exp(-(((x[0] - 6) / 3) ** 4))
        return casadi.vertcat(x[2:], u[0], u[1] - 0.12 * near * casadi.tanh(5 * x[entry]))

    ends = np.array([[0.0, 0.0], [12.0, 0.0]])
    leg = sato.Leg(sato.Points(ends[::-1], keep_order=True), 30)
    plant = sato.NonlinearPlant(sato.SymbolicModel(2, push))
    limits = {"max_control": 0.3, "max_speed": 1.0, "comm_radius": 40.0, "collision_radius": 0.5}
    automatic = {"replan_steps": None, "auction_steps": None, "assignment": "given"}
    mission = make_mission(ends, leg, plant=plant, **limits, **automatic)
    assert mission.margin > 0.04
    frames = fly(mission)
    assert min(np.linalg.norm(np.subtract(*frame.position)) for frame in frames) >= 0.5


@pytest.mark.parametrize("since", [0.0, 3.0, 100.0])
def test_a_wind_that_rises_on_the_way_is_not_the_model(since):
    still = Linear(2, np.zeros((2, 4)))
    assert planned_by(still, LinearPlant(Linear(2, np.zeros((2, 4))))).flies_model
    windy = LinearPlant(Linear(2, np.zeros((2, 4)), 0.01, since))
    assert not planned_by(still, windy).flies_model


def test_orbits_of_another_mean_motion_are_not_the_model():
    far = {"step": 30.0, "comm_radius": 1e3, "max_control": 0.01}
    for model in (
        ClohessyWiltshire(1.1e-3),
        OrbitalModel("clohessy_wiltshire", mean_motion=1.1e-3),
    ):
        same, other = (
            make_mission(
                row(2, 0.0, 3), sato.Leg(row(2, 2.0, 3), 12), model=model, max_speed=np.inf,
                plant=LinearPlant(ClohessyWiltshire(n)), allow_undetectable=True, **far,
            )
            for n in (1.1e-3, 1.1001e-3)
        )  # fmt: skip
        assert same.flies_model and same.margin == 0
        assert not other.flies_model and other.margin > 0


def test_vehicles_keep_their_distance_in_drag_that_their_model_lacks():
    drag = Linear(2, np.hstack([np.zeros((2, 2)), -0.02 * np.eye(2)]))
    leg = sato.Leg(sato.Points([[3.0, 0.3], [-3.0, -0.3]], keep_order=True), 24)
    limits = {"comm_radius": 9.0, "max_speed": 0.6, "assignment": "given"}
    mission = make_mission(
        np.array([[-3.0, 0.3], [3.0, -0.3]]), leg, plant=LinearPlant(drag),
        replan_steps=None, auction_steps=None, **limits,
    )  # fmt: skip
    assert mission.margin > 0
    frames = fly(mission)
    apart = [np.linalg.norm(frame.position[0] - frame.position[1]) for frame in frames]
    assert min(apart) >= mission.collision_radius
    away = np.linalg.norm(frames[-1].position - mission.legs[0].targets[:, :2], axis=1)
    assert away.max() <= mission.position_tolerance


def test_default_period_lets_vehicles_stop_within_reach_from_top_speed():
    # 0.4 n + 0.4²/(2 · 0.06) + 0.2 ≤ (5.4 − 0.5)/2 for n ≤ 2, where half of the horizon is 3.
    changes = {"horizon_steps": 6, "comm_radius": 5.4, "max_control": 0.06}
    changes |= {"replan_steps": None, "auction_steps": None}
    for model in (DoubleIntegrator(2), PointMass(2)):
        mission = make_mission(row(2, 0.0), sato.Leg(row(2, 2.0), 30), model=model, **changes)
        assert mission.replan_steps == 2
