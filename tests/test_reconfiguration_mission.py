"""Reconfigurations as definitions: arrays, dicts and TOML mean the same, and errors name fields."""

import tomllib
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from numpy.ma import masked_array

import sato
from dynamics import J2, ClohessyWiltshire, DoubleIntegrator, Orbit, discretize_zoh
from problems.auction_cost import compute_transfer_costs, solve_transfer
from problems.transfer import TransferProblem
from sato.reconfiguration.leg import Join, Leg, Loss
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.models import OrbitalModel, PlantSettings, PointMass
from sato.reconfiguration.orbit import Chief
from sato.reconfiguration.start import Random
from sato.scenario.errors import InputError
from sato.scenario.file import parse
from sato.shapes import Lattice, Points, Polygon, Ring, Text

START = np.array([[0.0, 0.0], [1.5, 0.0], [3.0, 0.5]])
TARGETS = np.array([[0.0, 3.0, 0.1, 0.0], [1.5, 4.0, 0.0, 0.0], [3.0, 3.0, 0.0, -0.1]])
TINY = {
    "model": DoubleIntegrator(2),
    "start": START,
    "legs": [Leg(TARGETS, steps=20)],
    "step": 1.0,
    "comm_radius": 20.0,
    "collision_radius": 0.5,
    "max_control": 0.2,
    "max_speed": 1.0,
}


def tiny(**changes):
    return Reconfiguration(**(TINY | changes))


# Random missions.


def maybe(rng, value):
    return value if rng.random() < 0.5 else None


def random_array(rng, count, axes, scale):
    """Positions, or states."""
    return rng.normal(scale=scale, size=(count, axes * int(rng.integers(1, 3))))


def random_shape(rng, count, axes, scale):
    return [
        lambda: random_array(rng, count, axes, scale),
        lambda: Points(rng.normal(scale=scale, size=(count, axes)), keep_order=True),
        lambda: Ring(radius=scale, center=maybe(rng, rng.normal(size=2))),
        lambda: Ring(spacing=rng.uniform(1, 2), normal=maybe(rng, rng.normal(size=axes))),
        lambda: Lattice(spacing=rng.uniform(1, 2), flat=bool(rng.integers(2))),
        lambda: Text("SATO"[: rng.integers(1, 5)], height=scale),
        lambda: Polygon(rng.normal(scale=scale, size=(4, 2)), spacing=maybe(rng, 0.1)),
    ][rng.integers(7)]()


def random_start(rng, count, axes, scale):
    if rng.random() < 0.7:
        return random_array(rng, count, axes, scale)
    box = maybe(rng, 5 * scale)
    depth = None if axes == 2 or box is None else maybe(rng, 0.0)
    connected = bool(rng.integers(2))
    return Random(rng.uniform(1, 2), box, depth, connected=connected)


def random_leg(rng, agents, axes, scale):
    steps = int(rng.integers(5, 30))
    losses = [
        Loss("agents", agents=(int(rng.integers(agents)),), at_step=int(rng.integers(steps))),
        Loss(str(rng.choice(["middle", "random"])), share=rng.uniform(0.1, 0.6)),
    ][: rng.integers(3)]
    joins = []
    for count in rng.integers(1, 3, rng.integers(3)).tolist():
        start = random_start(rng, count, axes, scale)
        joins.append(Join(count, start, at_step=int(rng.integers(steps))))
    enough = agents + 8 + int(rng.integers(3))
    shape = random_shape(rng, enough, axes, scale)
    choose = (
        None if isinstance(shape, Points) else maybe(rng, str(rng.choice(["prefix", "nearest"])))
    )
    leg = Leg(shape, steps, maybe(rng, enough), False, losses, joins, choose)
    return leg if leg.is_free else replace(leg, recount=bool(rng.integers(2)))


