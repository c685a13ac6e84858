"""Distributions of a key: what the table [draw] of a campaign holds."""

from abc import abstractmethod
from dataclasses import dataclass
from math import exp, log
from typing import Annotated, Any, ClassVar

from numpy.random import Generator

from sato.scenario.definition import Definition, NotNegative, Positive
from sato.scenario.errors import InputError, closest_name, format_value, join_names
from sato.scenario.table import read_table


class Distribution(Definition):
    """Distribution of the values of a key."""

    kind: ClassVar[str]

    @abstractmethod
    def draw(self, rng: Generator) -> Any:
        """Draw a value, as a scenario file would have it."""


@dataclass(frozen=True, eq=False, repr=False)
class Uniform(Distribution):
    """Uniform distribution of numbers."""

    kind: ClassVar[str] = "uniform"
    low: Annotated[float, "least value"]
    high: Annotated[float, "largest value"]

    def check(self) -> None:
        """Refuse limits in the wrong order."""
        _check_order(self.low, self.high)

    def draw(self, rng: Generator) -> float:
        """Draw a number."""
        return float(rng.uniform(self.low, self.high))


@dataclass(frozen=True, eq=False, repr=False)
class LogUniform(Distribution):
    """Distribution of positive numbers whose logarithms are uniform."""

    kind: ClassVar[str] = "log_uniform"
    low: Annotated[float, Positive, "least value"]
    high: Annotated[float, Positive, "largest value"]

    def check(self) -> None:
        """Refuse limits in the wrong order."""
        _check_order(self.low, self.high)

    def draw(self, rng: Generator) -> float:
        """Draw a number."""
        return exp(rng.uniform(log(self.low), log(self.high)))


@dataclass(frozen=True, eq=False, repr=False)
class Normal(Distribution):
    """Normal distribution."""

    kind: ClassVar[str] = "normal"
    mean: Annotated[float, "mean"]
    deviation: Annotated[float, NotNegative, "standard deviation"]

    def draw(self, rng: Generator) -> float:
        """Draw a number."""
        return float(rng.normal(self.mean, self.deviation))


@dataclass(frozen=True, eq=False, repr=False)
class Integers(Distribution):
    """Uniform distribution of integers."""

    kind: ClassVar[str] = "integers"
    low: Annotated[int, "least value"]
    high: Annotated[int, "largest value, which is drawn too"]

    def check(self) -> None:
        """Refuse limits in the wrong order."""
        _check_order(self.low, self.high)

    def draw(self, rng: Generator) -> int:
        """Draw an integer."""
        return int(rng.integers(self.low, self.high, endpoint=True))


@dataclass(frozen=True, eq=False, repr=False)
class Choice(Distribution):
    """One of some values, each as likely as the others."""

    kind: ClassVar[str] = "choice"
    values: Annotated[tuple[Any, ...], "values"]

    def check(self) -> None:
        """Refuse an empty list."""
        if not self.values:
            raise InputError("values", "must have at least one value")

    def draw(self, rng: Generator) -> Any:
        """Choose a value."""
        return self.values[rng.integers(len(self.values))]


DISTRIBUTIONS = {each.kind: each for each in (Uniform, LogUniform, Normal, Integers, Choice)}


def as_distribution(value: Any) -> Distribution:
    """Convert the table of a file, {"kind": "uniform", "low": 1.0, "high": 2.0}.

    Raises:
        InputError: There is no such distribution, or its numbers contradict each other.
    """
    if isinstance(value, Distribution):
        return value
    names = join_names(map(format_value, DISTRIBUTIONS), "and")
    if not isinstance(value, dict) or "kind" not in value:
        raise InputError("", f"must be a table with a kind; there are {names}")
    kind = value["kind"]
    if kind not in DISTRIBUTIONS:
        close = closest_name(str(kind), DISTRIBUTIONS)
        hint = f'; did you mean "{close}"?' if close else ""
        raise InputError("kind", f"there is no kind {format_value(kind)}, only {names}{hint}")
    found: Distribution = read_table(DISTRIBUTIONS[kind], value)
    return found


def _check_order(low: float, high: float) -> None:
    if not low <= high:
        raise InputError("high", f"must be at least low, {low:g}, got {high:g}")
