"""Assignment of formation points to agents: each aligns the formation with what it sees, and bids.

[Lusk2020, Sec. IV]: in its own frame every agent aligns the formation with itself and its
neighbors, and bids for each point by the distance to it. No two frames need agree.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.alignment import align
from problems.assignment import solve_assignment
from sato.auctions import CbaaAuction, VsdaaAuction, run_cbaa, run_vsdaa
from sato.formation.control_step import FormationState, Roles
from sato.formation.mission import Formation
from sato.formation.settings import CoordinateFrames
from sato.network.graph import CommunicationGraph
from sato.network.outages import PairOutages

SWITCHING_INCREMENTS = 1.2  # bid increments by which an agent prefers the point that it holds
SCORE_REGULARIZATION = 1e-8  # added to squared distances, so that no score is infinite [m²]


class NeighborPositions(NamedTuple):
    """Positions that each agent knows of the others: row i is of agent i, in its own frame."""

    positions: Float[Array, "agents points 3"]  # of the holder of each point; NaN unheard [m]
    is_known: Bool[Array, "agents points"]  # own point and those of neighbors


class AssignmentResult(NamedTuple):
    """Outcome of an auction."""

    assignment: Int[Array, " agents"]  # point of each agent; with losses two may hold one
    holder: Int[Array, "agents points"]  # of each point, as each agent knows it
    rounds: int  # rounds of messages


def observe_neighbors(
    state: FormationState, roles: Roles, frames: CoordinateFrames, graph: Bool[Array, "n n"]
) -> NeighborPositions:
    """Collect the positions that each agent knows of the holders of neighboring points."""
    agents = np.arange(len(state.position))
    heard = state.heard(agents[:, None], roles.holder)
    own = frames.rotation[:, None].conj()
    shift = frames.origin[roles.holder] - frames.origin[:, None]
    positions = _rotate(heard, own * frames.rotation[roles.holder]) + _rotate(shift, own)
    positions[agents, roles.assignment] = state.measured_position
    known = graph[roles.assignment] & ~np.isnan(positions[..., 0])
    known[agents, roles.assignment] = True
    return NeighborPositions(positions, known)


def compute_cost_matrix(
    seen: NeighborPositions, assignment: Int[Array, " agents"], points: Float[Array, "points 3"]
) -> Float[Array, "agents points"]:
    """Compute the squared distance of each agent to each point [m²] [Lusk2020, eq. 14]."""
    own = seen.positions[np.arange(len(assignment)), assignment]
    pose = align(points[None], seen.positions, seen.is_known)
    offset = pose.transform(points[None]) - own[:, None]
    return np.asarray(np.einsum("ijk,ijk->ij", offset, offset))


def assign_points(
    mission: Formation,
    leg: int,
    auction_index: int,
    state: FormationState,
    roles: Roles,
    rng: np.random.Generator,
    outages: PairOutages | None = None,
) -> AssignmentResult:
    """Hold an auction among the agents that hear each other now.

    Args:
        mission: A drawn mission.
        leg: Index of the leg.
        auction_index: Number of auctions held before on this leg.
        state: State of all agents, with the messages received.
        roles: Assignment until now.
        rng: Generator for lost bids.
        outages: Those of the links in the rounds to come.
    """
    formation, agents = mission.gains[leg].formation, np.arange(mission.agents)
    settings, link, points = mission.assignment, mission.timed_link, formation.points
    if settings.method == "hungarian":
        pose = align(points[roles.assignment], state.position)
        distance = np.linalg.norm(state.position[:, None] - pose.transform(points), axis=2)
        return _unanimous_result(solve_assignment(distance), 0)
    seen = observe_neighbors(state, roles, mission.coordinate_frames, formation.graph)
    cost = compute_cost_matrix(seen, roles.assignment, points)
    graph = formation.graph[np.ix_(roles.assignment, roles.assignment)]
    network = CommunicationGraph(graph, np.full(len(agents), True))
    if network.component.any():
        # After losses the network may be disconnected, and no agent would learn the outcome.
        return AssignmentResult(roles.assignment, roles.holder, 0)
    if settings.method == "vsdaa":
        epsilon = settings.relative_epsilon * float(np.linalg.norm(np.ptp(points, axis=0)))
        distance = np.sqrt(cost)
        if auction_index > 0:
            distance[agents, roles.assignment] -= SWITCHING_INCREMENTS * epsilon
        # The formation tells the diameter of the graph and the number of bidders.
        bidders = np.full(len(agents), len(agents))
        won = run_vsdaa(VsdaaAuction(distance, network, bidders, epsilon))
        return _unanimous_result(won.target_index, won.round_count * (1 + link.late))
    rounds = mission.radio.rounds_within(settings.period) if link.loses_messages else None
    is_down = None if outages is None or rounds is None else outages.look_ahead(rounds)
    score = 1 / (cost + SCORE_REGULARIZATION)
    found = run_cbaa(
        CbaaAuction(score, network, rounds, link.loss_probability, link.late, rng, is_down)
    )
    # An agent that has not learned the outcome by now keeps its point until the next auction.
    knows = found.finished_round > 0
    return AssignmentResult(
        np.where(knows, found.point, roles.assignment),
        np.where(knows[:, None], found.winner, roles.holder),
        found.round_count if rounds is None else rounds,  # no agent knows that all know
    )


def _unanimous_result(assignment: Int[Array, " agents"], rounds: int) -> AssignmentResult:
    holder = np.tile(np.argsort(assignment), (len(assignment), 1))
    return AssignmentResult(np.asarray(assignment), holder, rounds)


def _rotate(points: Array, rotation: Array) -> Array:
    flat = (points[..., 0] + 1j * points[..., 1]) * rotation
    return np.stack([flat.real, flat.imag, points[..., 2]], axis=-1)
