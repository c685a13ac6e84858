"""Ranges of numbers, and memory: what no computer of today can compute with."""

import os
from bisect import bisect_right
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from dynamics.inputs import check_range as check_range
from sato.scenario.errors import InputError

MANY_STEPS = 5000  # of a leg, beyond which a unit is likely to be wrong
MANY_SHORT_STEPS = 500_000  # the same of control loops with steps of some 20 ms
CONTROL_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")


def check_memory(agents: int, demand: Callable[[int], float]) -> None:
    """Refuse a swarm that takes more memory [byte] than there is, and say how many agents fit."""
    limit = machine_memory()
    if demand(agents) <= limit:
        return
    fits = bisect_right(range(1, agents), limit, key=demand)
    reason = f"{agents} take about {demand(agents) / 1e9:,.0f} GB of memory in a mission this long"
    shorter = "fewer steps or targets, or a shorter flight, would do"
    cure = f"{fits} would do, or fewer steps" if fits > 1 else shorter
    raise InputError("swarm.agents", f"{reason}, and there are {limit / 1e9:,.0f} GB; {cure}")


def doubt_long(
    where: str, steps: float, step: float, reason: str, most: int = MANY_STEPS
) -> list[str]:
    """Doubt a flight that is so long that a number is likely to be in another unit.

    The reason gives the numbers that make it long; a step is in seconds.
    """
    if steps <= most:
        return []
    hours = f"{steps * step / 3600:.3g} h"
    return [f"{where} takes {steps:,.0f} steps of {step:g} s ({hours}), {reason}"]


def machine_memory() -> float:
    """Return the memory that the machine, or the group of this process, has [byte]."""
    try:
        limits = [float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))]
    except (AttributeError, ValueError, OSError):  # not on Windows
        return float("inf")
    with suppress(OSError, ValueError):  # no group, or "max"
        limits.append(float(CONTROL_GROUP_LIMIT.read_text()))
    return min(limits)
