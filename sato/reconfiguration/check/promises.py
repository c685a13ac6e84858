"""What a run promises, each judged by recomputing it."""

import numpy as np

from sato.check import common
from sato.check.promise import Promise, expect_none, expect_small_error, max_or_zero
from sato.reconfiguration import record
from sato.reconfiguration.check.consistency import (
    check_assignment,
    check_chief,
    check_finite,
    check_legs,
    check_start,
    check_target_counts,
    check_targets,
)
from sato.reconfiguration.check.fuel import FuelBound, compute_step_fuel
from sato.reconfiguration.check.motion import (
    check_applied_control,
    check_control_limit,
    check_measurements,
    check_propagation,
    check_separation,
    check_speed_limit,
)
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.check.redraw import DisturbanceSamples
from sato.reconfiguration.check.summary import is_reached


def verify(
    evidence: ReconfigurationRecord,
    bounds: list[FuelBound | None],
    chance: DisturbanceSamples | None = None,
) -> tuple[Promise, ...]:
    """Judge everything; what was drawn is judged to the last digit if it is given."""
    mission, lives = evidence.mission, evidence.alive
    return (
        check_complete(evidence),
        common.check_attributes(evidence.attributes, record.collect_attributes(mission)),
        common.check_times(evidence.time, mission.step),
        check_chief(evidence),
        check_finite(evidence),
        check_start(evidence),
        common.check_alive(lives, evidence.events),
        common.check_components(evidence.position, lives, evidence.component, mission.comm_radius),
        check_propagation(evidence),
        check_applied_control(evidence, chance),
        check_measurements(evidence, chance),
        check_control_limit(evidence),
        check_speed_limit(evidence),
        check_targets(evidence),
        check_legs(evidence),
        check_assignment(evidence),
        check_target_counts(evidence),
        check_separation(evidence),
        check_feasible(evidence),
        check_arrival(evidence),
        check_fuel(evidence, bounds),
    )


def check_complete(evidence: ReconfigurationRecord) -> Promise:
    """The flight was not interrupted and every leg came to its end."""
    ended = {s.leg_index for s in evidence.leg_records if s.end_event is not None}
    lacking = [leg for leg in range(len(evidence.mission.legs)) if leg not in ended]
    cut = common.incomplete_reason(evidence.attributes)
    text = "every leg came to its end"
    if lacking:
        text = f"legs that never ended: {', '.join(str(leg + 1) for leg in lacking)}"
    if cut:
        text += f"; {cut}"
    return expect_none("complete", len(lacking) + bool(cut), text)


def check_feasible(evidence: ReconfigurationRecord) -> Promise:
    """Every programme had an answer."""
    count = len(evidence.events.of_kind("infeasible"))
    return expect_none("feasible", count, "programmes that had no answer on the way")


def check_arrival(evidence: ReconfigurationRecord) -> Promise:
    """Every leg was reached."""
    short = [s.leg_index for s in evidence.leg_records if not is_reached(evidence, s)]
    numbers = ", ".join(str(leg + 1) for leg in short)
    text = f"legs that were not reached: {numbers}" if short else "every leg was reached"
    lacking = len(evidence.mission.legs) - len(evidence.leg_records)
    return expect_none("reached", len(short) + lacking, text)


def check_fuel(evidence: ReconfigurationRecord, bounds: list[FuelBound | None]) -> Promise:
    """No leg that was reached burnt less than the least that it could have.

    The least is that of the shared model. A plant that did otherwise may have saved as much
    as it would cost the model to mend that (`Bound.mend`), and so much less is allowed.
    """
    burn, short, text = (
        compute_step_fuel(evidence),
        0.0,
        "a leg's fuel below its lower bound, relative",
    )
    for stretch, bound in zip(evidence.leg_records, bounds, strict=True):
        if bound is None or not is_reached(evidence, stretch):
            continue
        spent = float(burn[stretch.start_index : stretch.end_index, bound.agents].sum())
        saved = float(bound.correction_fuel.sum())
        short = max_or_zero(
            np.array([short, (bound.total - spent - saved) / max(bound.total, 1e-12)])
        )
    return expect_small_error("fuel", short, 1e-6, text)
