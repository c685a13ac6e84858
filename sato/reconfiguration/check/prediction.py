"""What the shared model makes of a run's controls, and how far the plant is from it.

Agents may know better than the model that they share, where each linearises about its own
path; what the shared one gets wrong bounds what they get wrong.
"""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord

SIGMA_BOUND = 8.0  # a normal draw is further out once in 10¹⁵


def find_entry_indices(
    evidence: ReconfigurationRecord, stretch: LegRecord, agents: Int[Array, " those"]
) -> Int[Array, " those"]:
    """The instant from which on each of the agents takes part in a leg."""
    return np.asarray(
        stretch.start_index + np.argmax(evidence.alive[stretch.start_index :, agents], axis=0)
    )


def predict_end_states(
    evidence: ReconfigurationRecord,
    stretch: LegRecord,
    agents: Int[Array, " those"],
    control: Float[Array, "instants agents d"],
) -> Float[Array, "those n"]:
    """Where controls take agents by the shared model, from where they were to the leg's end.

    Args:
        evidence: The run.
        stretch: The leg.
        agents: Who is asked for; each begins where it was at the leg's start, or came in.
        control: Of everybody in the whole run [m/s²].
    """
    first = find_entry_indices(evidence, stretch, agents)
    end: Array = evidence.state[first, agents]
    for k in np.unique(first[first < stretch.end_index]):
        who = np.flatnonzero(first == k)
        u = np.moveaxis(control[k : stretch.end_index, agents[who]], 0, 1)
        end[who] = evidence.model[slice(k, stretch.end_index)].simulate(end[who], u)[:, -1]
    return end


def bound_speed_excess(evidence: ReconfigurationRecord) -> Float[Array, "instants agents"]:
    """By how much an agent may be faster than its plan had it, at every instant [m/s].

    The difference between its recorded velocity and the one that the shared model predicts
    from its recorded state at an earlier instant under the commanded controls: the most since
    the last plan at the latest, and there what noise in the measured state adds. It holds all
    that the plant, the thrusters and the disturbance did otherwise. Where agents keep to their
    plans at the end, the last plan may be `commit_steps` older.
    """
    mission, steps, d = evidence.mission, evidence.model, evidence.axes
    sigma = np.repeat([mission.position_noise, mission.velocity_noise], d)
    age, T = _max_plan_age(evidence), len(steps)
    found = np.zeros(evidence.alive.shape)
    x, Phi = evidence.state, np.broadcast_to(np.eye(2 * d), (T, 2 * d, 2 * d))
    for lag in range(1, int(age.max(initial=0)) + 1):
        # x[k] is predicted from the state at k for the instant k + lag.
        x, Phi = x[: T - lag + 1], Phi[: T - lag + 1]
        A, B, z = (part[lag - 1 :] for part in (steps.A, steps.B, steps.z))
        pushed = np.einsum("kab,kib->kia", B, evidence.control[lag - 1 : -1])
        x = np.einsum("kab,kib->kia", A, x) + pushed + z[:, None]
        Phi = A @ Phi
        off = np.linalg.norm(evidence.velocity[lag:] - x[..., d:], axis=2)
        noise = SIGMA_BOUND * np.linalg.norm(Phi[:, d:] * sigma, axis=(1, 2))
        allowed = np.where(np.isfinite(off), off, 0.0) + noise[:, None]
        counts = (age[lag:] >= lag)[:, None]
        found[lag:] = np.maximum(found[lag:], np.where(counts, allowed, 0.0))
    return found


def _max_plan_age(evidence: ReconfigurationRecord) -> Int[Array, " instants"]:
    """Steps from the oldest plan that may be flown until an instant; 0 at the start."""
    p, commit = evidence.mission.replan_steps, evidence.mission.freeze_steps
    kept = p * -(-max(commit - 1, 0) // p)
    age = np.zeros(len(evidence.time), dtype=np.int64)
    for stretch in evidence.leg_records:
        k = np.arange(1, stretch.step_count + 1)
        age[stretch.start_index + k] = np.minimum(k, (k - 1) % p + 1 + kept)
    return age
