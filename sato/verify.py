"""Verification of a run: everything that its file and its summary say, recomputed."""

from collections.abc import Mapping
from dataclasses import replace
from math import isclose
from typing import Any

import numpy as np

from dynamics.callbacks import CallbackError, as_kind
from sato.check import common
from sato.check.report import JUDGED, Promise, Report, expect_none
from sato.damage import find_damage
from sato.record import RunFileError, RunRecord, initial_summary
from sato.run_data import RunData
from sato.scenario.errors import InputError
from sato.scenario.file import NO_MISSION, describe_own, load_toml
from sato.scenario.origin import Origin
from sato.systems import load_system

# Entries of summaries that earlier versions of this format did not write.
LATER = {
    "chattering", "cautious", "command_change_m_s", "followed", "fuel_lower_bound_asked_m_s",
    "margin_m", "position_tolerance_m", "reached", "velocity_tolerance_m_s",
}  # fmt: skip


def verify_run(data: RunData, mission: Any | None, summary: Mapping[str, Any]) -> Report:
    """Check a run by recomputing what its data and its summary say.

    The mission is not drawn; without it, only what needs no mission is recomputed, and the report
    lists all else as skipped. A `RunFileError` says that nothing can be, as the file was altered.
    """
    is_unaltered = data.attrs.get("digest") == data.compute_digest()
    try:
        found = _check_alone(data) if mission is None else _check(data, mission)
    except (LookupError, TypeError, ValueError, RuntimeError) as error:
        if is_unaltered:
            raise
        text = "the run file was altered since it was written; fly the scenario again"
        raise RunFileError(f"{text} ({type(error).__name__}: {error})") from error
    text = "alteration of the file since it was written"
    first = expect_none("unaltered", not is_unaltered, text), _check_scenario(data)
    report = replace(found, promises=(*first, *found.promises))
    if found.skipped:
        return report
    last = _check_summary(data, summary, report, is_unaltered)
    return replace(report, promises=(*report.promises, last))


def _check_scenario(data: RunData) -> Promise:
    # A file or a mission from Python may be anything, and the report says so.
    name, text = "scenario", str(data.attrs["scenario"])
    try:
        origin, says = Origin.from_json(data.attrs["origin"]), load_toml(text, "run.nc")
    except (LookupError, TypeError, ValueError):
        return expect_none(name, 1, "missing record of where the scenario comes from")
    if (says.get("name"), says.get("system")) != (data.attrs["name"], data.attrs["system"]):
        return expect_none(name, 1, f"other name or system than in the file: {says.get('name')}")
    if not origin.gives(text):
        return expect_none(name, 1, f"scenario in the file that is not {origin}")
    return Promise(name, True, 0.0, 0.0, str(origin))


def _check(data: RunData, mission: Any) -> Report:
    rng = np.random.default_rng(int(data.attrs["seed"]))
    try:
        drawn = mission.draw(rng)
    except CallbackError:
        raise
    except InputError as error:
        raise RunFileError(f"the scenario in the file cannot be flown: {error}") from error
    if damage := _report_damage(data, drawn):
        return damage
    checked = load_system(data.attrs["system"]).check(data, drawn, rng)
    report: Report = as_kind(checked, Report, "a Report of System.check")
    return report


def _report_damage(data: RunData, drawn: Any | None) -> Report | None:
    """Report a record that cannot be read; None where it can be."""
    if not (damage := find_damage(data, drawn)):
        return None
    names = *load_system(data.attrs["system"]).promises, "summary"
    return Report((Promise("record", False, 1.0, 0.0, damage),), {}, names, "the record is damaged")


def _check_alone(data: RunData) -> Report:
    if damaged := _report_damage(data, None):
        return damaged
    record: RunRecord[None, Any, Any] = RunRecord.from_data(data, None)
    frames = record.frames
    promises = [
        common.check_complete(data.attrs),
        common.check_finite(frames.alive, frames.position, frames.velocity, time=frames.time),
        common.check_alive(frames.alive, record.events),
    ]
    if "comm_radius_m" in data.attrs:
        promises.append(common.check_components(frames, float(data.attrs["comm_radius_m"])))
    summary = common.common_summary(data.attrs, frames.alive)
    every, checked = load_system(data.attrs["system"]).promises, [each.name for each in promises]
    skipped = tuple(name for name in (*every, "summary") if name not in checked)
    reason = describe_own(str(data.attrs["scenario"])) or NO_MISSION
    return Report(tuple(promises), summary, skipped, reason)


def _check_summary(
    data: RunData, summary: Mapping[str, Any], report: Report, is_unaltered: bool
) -> Promise:
    first, unchecked = initial_summary(data.attrs), {"verdict": "unchecked", "success": False}
    claims = {name: value for name, value in summary.items() if name != "check_failed"}
    if not _differs(claims, first) or not _differs(claims, first | unchecked):
        return expect_none("summary", 0, "results in the summary, which is of no check yet")
    expected = first | report.entries
    # Of a run that was altered, or saved without its mission, these tell it now, not then.
    is_told = is_unaltered and not unchecked.items() <= summary.items()
    both = expected.keys() & summary.keys()
    is_early = "verdict" not in summary  # when a success could be a collision
    judged = () if is_told and not is_early else JUDGED
    later = LATER - summary.keys() if is_early else ()
    names = [name for name in {**expected, **summary} if name not in {*judged, *later}]
    wrong = [n for n in names if n not in both or _differs(summary[n], expected[n])]
    text = "entries of summary.json that are missing or differ from the data"
    text += f": {', '.join(wrong)}" * bool(wrong)
    return expect_none("summary", len(wrong), text)


def _differs(value: Any, expected: Any) -> bool:
    if isinstance(expected, dict) and isinstance(value, dict) and value.keys() == expected.keys():
        return any(_differs(value[name], part) for name, part in expected.items())
    if isinstance(expected, list) and isinstance(value, list) and len(value) == len(expected):
        return any(map(_differs, value, expected))
    if isinstance(expected, float) and isinstance(value, int | float):
        return not isclose(value, expected, rel_tol=1e-6, abs_tol=1e-9)
    return bool(value != expected)
