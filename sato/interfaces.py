"""Interfaces of a system: its frames, what is recorded of them, and how they are shown."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Generic,
    NamedTuple,
    Protocol,
    TypeVar,
    runtime_checkable,
)

from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from numpy.random import Generator

from dynamics.doors import checked
from sato.check.report import Report
from sato.run_data import RunData

if TYPE_CHECKING:  # slow to import, and not needed to simulate
    import matplotlib.figure

    from sato.scene import SwarmScene


class Recorded(NamedTuple):
    """Variable of the run file, as a field of its name declares it by type, unit and meaning.

        control: Annotated[Vectors, "m/s2", "commanded control", HELD]

    The axes of the array are its dimensions, on a field of a frame those beside time. A field
    that may be None is absent in some runs.
    """

    dims: tuple[str, ...]
    unit: str
    meaning: str
    is_optional: bool
    is_held: bool  # until the next instant, so that the last one has none
    dtype: type | None  # float, int or bool; None for names


HELD = "until the next instant"

Reals = Float[Array, " agent"]
Vectors = Float[Array, "agent axis"]
Indices = Int[Array, " agent"]
Pairs = Float[Array, "agent other"]

Time = Annotated[float, "s", "time since the start"]
Position = Annotated[Vectors, "m", "true position"]
Velocity = Annotated[Vectors, "m/s", "true velocity"]
Alive = Annotated[Bool[Array, " agent"], "1", "true where the agent takes part"]
Component = Annotated[Indices, "1", "connected component of the network, -1 where not alive"]
Events = tuple[dict[str, Any], ...]  # {"kind": …, "agents": […], …}; without the time


@runtime_checkable
class Frame(Protocol):
    """One recorded instant; every system adds fields of its own.

    A frame is a named tuple; annotated fields become variables of the run file (`Recorded`),
    and `sato.record.RunRecord` reads them back as the same type, with time as the leading axis.
    """

    @property
    def time(self) -> float:
        """Time since the start [s]."""

    @property
    def position(self) -> Float[Array, "agents d"]:
        """True position [m]."""

    @property
    def velocity(self) -> Float[Array, "agents d"]:
        """True velocity [m/s]."""

    @property
    def alive(self) -> Bool[Array, " agents"]:
        """True for agents that take part."""

    @property
    def component(self) -> Int[Array, " agents"]:
        """Connected component of the network; −1 while not alive."""

    @property
    def events(self) -> Events:
        """Events of this instant, {"kind": …, "agents": […], …}; the record adds the time."""


@checked
class MissionProgress(NamedTuple):
    """Progress of a simulation."""

    stage: str  # "leg 1 of 2"
    done: int  # steps
    total: int  # steps, as far as is known by now
    details: str = ""


FigureFactories = Mapping[str, Callable[[], "matplotlib.figure.Figure"]]

MissionT = TypeVar("MissionT")
FrameT = TypeVar("FrameT", bound=Frame)


@checked
@dataclass(frozen=True)
class System(Generic[MissionT, FrameT]):
    """Parts of a system, from which all else follows; missions are drawn ones."""

    name: str
    frame: type  # a named tuple with annotated fields
    # Yields a frame an instant; all random numbers are of the generator.
    simulate: Callable[[MissionT, Generator], Iterator[FrameT]]
    # Radii, limits and constants of a run.
    attributes: Callable[[MissionT], Mapping[str, float | str]]
    # Promises and summary, recomputed; the generator is as the drawing of the mission left it.
    check: Callable[[RunData, MissionT, Generator], Report]
    progress: Callable[[MissionT, FrameT], MissionProgress]
    figures: Callable[[RunData, MissionT], FigureFactories]  # by file name, in order
    scene: "Callable[[RunData, MissionT], SwarmScene] | None" = None  # as viewers show it
    run_variables: type | None = None  # named tuple with annotated fields: variables of a run
    collect: Callable[[Sequence[FrameT], MissionT], Any] | None = None  # their values
    promises: tuple[str, ...] = ()  # names of those of `check`
    stop_errors: tuple[type[Exception], ...] = ()  # may end a flight early without being a fault


def lazy(name: str) -> Callable[..., Any]:
    """Return a function, "module:function", that is imported when it is first called."""
    return lambda *args: resolve_name(name)(*args)
