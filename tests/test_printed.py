"""The methods as printed: half-spaces at samples alone, no commitment, no identities of bidders."""

from dataclasses import replace

import numpy as np
import pytest

import sato
from dynamics import DoubleIntegrator, discretize_zoh
from problems.convexify import AvoidanceHorizon, choose_normals, convexify

STEPS, RADIUS = 5, 0.5


@pytest.fixture
def horizon():
    model = discretize_zoh(DoubleIntegrator(2), 1.0, STEPS)
    return AvoidanceHorizon(model, model, RADIUS, samples_only=True)


def fly(horizon, rng):
    start, u = rng.normal(size=4), 0.1 * rng.normal(size=(STEPS, 2))
    return horizon.discrete_model.simulate(start, u), u


def test_printed_half_spaces_hold_at_samples_alone(horizon):
    x, u = fly(horizon, np.random.default_rng(0))
    points = horizon.control_points(x, u)
    assert np.allclose(points, x[1:, None, :2], rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_printed_half_spaces_are_those_of_equation_38(horizon, seed):
    rng = np.random.default_rng(seed)
    own, other = (horizon.control_points(*fly(horizon, rng)) for _ in range(2))
    normal = choose_normals((own - other)[None], RADIUS, "nominal")
    x, u = fly(horizon, rng)
    violation = convexify(horizon, STEPS, other[None], normal).violation(x, u)
    apart = own[:, 0] - other[:, 0]  # of the nominals
    room = np.einsum("kd,kd->k", apart, x[1:, :2] - other[:, 0])
    size = np.linalg.norm(apart, axis=1)
    expected = horizon.required_separation - room / size
    # The state after the first step, u[0] included, is the first that can be changed.
    for k in range(STEPS):
        assert np.isclose(violation, expected[k], rtol=0, atol=1e-12).sum() == 4


@pytest.mark.parametrize("name", ["crossing", "crossing4"])
def test_printed_methods_keep_the_distance_at_samples_alone(name):
    printed = sato.run(name, overrides=["plan.printed=true"]).summary
    R = printed["collision_radius_m"]
    assert printed["min_separation_at_samples_m"] >= R > printed["min_separation_m"]
    assert printed["broken"] == ["separation"]
    assert sato.run(name).summary["min_separation_m"] >= R


def test_printed_vehicles_beyond_hearing_cannot_always_part():
    printed = sato.run("conflict", overrides=["plan.printed=true"]).summary
    assert printed["slack_used"] > 0
    assert printed["min_separation_at_samples_m"] < printed["collision_radius_m"]
    ours = sato.run("conflict").summary
    assert ours["slack_used"] == 0 and not ours["broken"]


def test_a_vehicle_alone_flies_the_same_by_printed_methods():
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        start=np.zeros((1, 2)),
        legs=[sato.Leg(np.array([[3.0, 1.0]]), steps=20)],
        step=1.0,
        comm_radius=20.0,
        collision_radius=0.5,
        max_control=0.2,
        max_speed=1.0,
    )
    own, printed = sato.run(mission).summary, sato.run(replace(mission, printed=True)).summary
    assert printed["fuel_m_s"] == pytest.approx(own["fuel_m_s"], rel=1e-6)
    assert not printed["broken"]


def test_defaults_of_printed_methods_are_those_of_the_paper():
    mission = sato.read("uiuc_printed")
    ours = replace(mission, printed=False).draw(np.random.default_rng(0))
    mission = mission.draw(np.random.default_rng(0))
    periods = mission.horizon_steps, mission.replan_steps, mission.auction_steps
    assert periods == (6, 6, 6)
    assert (mission.tie_break, mission.bidder_ids, mission.reset) == (0.0, False, "change")
    assert (ours.tie_break, ours.bidder_ids, ours.reset) == (0.2, True, "need")


@pytest.mark.parametrize(
    "more",
    [
        "plan.orders=2",
        "plan.foresight_steps=8",
        'plan.assignment="central"',
        "model.box_m=[[-20, -20], [20, 20]]",
        'obstacle=[{kind="sphere", center_m=[0, 3], radius_m=0.5}]',
        'leg.lose={kind="agents", agents=[0], at_step=3, body="coast"}',
        'leg.join={start={kind="points", positions_m=[[9, 9]]}}',
    ],
)
def test_what_printed_methods_lack_is_refused_with_its_key(more):
    key = more.partition("=")[0]
    with pytest.raises(ValueError, match=rf"{key}[\w.]*: is not in the printed methods"):
        sato.read("crossing", ["plan.printed=true", more])


def test_an_agent_by_itself_refuses_the_printed_methods():
    with pytest.raises(ValueError, match=r"plan\.printed"):
        sato.Agent(sato.read("crossing", ["plan.printed=true"]), 0)
