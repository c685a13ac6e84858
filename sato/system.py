"""What a system is: the few things that it brings, by which all else goes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.check.report import Report

if TYPE_CHECKING:  # what takes long to load, and who flies need not
    import matplotlib.backends.backend_agg
    import matplotlib.figure
    import xarray


@runtime_checkable
class Frame(Protocol):
    """One instant. Every system has a frame of its own, which says more."""

    @property
    def time(self) -> float:
        """Since the start [s]."""

    @property
    def position(self) -> Float[Array, "agents d"]:
        """True position [m]."""

    @property
    def velocity(self) -> Float[Array, "agents d"]:
        """True velocity [m/s]."""

    @property
    def alive(self) -> Bool[Array, " agents"]:
        """Who takes part."""

    @property
    def component(self) -> Int[Array, " agents"]:
        """Connected component of the network; −1 while not alive."""

    @property
    def events(self) -> tuple[dict[str, Any], ...]:
        """{"kind": …, "agents": […], …}; the record adds the time."""


class Variable(NamedTuple):
    """What a run file says of one of its variables."""

    axes: tuple[str, ...]  # without "agent", it counts for the whole swarm
    unit: str
    meaning: str
    may_lack: bool = False  # not every run has it


class Passage(NamedTuple):
    """How far a flight has come, for who waits."""

    stage: str  # what the swarm is about: "leg 1 of 2"
    done: int  # steps
    total: int  # steps, as far as is known by now
    words: str = ""  # what else there is to say of the instant


@runtime_checkable
class Scene(Protocol):
    """What a film is taken of. Moments are numbers that only the scene understands."""

    @property
    def canvas(self) -> "matplotlib.backends.backend_agg.FigureCanvasAgg":
        """What is filmed."""

    def moments(self, most: int) -> Float[Array, " moments"]:
        """So many moments at most, evenly spaced in time."""

    def show(self, moment: float) -> None:
        """Draw the swarm as it is at a moment."""


Figures = Mapping[str, "Callable[[], matplotlib.figure.Figure]"]

M = TypeVar("M")
F = TypeVar("F", bound=Frame)


@dataclass(frozen=True)
class System(Generic[M, F]):
    """What a system brings: M is what it calls a mission, F its frame.

    Its scenario file makes the mission; it is in `sato.scenario` by the same name, see
    `sato.scenario.ScenarioFile`.
    """

    name: str
    fly: Callable[[M, np.random.Generator], Iterator[F]]  # a frame an instant; all chance from here
    outcomes: tuple[type[Exception], ...]  # what may end a flight early without being a fault
    meaning: Mapping[str, Variable]  # of its variables beyond `sato.record.COMMON`
    variables: Callable[[Sequence[F], M], dict[str, Array]]  # their values
    attributes: Callable[[M], dict[str, float]]  # radii, limits and constants of a run, in SI
    judge: Callable[["xarray.Dataset", M, np.random.Generator], Report]  # rng as `build` left it
    passage: Callable[[M, F], Passage]
    figures: Callable[["xarray.Dataset", M], Figures]  # by file name, in order
    scene: "Callable[[xarray.Dataset, M], Scene] | None" = None  # where there is a film
