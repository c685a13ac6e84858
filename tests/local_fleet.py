"""Vehicles that run freely within one process, by a clock that goes on as they act."""

from collections import deque

import numpy as np

from sato.processes import free_running, free_vehicle
from sato.processes.codec import decode
from sato.processes.fleet import Fleet
from sato.processes.free_running import FreeRunning
from sato.processes.free_vehicle import HEARTBEAT, FreeVehicle
from sato.processes.messages import Alive, Briefing
from sato.processes.vehicle import Vehicle
from sato.processes.world import World

LEAST = 1e-4  # by which the clock goes on [s]


class LocalFleet(Fleet):
    """Fleet without processes and without a connection.

    Args:
        tick: Time between two packets [s].
        pauses: Times between which each vehicle is paused [s].
    """

    def __init__(self, tick, pauses):
        self.tick, self.pauses, self.now = tick, pauses, 0.0
        self.vehicles, self.inbox, self.due, self.sent = {}, {}, {}, deque()
        self.ids, self.processes = {}, {}

    def start(self, numbers):
        self.ids |= {i: i for i in numbers}

    def take_new(self):
        return []

    take_gone = take_new

    def kill(self, numbers):
        for i in numbers:
            self.vehicles.pop(i, None)

    def send(self, number, value):
        if isinstance(value, Briefing):
            vehicle = Vehicle(number, value)
            own = FreeVehicle(vehicle, lambda sent: self.sent.append((number, sent)), self.tick)
            self.vehicles[number], self.inbox[number] = own, deque()
            self.due[number] = self.now
        else:
            self.inbox[number].append(value)

    def pass_on(self, number, data):
        self.send(number, decode(data))

    def receive(self, timeout):
        """Let all act until one says something, or for a time."""
        until = self.now + timeout
        while True:
            awake = [i for i in self.vehicles if not self.is_paused(i)]
            for i in awake:
                self.act(i, self.vehicles[i])
            if self.sent:
                return self.sent.popleft()
            if self.now >= until:
                return None
            self.now = max(self.now + LEAST, min([until, *(self.due[i] for i in awake)]))

    def act(self, i, vehicle):
        while self.inbox[i]:
            vehicle._take_in(self.inbox[i].popleft())
        if self.now >= self.due[i]:
            self.due[i] = self.now + self.tick
            vehicle._act()
            if self.now > vehicle._sent + HEARTBEAT:
                vehicle._send(Alive())

    def is_paused(self, i):
        begin, end = self.pauses.get(i, (np.inf, np.inf))
        return begin <= self.now < end


def fly_freely(mission, monkeypatch, pauses, seed=0):
    """Fly by a clock of its own; yield all frames."""
    fleet = LocalFleet(mission.link.round, pauses)
    for module in (free_running, free_vehicle):
        monkeypatch.setattr(module, "monotonic", lambda: fleet.now)
    world = World(mission, np.random.default_rng(seed))
    return FreeRunning(world, fleet, mission.to_toml(), seed).fly()
