"""Judges a run from its file alone: recomputes what it promises and what is said of it."""

from dataclasses import dataclass, replace
from math import isclose
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.check.chance import drawn
from sato.check.evidence import Evidence, Stretch
from sato.check.fuel import Bound, burnt, least
from sato.check.promise import Promise, none
from sato.check.promises import promises
from sato.check.words import summarise
from sato.reconfiguration.mission import Reconfiguration
from sato.record import Run, RunFileError, digest, first_words

if TYPE_CHECKING:
    import xarray

__all__ = [
    "Bound",
    "Evidence",
    "Promise",
    "Report",
    "Stretch",
    "bound_of_each",
    "examine",
    "judge",
    "rebuild",
]


@dataclass(frozen=True, eq=False)
class Report:
    """What was found of a run."""

    promises: tuple[Promise, ...]
    summary: dict[str, Any]  # the words of summary.json, but for time and memory
    fuel: Float[Array, " agents"]  # burnt by each agent [m/s]
    fuel_bound: Float[Array, " agents"]  # least for the targets it held; NaN where unknown [m/s]

    @property
    def kept(self) -> bool:
        """Whether every promise was kept."""
        return all(p.kept for p in self.promises)

    @property
    def broken(self) -> tuple[Promise, ...]:
        """The promises that were not kept."""
        return tuple(p for p in self.promises if not p.kept)

    def __bool__(self) -> bool:
        return self.kept

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain values, fit for JSON."""
        return {
            "kept": self.kept,
            "promises": [{k: _plain(v) for k, v in p._asdict().items()} for p in self.promises],
            "summary": self.summary,
        }


def judge(run: "Run | xarray.Dataset") -> Report:
    """Judge a run by what its data say; the scenario is rebuilt from its own text."""
    data = run.data if isinstance(run, Run) else run
    mission, rng = _drawn_anew(data)
    try:
        report = examine(data, mission, rng)
    except (LookupError, TypeError, ValueError, RuntimeError) as error:
        if data.attrs.get("digest") == digest(data):
            raise
        raise RunFileError(
            "the run file was altered since it was written, and no longer makes sense "
            f"({type(error).__name__}: {error}); fly the scenario again"
        ) from error
    if not isinstance(run, Run):
        return report
    return replace(report, promises=(*report.promises, _summary(run, report)))


def examine(
    data: "xarray.Dataset", mission: Reconfiguration, rng: np.random.Generator | None = None
) -> Report:
    """Judge a run's data against a mission.

    Args:
        data: The run's.
        mission: What was to be flown.
        rng: As the drawing of the mission left it; without it, what was drawn in flight is
            judged by its size alone.
    """
    evidence = Evidence.of(data, mission)
    bounds = [least(evidence, s) for s in evidence.stretches]
    chance = None if rng is None else drawn(evidence, rng)
    return Report(
        promises(evidence, bounds, chance),
        summarise(evidence, bounds),
        burnt(evidence).sum(axis=0),
        bound_of_each(evidence, bounds),
    )


def rebuild(data: "xarray.Dataset") -> Reconfiguration:
    """The mission that a run flew, from its own scenario text and seed."""
    return _drawn_anew(data)[0]


def bound_of_each(evidence: Evidence, bounds: list[Bound | None]) -> Float[Array, " agents"]:
    """Least fuel of each agent to the targets it held; NaN unless all its legs are priced."""
    total = np.zeros(evidence.alive.shape[1])
    for stretch, bound in zip(evidence.stretches, bounds, strict=True):
        priced = np.full(len(total), np.nan)
        if bound is not None:
            priced[bound.agents] = np.where(np.isfinite(bound.own), bound.own, np.nan)
        absent = ~evidence.alive[stretch.first : stretch.last].any(axis=0)
        total += np.where(absent, 0.0, priced)
    return total


def _drawn_anew(data: "xarray.Dataset") -> tuple[Reconfiguration, np.random.Generator]:
    from sato.scenario import parse

    rng = np.random.default_rng(int(data.attrs["seed"]))
    return parse(str(data.attrs["scenario"])).build(rng), rng


def _summary(run: Run, report: Report) -> Promise:
    """What the summary says is what was found; a run not yet judged has said little."""
    found = first_words(run.data.attrs) | report.summary
    found["broken"] = [p.name for p in report.promises if not p.kept]
    said = run.summary
    if not report.promises[0].kept:
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


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value
