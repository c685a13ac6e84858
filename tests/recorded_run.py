"""Runs of frames that a test made by hand, and flights of reconfigurations without planning."""

from dataclasses import replace

import numpy as np

from dynamics import DoubleIntegrator, discretize_zoh
from problems.assignment import solve_assignment
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.check.promises import check_run
from sato.reconfiguration.leg import Join, Leg, Loss
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import ReconfigurationFrame
from sato.reconfiguration.system import SYSTEM
from sato.record import collect_run_data, initial_summary
from sato.run_data import RunData
from sato.runs import Run
from sato.scenario.origin import Origin
from sato.shapes import Points


def record_run(system, frames, mission, definition=None, **attributes):
    """Record frames as `sato.run` does.

    Args:
        system: System of the frames.
        frames: Frames in the order of time.
        mission: Drawn mission that they are of.
        definition: Mission before it was drawn, where the test loads or checks the run.
        attributes: Attributes of the run other than those below.
    """
    about = {"name": mission.name, "seed": 3, "version": "0", "wall_s": 1.0, "peak_memory_mib": 1.0}
    about |= {"origin": Origin("python").to_json()}
    text = "" if definition is None else definition.to_toml()
    data = collect_run_data(system, list(frames), mission, scenario=text, **(about | attributes))
    return Run(data, initial_summary(data.attrs), definition)


def recorded(mission, frames=None, **options):
    """Record a flight of a reconfiguration; a straight one unless frames are given."""
    return record_run(SYSTEM, frames or fly_straight(mission, **options), mission, mission)


def check(run, mission=None, seed=0):
    """Check a run, as one of another mission if one is given."""
    return check_run(run.recorded, mission or run.mission, np.random.default_rng(seed))


def broken(run, mission=None):
    """Return the names of the promises that a run breaks."""
    return {promise.name for promise in check(run, mission).broken}


def altered(run, names, where, value=None, by=0.0):
    """Return the run with variables altered in one place: set to a value, or shifted."""
    variables = dict(run.recorded.variables)
    for name in names.split():
        values = run.recorded[name].copy()
        values[where] = values[where] + by if value is None else value
        variables[name] = variables[name]._replace(values=values)
    data = replace(run.recorded, variables=variables)
    return replace(run, recorded=data, claimed=dict(run.summary))


def with_data(run, data):
    """Return the run with the data of a dataset."""
    return replace(run, recorded=RunData.from_xarray(data))


def in_order(states):
    """Targets that keep their order."""
    return Points(*np.hsplit(states, 2), keep_order=True)


def square(corner, spacing):
    """Nine targets at rest on a lattice, in order."""
    grid = np.stack(np.meshgrid(np.arange(3), np.arange(3), indexing="ij"), -1)
    return in_order(np.hstack([grid.reshape(-1, 2) * spacing + np.array(corner), np.zeros((9, 2))]))


def make_mission(agents=6, **changed):
    """Draw a row that becomes a square, loses one agent, gains one, and moves on."""
    x = np.arange(6) * 1.2
    lose, join = Loss("agents", agents=(2,)), Join(None, [[6.5, 5.0]], at_step=3)
    plain = Reconfiguration(
        model=DoubleIntegrator(2),
        start=np.stack([x, 0.1 * x], axis=1),
        legs=(
            Leg(square((1.0, 3.0), 1.0), steps=12, count=9),
            Leg(square((4.0, 6.0), 1.1), steps=10, count=9, losses=(lose,), joins=(join,)),
        ),
        step=1.5,
        comm_radius=3.5,
        collision_radius=0.2,
        max_control=0.3,
        max_speed=1.0,
        horizon_steps=1,
        replan_steps=1,
        auction_steps=1,
        position_tolerance=1e-6,
        velocity_tolerance=1e-6,
    )
    drawn = plain.draw(np.random.default_rng(0))
    return replace(drawn, agents=agents, target_count=agents, **changed)


def make_crossing(gap):
    """Draw two agents that pass each other at this distance."""
    start = np.array([[-4.0, 0, 0, 0], [4.0, gap, 0, 0]])
    goals = np.array([[4.0, 0, 0, 0], [-4.0, gap, 0, 0]])
    legs = (Leg(in_order(goals), 15),)
    return make_mission(2, start=start, legs=legs, comm_radius=9.0, max_speed=2.0)


def fly_straight(mission, own_targets=False, controls=None):
    """Fly each leg by least-norm controls, or by those that are given.

    Agents take the targets of least squared distance, or each that of its own number.
    """
    d, step = mission.axes, mission.step
    x, alive = mission.initial_states.copy(), mission.alive.copy()
    count = mission.target_count or len(x)
    target, believed = np.full(len(x), -1), np.full(len(x), count)
    frames, events = [], []

    def labels():
        return CommunicationGraph.from_positions(x[:, :d], mission.comm_radius, alive).component

    def add_frame(u):
        frames.append(
            ReconfigurationFrame(
                time=len(frames) * step,
                position=x[:, :d].copy(),
                velocity=x[:, d:].copy(),
                alive=alive.copy(),
                component=labels(),
                control=u,
                applied_control=u,
                leg_index=number,
                target_index=target.copy(),
                target_count=believed,
                measured_position=None,
                measured_velocity=None,
                rounds=None,
                received=None,
                events=tuple(events),
            )
        )

    for number, leg in enumerate(mission.legs):
        model = discretize_zoh(mission.linear_model, step, leg.steps)
        for loss in leg.losses:
            alive[list(loss.agents)] = False
            target[list(loss.agents)] = -1
            events.append({"kind": "loss", "agents": list(loss.agents)})
        events.append({"kind": "leg_start", "leg": number, "agents": np.flatnonzero(alive)})
        u = np.full((len(x), leg.steps, d), np.nan)
        entering = {0: np.flatnonzero(alive)}
        entering |= {k: np.array(agents) for agents, k in mission.joining(number)}
        for k in range(leg.steps):
            if k in entering:
                who = entering[k]
                if k:
                    alive[who] = True
                    events.append({"kind": "join", "agents": who})
                free = np.setdiff1d(np.arange(count), target[alive] if k else [])
                apart = np.linalg.norm(x[who, None, :d] - leg.targets[free, :d], axis=2) ** 2
                target[who] = who if own_targets else free[solve_assignment(apart)]
                events.append({"kind": "assignment", "agents": who, "target": target[who]})
                goal = leg.targets[target[who]]
                left = model[slice(k, None)]
                u[who, k:] = least_norm(left, x[who], goal) if controls is None else controls
            events.append({"kind": "replan", "agents": np.flatnonzero(alive), "solves": 2})
            add_frame(u[:, k].copy())
            time = (len(frames) - 1) * step
            flown = mission.flown_plant.propagate(x, np.nan_to_num(u[:, k]), time, step)[1]
            x, events = np.where(alive[:, None], flown, x), []
        end = {"kind": "leg_end", "leg": number, "agents": np.flatnonzero(alive)}
        events = [end | {"target": target.copy(), "believed": believed, "component": labels()}]
    add_frame(np.full((len(x), d), np.nan))
    return frames


def least_norm(model, start, goal):
    """Return the controls of least sum of squares from start to goal."""
    T, d = len(model), model.axes
    unit = np.eye(T * d).reshape(-1, T, d)
    response = np.stack([model.simulate(0 * start[0], u)[-1] for u in unit], axis=1)
    free = model.simulate(start, np.zeros((len(start), T, d)))[:, -1]
    return ((goal - free) @ np.linalg.pinv(response).T).reshape(len(start), T, d)
