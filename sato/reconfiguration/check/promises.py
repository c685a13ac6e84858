"""What a run promises, each judged by recomputing it."""

import numpy as np

from sato.check import common
from sato.check.promise import Promise, largest, none, within
from sato.reconfiguration import log
from sato.reconfiguration.check.account import (
    assignment,
    believed,
    chief,
    legs,
    numbers,
    start,
    targets,
)
from sato.reconfiguration.check.chance import Chance
from sato.reconfiguration.check.evidence import Evidence
from sato.reconfiguration.check.fuel import Bound, burnt
from sato.reconfiguration.check.motion import (
    applied,
    control_limit,
    flight,
    measured,
    separation,
    speed_limit,
)
from sato.reconfiguration.check.words import reached


def promises(
    evidence: Evidence, bounds: list[Bound | None], chance: Chance | None = None
) -> tuple[Promise, ...]:
    """Judge everything; what was drawn is judged to the last digit if it is given."""
    mission, lives = evidence.mission, evidence.alive
    return (
        complete(evidence),
        common.attributes(evidence.attributes, log.attributes(mission)),
        common.times(evidence.time, mission.step),
        chief(evidence),
        numbers(evidence),
        start(evidence),
        common.alive(lives, evidence.happened),
        common.component(evidence.position, lives, evidence.component, mission.comm_radius),
        flight(evidence),
        applied(evidence, chance),
        measured(evidence, chance),
        control_limit(evidence),
        speed_limit(evidence),
        targets(evidence),
        legs(evidence),
        assignment(evidence),
        believed(evidence),
        separation(evidence),
        feasible(evidence),
        arrival(evidence),
        fuel(evidence, bounds),
    )


def complete(evidence: Evidence) -> Promise:
    """The flight was not interrupted and every leg came to its end."""
    ended = {s.leg for s in evidence.stretches if s.end is not None}
    lacking = [leg for leg in range(len(evidence.mission.legs)) if leg not in ended]
    cut = common.cut_short(evidence.attributes)
    text = "every leg came to its end"
    if lacking:
        text = f"legs that never ended: {', '.join(str(leg + 1) for leg in lacking)}"
    if cut:
        text += f"; {cut}"
    return none("complete", len(lacking) + bool(cut), text)


def feasible(evidence: Evidence) -> Promise:
    """Every programme had an answer."""
    count = len(evidence.happened.told("infeasible"))
    return none("feasible", count, "programmes that had no answer on the way")


def arrival(evidence: Evidence) -> Promise:
    """Every leg was reached."""
    short = [s.leg for s in evidence.stretches if not reached(evidence, s)]
    numbers = ", ".join(str(leg + 1) for leg in short)
    text = f"legs that were not reached: {numbers}" if short else "every leg was reached"
    lacking = len(evidence.mission.legs) - len(evidence.stretches)
    return none("reached", len(short) + lacking, text)


def fuel(evidence: Evidence, bounds: list[Bound | None]) -> Promise:
    """No leg that was reached burnt less than the least that it could have.

    The least is that of the shared model. A plant that did otherwise may have saved as much
    as it would cost the model to mend that (`Bound.mend`), and so much less is allowed.
    """
    burn, short, text = burnt(evidence), 0.0, "a leg's fuel below its lower bound, relative"
    for stretch, bound in zip(evidence.stretches, bounds, strict=True):
        if bound is None or not reached(evidence, stretch):
            continue
        spent = float(burn[stretch.first : stretch.last, bound.agents].sum())
        saved = float(bound.mend.sum())
        short = largest(np.array([short, (bound.total - spent - saved) / max(bound.total, 1e-12)]))
    return within("fuel", short, 1e-6, text)
