"""Simulator of agents by messages alone, for comparison with the batched loop."""

import warnings
from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from sato.network.channel import Channel
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


def coasting(leg, k):
    """Return the agents that are lost at a step of a leg, and coast on."""
    lost = [loss for loss in leg.losses if (loss.at_step, loss.body) == (k, "coast")]
    return [i for loss in lost for i in loss.agents]


class NetworkFlight:
    """Flight of agents alone over a network in which rounds take time; without noise.

    States are those at the instants of each agent's own clock, as in the loop.
    """

    def __init__(self, mission, seed=0):
        self.mission, self.instant = mission, 0
        self.x, self.alive = mission.initial_states.copy(), mission.alive.copy()
        self.link_rng = np.random.default_rng(seed).spawn(1)[0]
        delay = self.link_rng.uniform(0.0, mission.link.skew, len(self.x))
        self.enters = mission.link.count_rounds(delay)
        self.rounds = mission.decision_rounds
        stops = find_first_commitments(mission)
        live = np.flatnonzero(self.alive).tolist()
        with warnings.catch_warnings(action="ignore"):  # doubts about the link, as a run has
            self.agents = {i: Agent(mission, i, commitment=stops.get(i)) for i in live}
        self.watch = Watch(mission)

    def fly(self):
        """Yield states, controls, targets and kinds of events of the agents at each instant."""
        for number, leg in enumerate(self.mission.legs):
            if number:
                more = {"recount": leg.recount, "choose": leg.choose}
                for agent in self.agents.values():
                    agent.set_targets(leg.shape, leg.steps, **more)
            for k in range(0, MAX_LEG_FACTOR * leg.steps, self.mission.lag_steps):
                yield from self.decide(number, leg, k)
                if all(agent.is_leg_over for agent in self.agents.values()):
                    break

    def decide(self, number, leg, k):
        """Fly until the next decision, while packets arrive as a channel has them."""
        mission, d = self.mission, self.mission.axes
        for joined, at_step in mission.joining(number):
            if k - mission.lag_steps < at_step <= k:
                self.alive[joined] = True
                begin = (self.instant - k) * mission.step
                self.agents |= {i: Agent(mission, i, 1, begin, leg) for i in joined}
        silent = self.lose(leg, k)
        graph = CommunicationGraph.from_positions(self.x[:, :d], mission.comm_radius, self.alive)
        channel = Channel(mission.link, graph, self.link_rng.spawn(1)[0])
        last = self.rounds + int(self.enters.max())
        channel.extend(last)
        inboxes = [{i: [] for i in self.agents} for _ in range(last)]
        states = np.full((mission.lag_steps, *self.x.shape), np.nan)
        controls, targets = states[..., :d].copy(), np.full(states.shape[:2], -1)
        events = [list[tuple[int, str]]() for _ in states]
        is_over = False  # for all, who would go on repeating themselves
        for now in range(last):
            sent, at = {}, now * mission.link.round / mission.step
            if at > 0.5 and abs(at - round(at)) < 1e-6:
                self.drift(leg, k + round(at), controls[round(at) - 1])
            for i, agent in self.agents.items():
                r = now - int(self.enters[i])
                if not 0 <= r < silent.get(i, self.rounds):
                    continue
                time = self.instant * mission.step + r * mission.link.round
                step = int(r * mission.link.round / mission.step + 1e-6)
                is_new = np.isnan(states[step, i]).all()
                if not is_new and is_over:
                    continue
                if step and is_new:
                    self.x[i] = self.fly_on(i, controls[step - 1, i])
                states[step, i] = self.x[i]
                seen = self.watch.look(self.x, [i], time)[i] if is_new else ()
                controls[step, i], sent[i] = agent.step(time, self.x[i], inboxes[now][i], seen)
                targets[step, i] = agent.target_index
                if is_new and not step:
                    events[0] += [(i, event["kind"]) for event in agent.events]
            for edge in np.flatnonzero(np.isin(channel.sender, list(sent))):
                at, j = channel.by_round[now, edge], int(channel.receiver[edge])
                if at < last:
                    inboxes[at][j].append(sent[int(channel.sender[edge])])
            has_begun = now >= self.enters.max()
            is_over = has_begun and all(agent.is_finished for agent in self.agents.values())
        for i in {*self.agents, *self.watch.adrift}:
            self.x[i] = self.fly_on(i, controls[-1, i])
        for i in silent:
            del self.agents[i]
            self.alive[i] = False
        self.instant += mission.lag_steps
        yield from zip(states, controls, targets, events, strict=True)

    def lose(self, leg, k):
        """Lose agents; return the rounds of this decision after which others fall silent."""
        silent = {}
        self.watch.adrift += coasting(leg, k)
        for loss in leg.losses:
            after = loss.at_step - k
            if 0 <= after < self.mission.lag_steps:
                rounds = int(self.mission.link.count_rounds(after * self.mission.step))
                silent |= dict.fromkeys(loss.agents, rounds)
        for i in [i for i, rounds in silent.items() if not rounds]:
            del silent[i], self.agents[i]
            self.alive[i] = False
        return silent

    def drift(self, leg, k, controls):
        """Fly wrecks on until a step of the leg, and those that become one at that step."""
        for i in [*self.watch.adrift, *coasting(leg, k)]:
            self.x[i] = self.fly_on(i, controls[i])
        self.watch.adrift += coasting(leg, k)

    def fly_on(self, i, control):
        """State of an agent after a step."""
        mission, u = self.mission, np.zeros((len(self.x), self.mission.axes))
        u[i] = np.nan_to_num(control)
        return mission.flown_plant.propagate(self.x, u, 0.0, mission.step)[1][i]
