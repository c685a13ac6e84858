"""Judges a run by what its data say."""

from dataclasses import replace
from math import isclose
from typing import TYPE_CHECKING, Any

import numpy as np

from sato.check.promise import Promise, expect_none
from sato.check.report import Report
from sato.former import parse
from sato.record import Run, RunFileError, compute_digest, initial_summary
from sato.systems import load_system

if TYPE_CHECKING:
    import xarray


def verify_run(run: "Run | xarray.Dataset") -> Report:
    """Judge a run by what its data say; the scenario is rebuilt from its own text."""
    data = run.data if isinstance(run, Run) else run
    mission, rng = _rebuild_with_rng(data)
    unaltered = data.attrs.get("digest") == compute_digest(data)
    try:
        found = load_system(str(data.attrs["system"])).check(data, mission, rng)
    except (LookupError, TypeError, ValueError, RuntimeError) as error:
        if unaltered:
            raise
        raise RunFileError(
            "the run file was altered since it was written, and no longer makes sense "
            f"({type(error).__name__}: {error}); fly the scenario again"
        ) from error
    first = expect_none("unaltered", not unaltered, "alteration of the file since it was written")
    report = replace(found, promises=(first, *found.promises))
    if not isinstance(run, Run):
        return report
    return replace(report, promises=(*report.promises, _check_summary(run, report, unaltered)))


def rebuild_mission(data: "xarray.Dataset") -> Any:
    """The mission that a run flew, from its own scenario text and seed."""
    return _rebuild_with_rng(data)[0]


def _rebuild_with_rng(data: "xarray.Dataset") -> tuple[Any, np.random.Generator]:
    rng = np.random.default_rng(int(data.attrs["seed"]))
    return parse(str(data.attrs["scenario"])).build(rng), rng


def _check_summary(run: Run, report: Report, unaltered: bool) -> Promise:
    """What the summary says is what was found; a run not yet judged has said little."""
    found = initial_summary(run.data.attrs) | report.summary
    found["broken"] = [p.name for p in report.broken]
    said = run.summary
    if not unaltered:
        said = {k: v for k, v in said.items() if k != "broken"}  # other than it was, of course
    wrong = [name for name in said if name not in found or _values_differ(said[name], found[name])]
    text = "entries of summary.json that are not what was found"
    if wrong:
        text += f": {', '.join(wrong)}"
    return expect_none("summary", len(wrong), text)


def _values_differ(said: Any, found: Any) -> bool:
    if isinstance(found, dict):
        return (
            not isinstance(said, dict)
            or said.keys() != found.keys()
            or any(_values_differ(said[name], value) for name, value in found.items())
        )
    if isinstance(found, list):
        return (
            not isinstance(said, list)
            or len(said) != len(found)
            or any(map(_values_differ, said, found))
        )
    if isinstance(found, float) and isinstance(said, int | float):
        return not isclose(said, found, rel_tol=1e-6, abs_tol=1e-9)
    return bool(said != found)
