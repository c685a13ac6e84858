"""Check of consistently altered runs, by replay of flights and of camera views."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from recorded_run import with_data
from test_connectivity_check import QUADROTOR, SHAKEN, broken, flown

from problems.interaction_graph import algebraic_connectivity, interaction_graph
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.obstacles import (
    Box,
    Obstacles,
    Sphere,
    min_obstacle_distance,
    obstacle_distances,
)

HIDING = ("camera.occlusion=true", "camera.body_m=1.0")


@pytest.fixture(scope="module")
def tilted():
    return flown(QUADROTOR)


@pytest.fixture(scope="module")
def hiding():
    return flown(*HIDING)


def told(run, **values):
    """Replace some variables of a run."""
    data = {name: (run.data[name].dims, new) for name, new in values.items()}
    return with_data(run, run.data.assign(data))


def weighing(run, weight):
    """Replace the weights of a run without losses, and their eigenvalues."""
    found = algebraic_connectivity(weight)
    assert (run.data["component"].values == 0).all() and found.lambda2.min() > 0.01
    return told(run, edge_weight=weight, lambda2=found.lambda2, lambda3=found.lambda3)


def poses(run, mission):
    """Compute the graph of level cameras in empty space."""
    return interaction_graph(run.data["position"].values, run.data["yaw"].values, mission.camera)


def test_weights_without_field_of_view_or_tilt_are_detected(tilted):
    run, mission = tilted
    blind = weighing(run, poses(run, mission).range_weights)
    assert blind.data["lambda2"].values.mean() > run.data["lambda2"].values.mean() + 0.5
    assert broken(blind, mission) == {"weights"}
    upright = weighing(run, poses(run, mission).weights)
    assert broken(upright, mission) == {"weights"}


def test_visibility_is_checked_with_tilted_cameras(tilted):
    run, mission = tilted
    upright = poses(run, mission).fov_weights > 0
    assert (upright != run.data["visibility"].values).any()
    assert broken(told(run, visibility=upright), mission) == {"visibility"}


@pytest.mark.parametrize(
    ("name", "promises"),
    [
        ("velocity_command", {"flight", "obedience"}),
        ("yaw_rate", {"heading"}),
        ("stick", {"stick", "flight", "obedience"}),
    ],
)
def test_quadrotor_that_moves_without_commands_is_detected(tilted, name, promises):
    run, mission = tilted
    nothing = told(run, **{name: np.zeros_like(run.data[name].values)})
    assert promises <= broken(nothing, mission)


def test_noise_does_not_excuse_motion_without_commands():
    run, mission = flown(SHAKEN.replace("lag_s=0.3, ", ""))
    assert broken(run, mission) == set()
    for name, promise in (("velocity_command", "obedience"), ("yaw_rate", "heading")):
        nothing = told(run, **{name: np.zeros_like(run.data[name].values)})
        assert promise in broken(nothing, mission)


def test_stick_commands_to_a_lost_leader_are_detected():
    run, mission = flown(QUADROTOR, "death=[{robot=0, time_s=1}]")
    stick = run.data["stick"].values.copy()
    assert stick[:50].any(axis=1).all() and not stick[50:].any()
    stick[100, 0] = 1.0
    assert broken(told(run, stick=stick), mission) == {"stick"}


@pytest.mark.parametrize("plant", ['plant={kind="kinematic"}', QUADROTOR])
def test_occlusion_by_robots_is_checked(plant):
    run, mission = flown(plant, *HIDING)
    record = ConnectivityRecord.from_data(run.recorded, mission)
    clear = ConnectivityRecord.from_data(run.recorded, replace(mission, occlusion=False)).views
    covered = (clear.weight > 0) & (record.views.weight == 0)
    assert covered.any()
    assert broken(weighing(run, clear.weight), mission) == {"weights"}
    seen = clear.view_cosine > mission.camera.a_min
    assert broken(told(run, visibility=seen), mission) == {"visibility"}
    assert {"weights", "visibility"} <= broken(run, replace(mission, occlusion=False))


def test_missing_edge_in_clear_view_is_detected(hiding):
    run, mission = hiding
    weight = run.data["edge_weight"].values.copy()
    k, i, j = np.unravel_index(np.argmin(np.where(weight > 1e-3, weight, 9)), weight.shape)
    weight[k, i, j] = weight[k, j, i] = 0
    assert broken(weighing(run, weight), mission) == {"weights"}


def test_occlusion_by_obstacles_is_checked(hiding):
    run, mission = hiding
    p, sees = run.data["position"].values, run.data["visibility"].values
    i, j = np.argwhere(sees[-1])[0]
    wall = Sphere(tuple((p[-1, i] + p[-1, j]) / 2), 0.1)
    assert {"weights", "visibility"} <= broken(run, replace(mission, obstacles=(wall,)))


@pytest.mark.parametrize("kind", [Sphere, Box])
def test_passage_through_an_obstacle_between_instants_is_detected(tilted, kind):
    run, mission = tilted
    p = run.data["position"].values.copy()
    top = int(np.argmax(p[0, :, 2]))
    high, half = p[99, top] + [0, 0, 4.0], np.array([9, 9, 0.1])
    p[100:, top, 2] += 8.0
    wall = (
        Sphere(tuple(high), 0.3) if kind is Sphere else Box(tuple(high - half), tuple(high + half))
    )
    assert obstacle_distances(p, Obstacles.of([wall])).min() > 2 * mission.repulsion.min_distance
    walled = replace(mission, obstacles=(wall,))
    assert "obstacles" not in broken(run, walled)
    assert {"obstacles", "flight"} <= broken(told(run, position=p), walled)


def test_least_obstacle_distance_agrees_with_fine_sampling(rng):
    spheres = np.hstack([rng.uniform(-3, 3, (3, 3)), rng.uniform(0.1, 0.5, (3, 1))])
    corner = rng.uniform(-3, 3, (3, 3))
    normal = rng.standard_normal((2, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    boxes = np.hstack([corner, corner + rng.uniform(0.01, 1.5, (3, 3))])
    some = Obstacles(spheres, boxes, np.hstack([normal, [[-4.0], [-5.0]]]))
    share = np.linspace(0, 1, 2001)[:, None, None]
    for _ in range(20):
        walk = rng.uniform(-4, 4, (3, 2, 3))
        alive = rng.random((3, 2)) < 0.8
        least = np.inf
        for (a, there), (b, _) in pairwise(zip(walk, alive, strict=True)):
            ways = (a + share * (b - a))[:, there]  # who is lost at b has moved until then
            least = min(least, obstacle_distances(ways, some).min(initial=np.inf))
        least = min(least, obstacle_distances(walk, some)[alive].min(initial=np.inf))
        # Samples are up to 14 m / 2000 apart, and distance changes by half of that between two.
        found = min_obstacle_distance(walk, alive, some)
        assert found == least if least == np.inf else least - 3.5e-3 <= found <= least + 1e-8


def test_least_obstacle_distance_is_exact_in_closed_form_cases():
    way, both = np.array([[[-1.0, 0.3, 0.4]], [[2.0, 0.3, 0.4]]]), np.ones((2, 1), dtype=bool)
    empty = Obstacles.of(())
    ball = empty._replace(spheres=np.array([[0.0, 0.0, 0.0, 0.2]]))
    box = empty._replace(boxes=np.array([[-0.1, -0.1, -0.1, 0.1, 0.0, 0.0]]))
    floor = empty._replace(planes=np.array([[1.0, 0.0, 0.0, -1.5]]))
    assert min_obstacle_distance(way, both, ball) == pytest.approx(0.3, abs=1e-12)
    assert min_obstacle_distance(way, both, box) == pytest.approx(0.5, abs=1e-12)
    assert min_obstacle_distance(way, both, floor) == pytest.approx(0.5, abs=1e-12)
    assert min_obstacle_distance(way, both, empty) == np.inf
    assert min_obstacle_distance(way, np.array([[True], [False]]), ball) == pytest.approx(
        0.3, abs=1e-12
    )