def random_plan(rng):
    replan = int(rng.integers(1, 3))
    auction = replan * int(rng.integers(1, 3))
    orders = int(rng.integers(1, 4))
    return {
        "horizon_steps": auction + int(rng.integers(3)),
        "foresight_steps": int(rng.integers(10)),
        "replan_steps": maybe(rng, replan),
        "auction_steps": auction,
        "orders": orders,
        "bargains": int(rng.integers(3)) if orders > 1 else 0,
        "epsilon": maybe(rng, rng.uniform(0.01, 1)) or "auto",
        "tie_break": rng.uniform(0, 1),
        "cost": str(rng.choice(["fuel", "distance"])),
        "bidder_ids": bool(rng.integers(2)),
        "reset": str(rng.choice(["change", "need"])),
        "freeze_steps": int(rng.integers(4)),
        "margin": [None, "auto", rng.uniform(0, 1)][rng.integers(3)],
        "position_tolerance": maybe(rng, rng.uniform(0, 1)),
        "allow_undetectable": True,
        "control_norm": [1, 2, "inf"][rng.integers(3)],
        "fuel_norm": [1, 2, "inf"][rng.integers(3)],
        "max_speed": maybe(rng, rng.uniform(1, 2)) or np.inf,
        "pointing_error": rng.uniform(0, 0.1),
        "thrust_error": maybe(rng, 0.01) or 0.0,
        "velocity_noise": maybe(rng, 0.1) or 0.0,
    }


def random_chief(rng):
    a, e, i, node, perigee, anomaly = rng.uniform([7e6, 0, 0.1, 0, 0, -3], [9e6, 0.05, 3, 6, 6, 3])
    orbit = Orbit.from_elements(a, e, i, node, perigee, anomaly)
    position = np.array([rng.uniform(7e6, 8e6), 0.0, 0.0])
    return [
        lambda: Chief(semi_major_axis=a, eccentricity=e, inclination=i, anomaly=anomaly, j2=0.0),
        lambda: Chief(position=position, velocity=rng.uniform([0, 7.4e3, 0], [1, 7.6e3, 99])),
        lambda: Chief.from_orbit(orbit),
        lambda: orbit,
    ][rng.integers(4)]()


def random_world(rng):
    """Model, chief and plant."""
    if rng.random() < 0.5:
        axes = int(rng.integers(2, 4))
        return axes, {"model": [PointMass(axes), DoubleIntegrator(axes)][rng.integers(2)]}
    kinds = ["clohessy_wiltshire", "schweighart_sedwick", "eccentric", "j2"]
    model = OrbitalModel(kinds[rng.integers(4)], relinearize=bool(rng.integers(2)))
    drag = PlantSettings(
        drag=True,
        ballistic=rng.uniform(0.005, 0.02),
        ballistic_spread=rng.uniform(0, 0.3),
        chief_ballistic=maybe(rng, 0.01),
    )
    about = {"model": model, "chief": random_chief(rng)}
    return 3, [
        lambda: about,
        lambda: about | {"plant": drag},
        lambda: about | {"plant": PlantSettings(kind="model")},
        lambda: {"model": J2(Orbit.from_elements(7e6, 0.01, rng.uniform(0, 3)))},
        lambda: {"model": ClohessyWiltshire(rng.uniform(1e-3, 2e-3))},
    ][rng.integers(5)]()


def random_mission(rng):
    axes, world = random_world(rng)
    agents, scale = int(rng.integers(2, 9)), 10.0 ** rng.uniform(1, 3)
    start = random_start(rng, agents, axes, scale)
    legs = [random_leg(rng, agents, axes, scale) for _ in range(rng.integers(1, 3))]
    return Reconfiguration(
        agents=agents if isinstance(start, Random) else maybe(rng, agents),
        start=start,
        legs=legs,
        step=rng.uniform(0.5, 60),
        comm_radius=rng.uniform(5, 1e3),
        collision_radius=rng.uniform(0.2, 1),
        max_control=rng.uniform(0.01, 1),
        target_count=None if all(leg.is_free for leg in legs) else maybe(rng, agents),
        **world,
        **random_plan(rng),
    )


@pytest.mark.parametrize("seed", range(20))
def test_random_mission_equals_itself_read_from_its_file(seed):
    for part in range(10):
        mission = random_mission(np.random.default_rng([seed, part]))
        text = mission.to_toml()
        again = parse(text)
        assert again == mission
        assert again.to_toml() == text


def test_arrays_dict_and_file_give_the_same_run_bit_for_bit():
    mission = tiny(disturbance=1e-4, position_noise=1e-3)
    text = mission.to_toml()
    runs = [sato.run(given, seed=5) for given in (mission, tomllib.loads(text), parse(text))]
    for run in runs[1:]:
        assert run.mission == mission
        assert run.data.variables.keys() == runs[0].data.variables.keys()
        for name, variable in run.data.variables.items():
            assert variable.identical(runs[0].data[name].variable), name


