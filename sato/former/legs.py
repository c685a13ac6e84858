"""Who comes and goes from leg to leg, and how many targets that takes."""

from math import floor

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.reconfiguration.mission import Loss
from sato.former.refusal import Refusal
from sato.former.tables import AnyLoss, LegTable, LoseAgents, Swarm


def wanted(swarm: Swarm, legs: list[LegTable]) -> list[int]:
    """The most targets that anybody may believe in on each leg, whoever is drawn to be lost."""
    most: list[int] = []
    live = swarm.agents
    believed = swarm.believed or swarm.agents
    known_lost: set[int] | None = set()  # by number; nothing is known after a loss by share
    for leg in legs:
        if leg.recount:
            believed = live
        live += sum(join.agents for join in leg.join)
        for loss in sorted(leg.lose, key=lambda loss: loss.at_step):
            if loss.at_step > 0:
                believed = max(believed, live)
            if not isinstance(loss, LoseAgents):
                live -= floor(loss.share * live)
                known_lost = None
            elif known_lost is not None:
                live -= len(set(loss.agents) - known_lost)
                known_lost |= set(loss.agents)
        believed = max(believed, live)
        most.append(believed)
    return most


def check_legs(swarm: Swarm, legs: list[LegTable]) -> None:
    """Every leg has targets enough, and loses only those there are.

    Raises:
        Refusal: Too few targets, or an agent that does not exist.
    """
    known = swarm.agents
    for number, (leg, enough) in enumerate(zip(legs, wanted(swarm, legs), strict=True)):
        known += sum(join.agents for join in leg.join)
        for loss in leg.lose:
            if isinstance(loss, LoseAgents) and max(loss.agents) >= known:
                raise Refusal(
                    f"leg.{number}.lose.agents",
                    f"there is no agent {max(loss.agents)}; they are 0 to {known - 1}",
                )
        if leg.targets is not None and leg.targets < enough:
            raise Refusal(
                f"leg.{number}.targets",
                f"{leg.targets} is less than the {enough} agents that there may be, or that may "
                f"be believed in; {enough} or more would do",
            )


def lost(loss: AnyLoss) -> Loss:
    """A loss as the mission has it."""
    if isinstance(loss, LoseAgents):
        return Loss("agents", agents=tuple(loss.agents), at_step=loss.at_step)
    return Loss(loss.kind, share=loss.share, at_step=loss.at_step)


def occupied(
    number: int, at_step: int, start: Float[Array, "k d"], before: Float[Array, "m d"] | None
) -> Float[Array, "n d"]:
    """Where agents are known to be when others join: at the start, or where the last leg ended."""
    if at_step > 0:
        return np.empty((0, start.shape[1]))
    return start if number == 0 or before is None else before
