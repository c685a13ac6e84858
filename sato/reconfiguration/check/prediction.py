"""Prediction of a run: by the model that its agents share, and by the random draws of its seed.

Agents may know better than the model that they share, where each linearizes about its own
trajectory; the error of the shared model bounds theirs.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from numpy.random import Generator

from sato.check.common import Alive, Change
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.disturbances import disturb_control, draw_losses, measure
from sato.reconfiguration.estimator import GATE_SIGMAS, measurement_covariance

SIGMA_BOUND = 8.0  # a normal draw exceeds it once in 10¹⁵


def predict_end_states(
    record: ReconfigurationRecord, leg: LegRecord, control: Float[Array, "instants agents d"]
) -> Float[Array, "survivors n"]:
    """Predict states at the end of a leg, by the shared model and controls of the run [m/s²].

    They are of the agents that are there at its end, each from its state at the start of the
    leg, or where it joined.
    """
    agents, first = np.flatnonzero(leg.alive), leg.entry_index[leg.alive]
    end: Array = record.state[first, agents]
    for k in np.unique(first[first < leg.end_index]):
        rows = np.flatnonzero(first == k)
        u = np.moveaxis(control[k : leg.end_index, agents[rows]], 0, 1)
        end[rows] = record.model[slice(k, leg.end_index)].simulate(end[rows], u)[:, -1]
    return end


def bound_speed_excess(record: ReconfigurationRecord) -> Float[Array, "instants agents"]:
    """Bound by how much each agent may be faster than planned, at every instant [m/s].

    The difference between its recorded velocity and the one that the shared model predicts
    from its recorded state at an earlier instant under the commanded controls, the largest
    since the last plan; and what noise of the measured state adds there, of which an estimate
    is off by no more, and a reference by the gate in addition. It contains all that
    the plant, the thrusters and the disturbance did otherwise. Where agents keep their plans
    before the deadline, the last plan may be `freeze_steps` older. Agents that follow references
    may be faster by what `TrackingDeviations` allow.
    """
    mission, model, d = record.mission, record.model, record.mission.axes
    if mission.tracking is not None:
        return np.full(record.frames.alive.shape, SIGMA_BOUND * d**0.5 * mission.tracking.velocity)
    velocity, control = record.frames.velocity, record.frames.control
    sigma = np.diag(measurement_covariance(mission)) ** 0.5
    age, T = _max_plan_age(record), len(model)
    found = np.zeros(record.frames.alive.shape)
    x, Phi = record.state, np.broadcast_to(np.eye(2 * d), (T, 2 * d, 2 * d))
    for lag in range(1, int(age.max(initial=0)) + 1):
        # x[k] is predicted from the state at k for the instant k + lag.
        x, Phi = x[: T - lag + 1], Phi[: T - lag + 1]
        A, B, z = (part[lag - 1 :] for part in (model.A, model.B, model.z))
        Bu = np.einsum("kab,kib->kia", B, control[lag - 1 : -1])
        x = np.einsum("kab,kib->kia", A, x) + Bu + z[:, None]
        Phi = A @ Phi
        error = np.linalg.norm(velocity[lag:] - x[..., d:], axis=2)
        noise = (SIGMA_BOUND + GATE_SIGMAS) * np.linalg.norm(Phi[:, d:] * sigma, axis=(1, 2))
        allowed = np.where(np.isfinite(error), error, 0.0) + noise[:, None]
        is_recent = (age[lag:] >= lag)[:, None]
        found[lag:] = np.maximum(found[lag:], np.where(is_recent, allowed, 0.0))
    return found


def _max_plan_age(record: ReconfigurationRecord) -> Int[Array, " instants"]:
    """Return the steps from the oldest plan that may be flown until an instant; 0 at the start."""
    p, frozen = record.mission.replan_steps, record.mission.freeze_steps
    kept = p * -(-max(frozen - 1, 0) // p)
    age = np.zeros(len(record.time), dtype=np.int64)
    for leg in record.leg_records:
        k = np.arange(1, leg.step_count + 1)
        age[leg.start_index + k] = np.minimum(k, (k - 1) % p + 1 + kept)
    return age


def redraw(
    record: ReconfigurationRecord, rng: Generator
) -> tuple[Alive, list[Change], Float[Array, "steps agents n"], Float[Array, "steps agents d"]]:
    """Draw again, in the order of the loop: losses, measurements, disturbances, thruster errors.

    Returned are who is there, losses and joins, states as measured, and controls as applied. An
    event of the mission that comes after the end of its leg is scheduled for instant −1, at which
    nothing can happen. The generator is as the drawing of the mission left it.
    """
    mission, alive = record.mission, record.mission.alive
    measured, applied = record.state[:-1].copy(), record.frames.control[:-1].copy()
    expected, events = np.tile(alive, (len(record.time), 1)), list[Change]()
    waiting = list[int]()
    for leg in record.leg_records:
        for k in range(leg.start_index, leg.end_index + 1):
            events += _redraw_changes(record, leg, k, alive, waiting, rng)
            expected[k] = alive
            if k < leg.end_index:
                measured[k] = measure(mission, measured[k], rng)
                applied[k] = disturb_control(mission, applied[k], rng)
        expected[leg.end_index :] = alive
        if leg.leg_index == len(mission.legs) - 1 and leg.end_event is not None:
            events += [(leg.end_index, "refused", i) for i in waiting]
        if leg.end_event is not None:
            due = [at_step for _, at_step in mission.joining(leg.leg_index)]
            due += [loss.at_step for loss in mission.legs[leg.leg_index].losses]
            events += [(-1, "", -1) for at_step in due if at_step > leg.step_count]
    return expected, events, measured, applied


def _has_room(
    record: ReconfigurationRecord, k: int, agent: int, alive: Bool[Array, " agents"]
) -> bool:
    # Vehicles wait only for others that they hear; in orbit also for those that drift near later.
    mission = record.mission
    if mission.has_surroundings:  # for which it may have to wait
        return False
    position = mission.initial_states[agent, : mission.axes]
    away = np.linalg.norm(record.frames.position[k, alive] - position, axis=1)
    return mission.is_point_mass and bool((away > mission.comm_radius).all())


def _redraw_changes(
    record: ReconfigurationRecord,
    leg: LegRecord,
    k: int,
    alive: Bool[Array, " agents"],
    waiting: list[int],
    rng: Generator,
) -> list[Change]:
    # Joins and losses at an instant of a leg, which change `alive` and `waiting` in place.
    mission, at_step = record.mission, k - leg.start_index
    waiting += [i for agents, at in mission.joining(leg.leg_index) if at == at_step for i in agents]
    known = [i for at, event in record.events.of_kind("join") if at == k for i in event["agents"]]
    joined = list[int]()
    for i in waiting:  # one after another, as later ones wait for those
        if i in known or _has_room(record, k, i, alive):
            joined.append(i)
            alive[i] = True
    changes: list[Change] = [(k, "join", i) for i in joined]
    changes += [(k, "refused", i) for i in waiting if not (i in joined or mission.waits[i])]
    waiting[:] = [i for i in waiting if mission.waits[i] and i not in joined]
    for loss in mission.legs[leg.leg_index].losses:
        if loss.at_step == at_step:
            lost = draw_losses(loss, record.frames.position[k], alive, rng)
            alive[lost] = False
            changes += [(k, "loss", i) for i in lost]
    # A process that ends, or is started again, is believed.
    for at, event in record.events.of_kind("loss", "join"):
        if at == k and event.get("cause") == "process":
            alive[event["agents"]] = event["kind"] == "join"
            changes += [(k, event["kind"], i) for i in event["agents"]]
    return changes