# Arrays from Python.

READ_ONLY = START.copy()
READ_ONLY.flags.writeable = False


@pytest.mark.parametrize(
    "start",
    [START.tolist(), tuple(map(tuple, START)), START.astype(np.float32), np.asfortranarray(START),
     READ_ONLY, np.repeat(START, 2, axis=0)[::2], Points(START)],
    ids=["lists", "tuples", "float32", "Fortran order", "read-only", "strided", "Points"],
)  # fmt: skip
def test_any_array_of_these_numbers_gives_the_same_mission(start):
    assert tiny(start=start) == tiny()


def test_integers_are_numbers_and_later_changes_of_an_array_do_not_count():
    whole = np.array([[0, 0], [2, 0], [4, 1]])
    start = whole.astype(float)
    mission = tiny(start=start)
    start[0] = 7.0
    assert mission == tiny(start=whole) == tiny(start=whole.tolist())


@pytest.mark.parametrize(
    ("array", "reason"),
    [
        (START[0], "must be an array with 2 axes, got shape (2,)"),
        (START[None], "must be an array with 2 axes, got shape (1, 3, 2)"),
        (START[:0], "must be an array that is not empty, got shape (0, 2)"),
        (np.ones((3, 5)), "or of 4 or 6 with velocities, got shape (3, 5)"),
        ([[0.0, 0.0], [1.5]], "must have rows of one length"),
        (masked_array(START, START > 2), "must not be a masked array"),
        (np.where(START > 2, np.nan, START), "must be finite, got nan at [2, 0]"),
        (np.where(START > 2, -np.inf, START), "must be finite, got -inf at [2, 0]"),
        (START.astype(complex), "must be an array of real numbers, got dtype complex128"),
        (START.astype(object), "must be an array of real numbers, got dtype object"),
        (START.astype(str), "must be an array of real numbers, got dtype <U32"),
        (START > 2, "must be an array of real numbers, got dtype bool"),
    ],
)  # fmt: skip
def test_bad_arrays_are_refused_with_the_field_and_the_reason(array, reason):
    for field, build in {
        "swarm.start": lambda: tiny(start=array),
        "shape": lambda: Leg(array, steps=5),
        "start": lambda: Join(None, array),
    }.items():
        with pytest.raises(InputError) as caught:
            build()
        assert str(caught.value).startswith(f"{field}: ") and reason in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"agents": 4}, "swarm.start.positions_m: lists 3 positions for 4 agents"),
        ({"start": np.eye(3)}, "swarm.start: has 3 coordinates per point, and the model has"),
        ({"legs": Leg(np.eye(3), 9)}, "leg.0.shape: has 3 coordinates per point, and the model"),
        ({"model": sato.DoubleIntegrator(3)}, "swarm.start: has 2 coordinates per point, and the"),
        ({"legs": Leg(TARGETS, 9, joins=[Join(None, np.eye(3))])}, "leg.0.join.0.start: has 3"),
        ({"legs": Leg(TARGETS[:2], 9)}, "leg.0.shape.positions_m: lists 2 points, fewer than"),
        ({"legs": ()}, "leg: needs at least 1 entry, got 0"),
        ({"auction_steps": 8}, "plan.auction_steps: 8 is more than horizon_steps = 4"),
        ({"replan_steps": 3, "auction_steps": 4}, "plan.auction_steps: 4 is no multiple of"),
        ({"step": 0.0}, "plan.step_s: must be greater than 0, got 0"),
        ({"horizon_steps": 0}, "plan.horizon_steps: must be greater than 0, got 0"),
        ({"orders": 0}, "plan.orders: must be greater than 0, got 0"),
        ({"orders": 2, "bargains": -1}, "plan.bargains: must be at least 0, got -1"),
        ({"bargains": 1}, "plan.bargains: 1 sweeps need orders of 2 or more"),
        ({"target_count": 3}, "swarm.believed: has no meaning where agents choose among"),
        ({"legs": Leg(Ring(radius=9), 9, 2, choose="nearest")}, "leg.0.targets: 2 is less than"),
        ({"comm_radius": "20"}, "swarm.comm_radius_m: must be a number"),
        ({"model": "double_integrator"}, "model: must be PointMass, OrbitalModel, LinearModel"),
        ({"legs": START}, "leg.0: must be Leg of sato.reconfiguration.leg, got ndarray"),
    ],
)  # fmt: skip
def test_mission_that_cannot_be_flown_is_refused_by_its_field(changes, message):
    with pytest.raises(InputError) as caught:
        tiny(**changes).draw(np.random.default_rng(0))
    assert str(caught.value).startswith(message)


