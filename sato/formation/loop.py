"""SYSTEM 2: formation flying. Gains → align → auction → steer → repeat [Lusk2020]."""

from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.formation.assignment import AssignmentResult, assign_points
from sato.formation.control_law import size_control_weights
from sato.formation.kernel import FormationData, FormationState, KernelParameters, Roles, Timing
from sato.formation.kernel import simulate_steps as fly_steps
from sato.formation.mission import Formation
from sato.formation.supervisor import Phase, Supervisor
from sato.interfaces import (
    FrameAlive,
    FrameComponent,
    FrameEvents,
    FramePosition,
    FrameTime,
    FrameVelocity,
    Recorded,
)


class FormationFrame(NamedTuple):
    """One instant."""

    time: FrameTime
    position: FramePosition
    velocity: FrameVelocity
    alive: FrameAlive
    component: FrameComponent  # of the graph, which is connected: 0
    velocity_command: Annotated[
        Float[Array, "agents 3"],
        Recorded(
            ("agent", "axis"),
            "m/s",
            "velocity that the control law commands, in the agent's own frame, before limits",
        ),
    ]
    avoiding: Annotated[
        Bool[Array, " agents"],
        Recorded(("agent",), "1", "true where the agent departs from its command to avoid others"),
    ]
    point_index: Annotated[
        Int[Array, " agents"],
        Recorded(("agent",), "1", "index of the formation point that the agent holds"),
    ]
    leg_index: Annotated[int, Recorded((), "1", "leg under way")]
    phase: Phase
    path_length: Float[Array, " agents"]  # flown in the plane since the start [m]
    min_separation: Float[Array, " agents"]  # least so far, in the plane [m]
    frame_drift: Annotated[
        Float[Array, "agents 3"],
        Recorded(("agent", "axis"), "m", "error of the agent's odometry, in its own frame"),
    ]
    events: FrameEvents


def simulate(mission: Formation, rng: np.random.Generator) -> Iterator[FormationFrame]:
    """Fly through all shapes, and yield the swarm every so many control steps.

    Ends early when the swarm has been stuck for too long, or the time is over.

    Args:
        mission: What is flown.
        rng: Draws noise, and which messages are lost.
    """
    return _Simulation(mission, rng).frames()


