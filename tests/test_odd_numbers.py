"""Numbers that are wildly off: tiny missions, long legs, and memory before it is asked for."""

import numpy as np
import pandas as pd
import pytest
from formation_runs import FIVE
from reconfiguration_runs import row

import sato
from sato.auctions.vsdaa import VsdaaAuction
from sato.connectivity.stick import RecordedStick
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.draw import draw
from sato.scenario.file import parse

RNG = np.random.default_rng(0)


def scaled(scale, steps=30, **changes):
    angle = 0.2 + np.arange(6) * np.pi / 3  # without symmetry, which rounding breaks
    limits = {"max_control": 0.2 * scale, "max_speed": scale} | changes
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        start=scale * row(6, 0.0),
        legs=[sato.Leg(scale * 4 * np.c_[np.cos(angle), np.sin(angle)], steps=steps)],
        step=1.0,
        comm_radius=20.0 * scale,
        collision_radius=0.5 * scale,
        **limits,
    )


@pytest.mark.parametrize("scale", [1e-9, 1e-7, 1e6])
def test_mission_of_any_size_is_flown_as_one_of_meters(scale):
    ends = [sato.run(scaled(s)).data.position.values / s for s in (1.0, scale)]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)


@pytest.mark.parametrize("kind", [np.int8, np.int16, np.int32, np.int64, np.float32, np.uint8])
def test_auction_of_costs_of_any_kind_is_that_of_floats(kind):
    cost = np.random.default_rng(1).integers(1, 100, (60, 60))
    graph = CommunicationGraph(~np.eye(60, dtype=bool), np.ones(60, dtype=bool))
    cost = cost * (20_000_000 if np.dtype(kind).itemsize > 3 else 1)
    least = 4 * np.spacing(60.0 * cost.max())
    with pytest.raises(ValueError, match="the bid increment is"):
        VsdaaAuction(cost.astype(kind), graph, np.full(60, 60), 0.99 * least)
    assert VsdaaAuction(cost.astype(kind), graph, np.full(60, 60), 2 * least).cost.dtype == float


@pytest.mark.parametrize("changes", [{"max_speed": 0.0005}, {"max_control": 2e-7}])
def test_leg_of_thousands_of_steps_is_doubted_before_the_flight(changes):
    (doubt,) = draw(scaled(1.0, "auto", **changes), RNG).warnings()
    assert doubt.startswith("leg.0 takes ") and "are the positions in m, and the limits" in doubt
    assert draw(scaled(1.0, "auto"), RNG).warnings() == []


def test_leg_too_long_for_its_programs_is_refused_before_memory_is_taken():
    with pytest.raises(ValueError, match=r"leg.0.steps: a transfer of .* GB of memory, and there"):
        draw(scaled(1000.0, "auto", max_speed=0.02, max_control=0.2), RNG)


def test_connectivity_flight_of_very_many_steps_is_doubted():
    stick = RecordedStick(np.zeros(1), np.zeros((1, 3)))
    mission = sato.Connectivity(agents=3, duration=15_000.0, step=0.02, stick=stick)
    (doubt,) = mission.draw(np.random.default_rng(0)).warnings()
    assert doubt.startswith("run takes 750,000 steps of 0.02 s (4.17 h)")


def test_formation_flight_of_very_many_steps_is_doubted():
    mission = parse(FIVE, ("control.step_s=0.001", "protocol.limit_s=600"))
    (doubt,) = mission.draw(np.random.default_rng(0)).warnings()
    assert doubt.startswith("a flight takes 603,000 steps of 0.001 s")


@pytest.mark.parametrize("take", [sato.FormationLeg, lambda value: sato.Leg(value, steps=5)])
def test_no_time_is_taken_for_points(take):
    for value in (pd.NaT, pd.Timedelta("5s"), np.timedelta64(5, "s")):
        with pytest.raises(sato.InputError, match=r"^(formation|shape): must be"):
            take(value)
