"""Check of a reconfiguration: promises and summary, recomputed from the recorded data."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check import common
from sato.check.promise import Promise, expect_none, expect_small_error, max_or_zero
from sato.check.report import Report
from sato.reconfiguration.check import consistency, motion
from sato.reconfiguration.check.fuel import FuelBound, compute_fuel_bound, compute_step_fuel
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.check.redraw import redraw_disturbances
from sato.reconfiguration.check.summary import is_reached, summarize
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.record import collect_attributes

if TYPE_CHECKING:
    import xarray

__all__ = ["FuelBound", "LegRecord", "ReconfigurationRecord", "check_run"]


def check_run(
    data: "xarray.Dataset", mission: Reconfiguration, rng: np.random.Generator | None = None
) -> Report:
    """Check a run's data against its drawn mission.

    Args:
        data: Data of the run.
        mission: Drawn mission.
        rng: Generator as the drawing of the mission left it; without it, disturbances and noise
            are checked by their size alone.
    """
    record = ReconfigurationRecord.from_dataset(data, mission)
    bounds = [compute_fuel_bound(record, leg) for leg in record.leg_records]
    samples = None if rng is None else redraw_disturbances(record, rng)
    alive = record.alive
    promises = (
        check_complete(record),
        common.check_attributes(record.attributes, collect_attributes(mission)),
        common.check_times(record.time, mission.step),
        consistency.check_chief(record),
        consistency.check_finite(record),
        consistency.check_start(record),
        common.check_alive(alive, record.events),
        common.check_components(record.position, alive, record.component, mission.comm_radius),
        motion.check_propagation(record),
        motion.check_applied_control(record, samples),
        motion.check_measurements(record, samples),
        motion.check_control_limit(record),
        motion.check_speed_limit(record),
        consistency.check_targets(record),
        consistency.check_legs(record),
        consistency.check_assignment(record),
        consistency.check_target_counts(record),
        motion.check_separation(record),
        check_feasible(record),
        check_arrival(record),
        check_fuel(record, bounds),
    )
    return Report(promises, summarize(record, bounds))


def check_complete(record: ReconfigurationRecord) -> Promise:
    """Check that the run was not interrupted and every leg ended."""
    ended = {leg.leg_index for leg in record.leg_records if leg.end_event is not None}
    missing = [leg for leg in range(len(record.mission.legs)) if leg not in ended]
    reason = common.incomplete_reason(record.attributes)
    text = f"legs that did not end: {_numbers(missing)}" if missing else "every leg ended"
    if reason:
        text += f"; {reason}"
    return expect_none("complete", len(missing) + bool(reason), text)


def check_feasible(record: ReconfigurationRecord) -> Promise:
    """Check that every program was feasible."""
    count = len(record.events.of_kind("infeasible"))
    return expect_none("feasible", count, "programs that were infeasible")


def check_arrival(record: ReconfigurationRecord) -> Promise:
    """Check that every leg was reached."""
    short = [leg.leg_index for leg in record.leg_records if not is_reached(record, leg)]
    text = f"legs that were not reached: {_numbers(short)}" if short else "every leg was reached"
    missing = len(record.mission.legs) - len(record.leg_records)
    return expect_none("reached", len(short) + missing, text)


def check_fuel(record: ReconfigurationRecord, bounds: list[FuelBound | None]) -> Promise:
    """Check that no leg that was reached burned less than its lower bound.

    The bound is that of the shared model. A plant that differs from it may have saved as much
    as it would cost the model to correct that (`FuelBound.correction_fuel`).
    """
    burned, worst = compute_step_fuel(record), 0.0
    for leg, bound in zip(record.leg_records, bounds, strict=True):
        if bound is None or not is_reached(record, leg):
            continue
        used = float(burned[leg.start_index : leg.end_index, bound.agents].sum())
        saved = float(bound.correction_fuel.sum())
        shortfall = (bound.total - used - saved) / max(bound.total, 1e-12)
        worst = max_or_zero(np.array([worst, shortfall]))
    return expect_small_error("fuel", worst, 1e-6, "a leg's fuel below its lower bound, relative")


def _numbers(legs: list[int]) -> str:
    return ", ".join(str(leg + 1) for leg in legs)
