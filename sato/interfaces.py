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

    dims: tuple[str, ...]  # without "agent", it counts for the whole swarm
    unit: str
    long_name: str
    optional: bool = False  # not every run has it


class MissionProgress(NamedTuple):
    """How far a flight has come, for who waits."""

    stage: str  # what the swarm is about: "leg 1 of 2"
    done: int  # steps
    total: int  # steps, as far as is known by now
    details: str = ""  # what else there is to say of the instant


@runtime_checkable
class Animation(Protocol):
    """What a film is taken of. Moments are numbers that only the scene understands."""

    @property
    def canvas(self) -> "matplotlib.backends.backend_agg.FigureCanvasAgg":
        """What is filmed."""

    def frame_positions(self, most: int) -> Float[Array, " frames"]:
        """So many moments at most, evenly spaced in time."""

    def draw_frame(self, moment: float) -> None:
        """Draw the swarm as it is at a moment."""


FigureFactories = Mapping[str, "Callable[[], matplotlib.figure.Figure]"]

MissionT = TypeVar("MissionT")
FrameT = TypeVar("FrameT", bound=Frame)


@dataclass(frozen=True)
class System(Generic[MissionT, FrameT]):
    """What a system brings: M is what it calls a mission, F its frame.

    Its scenario file makes the mission; it is in `sato.former` by the same name, see
    `sato.former.ScenarioFile`.
    """

    name: str
    simulate: Callable[
        [MissionT, np.random.Generator], Iterator[FrameT]
    ]  # a frame an instant; all chance from here
    stop_errors: tuple[type[Exception], ...]  # what may end a flight early without being a fault
    variable_definitions: Mapping[str, Variable]  # of its variables beyond `sato.record.COMMON`
    stack_variables: Callable[[Sequence[FrameT], MissionT], dict[str, Array]]  # their values
    attributes: Callable[
        [MissionT], dict[str, float]
    ]  # radii, limits and constants of a run, in SI
    check: Callable[
        ["xarray.Dataset", MissionT, np.random.Generator], Report
    ]  # rng as `build` left it
    progress: Callable[[MissionT, FrameT], MissionProgress]
    figures: Callable[["xarray.Dataset", MissionT], FigureFactories]  # by file name, in order
    animation: "Callable[[xarray.Dataset, MissionT], Animation] | None" = (
        None  # where there is a film
    )
