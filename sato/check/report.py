"""What was found of a run."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sato.check.promise import Promise


@dataclass(frozen=True)
class Report:
    """What was found of a run."""

    promises: tuple[Promise, ...]
    summary: dict[str, Any]  # the words of summary.json, but for time and memory

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
            "promises": [
                {k: _nan_to_none(v) for k, v in p._asdict().items()} for p in self.promises
            ],
            "summary": self.summary,
        }


def _nan_to_none(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value
