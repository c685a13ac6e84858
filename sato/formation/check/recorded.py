"""Record of a flight, the course that it must have taken, and its summary."""

from functools import cached_property
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array

from problems.alignment import compute_shape_error
from problems.gain_matrix import GainMatrix
from sato.check import common
from sato.formation.loop import FormationFrame
from sato.formation.mission import Formation
from sato.formation.record import GAIN_PARTS, FormationVariables
from sato.formation.supervisor import FlightCourse, Phase, find_blocked
from sato.record import RunRecord
from sato.summary import format_value


class FormationLegRecord(NamedTuple):
    """Instants of one leg."""

    leg: int
    first_instant: int  # the one after the start of the leg
    end_instant: int  # the formation is taken up or given up; the last where it never is
    last_instant: int  # the one before the next leg, or the last
    completed: bool  # the formation is taken up, by the supervisor


class Replay(NamedTuple):
    """Course that a flight must have taken by the recorded commands and avoidance."""

    leg: Int[Array, " instants"]  # −1 after the flight had to be over
    phase: tuple[Phase, ...]  # at each instant until then
    events: tuple[tuple[int, str, int], ...]  # instant, kind and leg
    legs: tuple[FormationLegRecord, ...]
    is_complete: bool  # True where the flight had to be over at the last instant


class FormationRecord(RunRecord[Formation, FormationFrame, FormationVariables]):
    """A flight as recorded, and the mission as drawn again from its scenario."""

    @cached_property
    def replay(self) -> Replay:
        """Course that the flight had to take by the recorded commands and avoidance."""
        course = _RecordedCourse(self)
        instants, leg = course.instants(), np.full(len(self.time), -1)
        phase, noted = list[Phase](), list[tuple[int, str, int]]()
        for k, events in enumerate(islice(instants, len(self.time))):
            leg[k] = course.leg
            phase.append(course.phase)
            noted += [(k, event["kind"], event["leg"]) for event in events]
        is_complete = len(phase) == len(self.time) and next(instants, None) is None
        last = len(phase) - 1  # the last instant that there had to be
        starts = [k for k, kind, _ in noted if kind == "leg_start"]
        ends = [(k, kind == "leg_end") for k, kind, _ in noted if kind in ("leg_end", "given_up")]
        if len(ends) < len(starts):
            ends.append((last, False))
        until = [*(k - 1 for k in starts[1:]), last]
        legs = tuple(
            FormationLegRecord(number, starts[number], end, until[number], completed)
            for number, (end, completed) in enumerate(ends)
        )
        return Replay(leg, tuple(phase), tuple(noted), legs, is_complete)

    @cached_property
    def closest_approach(self) -> common.ClosestPair:
        """Closest two vehicles in the plane, on straight lines between the instants."""
        return common.find_closest_approach(self.frames.position[..., :2], self.frames.alive)

    def load_gains(self, leg: int) -> GainMatrix:
        """Return the recorded gains; refuse those that are not stable for the scenario's leg."""
        if tuple(self.variables.part) != GAIN_PARTS:
            raise ValueError(f"gains have the parts {', '.join(GAIN_PARTS)}, in this order")
        real, imaginary, z = self.variables.gains[leg]
        formation = self.mission.gains[leg].formation
        return GainMatrix(formation, real + 1j * imaginary, z, "recorded", np.inf, np.inf)


class _RecordedCourse(FlightCourse):
    # Reads what the loop computes, as far as it was recorded.
    def __init__(self, record: FormationRecord) -> None:
        super().__init__(record.mission)
        self.frames, self.auctions = record.frames, iter(record.events.of_kind("auction"))

    def hold_auction(self) -> int:
        _, event = next(self.auctions, (0, {"rounds": 0}))
        return int(event["rounds"])

    def advance(self) -> tuple[Array, Array]:
        k = min(self.instant + 1, len(self.frames.avoiding) - 1)
        frames = self.frames
        blocked = find_blocked(self.mission, frames.velocity[k], frames.avoiding[k])
        return frames.velocity_command[k], blocked