def test_velocities_need_the_shape_of_the_positions():
    with pytest.raises(InputError, match=r"the positions, \(3, 2\), got \(2, 2\)"):
        Points(START, START[:2])


def test_plant_is_known_once_the_mission_is_drawn():
    with pytest.raises(ValueError, match="known once the mission is drawn"):
        drag = ("plant.drag=true", "plant.ballistic_m2_kg=0.01")
        sato.read("orbit", drag).flown_plant  # noqa: B018


@pytest.mark.parametrize("steps", [2, 7, 8])
def test_reach_from_rest_to_rest_is_that_of_the_transfer_problem(steps, rng):
    start, target = np.zeros((1, 4)), np.array([[1.0, 0.6, 0.0, 0.0]])
    model = discretize_zoh(DoubleIntegrator(2), 1.0, steps)
    free = {"max_speed": np.inf, "allow_undetectable": True, "legs": Leg(target, steps)}
    for factor, is_enough in ((1.001, True), (0.999, False)):
        control = factor / (steps**2 // 4)
        transfer = TransferProblem(model, control)
        assert compute_transfer_costs(transfer, start, target).is_reachable.all() == is_enough
        mission = tiny(start=start, max_control=control, **free)
        with nullcontext() if is_enough else pytest.raises(InputError, match="can reach none"):
            mission.draw(rng)


@pytest.mark.parametrize("v_start", [0.0, 1.0])
@pytest.mark.parametrize("v_end", [0.0, 1.0])
def test_speed_limit_asks_for_time_at_ends_at_rest_only(v_start, v_end, rng):
    # 10 m at 1 m/s, and half a second more for each end at rest.
    start, target = np.array([[0.0, 0.0, v_start, 0.0]]), np.array([[10.0, 0.0, v_end, 0.0]])
    least = round(4 * (11 - (v_start + v_end) / 2))
    for steps in (least, least - 1):
        model = discretize_zoh(DoubleIntegrator(2), 0.25, steps)
        transfer = solve_transfer(TransferProblem(model, 1.0, 1.0), start[0], target[0])
        assert (transfer is not None) == (steps == least)
        free = {"step": 0.25, "max_control": 1.0, "legs": Leg(target, steps)}
        mission = tiny(start=start, **free)
        with nullcontext() if steps == least else pytest.raises(InputError, match="can reach none"):
            mission.draw(rng)


@pytest.mark.parametrize("freeze", [0, 4])
def test_plans_that_reach_their_targets_are_kept_before_the_deadline(freeze):
    periods = {"replan_steps": 1, "auction_steps": 1}
    mission = tiny(assignment="central", freeze_steps=freeze, **periods)
    frames = list(sato.simulate(mission, seed=1))
    planned = [k for k, f in enumerate(frames) for e in f.events if e["kind"] == "replan"]
    assert planned == list(range(20 - max(freeze - 1, 0)))


def test_a_join_counts_the_agents_that_its_start_lists():
    joined = Join(None, [[9.0, 0.0], [9.0, 3.0]])
    mission = tiny(legs=[Leg(Ring(radius=6.0), 20, joins=[joined])])
    assert mission.legs[0].joins[0].agents == 2 and parse(mission.to_toml()) == mission
    with pytest.raises(InputError, match="agents: is missing"):
        Join(None, Random(box=9.0, separation=1.0))


def test_an_infinite_norm_is_a_number_or_a_word():
    assert tiny(control_norm=np.inf, fuel_norm=np.float64("inf")) == tiny(
        control_norm="inf", fuel_norm="inf"
    )
    assert sato.read("crossing", ["model.fuel_norm=inf"]).fuel_norm == "inf"
