"""Who takes which point: each vehicle lays the shape over what it sees, and bids.

[Lusk2020, Sec. IV]: in its own frame every vehicle aligns the shape with itself and its
neighbours, and prices every point by how far it would have to go. No two frames need agree.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.alignment import align
from problems.assignment import solve_assignment as optimum
from sato.auctions import run_cbaa, run_vsdaa
from sato.formation.kernel import CoordinateFrames, FormationState, Roles
from sato.formation.mission import Formation
from sato.network.graph import CommunicationGraph

SWITCHING_INCREMENTS = (
    1.2  # increments: by so much a vehicle would rather keep the point that it has
)
SCORE_REGULARIZATION = 1e-8  # added to squared distances, so that no score is infinite [m²]


class NeighborPositions(NamedTuple):
    """What each vehicle has of the others: row i is all that vehicle i knows, in its frame."""

    positions: Float[Array, "agents points 3"]  # of who holds each point; NaN unheard [m]
    is_known: Bool[Array, "agents points"]  # its own point and those of its neighbours


class AssignmentResult(NamedTuple):
    """How an auction ended."""

    assignment: Int[Array, " agents"]  # taken by each vehicle; with losses two may want the same
    holder: Int[Array, "agents points"]  # of each point, as each vehicle has it
    rounds: int  # of messages


def observe_neighbors(
    state: FormationState,
    roles: Roles,
    coordinate_frames: CoordinateFrames,
    graph: Bool[Array, "points points"],
) -> NeighborPositions:
    """What each vehicle sees of those who hold its neighbouring points.

    Args:
        state: Where everything is, and what was heard.
        roles: Who holds which point, as each vehicle has it.
        frames: Of the vehicles; each knows those of its neighbours in its own.
        graph: Of the formation.
    """
    agents = np.arange(len(state.position))
    heard = state.received[agents[:, None], roles.holder]
    own = coordinate_frames.rotation[:, None].conj()
    shift = coordinate_frames.origin[roles.holder] - coordinate_frames.origin[:, None]
    positions = _rotate(heard, own * coordinate_frames.rotation[roles.holder]) + _rotate(shift, own)
    positions[agents, roles.assignment] = state.measured_position
    known = graph[roles.assignment] & ~np.isnan(positions[..., 0])
    known[agents, roles.assignment] = True
    return NeighborPositions(positions, known)


def compute_cost_matrix(
    seen: NeighborPositions, point: Int[Array, " agents"], shape: Float[Array, "points 3"]
) -> Float[Array, "agents points"]:
    """Squared way of each vehicle to each point, as it lays the shape [m²] [Lusk2020, eq. 14].

    Args:
        seen: What each vehicle sees.
        point: That each holds.
        shape: The points [m].
    """
    own = seen.positions[np.arange(len(point)), point]
    away = align(shape[None], seen.positions, seen.is_known).transform(shape[None]) - own[:, None]
    return np.asarray(np.einsum("ijk,ijk->ij", away, away))


def assign_points(
    mission: Formation,
    leg: int,
    auction_index: int,
    state: FormationState,
    roles: Roles,
    rng: np.random.Generator,
) -> AssignmentResult:
    """Hold an auction among those who hear each other now.

    Args:
        mission: The flight.
        leg: Number of the shape.
        number: Of the auctions for that shape held before.
        state: Where everything is, and what was heard.
        roles: Who holds which point until now.
        rng: Draws which bids are lost.
    """
    formation, agents = mission.gains[leg].formation, mission.agents
    way = mission.assignment
    if way.method == "hungarian":
        pose = align(formation.points[roles.assignment], state.position)
        far = state.position[:, None] - pose.transform(formation.points)
        return _unanimous_result(optimum(np.linalg.norm(far, axis=2)), 0)
    cost = compute_cost_matrix(
        observe_neighbors(state, roles, mission.coordinate_frames, formation.graph),
        roles.assignment,
        formation.points,
    )
    graph = formation.graph[np.ix_(roles.assignment, roles.assignment)]
    network = CommunicationGraph(graph, np.ones(agents, dtype=bool))
    if network.component.any():
        return AssignmentResult(
            roles.assignment, roles.holder, 0
        )  # after losses: nobody would learn the end
    if way.method == "vsdaa":
        extent = float(np.linalg.norm(np.ptp(formation.points, axis=0)))
        epsilon = way.relative_epsilon * extent
        far = np.sqrt(cost)
        if auction_index > 0:
            far[np.arange(agents), roles.assignment] -= SWITCHING_INCREMENTS * epsilon
        # How wide the graph is and how many bid, the auction need not learn: the shape says so.
        won = run_vsdaa(far, network, np.full(agents, agents), epsilon)
        return _unanimous_result(
            won.target_index, won.round_count * (1 + mission.radio.delay_rounds)
        )
    radio = mission.radio
    rounds = radio.rounds_within(way.period) if radio.loss_probability > 0 else None
    found = run_cbaa(
        1 / (cost + SCORE_REGULARIZATION),
        network,
        rounds=rounds,
        loss=radio.loss_probability,
        delay=radio.delay_rounds,
        rng=rng,
    )
    # Who does not know the end by now keeps what it had; the next auction will mend it.
    knows = found.finished_round > 0
    return AssignmentResult(
        np.where(knows, found.point, roles.assignment),
        np.where(knows[:, None], found.winner, roles.holder),
        found.round_count if rounds is None else rounds,  # nobody can know that all know
    )


def _unanimous_result(point: Int[Array, " agents"], rounds: int) -> AssignmentResult:
    holder = np.broadcast_to(np.argsort(point), (len(point), len(point))).copy()
    return AssignmentResult(np.asarray(point), holder, rounds)


def _rotate(points: Array, heading: Array) -> Array:
    flat = (points[..., 0] + 1j * points[..., 1]) * heading
    return np.stack([flat.real, flat.imag, points[..., 2]], axis=-1)
