"""Missions among obstacles and lost vehicles: safe in continuous time, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reconfiguration_runs import make_mission, row
from recorded_run import altered

import sato
from sato.reconfiguration.allowed_places import are_blocked
from sato.reconfiguration.check.clearance import find_clearance, find_excess
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.check.summary import summarize

R = 0.5


def scatter(rng, count, axes, side, obstacles):
    """Places 2 R from each other, and R from obstacles as they are, and are 3 s later."""
    found = np.zeros((0, axes))
    while len(found) < count:
        p, side = rng.uniform(-side / 2, side / 2, axes), side * 1.001
        away = [o.distances(p - t * o.drift) for o in obstacles for t in (0.0, 1.5, 3.0)]
        apart = np.linalg.norm(found - p, axis=1)
        if min(away, default=9) > 1.1 * R and apart.min(initial=9) > 2 * R:
            found = np.vstack([found, p])
    return found


def draw_obstacle(rng, axes, moves):
    """A sphere, a box or an ellipsoid."""
    center, size = rng.uniform(-4, 4, axes), rng.uniform(0.3, 1.0, axes)
    way = rng.uniform(-0.3, 0.3, axes)
    more = {"velocity": tuple(way.tolist()) if moves else None, "known": bool(rng.random() < 0.5)}
    kind = rng.integers(3)
    if kind == 0:
        return sato.Sphere(tuple(center.tolist()), float(size[0]), **more)
    if kind == 1:
        low, high = center - size, center + size
        return sato.Box(tuple(low.tolist()), tuple(high.tolist()), **more)
    return sato.Ellipsoid(tuple(center.tolist()), tuple(size.tolist()), **more)


def draw_world(seed, axes, is_given, moves):
    """Four vehicles among four obstacles."""
    rng = np.random.default_rng(seed)
    obstacles = tuple(draw_obstacle(rng, axes, moves and n < 2) for n in range(4))
    start, goal = (scatter(rng, 4, axes, 8.0, obstacles) for _ in range(2))
    hidden = {} if all(o.known for o in obstacles) else {"sensing_radius": 2.5}
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(axes),
        start=start,
        legs=[sato.Leg(goal, "auto", time_factor=2.0)],
        obstacles=obstacles,
        box=[[-12.0] * axes, [12.0] * axes],
        step=0.5,
        comm_radius=12.0,
        collision_radius=R,
        max_control=0.5,
        max_speed=1.0,
        assignment="given" if is_given else "auction",
        **hidden,
    )


def record_of(run):
    return ReconfigurationRecord.from_data(run.recorded, run.mission)


@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    axes=st.sampled_from([2, 3]),
    is_given=st.booleans(),
    moves=st.booleans(),
)
def test_vehicles_arrive_and_keep_their_distance_from_everything(seed, axes, is_given, moves):
    mission = draw_world(seed, axes, is_given, moves)
    try:
        run = sato.run(mission, seed=0)
    except sato.InputError as error:  # something comes over a start too soon
        assert moves and "comes to the start" in str(error)
        return
    assert {p.name for p in run.check().promises if not p.kept} <= {"reached"}
    assert run.summary["reached"] or moves
    # Against samples of the cubics.
    record, least = record_of(run), np.inf
    x, h = record.pieces.state, record.pieces.duration
    for s in np.linspace(0, 1, 9):
        a, b = x[:-1, :, :axes], x[1:, :, :axes]
        va, vb = x[:-1, :, axes:], x[1:, :, axes:]
        p = (1 + 2 * s) * (1 - s) ** 2 * a + s * (1 - s) ** 2 * h * va
        p = p + s**2 * (3 - 2 * s) * b + s**2 * (s - 1) * h * vb
        t = (np.arange(len(p)) + s) * h
        for one in mission.obstacles:
            least = min(least, one.distances(p - t[:, None, None] * one.drift).min())
    found = find_clearance(record)
    assert least - 0.05 <= found.distance <= least + 1e-9
    assert found.distance >= R * (1 - 1e-9)


def test_straight_way_through_an_obstacle_is_found_by_the_check():
    mission = make_mission(row(1, 0.0), sato.Leg(row(1, 6.0), 40), max_control=0.3)
    run = sato.run(mission, seed=0)
    wall = replace(run.mission, obstacles=(sato.Box((-3.0, 2.0), (3.0, 3.0)),))
    record = ReconfigurationRecord.from_data(run.recorded, wall)
    assert find_clearance(record).distance == 0.0
    # It flies along y = p(t); one that keeps 2 m beside it, and one that meets it at its target.
    end = float(run.data.time[-1])
    beside = sato.Sphere((2.0, 3.0), 0.5)
    meeting = sato.Sphere((end * 0.1, 6.0), 0.5, velocity=(-0.1, 0.0))
    for one, distance in ((beside, 1.5), (meeting, 0.0)):
        record = ReconfigurationRecord.from_data(run.recorded, replace(wall, obstacles=(one,)))
        assert find_clearance(record).distance == pytest.approx(distance, abs=1e-6)
    passed = replace(meeting, velocity=(0.1, 0.0))
    record = ReconfigurationRecord.from_data(run.recorded, replace(wall, obstacles=(passed,)))
    assert find_clearance(record).distance > 1.0
    box = replace(wall, obstacles=(), box=np.array([[-1.0, -1.0], [1.0, 5.5]]))
    assert find_excess(ReconfigurationRecord.from_data(run.recorded, box))[0] == pytest.approx(0.5)


def test_ellipsoids_of_downwash_are_kept():
    start = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 3.0], [1.5, 0.0, 2.0]])
    leg = sato.Leg(sato.Points(start[[1, 2, 0]], keep_order=True), "auto", time_factor=2.0)
    more = {"assignment": "given", "comm_radius": 20.0, "separation_axes": (1.0, 1.0, 2.0)}
    run = sato.run(make_mission(start, leg, max_control=0.4, **more), seed=0)
    scaled = run.data.position.values / [1.0, 1.0, 2.0]
    apart = [
        np.linalg.norm(scaled[:, i] - scaled[:, j], axis=1) for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    assert np.min(apart) >= R * (1 - 1e-9)
    assert run.check().kept
    assert 1 - 1e-9 <= run.summary["min_relative_separation"] <= np.min(apart) / R + 1e-9


@pytest.mark.parametrize("is_given", [False, True])
def test_lost_vehicles_coast_and_are_avoided(is_given):
    loss = sato.Loss("agents", agents=(2, 5), at_step=10, body="coast")
    start = 1.2 * row(8, 0.0)
    goal = sato.Points(start[::-1] + np.array([0.4, 5.0]), keep_order=is_given)
    leg = sato.Leg(goal, "auto", time_factor=2.0, losses=(loss,))
    more = {"assignment": "given" if is_given else "auction", "comm_radius": 15.0}
    run = sato.run(make_mission(start, leg, max_control=0.4, **more), seed=0)
    assert run.check().kept
    k, x = 10, run.data
    drift = x.velocity.values[k, 2]
    coasted = x.position.values[-1, 2] - x.position.values[k, 2]
    np.testing.assert_allclose(coasted, (len(x.time) - 1 - k) * drift, atol=1e-9)
    assert not x.alive.values[k:, [2, 5]].any()
    live = [i for i in range(8) if i not in (2, 5)]
    apart = x.position.values[k:, live][:, :, None] - x.position.values[k:, None, [2, 5]]
    assert np.linalg.norm(apart, axis=-1).min() >= R * (1 - 1e-9)


@pytest.mark.parametrize("at_step", [6, 8, 10])
def test_vehicles_join_clear_of_what_passes_and_of_lost_ones(at_step):
    start = np.array([[0.0, 3.0], [3.0, 3.0], [6.0, 3.0]])
    passing = sato.Sphere((-5.0, 0.0), 0.5, velocity=(1.0, 0.0))
    loss = sato.Loss("agents", agents=(2,), at_step=2, body="coast")
    join = sato.Join(2, [[0.1, 0.2], [6.2, 3.1]], at_step=at_step)
    goal = np.array([[0.0, 6.0], [2.0, 6.0], [4.0, 6.0], [6.0, 6.0], [8.0, 6.0]])
    leg = sato.Leg(goal, 40, losses=(loss,), joins=(join,))
    more = {"obstacles": [passing], "comm_radius": 20.0, "step": 0.5, "max_speed": 0.8}
    run = sato.run(make_mission(start, leg, max_control=0.4, **more), seed=0)
    assert {p.name for p in run.check().promises if not p.kept} <= {"reached"}
    assert run.summary["min_separation_m"] >= R * (1 - 1e-9)
    assert run.summary["min_obstacle_distance_m"] >= R * (1 - 1e-9)


def test_targets_on_the_bounds_are_reached():
    leg = sato.Leg(np.array([[0.0, 4.0], [2.0, 4.0], [4.0, 3.0]]), 40)
    more = {"box": [[0.0, -1.0], [4.0, 4.0]], "comm_radius": 20.0}
    run = sato.run(
        make_mission(np.array([[0.0, 0.0], [2.0, 0.0]]), leg, max_control=0.4, **more), seed=0
    )
    assert run.summary["reached"] and run.check().kept
    assert "blocked" not in run.summary["legs"][0]


def test_starts_within_the_margin_of_an_obstacle_are_refused():
    wall = sato.Box((-0.5, -3.0), (0.5, -0.505))
    with pytest.raises(sato.InputError, match=r"with a margin of .*, agent 0 starts 0.505 m"):
        make_mission(row(2, 0.0), sato.Leg(row(2, 4.0), 30), obstacles=[wall], disturbance=2e-3)


def test_vanished_vehicles_are_in_nobody_s_way():
    losses = (
        sato.Loss("agents", agents=(1,), at_step=2, body="coast"),
        sato.Loss("agents", agents=(4,), at_step=3),
    )
    leg = sato.Leg(row(6, 4.0), 30, losses=losses)
    run = sato.run(make_mission(row(6, 0.0), leg, comm_radius=10.0), seed=0)
    assert run.check().kept
    position = run.data.position.values
    assert (position[3:, 4] == position[3, 4]).all() and (position[4, 1] != position[3, 1]).any()


def test_targets_that_a_lost_vehicle_takes_up_are_left_out():
    # Vehicle 1 dies at rest, on what is a target of the second leg.
    first = sato.Leg(row(4, 0.0), 20)
    loss = sato.Loss("agents", agents=(1,), body="coast")
    places = np.vstack([row(4, 0.0)[[1]], row(5, 2.0)])
    second = sato.Leg(sato.Points(places, keep_order=True), 40, losses=(loss,), choose="prefix")
    run = sato.run(make_mission(row(4, 0.0), first, second, comm_radius=10.0), seed=0)
    summary = run.summary["legs"][1]
    assert summary["reached"] and summary["blocked"] == 1
    assert 0 not in run.data.target_index.values[-1]
    assert run.check().kept
    vanished = replace(
        run.mission, legs=(first, replace(second, losses=(replace(loss, body="vanish"),)))
    )
    assert 0 in sato.run(vanished, seed=0).data.target_index.values[-1]


def test_altered_drift_of_a_lost_vehicle_is_caught():
    loss = sato.Loss("agents", agents=(0,), at_step=4, body="coast")
    leg = sato.Leg(row(3, 4.0), 30, losses=(loss,))
    run = sato.run(make_mission(row(3, 0.0), leg, comm_radius=10.0), seed=0)
    run = altered(run, "position", (15, 0, 0), by=1e-6)
    assert "flight" in {p.name for p in run.check().promises if not p.kept}


def test_shapes_leave_out_targets_and_starts_keep_clear_of_obstacles():
    hole = sato.Sphere((0.0, 0.0), 1.0)
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        agents=9,
        start=sato.Random(box=9.0, separation=1.0),
        legs=[sato.Leg(sato.Lattice(spacing=1.2), "auto", time_factor=2.0)],
        obstacles=[hole],
        step=0.5,
        comm_radius=20.0,
        collision_radius=R,
        max_control=0.5,
        max_speed=1.0,
    ).draw(np.random.default_rng(2))
    run = sato.run(mission, seed=2)
    targets = run.mission.legs[0].targets[:, :2]
    assert len(targets) >= 9
    assert not are_blocked(run.mission, targets, np.full(len(targets), R)).any()
    assert (hole.distances(run.mission.initial_states[:, :2]) >= R).all()
    assert run.summary["reached"] and run.check().kept


def test_closed_room_is_no_progress_and_no_collision():
    walls = [
        sato.Box((2.0, -2.0), (5.0, -1.5)),
        sato.Box((2.0, 1.5), (5.0, 2.0)),
        sato.Box((1.5, -2.0), (2.0, 2.0)),
        sato.Box((5.0, -2.0), (5.5, 2.0)),
    ]
    leg = sato.Leg(sato.Points([[3.5, 0.0]], keep_order=True), 6)
    more = {
        "obstacles": walls,
        "assignment": "given",
        "max_control": 1.0,
        "max_speed": 1.0,
        "comm_radius": 9.0,
    }
    run = sato.run(make_mission(row(1, 0.0), leg, **more), seed=0)
    assert not run.summary["reached"]
    assert run.summary["min_obstacle_distance_m"] >= R * (1 - 1e-9)
    assert {p.name for p in run.check().promises if not p.kept} == {"reached"}


def test_spacecraft_avoid_the_chief():
    start = np.array([[0.0, -300.0, 0.0], [0.0, 500.0, 0.0]])
    targets = np.array([[0.0, 300.0, 0.0], [0.0, 800.0, 0.0]])
    chief = sato.Sphere((0.0, 0.0, 0.0), 90.0)
    mission = sato.Reconfiguration(
        model=sato.ClohessyWiltshire(1.1e-3),
        start=start,
        legs=[sato.Leg(sato.Points(targets, keep_order=True), 15)],
        obstacles=[chief],
        assignment="given",
        step=60.0,
        comm_radius=3e3,
        collision_radius=40.0,
        max_control=2e-2,
        max_speed=4.0,
    )
    run = sato.run(mission, seed=0)
    assert run.summary["reached"] and run.check().kept
    assert run.summary["min_obstacle_distance_m"] >= 40.0 * (1 - 1e-9)
    alone = sato.run(replace(mission, obstacles=()), seed=0)
    x = alone.data.position.values
    assert chief.distances(x).min() < 40.0  # without it they come near


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"obstacles": [sato.Sphere((0.0, 0.0), 0.3)]}, "agent 0 starts .* m from obstacle 0"),
        ({"obstacles": [sato.Sphere((0.0, 4.2), 0.3)]}, "target 0 is .* m from obstacle 0"),
        ({"obstacles": [sato.Sphere((0.0, 9.0, 0.0), 0.3)]}, "has 3 coordinates, and the model"),
        ({"obstacles": [sato.Sphere((-2.4, 0.0), 1.0, velocity=(0.6, 0.0))]}, "comes to the start"),
        ({"box": [[-1.0, -1.0], [3.0, 1.0]]}, "target 0 is outside of the allowed positions"),
        ({"box": [[-1.0, 1.0], [3.0, 6.0]]}, "agent 0 starts outside of the allowed"),
        ({"box": [[1.0, 1.0], [0.0, 6.0]]}, "must have a lowest corner below"),
        ({"box": [[1.0, 1.0, 1.0]]}, "needs a lowest and a highest corner"),
        ({"separation_axes": (1.0,)}, "has 1 entries, and the model has 2 axes"),
        ({"separation_axes": (1.0, 0.0)}, "must be greater than 0"),
        ({"sensing_radius": 2.0}, "has no effect where all is known"),
        (
            {"obstacles": [sato.Sphere((9.0, 9.0), 1.0, known=False)], "sensing_radius": 0.4},
            "none could stop before it meets what it sees",
        ),
    ],
)
def test_worlds_that_cannot_be_are_refused_with_a_reason(changes, message):
    with pytest.raises(sato.InputError, match=message):
        make_mission(row(2, 0.0), sato.Leg(row(2, 4.0), 30), **changes)


def test_scenario_file_of_a_world_is_that_of_the_mission():
    mission = draw_world(3, 2, False, True)
    assert sato.parse(mission.to_toml()) == mission


def test_nothing_about_is_no_cost_to_the_summary():
    run = sato.run(make_mission(row(2, 0.0), sato.Leg(row(2, 3.0), 30)), seed=0)
    assert "min_obstacle_distance_m" not in summarize(record_of(run))
