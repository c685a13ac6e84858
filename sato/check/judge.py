"""Judges a run by what its data say."""

from dataclasses import replace
from math import isclose
from typing import TYPE_CHECKING, Any

import numpy as np

from sato.check.promise import Promise, none
from sato.check.report import Report
from sato.record import Run, RunFileError, digest, first_words
from sato.scenario import parse
from sato.systems import system

if TYPE_CHECKING:
    import xarray


def judge(run: "Run | xarray.Dataset") -> Report:
    """Judge a run by what its data say; the scenario is rebuilt from its own text."""
    data = run.data if isinstance(run, Run) else run
    mission, rng = _drawn_anew(data)
    unaltered = data.attrs.get("digest") == digest(data)
    try:
        found = system(str(data.attrs["system"])).judge(data, mission, rng)
    except (LookupError, TypeError, ValueError, RuntimeError) as error:
        if unaltered:
            raise
        raise RunFileError(
            "the run file was altered since it was written, and no longer makes sense "
            f"({type(error).__name__}: {error}); fly the scenario again"
        ) from error
    first = none("unaltered", not unaltered, "alteration of the file since it was written")
    report = replace(found, promises=(first, *found.promises))
    if not isinstance(run, Run):
        return report
    return replace(report, promises=(*report.promises, _summary(run, report, unaltered)))


def rebuild(data: "xarray.Dataset") -> Any:
    """The mission that a run flew, from its own scenario text and seed."""
    return _drawn_anew(data)[0]


def _drawn_anew(data: "xarray.Dataset") -> tuple[Any, np.random.Generator]:
    rng = np.random.default_rng(int(data.attrs["seed"]))
    return parse(str(data.attrs["scenario"])).build(rng), rng


def _summary(run: Run, report: Report, unaltered: bool) -> Promise:
    """What the summary says is what was found; a run not yet judged has said little."""
    found = first_words(run.data.attrs) | report.summary
    found["broken"] = [p.name for p in report.broken]
    said = run.summary
    if not unaltered:
        said = {k: v for k, v in said.items() if k != "broken"}  # other than it was, of course
    wrong = [name for name in said if name not in found or _differ(said[name], found[name])]
    text = "entries of summary.json that are not what was found"
    if wrong:
        text += f": {', '.join(wrong)}"
    return none("summary", len(wrong), text)


def _differ(said: Any, found: Any) -> bool:
    if isinstance(found, dict):
        return (
            not isinstance(said, dict)
            or said.keys() != found.keys()
            or any(_differ(said[name], value) for name, value in found.items())
        )
    if isinstance(found, list):
        return (
            not isinstance(said, list) or len(said) != len(found) or any(map(_differ, said, found))
        )
    if isinstance(found, float) and isinstance(said, int | float):
        return not isclose(said, found, rel_tol=1e-6, abs_tol=1e-9)
    return bool(said != found)
