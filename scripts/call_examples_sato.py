"""Valid calls of the public functions, classes and methods of `sato`, for `fuzz_calls.py`."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np

Call = tuple[Any, dict[str, Any]]

# Changes that an argument takes though they look wrong: "Class.method.argument": names of changes.
ALLOWED: dict[str, tuple[str, ...]] = {
    "CbaaAuction.score": ("nan entry",),  # of agents that are not alive
    "VsdaaAuction.cost": ("nan entry",),
    "CommunicationGraph.from_positions.position": ("nan entry",),  # near to none
    "Reconfiguration.max_speed": ("inf",),  # no limit
    "expect_small_error.errors": ("nan", "nan entry", "inf", "inf entry", "bool", "bool entries"),
    "Connectivity.start": ("empty",),
    "CommunicationGraph.from_positions.radius": ("inf",),  # all hear all
    "FormationLeg.formation": ("text", "long text"),  # a name
}
START = np.array([[0.0, 0.0], [3.0, 0.0], [6.0, 0.0], [9.0, 0.0]])
SQUARE = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [3.0, 3.0, 0.0]])


def list_calls() -> Iterator[Call]:
    """List a function, a class or a bound method, and its arguments by name."""
    yield from _shapes()
    yield from _obstacles()
    yield from _missions()
    yield from _reconfiguration()
    yield from _files()
    yield from _runs()
    yield from _agents()
    yield from _auctions()
    yield from _systems()


def _given(value: Any, *names: str) -> dict[str, Any]:
    chosen = names or tuple(field.name for field in fields(value))
    return {name: getattr(value, name) for name in chosen}


def _shapes() -> Iterator[Call]:
    import sato
    from sato.shapes import formation_library as library

    ring = sato.Ring(radius=5.0, center=(0.0, 1.0))
    lattice, text = sato.Lattice(spacing=1.0), sato.Text("AB", spacing=1.0)
    polygon = sato.Polygon([[0.0, 0.0], [5.0, 0.0], [5.0, 5.0]], spacing=1.0)
    points = sato.Points(START, 0.1 * START, keep_order=True)
    yield sato.Ring, {"radius": 5.0, "center": (0.0, 1.0)}
    yield sato.Lattice, {"spacing": 1.0, "flat": False, "center": (0.0, 1.0)}
    yield sato.Text, {"text": "AB", "spacing": 1.0}
    yield sato.Polygon, {"vertices": polygon.vertices, "spacing": 1.0}
    yield sato.Points, {"positions": START, "velocities": 0.1 * START, "keep_order": True}
    sizes: dict[str, Any] = {"count": 4, "axes": 2}
    yield ring.place, {**sizes, "min_distance": 0.1}
    for shape in (ring, lattice, text, polygon, points):
        yield shape.draw, sizes
    yield ring.place_velocities, sizes
    yield ring.without_files, sizes
    yield points.place_velocities, sizes
    yield library.load_formation, {"name": "swarm4/Square", "graph": "own"}
    yield library.make_formation, {"points": SQUARE, "name": "square"}
    edges = [[0, 1], [1, 2]]
    yield library.graph_from_edges, {"count": 4, "edges": edges}
    sparse = {"points": np.random.default_rng(0).random((6, 3)), "share": 1.0}
    yield library.random_sparse_graph, {**sparse, "rng": np.random.default_rng(0)}


def _obstacles() -> Iterator[Call]:
    import sato

    still = {"velocity": (0.0, 0.1), "known": True}
    sphere = sato.Sphere((50.0, 50.0), 1.0, **still)
    box = sato.Box((50.0, 50.0), (51.0, 52.0), **still)
    ellipsoid = sato.Ellipsoid((50.0, 50.0), (1.0, 2.0), **still)
    polytope = sato.Polytope([[50.0, 50.0], [51.0, 50.0], [50.0, 52.0]], **still)
    yield sato.Sphere, _given(sphere)
    yield sato.Box, _given(box)
    yield sato.Ellipsoid, _given(ellipsoid)
    yield sato.Polytope, {"points": polytope.points, **still}
    for body in (sphere, box, ellipsoid, polytope):
        yield body.nearest, {"points": START}
        yield body.scaled, {"factors": (1.0, 2.0)}
    yield sphere.distances, {"points": START}
    yield sphere.place_at, {"time": 2.0}


def _missions() -> Iterator[Call]:
    import sato
    from sato.connectivity.controller import evaluate_potential, negative_slope
    from sato.connectivity.settings import Potential
    from sato.formation.settings import CollisionAvoidance

    rng = np.random.default_rng(0)
    leg = sato.FormationLeg(SQUARE, "complete", name="square")
    formation = sato.Formation(start=START, legs=[leg])
    yield sato.FormationLeg, {"formation": SQUARE, "name": "square"}
    yield leg.draw, {"agents": 4, "keep_out": 1.2, "rng": rng}
    yield leg.without_files, {"agents": 4}
    swarm = {"start": START, "legs": [leg], "keep_out": 1.2, "max_speed": 0.5, "step": 0.02}
    yield sato.Formation, {**swarm, "agents": 4, "name": "square"}
    yield formation.draw, {"rng": rng}
    yield formation.with_defaults, {"data": {}}
    yield CollisionAvoidance, dict(CollisionAvoidance()._asdict())
    poses = np.array([[0.0, 0.0, 3.0], [2.0, 0.0, 3.0], [0.0, 2.0, 3.0]])
    robots = {"start": poses, "yaw": np.array([0.8, 2.4, -0.8]), "yaw_error": 0.1}
    connectivity = sato.Connectivity(**robots)
    yield sato.Connectivity, {**robots, "duration": 1.0, "step": 0.02, "camera_noise": 0.0}
    yield connectivity.draw, {"rng": rng}
    yield connectivity.with_defaults, {"data": {}}
    yield sato.AgentLoss, {"agent": 1, "time": 2.0}
    potential = Potential()
    yield Potential, dict(potential._asdict())
    eigenvalues = np.array([0.5, 0.6])
    yield evaluate_potential, {"lambda2": eigenvalues, "potential": potential}
    yield negative_slope, {"lambda2": eigenvalues, "potential": potential}


def _reconfiguration() -> Iterator[Call]:
    import sato

    mission = small_mission().draw(np.random.default_rng(0))
    leg = sato.Leg(np.add(START, [0.0, 3.0]), 12)
    world = _given(mission, "start", "comm_radius", "collision_radius", "max_control", "max_speed")
    plan = _given(mission, "step", "horizon_steps", "replan_steps", "orders", "bargains", "name")
    yield sato.Reconfiguration, {"model": sato.DoubleIntegrator(2), "legs": [leg], **world, **plan}
    yield sato.Leg, {"shape": START, "steps": 12, "count": 4, "recount": False}
    yield leg.place, {"demand": 4, "axes": 2, "min_distance": 0.1}
    yield sato.Loss, {"kind": "agents", "agents": (0, 1), "at_step": 3, "body": "coast"}
    yield sato.Join, {"agents": 1, "start": [[20.0, 0.0]], "at_step": 3, "room": "wait"}
    random = sato.Random(separation=1.0, box=20.0)
    yield sato.Random, {"separation": 1.0, "box": 20.0, "center": (0.0, 1.0), "connected": False}
    rng, nobody = np.random.default_rng(0), np.zeros((0, 2))
    yield random.draw, {"mission": mission, "count": 4, "occupied": nobody, "rng": rng}
    yield mission.draw, {"rng": rng}
    yield mission.with_defaults, {"data": {}}
    yield mission.discretize, {"steps": 3, "time": 1.0}
    yield mission.draw_plant, {"agents": 4, "rng": rng}
    agents = np.array([0, 2])
    for method in (
        mission.control_limit,
        mission.radius,
        mission.speed_limit,
        mission.planned_control_limit,
        mission.stop_speed_limit,
    ):
        yield method, {"agent": 1}
    yield mission.planned_speed_limit, {"agent": 1, "control_factor": 0.5}
    yield mission.group_by_limit, {"agents": agents}
    yield mission.group_by_limits, {"agents": agents}
    yield mission.own_clearances, {"clearance": 1.0, "agents": agents}
    yield mission.scale_separations, {"vectors": START}
    yield mission.find_tightest, {"targets": mission.initial_states}
    yield mission.uses_all_targets, {"leg": mission.legs[0]}
    yield mission.joining, {"number": 0}
    yield mission.tracking_after, {"steps": 2}
    for bounded in (mission.reach_unheard, mission.distance_unheard, mission.skew_margin):
        yield bounded, {"margin": 0.1}
    yield mission.radius_for_way, {"way": 1.0}
    yield mission.fastest_plans, {"steps": 2, "margin": 0.1}
    yield mission.speed_within_reach, {"steps": 2, "margin": 0.1, "control_factor": 1.0}
    yield mission.make_transfer, {"model": mission.discretize(3), "agent": 1}
    yield mission.require_equal_vehicles, {"what": "this"}
    yield sato.central_problem, {"mission": small_mission(), "seed": 0}
    yield sato.find_first_commitments, {"mission": mission}
    orbit = sato.Orbit.from_elements(7e6, inclination=1.0)
    chief = sato.Chief(semi_major_axis=7e6, inclination=1.0)
    shape = {"eccentricity": 0.01, "inclination": 1.0, "perigee": 0.1, "anomaly": 0.2}
    yield sato.Chief, {"semi_major_axis": 7e6, "node": 0.1, "j2": 1e-3, **shape}
    yield sato.Chief.from_orbit, {"orbit": orbit}
    position = np.array([[10.0, 20.0, 0.0]])
    asked = {"position": position, "t": 10.0, "where": "here", "times": (0.0, 10.0)}
    yield chief.drift_free_velocities, asked
    yield chief.suggest_start, {"times": (0.0, 10.0)}
    air = {"density": 1e-12, "altitude": 5e5, "scale_height": 6e4}
    body = {"ballistic": 0.01, "ballistic_spread": 0.1, "chief_ballistic": 0.01}
    yield sato.PlantSettings, {"kind": "inertial", "drag": True, **body, **air}
    yield sato.PlantSettings().atmosphere, {"chief": chief}


def small_mission() -> Any:
    """Make a mission that takes a fraction of a second."""
    import sato

    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        start=START,
        legs=[sato.Leg(np.add(START, [0.0, 1.0]), 3)],
        comm_radius=20.0,
        collision_radius=0.5,
        max_control=1.0,
        max_speed=2.0,
        step=1.0,
    )


def _files() -> Iterator[Call]:
    import tomllib

    import sato

    text = small_mission().to_toml()
    data = tomllib.loads(text)
    yield sato.read, {"name": "crossing", "overrides": ["plan.step_s=1.0"]}
    yield sato.parse, {"text": text, "overrides": ["plan.step_s=1.0"], "source": "here"}
    yield sato.from_dict, {"data": data, "overrides": [("plan.step_s", 1.0)]}


def _runs() -> Iterator[Call]:
    import sato
    from sato.check.report import Report, expect_small_error
    from sato.record import RunRecord
    from sato.run_data import RunData

    mission = small_mission()
    run = sato.run(mission)
    run.save("run")
    flight = {"scenario": mission, "seed": 1, "overrides": ()}
    yield sato.run, {**flight, "progress": False, "speed": 1.0}
    yield sato.simulate, flight
    yield sato.load, {"path": "run", "mission": mission}
    yield sato.Run, {"recorded": run.recorded, "claimed": run.claimed, "mission": mission}
    yield run.events, {}
    yield run.save, {"directory": "saved"}
    yield run.export, {"path": "table.csv", "format": "csv"}
    yield run.player, {"path": "player.html"}
    yield run.plot, {"directory": "figures", "pdf": False}
    yield run.animate, {"directory": "film", "fps": 20, "frames": 1}
    yield RunData, {"variables": run.recorded.variables, "attrs": run.recorded.attrs}
    yield RunData.from_xarray, {"data": run.data}
    drawn = run.drawn_mission
    yield RunRecord.from_data, {"data": run.recorded, "mission": drawn}
    yield Report, {"promises": run.check().promises, "summary": {}, "skipped": ("this",)}
    errors = {"errors": np.array([0.1, 0.2]), "tolerance": 0.3, "text": "m"}
    yield expect_small_error, {"name": "position", **errors}
    fly = {"trials": 1, "seed": 0, "workers": 1, "resume": True, "keep": "none"}
    yield sato.campaign, {"scenario": mission, "out": "campaign", **fly}


def _agents() -> Iterator[Call]:
    import sato

    mission = small_mission()
    agent = sato.Agent(mission, 0)
    still = [0.0, 0.0, 0.0, 0.0]
    _, message = sato.Agent(mission, 1).step(0.0, START.tolist()[1] + [0.0, 0.0], [])
    yield sato.Agent, {"mission": mission, "number": 0, "target_count": 4, "leg_start": 0.0}
    seen = [sato.Sphere((30.0, 30.0), 1.0), (3, [40.0, 40.0, 0.0, 0.0])]

    def step(**arguments: Any) -> Any:
        return sato.Agent(mission, 0).step(**arguments)

    step.__qualname__ = "Agent.step"
    yield step, {"time": 0.0, "state": still, "inbox": [message], "seen": seen}
    yield agent.set_targets, {"targets": START, "steps": 12, "recount": False}


def _auctions() -> Iterator[Call]:
    from sato import auctions
    from sato.auctions.bidder import CbaaBidder, VsdaaBidder, WinningBids
    from sato.network.graph import CommunicationGraph

    adjacency, alive = ~np.eye(3, dtype=bool), np.ones(3, dtype=bool)
    graph = CommunicationGraph(adjacency, alive)
    yield CommunicationGraph, {"adjacency": adjacency, "alive": alive}
    yield (
        CommunicationGraph.from_positions,
        {"position": np.eye(3), "radius": 2.0, "alive": alive},
    )
    yield graph.subgraph, {"members": np.array([True, True, False])}
    yield graph.pairs_among, {"agents": np.array([0, 2])}
    yield graph.component_max, {"values": np.arange(3)}
    yield graph.component_any, {"is_true": np.array([True, False, False])}
    cost, m = np.random.default_rng(0).uniform(1, 2, (3, 4)), np.array([3, 3, 3])
    rules = {"target_count": m, "epsilon": 0.01, "bidder_ids": True}
    yield auctions.VsdaaAuction, {"cost": cost, "graph": graph, **rules}
    yield auctions.run_vsdaa, {"auction": auctions.VsdaaAuction(cost, None, 3, 0.01)}
    lossy = {"rounds": 20, "loss": 0.1, "delay": 1, "rng": np.random.default_rng(0)}
    yield auctions.CbaaAuction, {"score": cost, "graph": graph, **lossy}
    yield auctions.run_cbaa, {"auction": auctions.CbaaAuction(cost, graph)}
    bids = WinningBids.empty(4)
    yield WinningBids, {"price": bids.price, "winner": bids.winner}
    yield WinningBids.empty, {"targets": 4}
    vsdaa = {"agent_id": 0, "cost": cost[0], "epsilon": 0.01, "bidder_ids": True}
    bidder = VsdaaBidder(**vsdaa, patience=2, target_count=3, bids=bids)
    yield VsdaaBidder, {**vsdaa, "patience": 2, "target_count": 3, "bids": bids}
    yield bidder.update, {"inbox": [bids]}
    cbaa = {"agent_id": 0, "score": cost[0], "agent_count": 3, "bids": bids}
    yield CbaaBidder, cbaa
    yield CbaaBidder(**cbaa).update, {"inbox": [bids]}


def _systems() -> Iterator[Call]:
    from PIL import Image

    import sato
    from sato.interfaces import MissionProgress, System
    from sato.scenario.definition import Convert, In, fields_of
    from sato.scenario.file import Mission
    from sato.systems import load_system

    Image.new("L", (20, 10), 0).save("picture.png")
    picture = sato.Picture(file="picture.png", height=5.0)
    yield sato.Picture, {"file": "picture.png", "height": 5.0, "invert": False}
    yield picture.draw, {"count": 4, "axes": 2}
    yield In, {"table": "plan"}
    yield Convert, {"function": tuple}
    yield Mission, {"name": "mission"}
    yield MissionProgress, {"stage": "leg 1 of 2", "done": 1, "total": 2, "details": ""}
    yield fields_of, {"definition": sato.Loss}
    yield System, _given(load_system("formation"))
