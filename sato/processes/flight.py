"""Flight of a mission by processes, as `sato.run` flies and records it."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import version
from typing import Any, Literal

import numpy as np

from sato.interfaces import System
from sato.processes.fleet import MAX_VEHICLES, Fleet, VehicleError, check_memory
from sato.processes.free_running import FreeRunning
from sato.processes.lock_step import LockStep
from sato.processes.network import load_zenoh
from sato.processes.world import World
from sato.reconfiguration.agent_inputs import check_agent
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import ReconfigurationFrame
from sato.scenario.errors import InputError
from sato.scenario.file import load_toml, parse
from sato.scenario.table import find_own

Mode = Literal["lock-step", "free-running"]


def as_processes(
    system: System[Any, Any],
    mission: Any,
    seed: int,
    mode: Mode,
    port: int | None = None,
    speed: float = 1.0,
    announce: Callable[[Fleet], object] = lambda fleet: None,
) -> System[Any, Any]:
    """Return a system that flies a mission with a process for each vehicle.

    Args:
        system: System of the mission.
        mission: Mission, not drawn.
        seed: Seed with which it is drawn.
        mode: In lock step, or free running.
        port: At which the world listens; by default a socket that no other user can open.
        speed: Times as fast as by the clock, free running.
        announce: Called with the processes, once all are there.

    Raises:
        InputError: The mission cannot be flown so; says what would do.
    """
    if not isinstance(mission, Reconfiguration):
        reason = "flies no vehicles as processes; a reconfiguration would do"
        raise InputError("system", f'"{system.name}" {reason}')
    load_zenoh()
    scenario = mission.to_toml()
    for address, kind in find_own(load_toml(scenario, mission.name)):
        reason = f"{kind} of your own cannot be sent to a process; one of a file would do"
        raise InputError(address, reason)
    parse(scenario)

    def simulate(
        drawn: Reconfiguration, rng: np.random.Generator
    ) -> Iterator[ReconfigurationFrame]:
        check_vehicles(drawn)
        check_link(drawn, mode)
        told = f"{version('sato-swarm')} {seed} {scenario}"
        with Fleet(told, len(drawn.initial_states), port) as fleet:
            own = World(drawn, rng), fleet, scenario, seed
            flight = LockStep(*own) if mode == "lock-step" else FreeRunning(*own, speed)
            for k, frame in enumerate(flight.fly()):
                if k == 0:
                    announce(fleet)
                yield frame

    return replace(system, simulate=simulate, stop_errors=(*system.stop_errors, VehicleError))


def check_vehicles(mission: Reconfiguration) -> None:
    """Refuse a drawn mission with too many vehicles, or one that no agent can fly."""
    count = len(mission.initial_states)
    if count > MAX_VEHICLES:
        reason = f"{count} vehicles are too many for a process each; {MAX_VEHICLES} would do"
        raise InputError("swarm.agents", reason)
    try:
        check_agent(mission, 0)
    except ValueError as error:
        raise InputError("", str(error)) from error
    check_memory(count)


def check_link(mission: Reconfiguration, mode: Mode) -> None:
    """Refuse a mission whose messages do not pass as processes pass them."""
    if mode == "free-running" and not mission.lag_steps:
        reason = "is 0, and messages between processes take time; 0.02 would do"
        raise InputError("link.round_s", reason)
    if mission.link.skew:
        reason = f"{mission.link.skew:g}: processes have the same clock; 0 would do"
        raise InputError("link.skew_s", reason)


def print_processes(fleet: Fleet) -> None:
    """Print the numbers of the processes to the operating system, and the port of the world."""
    each = ", ".join(f"{i}: {fleet.ids[i]}" for i in sorted(fleet.ids))
    text = f"processes of the vehicles: {each}; the key of the flight is in {fleet.key_file}"
    print(text, file=sys.stderr)
