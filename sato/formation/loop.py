"""Loop of a formation flight: align, auction, steer, repeat [Lusk2020]."""

from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.formation.assignment import AssignmentResult, assign_points
from sato.formation.control_law import size_control_weights
from sato.formation.kernel import (
    LIMITS,
    FormationData,
    FormationState,
    KernelParameters,
    MissionNumbers,
    Roles,
    Timing,
    simulate_steps,
)
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
    """Frame of a formation flight."""

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
    frame_drift: Annotated[
        Float[Array, "agents 3"],
        Recorded(("agent", "axis"), "m", "error of the agent's odometry, in its own frame"),
    ]
    events: FrameEvents


def simulate(mission: Formation, rng: np.random.Generator) -> Iterator[FormationFrame]:
    """Fly through all formations, and yield a frame every `mission.frame_period`.

    Ends early where the swarm has been gridlocked for too long, or the time is over.

    Args:
        mission: A drawn mission.
        rng: Generator for noise, wandering and lost messages.
    """
    return _Simulation(mission, rng).frames()


class _Simulation:
    def __init__(self, mission: Formation, rng: np.random.Generator) -> None:
        self.mission, self.rng = mission, rng
        self.state = FormationState.at_rest(mission.initial_positions, mission.radio.delay_rounds)
        self.step_index = 0  # of the next control step
        self.events: list[dict[str, Any]] = []
        self._reset(0)

    def _reset(self, leg: int) -> None:
        mission, n = self.mission, self.mission.agents
        self.leg, self.parameters = leg, _kernel_parameters(mission, leg)
        self.assignment = np.arange(n)
        self.holder = np.tile(self.assignment, (n, 1))
        self.is_active = np.zeros(n, dtype=bool)
        self.supervisor = Supervisor(mission.supervision, mission.frame_period, n)
        self.pending_result: AssignmentResult | None = None  # of an auction under way
        self.pending_until = 0.0  # when all know it [s]
        self.auction_count = 0  # on this leg

    @property
    def time(self) -> float:
        return self.step_index * self.mission.step

    def frames(self) -> Iterator[FormationFrame]:
        yield self._make_frame()
        yield from self._hover()
        for leg in range(len(self.mission.legs)):
            self._reset(leg)
            agents = list(range(self.mission.agents))
            self.events.append({"kind": "leg_start", "leg": leg, "agents": agents})
            yield from self._fly_leg()
            if self.supervisor.phase is not Phase.COMPLETED:
                return
            yield from self._hover()

    def _hover(self) -> Iterator[FormationFrame]:
        # Agents that have taken up a formation go on holding it.
        for _ in range(round(self.mission.supervision.hover_time / self.mission.frame_period)):
            self._advance()
            yield self._make_frame()

    def _fly_leg(self) -> Iterator[FormationFrame]:
        settings, due = self.mission.assignment, np.inf
        if settings.method == "none":
            self._apply_assignment(self.assignment, self.holder, 0)
        else:
            due = self.time + settings.first_delay
        over = False
        while not over:
            if self.pending_result is None and self.time >= due - 1e-9:
                self._start_auction()
                due = self.time + settings.period
            if self.pending_result is not None and self.time >= self.pending_until - 1e-9:
                self._apply_assignment(*self.pending_result)
                self.pending_result = None
            self._advance()
            self._supervise()
            over = self._is_leg_over
            if over:
                ended = self.supervisor.phase is Phase.COMPLETED
                kind = "leg_end" if ended else "given_up"
                self.events.append({"kind": kind, "leg": self.leg, "agents": []})
            yield self._make_frame()

    @property
    def _is_leg_over(self) -> bool:
        ended = self.supervisor.phase in (Phase.COMPLETED, Phase.ABORTED)
        return ended or self.time >= self.mission.supervision.time_limit - 1e-9

    def _start_auction(self) -> None:
        found = assign_points(
            self.mission, self.leg, self.auction_count, self.state, self._roles(), self.rng
        )
        self.auction_count += 1
        self.events.append(
            {"kind": "auction", "leg": self.leg, "agents": [], "rounds": found.rounds}
        )
        # Messages take time: until all know the outcome, agents go on as before.
        self.pending_result = found
        self.pending_until = self.time + found.rounds / self.mission.radio.message_rate

    def _apply_assignment(self, assignment: Array, holder: Array, rounds: int) -> None:
        changed = np.flatnonzero(assignment != self.assignment)
        if len(changed) or not self.is_active.any():
            said = {"agents": changed.tolist(), "point": assignment.tolist(), "rounds": rounds}
            self.events.append({"kind": "assignment", **said})
        self.assignment, self.holder = assignment, holder
        self.is_active[:] = True
        self.supervisor.mark_assigned()

    def _supervise(self) -> None:
        before, command = self.supervisor.phase, self.state.velocity_command
        speed = np.sqrt(np.einsum("ij,ij->i", command, command))
        now = self.supervisor.observe(speed, self.state.avoiding)
        if now is not before and Phase.GRIDLOCKED in (before, now):
            kind = "gridlock" if now is Phase.GRIDLOCKED else "gridlock_end"
            stuck = np.flatnonzero(self.state.avoiding).tolist()
            self.events.append({"kind": kind, "leg": self.leg, "agents": stuck})

    def _roles(self) -> Roles:
        agent, velocity = -1, np.zeros(3)
        for command in self.mission.operator_commands:
            if command.start <= self.time < command.end:
                agent, velocity = command.agent, np.array(command.velocity)
        return Roles(self.assignment, self.holder, self.is_active, agent, velocity)

    def _advance(self) -> None:
        steps = self.mission.steps_per_frame
        simulate_steps(self.state, self._roles(), self.parameters, self.step_index, steps, self.rng)
        self.step_index += steps

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
            frame_drift=state.drift.copy(),
            events=events,
        )


def _kernel_parameters(mission: Formation, leg: int) -> KernelParameters:
    gains, radio = mission.gains[leg], mission.radio
    graph = gains.formation.graph
    degree = graph.sum(axis=1)
    # Row by row the neighbors first, in order; the rest is −1.
    order = np.argsort(~graph, axis=1, kind="stable")[:, : degree.max()]
    neighbors = np.where(np.arange(degree.max()) < degree[:, None], order, -1)
    return KernelParameters(
        FormationData(
            gains.xy, gains.z, gains.formation.points, neighbors, size_control_weights(graph)
        ),
        mission.coordinate_frames,
        mission.control_law,
        mission.avoidance,
        MissionNumbers._make([*(getattr(mission, name) for name in LIMITS), mission.frames.noise]),
        Timing(
            mission.step,
            max(1, round(1 / (radio.message_rate * mission.step))),
            radio.delay_rounds,
            radio.loss_probability,
        ),
    )
