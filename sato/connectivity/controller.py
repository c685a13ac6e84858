"""Controller of all agents: edges with their gradients, λ₂, and commands.

Row i of every array is of agent i, in its own body frame, and row i of a result follows from
row i of measurements, messages and estimates alone. The estimators `exact` and `power_pi` are
exceptions, for comparison.
"""

from functools import partial

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.doors import checked
from dynamics.vehicle import rotate_by_yaw, vector_lengths
from problems.interaction_graph import Numbers, algebraic_connectivity, edge_weights, spectral_slope
from sato.connectivity.mission import Connectivity
from sato.connectivity.power_iteration import iterate_power, lambda2_from_power
from sato.connectivity.settings import MAX_ROW_AGE, Potential, Repulsion
from sato.connectivity.state import AdjacencyRows, AgentEstimates, Knowledge
from sato.connectivity.yaw_estimator import estimate_relative_yaw

ASYMPTOTE_OFFSET = 1e-3  # least distance to an asymptote at which to evaluate


def estimate_edges(known: Knowledge, mission: Connectivity, time: float) -> AgentEstimates:
    """Estimate relative yaws, weights of own edges and their gradients.

    Measurements and messages are those of now, estimates those of a step ago.
    """
    measurements, inbox, estimates = known
    psi, observer = estimate_relative_yaw(known, mission, time)
    is_mutual = measurements.visibility & inbox.is_seen
    i, j = np.nonzero(measurements.visibility | inbox.is_seen)
    sees, is_seen = measurements.visibility[i, j], inbox.is_seen[i, j]
    p, p_back = measurements.relative_position[i, j], inbox.relative_position[i, j]
    # An agent that does not see rotates the other's measurement [Bernard2023, Sec. III-C,
    # where the rotation is printed in the wrong sense].
    turn = psi[i, j]
    p = np.where(sees[:, None], p, -rotate_by_yaw(p_back, turn))
    p_back = np.where(is_seen[:, None], p_back, -rotate_by_yaw(p, -turn))
    both = np.stack([p, p_back])
    d = vector_lengths(both)
    own, other = both / d[..., None]
    edges = edge_weights(d[0], own, other, turn, mission.assumed_camera, sees, is_seen)
    weight, gradient = np.zeros_like(psi), np.zeros((*psi.shape, 4))
    weight[i, j], gradient[i, j] = edges.weights, edges.gradients
    adjacency = estimates.adjacency
    if mission.estimator == "flood":
        row, adjacency = np.arange(len(psi)), AdjacencyRows(*(part.copy() for part in adjacency))
        adjacency.weight[row, row], adjacency.time[row, row] = weight, time
    return estimates._replace(
        velocity_observer=observer,
        relative_yaw=psi,
        is_mutual=is_mutual,
        weight=weight,
        weight_gradient=gradient,
        adjacency=adjacency,
    )


def estimate_lambda2(
    known: Knowledge, alive: Bool[Array, " n"], mission: Connectivity, time: float
) -> AgentEstimates:
    """Estimate λ₂, and the slope of the potential in the weights of own edges.

    What agents know has the edges of now; those that are alive take part.
    """
    estimates = known.estimates
    if mission.estimator == "power_pi":
        return _estimate_by_power_iteration(known, alive, mission)
    if mission.estimator == "flood":
        oldest = time - MAX_ROW_AGE
        lambda2, action = act_on_rows(estimates.adjacency, oldest, mission.potential)
    else:
        # From outside: λ₂ of the weights that the agents estimate.
        mean = _mean_of_both_ends(estimates.weight)
        lambda2, action = _act_on_graph(mean, alive, mission.potential)
    is_known = alive & np.isfinite(lambda2)
    return estimates._replace(
        lambda2=np.where(is_known, lambda2, np.nan), action=np.where(is_known[:, None], action, 0.0)
    )


