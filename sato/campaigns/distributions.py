"""Distributions of a key: what the table [draw] of a campaign holds."""

from abc import abstractmethod
from dataclasses import MISSING, dataclass
from math import exp, log
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Len
from numpy.random import Generator

from dynamics.inputs import LARGEST_COUNT
from sato.scenario.definition import Definition, Field, NotNegative
from sato.scenario.errors import InputError
from sato.scenario.table import choose, read_table


class Distribution(Definition):
    """Distribution of the values of a key."""

    @abstractmethod
    def draw(self, rng: Generator) -> Any:
        """Draw a value, as a scenario file would have it."""


@dataclass(frozen=True, eq=False, repr=False)
class Uniform(Distribution):
    """Uniform distribution of numbers, of the logarithms of numbers, or of integers."""

    kind: Annotated[Literal["uniform", "log_uniform", "integers"], "numbers that are drawn"]
    low: Annotated[float, "least value"]
    high: Annotated[float, "largest value; of integers, it is drawn too"]

    def check(self) -> None:
        """Refuse limits in the wrong order, and those that the kind cannot have."""
        if self.kind == "log_uniform" and self.low <= 0:
            raise InputError("low", f"must be greater than 0, got {self.low:g}")
        for key, limit in {"low": self.low, "high": self.high}.items():
            if self.kind == "integers" and (limit % 1 or abs(limit) > LARGEST_COUNT):
                raise InputError(key, f"must be an integer, at most 1e9 in size, got {limit:g}")
        if self.low > self.high:
            raise InputError("high", f"must be at least low, {self.low:g}, got {self.high:g}")

    def draw(self, rng: Generator) -> float:
        """Draw a number."""
        if self.kind == "integers":
            return int(rng.integers(int(self.low), int(self.high), endpoint=True))
        if self.kind == "log_uniform":
            return exp(rng.uniform(log(self.low), log(self.high)))
        return float(rng.uniform(self.low, self.high))


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
class Choice(Distribution):
    """One of some values, each as likely as the others."""

    kind: ClassVar[str] = "choice"
    values: Annotated[tuple[Any, ...], Len(1), "values"]

    def draw(self, rng: Generator) -> Any:
        """Choose a value."""
        return self.values[rng.integers(len(self.values))]


_ANY = Field("draw", Uniform | Normal | Choice, MISSING)


def as_distribution(value: Any) -> Distribution:
    """Convert the table of a file, {"kind": "uniform", "low": 1.0, "high": 2.0}."""
    if isinstance(value, Distribution):
        return value
    found: Distribution = read_table(choose(_ANY, value), value)
    return found