class _Simulation:
    def __init__(self, mission: Formation, rng: np.random.Generator) -> None:
        self.mission, self.rng = mission, rng
        self.state = FormationState.at_rest(mission.start, mission.radio.delay_rounds)
        self.step_index = 0  # of the next control step
        self.leg = 0
        self.parameters = _kernel_parameters(mission, 0)
        self.assignment = np.arange(mission.agents)
        self.holder = np.tile(self.assignment, (mission.agents, 1))
        self.is_active = np.zeros(mission.agents, dtype=bool)
        self.supervisor = self._make_supervisor()
        self.pending_result: AssignmentResult | None = None  # of an auction under way
        self.pending_until = 0.0  # when all know it [s]
        self.auction_count = 0  # held for this shape
        self.events: list[dict[str, Any]] = []

    @property
    def time(self) -> float:
        return self.step_index * self.mission.control_step

    def frames(self) -> Iterator[FormationFrame]:
        yield self._make_frame()
        yield from self._hover()
        for leg in range(len(self.mission.gains)):
            self._begin_leg(leg)
            yield from self._fly_leg()
            if self.supervisor.phase is not Phase.COMPLETED:
                return
            yield from self._hover()

    def _begin_leg(self, leg: int) -> None:
        everybody = list(range(self.mission.agents))
        self.leg, self.parameters = leg, _kernel_parameters(self.mission, leg)
        self.assignment = np.arange(self.mission.agents)
        self.holder = np.tile(self.assignment, (self.mission.agents, 1))
        self.is_active[:] = False
        self.supervisor = self._make_supervisor()
        self.events.append({"kind": "leg_start", "leg": leg, "agents": everybody})

    def _hover(self) -> Iterator[FormationFrame]:
        # Whoever has a shape goes on holding it.
        for _ in range(round(self.mission.supervision.hover_time / self.mission.frame_period)):
            self._advance()
            yield self._make_frame()

    def _fly_leg(self) -> Iterator[FormationFrame]:
        way, began = self.mission.assignment, self.time
        if way.method == "none":
            self._apply_assignment(self.assignment, self.holder, 0)
        due = began + way.first_delay if way.method != "none" else np.inf
        over, self.pending_result, self.auction_count = False, None, 0
        while not over:
            if self.pending_result is None and self.time >= due - 1e-9:
                self._start_auction()
                due = self.time + way.period
            if self.pending_result is not None and self.time >= self.pending_until - 1e-9:
                self._apply_assignment(*self.pending_result)
                self.pending_result = None
            self._advance()
            self._supervise()
            over = self._is_leg_over
            if over:
                self.events.append({"kind": self._leg_end_event, "leg": self.leg, "agents": []})
            yield self._make_frame()

    @property
    def _is_leg_over(self) -> bool:
        ended = self.supervisor.phase in (Phase.COMPLETED, Phase.ABORTED)
        return ended or self.time >= self.mission.supervision.time_limit - 1e-9

    @property
    def _leg_end_event(self) -> str:
        return "leg_end" if self.supervisor.phase is Phase.COMPLETED else "given_up"

    def _start_auction(self) -> None:
        found = assign_points(
            self.mission, self.leg, self.auction_count, self.state, self._roles(), self.rng
        )
        self.auction_count += 1
        held = {"leg": self.leg, "agents": [], "rounds": found.rounds}
        self.events.append({"kind": "auction", **held})
        # Messages take their time: until all know the end, they go on as they were.
        self.pending_result, self.pending_until = (
            found,
            self.time + found.rounds / self.mission.radio.message_rate,
        )

    def _apply_assignment(self, point: Array, holder: Array, rounds: int) -> None:
        changed = np.flatnonzero(point != self.assignment)
        if len(changed) or not self.is_active.any():
            said = {"agents": changed.tolist(), "point": point.tolist(), "rounds": rounds}
            self.events.append({"kind": "assignment", **said})
        self.assignment, self.holder = point, holder
        self.is_active[:] = True
        self.supervisor.mark_assigned()

    def _supervise(self) -> None:
        before = self.supervisor.phase
        speed = np.sqrt(
            np.einsum("ij,ij->i", self.state.velocity_command, self.state.velocity_command)
        )
        now = self.supervisor.observe(speed, self.state.avoiding)
        if now is not before and Phase.GRIDLOCKED in (before, now):
            kind = "gridlock" if now is Phase.GRIDLOCKED else "gridlock_end"
            stuck = np.flatnonzero(self.state.avoiding).tolist()
            self.events.append({"kind": kind, "leg": self.leg, "agents": stuck})

    def _roles(self) -> Roles:
        pushed, push = -1, np.zeros(3)
        for p in self.mission.operator_commands:
            if p.start <= self.time < p.end:
                pushed, push = p.agent, p.velocity
        return Roles(self.assignment, self.holder, self.is_active, pushed, push)

    def _advance(self) -> None:
        every = self.mission.steps_per_frame
        fly_steps(self.state, self._roles(), self.parameters, self.step_index, every, self.rng)
        self.step_index += every

    def _make_frame(self) -> FormationFrame:
        state, n = self.state, self.mission.agents
        events, self.events = tuple(self.events), []
        return FormationFrame(
            time=self.time,
            position=state.position.copy(),
            velocity=state.velocity.copy(),
            alive=np.ones(n, dtype=bool),
            component=np.zeros(n, dtype=np.int64),
            velocity_command=state.velocity_command.copy(),
            avoiding=state.avoiding.copy(),
            point_index=self.assignment,
            leg_index=self.leg,
            phase=self.supervisor.phase,
            path_length=state.path_length.copy(),
            min_separation=state.min_separation.copy(),
            frame_drift=state.drift.copy(),
            events=events,
        )

    def _make_supervisor(self) -> Supervisor:
        return Supervisor(self.mission.supervision, self.mission.frame_period, self.mission.agents)


def _kernel_parameters(mission: Formation, leg: int) -> KernelParameters:
    gains, radio = mission.gains[leg], mission.radio
    graph = gains.formation.graph
    degree = graph.sum(axis=1)
    # Row by row the neighbours first, in order; what is over is −1.
    order = np.argsort(~graph, axis=1, kind="stable")[:, : degree.max()]
    neighbours = np.where(np.arange(degree.max()) < degree[:, None], order, -1)
    if mission.control_law.legacy:
        weight = graph.astype(float)
    else:
        weight = size_control_weights(graph)
    pace = Timing(
        mission.control_step,
        max(1, round(1 / (radio.message_rate * mission.control_step))),
        radio.delay_rounds,
        radio.loss_probability,
    )
    formed = FormationData(gains.xy, gains.z, gains.formation.points, neighbours, weight)
    return KernelParameters(
        formed,
        mission.coordinate_frames,
        mission.control_law,
        mission.avoidance,
        mission.limits,
        pace,
    )