def act_on_rows(
    adjacency: AdjacencyRows, oldest: float, potential: Potential
) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Estimate λ₂ of the graph known to each agent, and −∂V/∂A_ij of the edges of the agent.

    Rows that are older than the oldest time are forgotten.

    Every agent computes the row of its own edges, with the time, and relays all rows that it
    knows. A row from the other end of the graph is as many steps old as it is hops away.
    """
    graph, own = _mean_of_both_ends(adjacency.weight), np.arange(len(adjacency.time))
    lambda2, action = _act_on_graph(graph, adjacency.time >= oldest, potential)
    return lambda2, action[own, own]


def _act_on_graph(
    weight: Float[Array, "*k n n"], members: Bool[Array, "*k n"], potential: Potential
) -> tuple[Float[Array, "*k"], Float[Array, "*k n n"]]:
    if potential.of == "spectrum":
        return spectral_slope(weight, partial(negative_slope, potential=potential), members)
    found = algebraic_connectivity(weight, members)
    slope = np.asarray(negative_slope(found.lambda2, potential))
    return found.lambda2, slope[..., None, None] * found.weight_gradient


def _mean_of_both_ends(weight: Float[Array, "*k n n"]) -> Float[Array, "*k n n"]:
    # Both ends of an edge compute its weight; noise and age make the two differ.
    return np.asarray((weight + weight.swapaxes(-1, -2)) / 2)


def _estimate_by_power_iteration(
    known: Knowledge, alive: Bool[Array, " n"], mission: Connectivity
) -> AgentEstimates:
    # Exchanged between control steps, without loss or delay. |v̂|² tends to N (1 − (e₂/e₃) λ₂),
    # and z₂ is its mean. The estimate of an isolated agent is out of range; the last one is kept.
    estimates, sees, gains = known.estimates, known.measurements.visibility, mission.gains
    exchanges = round(mission.step / gains.exchange_period)
    iterates = iterate_power(estimates.iterates, estimates.weight, sees | sees.T, gains, exchanges)
    lambda2, size = lambda2_from_power(iterates, gains), iterates.average[:, 1]
    is_good = (lambda2 >= 0) & (lambda2 <= 1.1 * mission.potential.lambda2_max) & (size >= 0.05)
    difference = iterates.v[:, None] - iterates.v
    gradient = difference**2 / (len(size) * np.where(is_good, size, 1.0))[:, None]
    action = negative_slope(lambda2, mission.potential)[:, None] * gradient
    action = np.where(is_good[:, None], action, estimates.action)
    return estimates._replace(
        iterates=iterates,
        lambda2=np.where(alive, np.where(is_good, lambda2, estimates.lambda2), np.nan),
        action=np.where(alive[:, None], action, 0.0),
    )


def compute_commands(known: Knowledge, mission: Connectivity) -> Float[Array, "n 4"]:
    """Compute velocities and yaw rates, without the stick [Bernard2023, eq. 5].

    An agent without an edge, or without an estimate of λ₂, only keeps its distance.
    """
    estimates, points, limits = known.estimates, known.measurements.range_points, mission.limits
    command = np.einsum("ij,ijk->ik", estimates.action, estimates.weight_gradient)
    gain = repulsion_gain(vector_lengths(points), mission.repulsion)
    apart = np.where(np.isnan(points), 0.0, points)
    velocity = command[:, :3] - np.einsum("ij,ijk->ik", gain, apart)
    speed = vector_lengths(velocity)
    velocity *= (limits.speed / np.maximum(speed, limits.speed))[:, None]
    yaw_rate = np.clip(command[:, 3:], -limits.yaw_rate, limits.yaw_rate)
    return np.concatenate([velocity, yaw_rate], axis=1)


@checked
def evaluate_potential(lambda2: Numbers, potential: Potential) -> Numbers:
    """Compute V = k (m − x)² / x with x = λ₂ − λ₂^min and m = λ₂^max − λ₂^min; 0 beyond."""
    m = potential.lambda2_max - potential.lambda2_min
    x = np.maximum(lambda2 - potential.lambda2_min, ASYMPTOTE_OFFSET)
    return np.where(x < m, potential.strength * (m - x) ** 2 / x, 0.0)[()]


@checked
def negative_slope(lambda2: Numbers, potential: Potential) -> Numbers:
    """Compute −V′(λ₂) = k (m²/x² − 1), which is 0 at λ₂^max, as V is, and for NaN."""
    m = potential.lambda2_max - potential.lambda2_min
    x = np.maximum(lambda2 - potential.lambda2_min, ASYMPTOTE_OFFSET)
    return np.where(x < m, potential.strength * (m * m / (x * x) - 1), 0.0)[()]


def repulsion_gain(distance: Numbers, repulsion: Repulsion) -> Numbers:
    """Compute k_obs, the speed away from a point over its distance [1/s]."""
    m = repulsion.max_distance - repulsion.min_distance
    x = np.maximum(distance - repulsion.min_distance, ASYMPTOTE_OFFSET)
    return np.where(x < m, repulsion.strength * (m - x) ** 2 / (m * x), 0.0)[()]
