"""Statistics of a column over the runs of a group: rates and numbers, with 95 % intervals."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from math import floor, isfinite, log10, nan, sqrt
from statistics import NormalDist
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

LEVEL = 0.95  # of all intervals
NAMES = ("rate", "mean", "median", "least", "largest", "deviation", "range", "sum", "count")
_QUANTILE = re.compile(r"p(100|\d\d?)")  # p5 is the quantile of 5 %
_PERCENTS = {"least": "p0", "median": "p50", "largest": "p100"}


@dataclass(frozen=True, eq=False)
class Statistics:
    """Values of a column over the runs of a group, and what is computed from them.

    Booleans are numbers 0 and 1, and their mean is a rate.
    """

    values: Float[Array, " count"]  # sorted; those of runs that have one
    runs: int  # with those that have no value
    is_rate: bool

    @classmethod
    def of(cls, values: Iterable[Any], is_rate: bool = False) -> "Statistics":
        """Collect values, one a run, of a rate if they are booleans; None and NaN are absent."""
        numbers = np.array([nan if value is None else value for value in values], dtype=float)
        return cls(np.sort(numbers[~np.isnan(numbers)]), len(numbers), is_rate)

    @property
    def count(self) -> int:
        """Number of runs that have a value."""
        return len(self.values)

    @cached_property
    def mean(self) -> float:
        """Mean, or rate; NaN without values."""
        return float(self.values.mean()) if self.count else nan

    @cached_property
    def deviation(self) -> float:
        """Standard deviation, with n − 1; NaN where it is not defined."""
        is_defined = self.count > 1 and np.isfinite(self.values).all()
        return float(self.values.std(ddof=1)) if is_defined else nan

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Interval of 95 % of the rate (Wilson's) or of the mean (Student's); NaN if undefined."""
        if self.is_rate:
            return wilson_interval(int(self.values.sum()), self.count)
        from scipy.special import stdtrit  # imports take longer than to read 10,000 rows

        freedom = self.count - 1
        half = stdtrit(freedom, (1 + LEVEL) / 2) * self.deviation / sqrt(self.count or 1)
        return float(self.mean - half), float(self.mean + half)

    def quantile(self, share: float) -> float:
        """Return a quantile, interpolated; NaN without values."""
        if not self.count:
            return nan
        index, part = divmod(share * (self.count - 1), 1)
        low = float(self.values[int(index)])
        # Not by `np.quantile`, to which an infinite value beside it is not a number.
        return low + part * (float(self.values[int(index) + 1]) - low) if part else low

    def number(self, name: str) -> float:
        """Return a statistic by its name, one of `NAMES` or a quantile, "p5"."""
        if found := _QUANTILE.fullmatch(_PERCENTS.get(name, name)):
            return self.quantile(int(found[1]) / 100)
        return {
            "rate": self.mean,
            "mean": self.mean,
            "deviation": self.deviation,
            "range": self.quantile(1.0) - self.quantile(0.0),
            "sum": float(self.values.sum()),
            "count": float(self.count),
        }[name]

    def text(self, name: str) -> str:
        """Format a statistic by its name; rates and means with their intervals."""
        if not self.count and name != "count":
            return "–"
        if name in ("rate", "mean"):
            scale, unit, shown = (100, " %", 1) if name == "rate" else (1, "", 2)
            low, high = (scale * end for end in self.interval)
            if isfinite(high):
                digits = _decimals(high - low, shown)
                spread = "" if name == "rate" else f" ± {self.deviation:.{digits}f}"
                of = f" of {self.count}" if name == "rate" and self.count < self.runs else ""
                mean = f"{scale * self.mean:.{digits}f}{unit}{spread}"
                return f"{mean} [{low:.{digits}f}, {high:.{digits}f}]{of}"
        if name == "range":
            return f"{self.quantile(0):.4g} to {self.quantile(1):.4g}"
        digits = 7 if name in ("least", "largest") else 4  # a limit may be near these
        return f"{self.number(name):.{digits}g}"


def is_statistic(name: str) -> bool:
    """Return True for the name of a statistic."""
    return name in NAMES or _QUANTILE.fullmatch(name) is not None


def wilson_interval(good: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate [Wilson1927]; NaN without trials.

    It is that of `scipy.stats.binomtest`, which takes a second to import.
    """
    if not count:
        return nan, nan
    z2 = NormalDist().inv_cdf((1 + LEVEL) / 2) ** 2
    middle = (good + z2 / 2) / (count + z2)
    half = sqrt(z2 * (good * (count - good) / count + z2 / 4)) / (count + z2)
    return max(0.0, middle - half), min(1.0, middle + half)


def _decimals(width: float, shown: int) -> int:
    """Return the decimals that show so many digits of a width, and so of an interval."""
    return max(0, shown - 1 - floor(log10(width))) if width > 0 else 1
