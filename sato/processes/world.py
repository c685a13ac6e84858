"""World of the vehicles: their true states, losses and joins, and the record of the flight.

In each vehicle's place it knows what that reports for the record. Of this, the world uses the
controls that are held, and what is committed to where a vehicle joins.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.network.graph import CommunicationGraph
from sato.obstacles import Obstacle, Polytope
from sato.processes.messages import Status
from sato.reconfiguration.disturbances import draw_losses
from sato.reconfiguration.first_commitment import Traffic, find_first_commitments
from sato.reconfiguration.leg import longest_leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import Event, ReconfigurationFrame, begin_memory
from sato.reconfiguration.stopping import Commitments, controls_at
from sato.reconfiguration.surroundings import Sensed, find_surroundings


class World:
    """True states of all vehicles, and what is recorded of them."""

    def __init__(self, mission: Reconfiguration, rng: np.random.Generator) -> None:
        self.mission, self.rng = mission, rng
        self.leg_index = self.step_index = self.leg_start = 0
        self.x, self.alive = mission.initial_states.copy(), mission.alive
        self.surroundings = find_surroundings(mission)
        self.committed: Commitments = dict(find_first_commitments(mission))
        self.intended: Commitments = {}  # what is flown from a later instant on
        self.waiting: list[int] = []  # vehicles that join as soon as there is room
        self.restarted: set[int] = set()  # those of them whose processes were started again
        self.lost: set[int] = set()  # vehicles that have been lost
        self.status: dict[int, Status] = {}  # last report of each that is there
        self.new_reports: set[int] = set()  # vehicles that have reported at this instant
        believed = np.where(self.alive, mission.target_count or int(self.alive.sum()), 1)
        begun = begin_memory(mission, mission.legs[0], believed)
        self.target_index, self.target_count = begun.target_index, begun.target_count.copy()
        self.left_out: set[int] = set()  # targets that some know to be blocked
        self.events: list[Event] = []  # since the last frame

    @property
    def time(self) -> float:
        """Time since the start of the mission [s]."""
        return self.step_index * self.mission.step

    @property
    def leg_step(self) -> int:
        """Steps since the start of the leg."""
        return self.step_index - self.leg_start

    @property
    def live(self) -> list[int]:
        """Numbers of the vehicles that are there."""
        return [int(i) for i in np.flatnonzero(self.alive)]

    def note(self, kind: str, agents: Any, **more: object) -> None:
        """Note an event of some vehicles."""
        self.events.append({"kind": kind, "agents": sorted(map(int, agents)), **more})

    def connect(self) -> CommunicationGraph:
        """Connect all vehicles that are there and within hearing."""
        position = self.x[:, : self.mission.axes]
        return CommunicationGraph.from_positions(position, self.mission.comm_radius, self.alive)

    def begin_leg(self, number: int) -> None:
        """Begin a leg."""
        self.leg_index, self.leg_start, self.left_out = number, self.step_index, set()
        self.target_index = np.full(len(self.x), -1)
        self.note("leg_start", self.live, leg=number)

    def end_leg(self) -> bool:
        """End the leg if it is over; return True if so."""
        steps = self.mission.legs[self.leg_index].steps
        longest = longest_leg(steps, self.mission.lag_steps)
        is_given_up = self.leg_step == longest
        if not (is_given_up or (self.leg_step > 0 and self._is_leg_over())):
            return False
        if is_given_up:
            what = f"the leg is given up after {longest} steps"
            self.note("infeasible", self.live, what=what)
        waiting = [i for i in self.waiting if i not in self.restarted]
        if self.leg_index == len(self.mission.legs) - 1 and waiting:
            self.note("refused", waiting)
        held, counts = self.target_index.tolist(), self.target_count.tolist()
        component = self.connect().component.tolist()
        ended = {"target": held, "believed": counts, "component": component}
        self.note("leg_end", self.live, leg=self.leg_index, **ended)
        return True

    def _is_leg_over(self) -> bool:
        """Tell whether all have arrived; over a network, whether they know it of each other."""
        each = [self.status[i] for i in self.live if i in self.status]
        if not self.mission.lag_steps:
            return self._have_arrived()
        is_between = self.leg_step % self.mission.lag_steps
        is_over = all(own.is_leg_over or own.leg > self.leg_index for own in each)
        return not is_between and len(each) == len(self.live) and is_over

    def _have_arrived(self) -> bool:
        # Vehicles whose last plans are not clear may not be where their clocks have them.
        steps, reports = self.mission.legs[self.leg_index].steps, self.status
        is_due = any(at > self.leg_step for _, at in self.mission.joining(self.leg_index))
        if is_due or not all(i in reports for i in self.live):
            return False
        nobody = self._traffic._replace(alive=np.zeros_like(self.alive), committed={})
        if not all(map(nobody.has_room, self.waiting)):  # something that passes by is in the way
            return False
        each = [reports[i] for i in self.live]
        return all(own.has_plan and own.clock + 1 >= steps for own in each)

    @property
    def _traffic(self) -> Traffic:
        own = self.alive, self.committed, self.step_index, self.surroundings
        return Traffic(self.mission, self._states_to_join, *own)

    @property
    def _states_to_join(self) -> Float[Array, "agents n"]:
        """States of all; of those whose processes were started again, that at the start."""
        again = np.isin(np.arange(len(self.x)), list(self.restarted))
        return np.where(again[:, None], self.mission.initial_states, self.x)

    def take_up(self) -> None:
        """Fly from now on what was intended for this instant."""
        due = [i for i, own in self.intended.items() if own.first_step <= self.step_index]
        self.committed |= {i: self.intended.pop(i) for i in due}

    def admit_joins(self) -> list[int]:
        """Return the vehicles that join now: over a network, when others decide."""
        mission, k = self.mission, self.leg_step
        for agents, at_step in mission.joining(self.leg_index):
            self.waiting += agents if at_step == k else []
        if mission.lag_steps and k % mission.replan_steps:
            return []
        joined = self._traffic.admit(self.waiting)
        enters = np.isin(np.arange(len(self.x)), joined)
        self.x = np.where(enters[:, None], self._states_to_join, self.x)
        alone = begin_memory(mission, mission.legs[self.leg_index], np.ones_like(self.target_count))
        self.target_count[joined] = alone.target_count[joined]
        self.alive = self.alive | enters
        again = [i for i in joined if i in self.restarted]
        waits = [i for i in self.waiting if mission.waits[i] or i in self.restarted]
        refused = [i for i in self.waiting if not (self.alive[i] or i in waits)]
        self.waiting = [i for i in waits if not self.alive[i]]
        self.restarted.difference_update(again)
        first = [i for i in joined if i not in again]
        for kind, those in (("join", first), ("refused", refused)):
            if those:
                self.note(kind, those)
        if again:
            self.note("join", again, cause="process")
        return joined

    def apply_losses(self) -> list[int]:
        """Return the vehicles that the mission loses now."""
        mission, found = self.mission, list[int]()
        for loss in mission.legs[self.leg_index].losses:
            if loss.at_step == self.leg_step:
                lost = draw_losses(loss, self.x[:, : mission.axes], self.alive, self.rng)
                self._remove(lost)
                event: dict[str, object] = {}
                if loss.body == "coast" and self.surroundings is not None:
                    gone = sorted(lost)
                    self.surroundings = self.surroundings.with_lost(gone, self.x[gone])
                    event = {"body": "coast"}
                self.note("loss", lost, **event)
                found += lost
        return found

    def lose(self, agents: list[int]) -> None:
        """Lose vehicles whose processes have ended."""
        lost = [i for i in agents if self.alive[i]]
        self.waiting = [i for i in self.waiting if i not in agents]
        if lost:
            self._remove(lost)
            self.note("loss", lost, cause="process")

    def _remove(self, lost: list[int]) -> None:
        self.alive = self.alive & ~np.isin(np.arange(len(self.x)), lost)
        self.target_index = np.where(self.alive, self.target_index, -1)
        self.lost.update(lost)
        self.new_reports.difference_update(lost)
        for i in lost:
            self.status.pop(i, None)
            self.committed.pop(i, None)
            self.intended.pop(i, None)

    def restart(self, agent: int) -> None:
        """Let a lost vehicle whose process was started again wait for room where it started."""
        if agent in self.lost and not self.alive[agent] and agent not in self.waiting:
            self.restarted.add(agent)
            self.waiting.append(agent)

    def look_around(self, silent: Sequence[int] = ()) -> dict[int, tuple[Sensed, ...]]:
        """Return what each vehicle has seen so far and its mission does not list, as it is now.

        Those that are there and say nothing are seen by others where they are near.
        """
        seen, d = self._look_at_bodies(), self.mission.axes
        for j in silent:
            away = np.linalg.norm(self.x[:, :d] - self.x[j, :d], axis=1)
            for i in np.flatnonzero(self.alive & (away <= self.mission.sight)).tolist():
                if i != j:
                    seen[i] = (*seen.get(i, ()), (j, self.x[j]))
        return seen

    def _look_at_bodies(self) -> dict[int, tuple[Sensed, ...]]:
        if self.surroundings is None:
            return {}
        around = self.surroundings = self.surroundings.seen_from(self.mission, self.x)
        hidden = [one for one in self.mission.obstacles if not one.known]
        lost = around.vehicle[around.is_lost].tolist()
        first = len(around.state) - len(hidden) - len(lost)
        now: list[Sensed] = [move(one, self.time) for one in hidden]
        now += [(i, self.x[i]) for i in lost]
        return {
            i: tuple(now[n - first] for n in np.flatnonzero(around.is_known[i]) if n >= first)
            for i in self.live
        }

    def take_reports(
        self, reports: dict[int, Status], late: Collection[int] = ()
    ) -> Float[Array, "agents d"]:
        """Take in what vehicles report at an instant, and return the controls that they hold.

        Those that do not report, or too late, fly what they have committed to.
        """
        before, self.new_reports = self.target_index, set(reports)
        held = self.alive & np.isin(np.arange(len(self.x)), list(self.committed))
        control = controls_at(self.committed, self.step_index, held, self.mission)
        self.status |= reports
        self.target_index = np.where(self.alive, before, -1)
        for i, own in reports.items():
            self.target_index[i], self.target_count[i] = own.target_index, own.target_count
            if i not in late:
                control[i] = own.control
                if own.commitment is not None:
                    self.committed[i] = own.commitment
        self._note_decisions(reports, self.alive & (self.target_index != before))
        return control

    def _note_decisions(self, reports: dict[int, Status], moved: Bool[Array, " agents"]) -> None:
        if any(own.decides for own in reports.values()):
            solves = sum(own.solves for own in reports.values())
            self.note("replan", (), solves=solves)
        joined = {i for event in self.events if event["kind"] == "join" for i in event["agents"]}
        closed = [i for i, own in reports.items() if own.calls and i not in joined]
        if closed:
            self.note("closed", closed)
        blocked = {t for own in reports.values() for t in own.blocked} - self.left_out
        if blocked:
            agents = [i for i, own in reports.items() if blocked.intersection(own.blocked)]
            self.note("blocked", agents, targets=sorted(blocked))
            self.left_out |= blocked
        if moved.any():
            others = np.flatnonzero(moved)
            self.note("assignment", others, target=self.target_index[others].tolist())
        self.events += merge_events([event for own in reports.values() for event in own.events])

    def fly(self, control: Float[Array, "agents d"], applied: Float[Array, "agents d"]) -> None:
        """Fly one step under the controls that act."""
        mission, around = self.mission, self.surroundings
        acting = np.nan_to_num(applied)
        flown = mission.flown_plant.propagate(self.x, acting, self.time, mission.step)
        moves = self.alive.copy()
        if around is not None:
            moves[around.vehicle[around.is_lost]] = True
        self.x = np.where(moves[:, None], flown[1], self.x)
        self.surroundings = around and around.after(mission, self.x)
        self.step_index += 1
        steps = mission.legs[self.leg_index].steps
        arrived = [i for i in self.new_reports if self.status[i].clock + 1 == steps]
        if arrived:
            self.note("arrival", arrived)

    def make_frame(
        self,
        control: Float[Array, "agents d"] | None = None,
        applied: Float[Array, "agents d"] | None = None,
        measured: Float[Array, "agents n"] | None = None,
    ) -> ReconfigurationFrame:
        """Record this instant, and the events since the last one."""
        d, events = self.mission.axes, tuple(self.events)
        self.events = []
        none = np.full((len(self.x), d), np.nan)
        seen = measured if self.mission.position_noise or self.mission.velocity_noise else None
        return ReconfigurationFrame(
            time=self.time,
            position=self.x[:, :d],
            velocity=self.x[:, d:],
            alive=self.alive,
            component=self.connect().component,
            control=none if control is None else control,
            applied_control=none if applied is None else applied,
            leg_index=self.leg_index,
            target_index=self.target_index,
            target_count=self.target_count.copy(),
            measured_position=None if seen is None else seen[:, :d],
            measured_velocity=None if seen is None else seen[:, d:],
            rounds=None,
            received=None,
            events=events,
        )


def merge_events(events: list[Event]) -> list[Event]:
    """Return events with the agents of all that differ in nothing else together."""
    found: dict[str, Event] = {}
    for event in events:
        rest = repr({name: value for name, value in event.items() if name != "agents"})
        agents = found[rest]["agents"] if rest in found else []
        found[rest] = event | {"agents": sorted({*agents, *event["agents"]})}
    return list(found.values())


def move(obstacle: Obstacle, time: float) -> Obstacle:
    """Return an obstacle as it is at a time [s]."""
    place = obstacle.place_at(time)
    if isinstance(obstacle, Polytope):
        points = obstacle.corners + place
        return replace(obstacle, points=points, normals=None, offsets=None)
    way = place - obstacle.place
    moved: dict[str, Any] = {
        name: tuple((np.array(getattr(obstacle, name)) + way).tolist())
        for name in ("center", "low", "high")
        if hasattr(obstacle, name)
    }
    return replace(obstacle, **moved)
