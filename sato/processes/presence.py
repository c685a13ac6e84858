"""Vehicles that come and go: their processes, and their places in the world."""

from sato.processes.fleet import Fleet
from sato.processes.messages import Briefing
from sato.processes.world import World


class Presence:
    """Processes and the world, which take note of each other."""

    def __init__(self, world: World, fleet: Fleet, scenario: str, seed: int, tick: float) -> None:
        self.world, self.fleet = world, fleet
        self._told = scenario, seed, tick

    def begin(self) -> None:
        """Start the processes of all that are there at the start."""
        self._brief(self.world.live, None)

    def update(self) -> None:
        """Take note of processes that have ended or were started again; lose and admit."""
        world = self.world
        world.lose(self.fleet.take_gone())
        for i in self.fleet.take_new():
            world.restart(i)
        joined = world.admit_joins()
        self.fleet.kill(world.apply_losses())
        self._brief([i for i in joined if world.alive[i]], world.leg_start * world.mission.step)

    def _brief(self, agents: list[int], leg_start: float | None) -> None:
        self.fleet.start(i for i in agents if i not in self.fleet.ids)
        self.fleet.take_new()
        scenario, seed, tick = self._told
        for i in agents:
            self.fleet.send(i, Briefing(scenario, seed, self.world.leg_index, leg_start, tick))
