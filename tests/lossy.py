"""Messages over a network that loses and delays them, for tests of batched code."""

from typing import NamedTuple

import numpy as np

from sato.network.channel import NEVER


def relay(channel, rounds, entered, stops, begin, act):
    """Let agents send a packet in every round of the network; yield all agents after each round.

    Args:
        channel: Rounds in which packets arrive.
        rounds: Number of rounds.
        entered: Round in which each agent begins.
        stops: Round in which each agent falls silent.
        begin: Function of an agent's number that returns the agent and its first packet.
        act: Function of an agent and its inbox that returns the agent and its next packet.
    """
    channel.extend(rounds)
    agents = {}
    inboxes = [{i: [] for i in range(len(entered))} for _ in range(rounds + 1)]
    for now in range(rounds):
        for i in np.flatnonzero((entered <= now) & (now < stops)).tolist():
            own, inbox = agents.get(i), inboxes[now][i]
            agents[i], packet = begin(i) if own is None else act(own, inbox)
            for edge in np.flatnonzero(channel.sender == i):
                if (at := channel.by_round[now, edge]) <= rounds:
                    inboxes[at][int(channel.receiver[edge])].append(packet)
        yield dict(agents)


def enter_rounds(history, agents, rounds):
    """Round of the network in which each of these agents gets through each synchronous round."""
    found = np.full((len(agents), rounds + 1), NEVER)
    for now, after in enumerate(history):
        for row, i in enumerate(agents):
            if i in after and found[row, after[i].round] == NEVER:
                found[row, after[i].round] = now
    return found


class Limited(NamedTuple):
    """An agent of some protocol, for so many rounds; it goes on acting once it has finished."""

    agent: object
    message_of: object  # function of the agent
    rounds: int

    @property
    def message(self):
        return self.message_of(self.agent)

    @property
    def is_finished(self):
        return self.rounds == 0

    def update(self, inbox):
        return self._replace(agent=self.agent.update(inbox), rounds=self.rounds - 1)
