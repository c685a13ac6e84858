"""Who takes which point: each vehicle lays the shape over what it sees, and bids.

[Lusk2020, Sec. IV]: in its own frame every vehicle aligns the shape with itself and its
neighbours, and prices every point by how far it would have to go. No two frames need agree.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.alignment import align
from problems.assignment import assign as optimum
from sato.cbaa import assign as cbaa
from sato.formation.mission import FormationFlight
from sato.formation.swarm import Frames, Roles, State
from sato.network import Network
from sato.vsdaa import vsdaa

LOYALTY = 1.2  # increments: by so much a vehicle would rather keep the point that it has
NEAREST = 1e-8  # added to squared distances, so that no score is infinite [m²]


class Seen(NamedTuple):
    """What each vehicle has of the others: row i is all that vehicle i knows, in its frame."""

    positions: Float[Array, "agents points 3"]  # of who holds each point; NaN unheard [m]
    known: Bool[Array, "agents points"]  # its own point and those of its neighbours


class Outcome(NamedTuple):
    """How an auction ended."""

    point: Int[Array, " agents"]  # taken by each vehicle; with losses two may want the same
    holder: Int[Array, "agents points"]  # of each point, as each vehicle has it
    rounds: int  # of messages


def seen(state: State, roles: Roles, frames: Frames, graph: Bool[Array, "points points"]) -> Seen:
    """What each vehicle sees of those who hold its neighbouring points.

    Args:
        state: Where everything is, and what was heard.
        roles: Who holds which point, as each vehicle has it.
        frames: Of the vehicles; each knows those of its neighbours in its own.
        graph: Of the formation.
    """
    agents = np.arange(len(state.position))
    heard = state.heard[agents[:, None], roles.holder]
    own = frames.heading[:, None].conj()
    shift = frames.offset[roles.holder] - frames.offset[:, None]
    positions = _turned(heard, own * frames.heading[roles.holder]) + _turned(shift, own)
    positions[agents, roles.point] = state.reckoned
    known = graph[roles.point] & ~np.isnan(positions[..., 0])
    known[agents, roles.point] = True
    return Seen(positions, known)


def prices(
    seen: Seen, point: Int[Array, " agents"], shape: Float[Array, "points 3"]
) -> Float[Array, "agents points"]:
    """Squared way of each vehicle to each point, as it lays the shape [m²] [Lusk2020, eq. 14].

    Args:
        seen: What each vehicle sees.
        point: That each holds.
        shape: The points [m].
    """
    own = seen.positions[np.arange(len(point)), point]
    away = align(shape[None], seen.positions, seen.known).place(shape[None]) - own[:, None]
    return np.asarray(np.einsum("ijk,ijk->ij", away, away))


def ask(
    mission: FormationFlight,
    leg: int,
    number: int,
    state: State,
    roles: Roles,
    rng: np.random.Generator,
) -> Outcome:
    """Hold an auction among those who hear each other now.

    Args:
        mission: The flight.
        leg: Number of the shape.
        number: Of the auctions for that shape held before.
        state: Where everything is, and what was heard.
        roles: Who holds which point until now.
        rng: Draws which bids are lost.
    """
    formation, agents = mission.shapes[leg].formation, mission.agents
    way = mission.assigning
    if way.kind == "hungarian":
        pose = align(formation.points[roles.point], state.position)
        far = state.position[:, None] - pose.place(formation.points)
        return _agreed(optimum(np.linalg.norm(far, axis=2)), 0)
    cost = prices(
        seen(state, roles, mission.frames, formation.graph), roles.point, formation.points
    )
    graph = formation.graph[np.ix_(roles.point, roles.point)]
    network = Network(graph, np.ones(agents, dtype=bool))
    if network.component.any():
        return Outcome(roles.point, roles.holder, 0)  # after losses: nobody would learn the end
    if way.kind == "vsdaa":
        extent = float(np.linalg.norm(np.ptp(formation.points, axis=0)))
        epsilon = way.fineness * extent
        far = np.sqrt(cost)
        if number > 0:
            far[np.arange(agents), roles.point] -= LOYALTY * epsilon
        # How wide the graph is and how many bid, the auction need not learn: the shape says so.
        won = vsdaa(far, network, np.full(agents, agents), epsilon)
        return _agreed(won.target, won.rounds * (1 + mission.radio.late))
    radio = mission.radio
    rounds = radio.rounds_within(way.period) if radio.loss > 0 else None
    found = cbaa(
        1 / (cost + NEAREST), network, rounds=rounds, loss=radio.loss, delay=radio.late, rng=rng
    )
    # Who does not know the end by now keeps what it had; the next auction will mend it.
    knows = found.knew > 0
    return Outcome(
        np.where(knows, found.point, roles.point),
        np.where(knows[:, None], found.holder, roles.holder),
        found.rounds if rounds is None else rounds,  # nobody can know that all know
    )


def _agreed(point: Int[Array, " agents"], rounds: int) -> Outcome:
    holder = np.broadcast_to(np.argsort(point), (len(point), len(point))).copy()
    return Outcome(np.asarray(point), holder, rounds)


def _turned(points: Array, heading: Array) -> Array:
    flat = (points[..., 0] + 1j * points[..., 1]) * heading
    return np.stack([flat.real, flat.imag, points[..., 2]], axis=-1)
