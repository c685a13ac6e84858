"""Simulator of agents by messages alone, for comparison with the batched loop."""

import numpy as np

from sato.network.graph import CommunicationGraph
from sato.reconfiguration.agent import Agent
from sato.reconfiguration.disturbances import disturb_control, draw_losses, measure
from sato.reconfiguration.first_commitment import find_first_commitments
from sato.reconfiguration.leg import MAX_LEG_FACTOR


def decide(agents, time, states, graph):
    """Call all agents in rounds until all have finished; yield the messages after each round."""
    sent = {}
    while not sent or not all(agent.is_finished for agent in agents.values()):
        inbox = {i: [sent[j] for j in graph.neighbors[i] if j in sent] for i in agents}
        sent = {i: agent.step(time, states[i], inbox[i])[1] for i, agent in agents.items()}
        yield sent


def fly_by_messages(mission, seed=0):
    """Fly a drawn mission with agents alone; yield states, controls, agents and messages."""
    rng = np.random.default_rng(seed)
    x, alive, n = mission.initial_states, mission.alive, 0
    stops = find_first_commitments(mission)
    live = np.flatnonzero(alive).tolist()
    agents = {i: Agent(mission, i, commitment=stops.get(i)) for i in live}
    for number, leg in enumerate(mission.legs):
        if number:
            for agent in agents.values():
                agent.set_targets(leg.shape, leg.steps, recount=leg.recount, choose=leg.choose)
        for k in range(MAX_LEG_FACTOR * leg.steps):
            alive, begin = alive.copy(), (n - k) * mission.step
            for joined, at_step in mission.joining(number):
                if at_step == k:
                    alive[joined] = True
                    agents |= {i: Agent(mission, i, 1, begin, leg) for i in joined}
            for loss in leg.losses:
                if loss.at_step == k:
                    alive[draw_losses(loss, x[:, : mission.axes], alive, rng)] = False
            agents = {i: agent for i, agent in agents.items() if alive[i]}
            graph = CommunicationGraph.from_positions(
                x[:, : mission.axes], mission.comm_radius, alive
            )
            rounds = list(decide(agents, n * mission.step, measure(mission, x, rng), graph))
            control = np.full((len(x), mission.axes), np.nan)
            for i, agent in agents.items():
                control[i] = agent.memory.control
            yield x, control, agents, graph, rounds
            applied = disturb_control(mission, control, rng)
            flown = mission.flown_plant.propagate(
                x, np.nan_to_num(applied), n * mission.step, mission.step
            )
            x, n = np.where(alive[:, None], flown[1], x), n + 1
            clocks = [int(agent.memory.memory.clock[i]) + 1 for i, agent in agents.items()]
            if min(clocks) >= leg.steps:
                break
