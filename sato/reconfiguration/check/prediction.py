"""Prediction of a run's controls by the shared model, and the distance of the plant from it.

Agents may know better than the model that they share, where each linearizes about its own
trajectory; the error of the shared model bounds theirs.
"""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord

SIGMA_BOUND = 8.0  # a normal draw exceeds it once in 10¹⁵


def find_entry_indices(
    record: ReconfigurationRecord, leg: LegRecord, agents: Int[Array, " k"]
) -> Int[Array, " k"]:
    """Find the instant from which on each agent takes part in a leg."""
    alive = record.alive[leg.start_index :, agents]
    return np.asarray(leg.start_index + np.argmax(alive, axis=0))


def predict_end_states(
    record: ReconfigurationRecord,
    leg: LegRecord,
    agents: Int[Array, " k"],
    control: Float[Array, "instants agents d"],
) -> Float[Array, "k n"]:
    """Predict the states of agents at the end of a leg, by the shared model.

    Args:
        record: Run.
        leg: Leg.
        agents: Indices; each starts with its state at the start of the leg, or where it joined.
        control: Controls of all agents in the whole run [m/s²].
    """
    first = find_entry_indices(record, leg, agents)
    end: Array = record.state[first, agents]
    for k in np.unique(first[first < leg.end_index]):
        chosen = np.flatnonzero(first == k)
        u = np.moveaxis(control[k : leg.end_index, agents[chosen]], 0, 1)
        model = record.model[slice(k, leg.end_index)]
        end[chosen] = model.simulate(end[chosen], u)[:, -1]
    return end


def bound_speed_excess(record: ReconfigurationRecord) -> Float[Array, "instants agents"]:
    """Bound by how much each agent may be faster than planned, at every instant [m/s].

    The difference between its recorded velocity and the one that the shared model predicts
    from its recorded state at an earlier instant under the commanded controls, the largest
    since the last plan; and what noise of the measured state adds there. It contains all that
    the plant, the thrusters and the disturbance did otherwise. Where agents keep their plans
    before the deadline, the last plan may be `freeze_steps` older.
    """
    mission, model, d = record.mission, record.model, record.axes
    sigma = np.repeat([mission.position_noise, mission.velocity_noise], d)
    age, T = _max_plan_age(record), len(model)
    found = np.zeros(record.alive.shape)
    x, Phi = record.state, np.broadcast_to(np.eye(2 * d), (T, 2 * d, 2 * d))
    for lag in range(1, int(age.max(initial=0)) + 1):
        # x[k] is predicted from the state at k for the instant k + lag.
        x, Phi = x[: T - lag + 1], Phi[: T - lag + 1]
        A, B, z = (part[lag - 1 :] for part in (model.A, model.B, model.z))
        Bu = np.einsum("kab,kib->kia", B, record.control[lag - 1 : -1])
        x = np.einsum("kab,kib->kia", A, x) + Bu + z[:, None]
        Phi = A @ Phi
        error = np.linalg.norm(record.velocity[lag:] - x[..., d:], axis=2)
        noise = SIGMA_BOUND * np.linalg.norm(Phi[:, d:] * sigma, axis=(1, 2))
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
