"""SYSTEM 2: formation flying. Gains → align → auction → steer → repeat [Lusk2020]."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.formation.assigning import Outcome, ask
from sato.formation.law import size_weights
from sato.formation.mission import FormationFlight
from sato.formation.supervisor import Phase, Supervisor
from sato.formation.swarm import Formed, Pace, Roles, State, Swarm
from sato.formation.swarm import fly as fly_steps


class Frame(NamedTuple):
    """One instant."""

    time: float  # [s]
    position: Float[Array, "agents 3"]  # [m]
    velocity: Float[Array, "agents 3"]  # [m/s]
    alive: Bool[Array, " agents"]
    component: Int[Array, " agents"]  # of the graph, which hangs together: 0
    velocity_command: Float[Array, "agents 3"]  # by the law, in the own frame [m/s]
    avoiding: Bool[Array, " agents"]
    point: Int[Array, " agents"]  # held
    leg: int  # number of the shape that is flown to
    phase: Phase  # as seen from outside
    path: Float[Array, " agents"]  # flown in the plane since the start [m]
    nearest: Float[Array, " agents"]  # that anybody ever came in the plane [m]
    drift: Float[Array, "agents 3"]  # error of the reckoning, in the own frame [m]
    events: tuple[dict[str, Any], ...]  # {"kind": …, "agents": […], …}; the record adds the time


def fly(mission: FormationFlight, rng: np.random.Generator) -> Iterator[Frame]:
    """Fly through all shapes, and yield the swarm every so many control steps.

    Ends early when the swarm has been stuck for too long, or the time is over.

    Args:
        mission: What is flown.
        rng: Draws noise, and which messages are lost.
    """
    return _Flight(mission, rng).frames()


class _Flight:
    def __init__(self, mission: FormationFlight, rng: np.random.Generator) -> None:
        self.mission, self.rng = mission, rng
        self.state = State.resting(mission.start, mission.radio.late)
        self.number = 0  # of the next control step
        self.leg = 0
        self.swarm = _swarm(mission, 0)
        self.point = np.arange(mission.agents)
        self.holder = np.tile(self.point, (mission.agents, 1))
        self.follows = np.zeros(mission.agents, dtype=bool)
        self.supervisor = self._supervisor()
        self.won: Outcome | None = None  # of an auction under way
        self.known = 0.0  # when all know it [s]
        self.auctions = 0  # held for this shape
        self.events: list[dict[str, Any]] = []

    @property
    def time(self) -> float:
        return self.number * self.mission.step

    def frames(self) -> Iterator[Frame]:
        yield self._frame()
        yield from self._hover()
        for leg in range(len(self.mission.shapes)):
            self._begin(leg)
            yield from self._transition()
            if self.supervisor.phase is not Phase.DONE:
                return
            yield from self._hover()

    def _begin(self, leg: int) -> None:
        everybody = list(range(self.mission.agents))
        self.leg, self.swarm = leg, _swarm(self.mission, leg)
        self.point = np.arange(self.mission.agents)
        self.holder = np.tile(self.point, (self.mission.agents, 1))
        self.follows[:] = False
        self.supervisor = self._supervisor()
        self.events.append({"kind": "leg_start", "leg": leg, "agents": everybody})

    def _hover(self) -> Iterator[Frame]:
        # Whoever has a shape goes on holding it.
        for _ in range(round(self.mission.protocol.hover / self.mission.sample)):
            self._step()
            yield self._frame()

    def _transition(self) -> Iterator[Frame]:
        way, began = self.mission.assigning, self.time
        if way.kind == "none":
            self._take(self.point, self.holder, 0)
        due = began + way.first if way.kind != "none" else np.inf
        over, self.won, self.auctions = False, None, 0
        while not over:
            if self.won is None and self.time >= due - 1e-9:
                self._auction()
                due = self.time + way.period
            if self.won is not None and self.time >= self.known - 1e-9:
                self._take(*self.won)
                self.won = None
            self._step()
            self._watch()
            over = self._over
            if over:
                self.events.append({"kind": self._ending, "leg": self.leg, "agents": []})
            yield self._frame()

    @property
    def _over(self) -> bool:
        ended = self.supervisor.phase in (Phase.DONE, Phase.GIVEN_UP)
        return ended or self.time >= self.mission.protocol.limit - 1e-9

    @property
    def _ending(self) -> str:
        return "leg_end" if self.supervisor.phase is Phase.DONE else "given_up"

    def _auction(self) -> None:
        found = ask(self.mission, self.leg, self.auctions, self.state, self._roles(), self.rng)
        self.auctions += 1
        held = {"leg": self.leg, "agents": [], "rounds": found.rounds}
        self.events.append({"kind": "auction", **held})
        # Messages take their time: until all know the end, they go on as they were.
        self.won, self.known = found, self.time + found.rounds / self.mission.radio.rate

    def _take(self, point: Array, holder: Array, rounds: int) -> None:
        changed = np.flatnonzero(point != self.point)
        if len(changed) or not self.follows.any():
            said = {"agents": changed.tolist(), "point": point.tolist(), "rounds": rounds}
            self.events.append({"kind": "assignment", **said})
        self.point, self.holder = point, holder
        self.follows[:] = True
        self.supervisor.assigned()

    def _watch(self) -> None:
        before = self.supervisor.phase
        speed = np.sqrt(np.einsum("ij,ij->i", self.state.command, self.state.command))
        now = self.supervisor.observe(speed, self.state.avoiding)
        if now is not before and Phase.GRIDLOCKED in (before, now):
            kind = "gridlock" if now is Phase.GRIDLOCKED else "gridlock_end"
            stuck = np.flatnonzero(self.state.avoiding).tolist()
            self.events.append({"kind": kind, "leg": self.leg, "agents": stuck})

    def _roles(self) -> Roles:
        pushed, push = -1, np.zeros(3)
        for p in self.mission.pushes:
            if p.start <= self.time < p.end:
                pushed, push = p.vehicle, p.velocity
        return Roles(self.point, self.holder, self.follows, pushed, push)

    def _step(self) -> None:
        every = self.mission.every
        fly_steps(self.state, self._roles(), self.swarm, self.number, every, self.rng)
        self.number += every

    def _frame(self) -> Frame:
        state, n = self.state, self.mission.agents
        events, self.events = tuple(self.events), []
        return Frame(
            time=self.time,
            position=state.position.copy(),
            velocity=state.velocity.copy(),
            alive=np.ones(n, dtype=bool),
            component=np.zeros(n, dtype=np.int64),
            velocity_command=state.command.copy(),
            avoiding=state.avoiding.copy(),
            point=self.point,
            leg=self.leg,
            phase=self.supervisor.phase,
            path=state.flown.copy(),
            nearest=state.nearest.copy(),
            drift=state.drifted.copy(),
            events=events,
        )

    def _supervisor(self) -> Supervisor:
        return Supervisor(self.mission.protocol, self.mission.sample, self.mission.agents)


def _swarm(mission: FormationFlight, leg: int) -> Swarm:
    gains, radio = mission.shapes[leg], mission.radio
    graph = gains.formation.graph
    degree = graph.sum(axis=1)
    # Row by row the neighbours first, in order; what is over is −1.
    order = np.argsort(~graph, axis=1, kind="stable")[:, : degree.max()]
    neighbours = np.where(np.arange(degree.max()) < degree[:, None], order, -1)
    if mission.law.printed:
        weight = graph.astype(float)
    else:
        weight = size_weights(graph)
    pace = Pace(
        mission.step, max(1, round(1 / (radio.rate * mission.step))), radio.late, radio.loss
    )
    formed = Formed(gains.xy, gains.z, gains.formation.points, neighbours, weight)
    return Swarm(formed, mission.frames, mission.law, mission.avoidance, mission.limits, pace)
