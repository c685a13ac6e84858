"""Result of checking a run: promises, each kept or broken."""

from dataclasses import dataclass
from math import isfinite
from typing import Any

from sato.check.promise import Promise


@dataclass(frozen=True)
class Report:
    """Promises of a run, and the summary that was recomputed with them."""

    promises: tuple[Promise, ...]
    summary: dict[str, Any]  # as in summary.json, without time and memory
    skipped: tuple[str, ...] = ()  # names of promises that could not be recomputed

    @property
    def kept(self) -> bool:
        """True where every promise was kept."""
        return all(promise.kept for promise in self.promises)

    @property
    def broken(self) -> tuple[Promise, ...]:
        """Promises that were not kept."""
        return tuple(promise for promise in self.promises if not promise.kept)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values, fit for JSON."""
        return {
            "kept": self.kept,
            "promises": [
                {key: finite_or_none(value) for key, value in promise._asdict().items()}
                for promise in self.promises
            ],
            "skipped": list(self.skipped),
            "summary": self.summary,
        }


def finite_or_none(value: Any) -> Any:
    """Replace numbers that JSON cannot hold, in lists and tables too."""
    if isinstance(value, float) and not isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: finite_or_none(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(part) for part in value]
    return value
