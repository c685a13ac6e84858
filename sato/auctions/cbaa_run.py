"""CBAA for a swarm: by messages, which is the definition, or compiled, which is fast."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.auctions.bids import WinningBids
from sato.auctions.cbaa import CbaaBidder, is_finished, update_bidder
from sato.auctions.cbaa_kernel import init_state, run_kernel
from sato.network.graph import CommunicationGraph
from sato.network.graph import run_round as play_round

UNLIMITED_ROUNDS = 2**62  # rounds


@dataclass(frozen=True, eq=False)
class CbaaResult:
    """How an auction ended, with the books that prove it."""

    point: Int[Array, " agents"]  # claimed by each agent; −1 for who is not alive
    finished_round: Int[Array, " agents"]  # round in which it knew that this is final; 0 for never
    price: Float[Array, "agents points"]  # the agents' books
    winner: Int[Array, "agents points"]
    round_count: int  # played
    message_count: int  # books sent, each to one neighbour

    @property
    def is_conflict_free(self) -> bool:
        """Whether no two agents claim the same point."""
        claimed = self.point[self.point >= 0]
        return len(np.unique(claimed)) == len(claimed)

    @property
    def has_consensus(self) -> bool:
        """Whether all agents have the same book, and it sells to each the point it claims.

        Then everybody knows everybody's point, and that they are all different.
        """
        live = np.flatnonzero(self.point >= 0)
        price, holder = self.price[live], self.winner[live]
        same = np.all(price == price[:1]) and np.all(holder == holder[:1])
        return bool(same and np.all(holder[np.arange(len(live)), self.point[live]] == live))


def run_by_messages(
    score: Float[Array, "agents points"],
    network: CommunicationGraph,
    *,
    rounds: int | None = None,
    loss: float = 0.0,
    delay: int = 0,
    rng: np.random.Generator | None = None,
) -> Iterator[list[CbaaBidder]]:
    """Run the definition itself: every agent after every round. See `assign`."""
    _validate(score, network, rounds, loss, delay, rng)
    agents, points = score.shape
    live, silence = np.flatnonzero(network.alive).tolist(), WinningBids.empty(points)
    now = [CbaaBidder(i, score[i], len(live), silence) for i in range(agents)]
    under_way = deque([[silence] * agents] * (delay + 1), maxlen=delay + 1)
    for _ in count() if rounds is None else range(rounds):
        acted: dict[int, CbaaBidder] = {}
        for i in live:
            if not is_finished(now[i]):
                lost = _draw_lost_messages(agents, loss, rng)
                # A message that is lost says as much as an empty book.
                told = [silence if gone else b for gone, b in zip(lost, under_way[0], strict=True)]
                acted |= play_round(network, now, update_bidder, told, [i])
        if not acted:
            return
        now = [acted.get(i, agent) for i, agent in enumerate(now)]
        under_way.append([agent.bids for agent in now])
        yield now


def _draw_lost_messages(
    agents: int, loss: float, rng: np.random.Generator | None
) -> Bool[Array, " agents"]:
    if rng is None or loss == 0:
        return np.zeros(agents, dtype=bool)
    return np.asarray(rng.random(agents) < loss)


def run_cbaa(
    score: Float[Array, "agents points"],
    network: CommunicationGraph,
    *,
    rounds: int | None = None,
    loss: float = 0.0,
    delay: int = 0,
    rng: np.random.Generator | None = None,
) -> CbaaResult:
    """Give every agent its own point, by talking to neighbours only [Lusk2020, sec. IV-B].

    The same as taking the largest of all scores, then the largest that shares neither
    agent nor point with it, and so on; of equal ones the smaller agent, then the smaller
    point. Hence at least half of the best total score [Choi2009], and only the order of the
    scores matters. With D the diameter of the network, all know it by round
    (delay + 1) n D + 1, which listens (delay + 1) n D times; each stops by itself.

    Messages that are lost or late do no harm but to the time: every round tells all that
    one knows. Only, whoever knows the end must go on telling it, since others may not have
    heard, and no message can tell it when to stop: then all go on for `rounds`. Those who
    know by then never claim each other's points. What others claim may still be wrong, and
    `conflict_free` and `agreed` say how it turned out.

    Args:
        score: What each point is worth to each agent; positive and finite.
        network: Who hears whom while the auction lasts; connected.
        rounds: After so many the auction is broken off; None: when all know the end.
        loss: Probability that a message is lost.
        delay: Rounds by which each message comes later than in the next round.
        rng: Draws which messages are lost.

    Raises:
        ValueError: The input is not of this kind.
    """
    _validate(score, network, rounds, loss, delay, rng)
    swarm = init_state(score, network, delay)
    # Without losses nothing is drawn from the generator, whichever it is.
    run_kernel(swarm, rounds or UNLIMITED_ROUNDS, loss, rng or np.random.default_rng(0))
    played = int(swarm.round[0])
    told = np.where(swarm.finished_round > 0, swarm.finished_round, played)
    if loss > 0:
        told = np.full(len(score), rounds)
    return CbaaResult(
        point=swarm.point,
        finished_round=swarm.finished_round,
        price=swarm.price,
        winner=swarm.winner,
        round_count=played,
        message_count=int(told @ network.adjacency.sum(axis=1)),
    )


def _validate(
    score: Array,
    network: CommunicationGraph,
    rounds: int | None,
    loss: float,
    delay: int,
    rng: np.random.Generator | None,
) -> None:
    (agents, points), alive = score.shape, network.alive
    if agents != len(alive) or not 0 < np.count_nonzero(alive) <= points:
        raise ValueError(
            f"scores of {points} points for {agents} agents, a network of {len(alive)} of which "
            f"{np.count_nonzero(alive)} are alive: there must be a row for every agent of the "
            "network, and a point for each that is alive"
        )
    wrong = np.argwhere(alive[:, None] & ~((score > 0) & np.isfinite(score)))
    if len(wrong):
        i, j = wrong[0]
        raise ValueError(
            f"the score of point {j} for agent {i} is {score[i, j]}: scores must be positive and "
            "finite; with 1 / d², add a small number to d²"
        )
    _validate_connected(network)
    if not (0 <= loss < 1 and delay >= 0 and (rounds is None or rounds > 0)):
        raise ValueError(
            f"a loss of {loss}, a delay of {delay} rounds, at most {rounds} rounds: the loss must "
            "be in [0, 1), the delay no less than 0, and there must be a round"
        )
    if loss > 0 and (rng is None or rounds is None):
        raise ValueError(
            "where messages can be lost, somebody who knows the end cannot know whether the "
            "others do: give the number of rounds after which all stop, and the generator rng "
            "that draws the losses"
        )


def _validate_connected(network: CommunicationGraph) -> None:
    # Cheaper than `network.component`, which takes as long as the auction itself.
    reached = np.arange(len(network.alive)) == np.argmax(network.alive)
    while np.any(news := network.adjacency[reached].any(axis=0) & ~reached):
        reached |= news
    if np.any(apart := network.alive & ~reached):
        lost, *_ = np.flatnonzero(apart)
        raise ValueError(
            f"no message gets from agent {np.argmax(network.alive)} to agent {lost}: the parts of "
            "a network that is not connected would give away the same points; connect it"
        )