def summarize_flight(record: FormationRecord) -> dict[str, Any]:
    """Summarize a flight, without the entries that the runs of every system have."""
    mission = record.mission
    legs = [summarize_leg(record, leg) for leg in record.replay.legs]
    gridlocked = record.replay.phase[:-1].count(Phase.GRIDLOCKED)
    errors = [leg["shape_error_m"] for leg in legs if "shape_error_m" in leg]
    rounds = [int(event["rounds"]) for _, event in record.events.of_kind("auction")]
    return common.drop_non_finite(
        {
            "reached": not find_faults(record),
            "shape_error_m": max(errors, default=np.nan),
            **{key: sum(leg[key] for leg in legs) for key in ("path_m", "time_s", "reassignments")},
            "gridlocked_s": gridlocked * mission.frame_period,
            "bytes_per_vehicle_s": received_bit_rate(record) / 8,
            "longest_auction_s": max(rounds, default=0) / mission.radio.message_rate,
            "min_separation_m": record.closest_approach.distance,
            "keep_out_m": mission.keep_out,
            "gains_rate": min_convergence_rate(record),
            "legs": legs,
        }
    )


def summarize_leg(record: FormationRecord, leg: FormationLegRecord) -> dict[str, Any]:
    """Summarize one leg.

    Path and time count from the first assignment until the formation is taken up or given up;
    the path is in the plane, the mean of all vehicles, as in [Lusk2020]. The shape error is
    measured after hovering in the formation, at the last instant before the next leg.
    """
    mission = record.mission
    k = np.arange(leg.first_instant, leg.end_instant + 1)
    k = k[[record.replay.phase[i] is not Phase.WAITING for i in k]]
    steps = record.frames.position[k] - record.frames.position[k - 1]
    flown = np.linalg.norm(steps[..., :2], axis=2)
    assigned = [i for i, _ in record.events.of_kind("assignment")]
    summary: dict[str, Any] = {
        "success": False,
        "time_s": len(k) * mission.frame_period,
        "path_m": float(flown.mean(axis=1).sum()),
        "reassignments": sum(leg.first_instant <= i <= leg.end_instant for i in assigned),
    }
    held = record.frames.point_index[leg.last_instant]
    position = record.frames.position[leg.last_instant, np.argsort(held)]
    is_whole = np.array_equal(np.sort(held), np.arange(len(held)))  # no two hold one point
    if is_whole and np.isfinite(position).all():
        points = mission.gains[leg.leg].formation.points
        shape = compute_shape_error(position, points)
        error = shape.upright if mission.control_law.upright else min(shape)
        summary["success"] = leg.completed and error <= mission.supervision.shape_tolerance
        summary |= {"shape_error_m": shape.error, "inverted": shape.inverted}
    return common.drop_non_finite(summary)


def find_faults(record: FormationRecord) -> list[str]:
    """Describe why formations were not taken up, one a leg that was not."""
    legs, limit = record.replay.legs, record.mission.supervision.shape_tolerance
    found = []
    for leg in legs:
        summary, name = summarize_leg(record, leg), f"leg {leg.leg + 1}"
        if not leg.completed:
            found.append(f"{name}, not taken up by {record.time[leg.end_instant]:g} s")
        elif not summary["success"]:
            error = summary.get("shape_error_m", np.nan)
            off = f"shape error {format_value(error, limit)} m (tolerance {limit:g} m)"
            found.append(f"{name}, {off}" + ", upside down" * bool(summary.get("inverted")))
    return found + [
        f"leg {k + 1} did not begin" for k in range(len(legs), len(record.mission.legs))
    ]


def received_bit_rate(record: FormationRecord) -> float:
    """Return the bits a second that a vehicle receives, mean of all over the whole flight."""
    mission, radio = record.mission, record.mission.radio
    degree = [float(gains.formation.graph.sum(axis=1).mean()) for gains in mission.gains]
    poses = sum(degree[leg] for leg in record.leg_index[1:])
    bits = poses * radio.localization_rate * mission.frame_period
    for _, event in record.events.of_kind("auction"):
        rounds = int(event["rounds"])
        bits += degree[event["leg"]] * radio.count_auction_bits(mission.agents, rounds)
    time = (len(record.time) - 1) * mission.frame_period
    return bits / time if time > 0 else np.nan


def min_convergence_rate(record: FormationRecord) -> float:
    """Return the least rate of the recorded gains [1/s]; NaN where they are not stable."""
    try:
        legs = range(len(record.mission.legs))
        return min(record.load_gains(leg).convergence_rate for leg in legs)
    except ValueError:
        return np.nan
