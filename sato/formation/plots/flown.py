"""What a run file holds, as the figures of this system read it."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.check.happened import Happened
from sato.formation.mission import FormationFlight

if TYPE_CHECKING:
    import xarray

Doing = Literal["hovering", "flying", "gridlock", "settled"]


class Span(NamedTuple):
    """What the swarm was about for a while."""

    doing: Doing
    start: float  # [s]
    end: float  # [s]


class Stretch(NamedTuple):
    """One leg as it was flown: from the call for a shape to the next."""

    leg: int
    first: int  # instant of the call
    last: int  # instant before the next, or the last of the run
    end: str  # "leg_end", "given_up", or "" where the run stopped before


@dataclass(frozen=True, eq=False)
class Flown:
    """A run as recorded, and the mission rebuilt from its scenario."""

    mission: FormationFlight
    time: Float[Array, " instants"]  # [s]
    position: Float[Array, "instants agents 3"]  # [m]
    velocity: Float[Array, "instants agents 3"]  # [m/s]
    command: Float[Array, "instants agents 3"]  # by the law, in the own frame [m/s]
    avoiding: Bool[Array, "instants agents"]
    point: Int[Array, "instants agents"]
    leg: Int[Array, " instants"]
    drift: Float[Array, "instants agents 3"]  # error of the reckoning, in the own frame [m]
    happened: Happened

    @classmethod
    def of(cls, data: "xarray.Dataset", mission: FormationFlight) -> "Flown":
        """Read a run's data."""

        def numbers(name: str) -> Array:
            return np.asarray(data[name], dtype=float)

        return cls(
            mission=mission,
            time=numbers("time"),
            position=numbers("position"),
            velocity=numbers("velocity"),
            command=numbers("velocity_command"),
            avoiding=np.asarray(data["avoiding"], dtype=bool),
            point=np.asarray(data["point"]),
            leg=np.asarray(data["leg"]),
            drift=numbers("frame_drift"),
            happened=Happened.of(data),
        )

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """The legs that were begun, in order."""
        ends = {e["leg"]: e["kind"] for _, e in self.happened.told("leg_end", "given_up")}
        begun = [(k, int(e["leg"])) for k, e in self.happened.told("leg_start")]
        last = [k - 1 for k, _ in begun[1:]] + [len(self.time) - 1]
        return tuple(
            Stretch(leg, first, k, ends.get(leg, ""))
            for (first, leg), k in zip(begun, last, strict=True)
        )

    @cached_property
    def spans(self) -> tuple[Span, ...]:
        """What the swarm was about from the start to the end, without gaps."""
        now: Doing = "hovering"
        since, found = float(self.time[0]), list[Span]()
        for event in self.happened.events:
            then = _AFTER.get(event["kind"], now)
            if event["kind"] == "assignment" and now != "hovering":
                continue  # not the first of a leg
            if then != now:
                found.append(Span(now, since, float(event["time"])))
                now, since = then, float(event["time"])
        found.append(Span(now, since, float(self.time[-1])))
        return tuple(span for span in found if span.end > span.start)

    @cached_property
    def under_way(self) -> Bool[Array, " instants"]:
        """Whether a shape is flown to, or held."""
        found = np.zeros(len(self.time), dtype=bool)
        for stretch in self.stretches:
            found[self.begun(stretch) : stretch.last + 1] = True
        return found

    def begun(self, stretch: Stretch) -> int:
        """The instant from which a shape is flown to; the last of the leg where it never is."""
        taken = [k for k, _ in self.happened.told("assignment")]
        return min((k for k in taken if k >= stretch.first), default=stretch.last)

    def called(self, leg: int) -> str:
        """The name of a leg's shape, without that of its group; it may have none."""
        return self.mission.shapes[leg].formation.name.rpartition("/")[2]


_AFTER: dict[str, Doing] = {
    "leg_start": "hovering",
    "assignment": "flying",
    "gridlock": "gridlock",
    "gridlock_end": "flying",
    "leg_end": "settled",
}


def thinned(count: int, most: int) -> Int[Array, " kept"]:
    """So many of the first numbers at most, evenly spaced, first and last among them."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(int))
