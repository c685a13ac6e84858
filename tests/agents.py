"""Simulator of agents by messages alone, for comparison with the batched loop."""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from sato.network.graph import CommunicationGraph
from sato.reconfiguration.agent import Agent
from sato.reconfiguration.disturbances import disturb_control, draw_losses, measure
from sato.reconfiguration.first_commitment import find_first_commitments
from sato.reconfiguration.leg import MAX_LEG_FACTOR


def decide(agents, time, states, graph, seen=None):
    """Call all agents in rounds until all have finished; yield the messages after each round.

    One that has finished sends nothing any more.
    """
    sent, seen = {}, seen or {}
    while True:
        inbox = {i: [sent[j] for j in graph.neighbors[i] if j in sent] for i in agents}
        told = {
            i: agent.step(time, states[i], inbox[i], seen.get(i, ()))[1]
            for i, agent in agents.items()
        }
        sent = {i: message for i, message in told.items() if not agents[i].is_finished}
        if not sent:
            return
        yield sent


class Watch:
    """Sightings of each agent: of spheres that are not known, and of vehicles that are adrift."""

    def __init__(self, mission):
        self.mission, self.adrift, self.seen = mission, [], {}

    def look(self, x, agents, time):
        """Return all that each has seen so far, as it is now."""
        d, unknown = self.mission.axes, [o for o in self.mission.obstacles if not o.known]
        now = [replace(o, center=tuple(o.place_at(time).tolist())) for o in unknown]
        now += [(lost, x[lost]) for lost in self.adrift]
        for i in agents:
            away = [
                norm(o[1][:d] - x[i, :d]) if isinstance(o, tuple) else o.distances(x[i, :d])
                for o in now
            ]
            near = {n for n, distance in enumerate(away) if distance <= self.mission.sight}
            self.seen[i] = self.seen.get(i, set()) | near
        return {i: [now[n] for n in sorted(self.seen[i])] for i in agents}


def fly_by_messages(mission, seed=0):
    """Fly a drawn mission with agents alone; yield states, controls, agents and messages."""
    rng = np.random.default_rng(seed)
    x, alive, n = mission.initial_states, mission.alive, 0
    stops = find_first_commitments(mission)
    live = np.flatnonzero(alive).tolist()
    agents = {i: Agent(mission, i, commitment=stops.get(i)) for i in live}
    watch = Watch(mission)
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
                    lost = draw_losses(loss, x[:, : mission.axes], alive, rng)
                    alive[lost] = False
                    watch.adrift += sorted(lost) if loss.body == "coast" else []
            agents = {i: agent for i, agent in agents.items() if alive[i]}
            graph = CommunicationGraph.from_positions(
                x[:, : mission.axes], mission.comm_radius, alive
            )
            seen = watch.look(x, agents, n * mission.step)
            measured = measure(mission, x, rng)
            rounds = list(decide(agents, n * mission.step, measured, graph, seen))
            control = np.full((len(x), mission.axes), np.nan)
            for i, agent in agents.items():
                control[i] = agent.memory.control
            yield x, control, agents, graph, rounds
            applied = disturb_control(mission, control, rng)
            flown = mission.flown_plant.propagate(
                x, np.nan_to_num(applied), n * mission.step, mission.step
            )
            moves = alive | np.isin(np.arange(len(x)), watch.adrift)
            x, n = np.where(moves[:, None], flown[1], x), n + 1
            clocks = [int(agent.memory.memory.clock[i]) + 1 for i, agent in agents.items()]
            plans = [agent.memory.plans[i] for i, agent in agents.items()]
            if min(clocks) >= leg.steps and all(own.target_index is not None for own in plans):
                break
