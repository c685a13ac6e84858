"""Judges a run from its file alone: recomputes what it promises and what is said of it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.check.evidence import Evidence, Stretch
from sato.check.fuel import Bound, burnt, least
from sato.check.promises import Promise, promises
from sato.check.words import summarise
from sato.reconfiguration.mission import Reconfiguration
from sato.record import Run

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
    return examine(data, rebuild(data))


def examine(data: "xarray.Dataset", mission: Reconfiguration) -> Report:
    """Judge a run's data against a mission."""
    evidence = Evidence.of(data, mission)
    bounds = [least(evidence, s) for s in evidence.stretches]
    return Report(
        promises(evidence, bounds),
        summarise(evidence, bounds),
        burnt(evidence).sum(axis=0),
        bound_of_each(evidence, bounds),
    )


def rebuild(data: "xarray.Dataset") -> Reconfiguration:
    """The mission that a run flew, from its own scenario text and seed."""
    from sato.scenario import parse

    return parse(str(data.attrs["scenario"])).build(np.random.default_rng(int(data.attrs["seed"])))


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


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value
