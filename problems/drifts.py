"""Passive safety: motion without thrust from each step of a plan, and half-spaces about it.

A vehicle that loses all thrust at step k drifts on from x[k]. It is passively safe where each of
these drifts keeps a distance from the paths of all others, and from their free motion after it
[Guffanti2023]. About its nominal a drift is linear in x[k], so distances of drifts become
half-spaces on states, as those of paths do.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel
from dynamics.model import ControlSamples, StateSamples
from dynamics.trajectory_geometry import divide_pieces, division_matrices, hull_distance
from problems.convexify import AvoidanceHorizon, PassingSide, choose_normals
from problems.half_spaces import HalfSpaces
from problems.path_separation import are_balls_separated, are_hulls_separated
from problems.transfer import Trajectory

PARTS = 4  # into which pieces that come near are divided: hulls are wider than what they hold
NEARBY_FACTOR = 2.0  # times the distance: what comes nearer is constrained from the first
PLANNED_FACTOR = 1.002  # times the distance, which is planned: drifts are not quite linear
KEPT_FACTOR = 1.001  # times the distance, which is verified: pieces are not quite cubic

Paths = Float[Array, "others pieces 4 d"]
FreeMotion = Callable[[StateSamples, float, float], StateSamples]  # from a time [s], for a time [s]


class Drifts(NamedTuple):
    """Motion of a vehicle as planned, and without thrust from each step of the plan on."""

    path: Float[Array, "*agents pieces 4 d"]  # control points of the plan and of what follows [m]
    drifts: Float[Array, "*agents drifts 4 d"]  # of all pieces of all drifts [m]

    def take(self, rows: Any) -> "Drifts":
        """Return those of some agents, by index."""
        return Drifts(*(part[rows] for part in self))


class Encounters(NamedTuple):
    """Pieces of drifts in which another may come near."""

    other: Int[Array, " encounters"]
    row: Int[Array, " encounters"]  # of the piece among those of all drifts

    def join(self, more: "Encounters") -> "Encounters":
        """Return these and more, each once."""
        pairs = np.concatenate([np.stack(self), np.stack(more)], axis=1)
        return Encounters(*np.unique(pairs, axis=1))


@dataclass(frozen=True, eq=False)
class DriftHorizon:
    """Pieces of the time over which drifts are looked at: steps of the plan, and parts after it."""

    steps: AvoidanceHorizon  # of the plan, a piece each
    later: DiscreteModel  # of the time after it, about the reference
    move: FreeMotion
    time: float  # at which the plan begins [s]
    duration: float  # of a drift [s]
    distance: float  # to keep [m]

    @cached_property
    def lengths(self) -> Float[Array, " pieces"]:
        """Length of each piece [s]."""
        step = self.steps.discrete_model.dt
        return np.repeat([step, self.later.dt], [self.steps.steps, len(self.later)])

    @cached_property
    def begins(self) -> Float[Array, " pieces"]:
        """Time at which each piece begins [s]; after the plan the same whenever it is made."""
        T, dt = self.steps.steps, self.steps.discrete_model.dt
        later = (self.time + T * dt) + np.arange(len(self.later)) * self.later.dt
        return np.append(self.time + np.arange(T) * dt, later)

    @property
    def step(self) -> Int[Array, " drifts"]:
        """Step at which the thrust is lost, of each piece of a drift."""
        return self._pieces[0]

    @property
    def piece(self) -> Int[Array, " drifts"]:
        """Piece of time in which each piece of a drift is."""
        return self._pieces[1]

    @cached_property
    def _pieces(self) -> tuple[Int[Array, " drifts"], Int[Array, " drifts"]]:
        k, begins = np.arange(self.steps.steps)[:, None], self.begins
        ends = self.time + k * self.steps.discrete_model.dt + self.duration
        is_drift = (np.arange(len(begins)) >= k) & (begins < ends)
        step, piece = np.nonzero(is_drift)
        return step, piece

    @cached_property
    def _transitions(self) -> tuple[Float[Array, "instants n n"], Float[Array, "steps n n"]]:
        """Transition matrices from the first instant to all, and the inverses of those to steps."""
        found = [np.eye(self.later.A.shape[-1])]
        for A in np.concatenate([self.steps.discrete_model.A, self.later.A]):
            found.append(A @ found[-1])
        return np.stack(found), np.linalg.inv(np.stack(found[: self.steps.steps]))

    def follow(self, x: StateSamples, u: ControlSamples) -> Drifts:
        """Return the motion along plans, then free, and from each step without thrust."""
        d, pieces = u.shape[-1], np.arange(len(self.lengths))
        begin, end = self._move(x)
        k, p = self.step, self.piece
        drifts = _join(begin[..., k, p, :], end[..., k, p, :], self.lengths[p], d)
        last = np.minimum(pieces, self.steps.steps)  # from which step on the plan moves freely
        first, after = begin[..., last, pieces, :], end[..., last, pieces, :]
        count = min(self.steps.steps, u.shape[-2])
        after[..., :count, :] = x[..., 1 : count + 1, :]
        return Drifts(_join(first, after, self.lengths, d), drifts)

    def _move(
        self, x: StateSamples
    ) -> tuple[Float[Array, "*agents steps pieces n"], Float[Array, "*agents steps pieces n"]]:
        """Return the states at which pieces of free motion from each state begin, and end."""
        T, n = self.steps.steps, x.shape[-1]
        begin = np.zeros((*x.shape[:-2], T + 1, len(self.lengths), n))
        end, moving = np.zeros_like(begin), x[..., :0, :]
        for piece, (t, h) in enumerate(zip(self.begins, self.lengths, strict=True)):
            if piece <= T:
                own = x[..., piece, :] if piece < x.shape[-2] else moving[..., -1, :]
                moving = np.concatenate([moving, own[..., None, :]], axis=-2)
            count = moving.shape[-2]
            begin[..., :count, piece, :] = moving
            moving = self.move(moving, t, h)
            end[..., :count, piece, :] = moving
        return begin, end

    def predict(self, own: Drifts, nominal: Trajectory, plan: Trajectory) -> Drifts:
        """Return the motion along a plan near its nominal, by the linear model."""
        x, u, _ = plan
        moved = np.zeros((self.steps.steps, x.shape[-1]))
        count = min(len(u), len(moved))
        moved[:count] = x[:count] - nominal.x[:count]
        moves = np.einsum("rjdn,rn->rjd", self._all_maps, moved[self.step])
        path = own.path.copy()
        path[:count] = _join(x[:count], x[1 : count + 1], self.lengths[:count], u.shape[-1])
        return Drifts(path, own.drifts + moves)

    @cached_property
    def _all_maps(self) -> Float[Array, "drifts 4 d n"]:
        return self._drift_maps(np.arange(len(self.step)))

    def find_encounters(
        self, own: Drifts, others: Drifts, is_above: Bool[Array, " others"], factor: float
    ) -> tuple[Encounters, Encounters]:
        """Find where a vehicle or others drift nearer than the distance, times a factor.

        It keeps clear of the plans of those above and of their drifts. Of the rest it knows where
        they move freely after their plans, and where they drift from now on, which no control of
        theirs can change.

        The first are those of its drifts with the plans of others, the second of its plan with
        theirs.
        """
        is_now, is_planned = self.step == 0, self.piece < self.steps.steps
        known = is_above[:, None]
        relative = own.drifts - others.path[:, self.piece]
        of_drifts = self._find_near(relative, ~is_now & (known | ~is_planned), factor)
        relative = own.path[self.piece] - others.drifts
        return of_drifts, self._find_near(relative, is_planned & (known | is_now), factor)

    def find_near_paths(self, own: Drifts, paths: Paths) -> Encounters:
        """Find where a vehicle drifts nearer to whole paths than the distance that is kept.

        From now on it drifts as it does; others can only keep their plans clear of that.
        """
        relative = own.drifts - paths[:, self.piece]
        asked = (self.step > 0) | (self.piece < self.steps.steps)
        return self._find_near(relative, np.broadcast_to(asked, relative.shape[:2]), KEPT_FACTOR)

    def _find_near(self, relative: Array, is_asked: Array, factor: float) -> Encounters:
        radius = factor * self.distance
        other, row = np.nonzero(is_asked & ~are_balls_separated(relative, radius))
        parts = divide_pieces(relative[other, row], PARTS)
        near = ~are_hulls_separated(parts, radius).all(axis=1)
        return Encounters(other[near], row[near])

    def constrain(
        self,
        own: Drifts,
        others: Drifts,
        encounters: tuple[Encounters, Encounters],
        nominal: Trajectory,
        side: PassingSide = "same",
    ) -> HalfSpaces:
        """Constrain a plan so that it keeps the distance in encounters [Morgan2016, eq. 64].

        Args:
            own: Motion of the vehicle along its nominal.
            others: Motion of the others.
            encounters: Of its own drifts with plans of others, and of its plan with their drifts.
            nominal: Nominal.
            side: Side on which to pass.
        """
        of_drifts, of_plan = encounters
        (other, row), (met, theirs) = of_drifts, of_plan
        relative = own.drifts[row] - others.path[other, self.piece[row]]
        P, k = self._drift_maps(row), self.piece[theirs]
        rows = self._make_rows(of_drifts, self.step[row], relative, P, None, nominal, side)
        relative = own.path[k] - others.drifts[met, theirs]
        P, Q, _ = (part[k, 0] for part in self.steps.control_point_maps)
        return rows.join(self._make_rows(of_plan, k, relative, P, Q, nominal, side))

    def _drift_maps(self, rows: Int[Array, " rows"]) -> Float[Array, "rows 4 d n"]:
        """Return the matrices that take the state at which thrust is lost to control points."""
        piece, (to, back) = self.piece[rows], self._transitions
        n = to.shape[-1]
        third = (self.lengths[piece] / 3)[:, None, None]
        first, last = (to[piece + i] @ back[self.step[rows]] for i in (0, 1))
        p, v = slice(n // 2), slice(n // 2, n)
        points = first[:, p], first[:, p] + third * first[:, v], last[:, p] - third * last[:, v]
        return np.stack([*points, last[:, p]], axis=1)

    def _make_rows(
        self,
        encounters: Encounters,
        step: Int[Array, " rows"],
        relative: Float[Array, "rows 4 d"],
        P: Float[Array, "rows 4 d n"],
        Q: Float[Array, "rows 4 d m"] | None,
        nominal: Trajectory,
        side: PassingSide,
    ) -> HalfSpaces:
        x, u, _ = nominal
        points = divide_pieces(relative, PARTS)
        normal = np.empty((*points.shape[:2], points.shape[-1]))
        required = np.empty(len(points))
        for run in _list_runs(encounters, self.step):
            each = points[run].reshape(1, -1, *points.shape[2:])
            # What is kept already is enough: at the last steps hardly anything can change it.
            least = float(hull_distance(each)[0].min())
            kept = least >= KEPT_FACTOR * self.distance
            required[run] = min(PLANNED_FACTOR * self.distance, least if kept else np.inf)
            normal[run] = choose_normals(each, required[run[0]], side).reshape(normal[run].shape)
        movable = step < len(u)
        step, normal, points, P = step[movable], normal[movable], points[movable], P[movable]
        required = required[movable, None, None]
        weights = division_matrices(PARTS)[:, :, :, None] * normal[:, :, None, None]
        on_x = np.einsum("rsijd,rjdn->rsin", weights, P)
        rhs = required - np.einsum("rsd,rsid->rsi", normal, points)
        rhs += np.einsum("rsin,rn->rsi", on_x, x[step])
        on_u = np.zeros((*on_x.shape[:3], u.shape[-1]))
        if Q is not None:
            on_u = np.einsum("rsijd,rjdm->rsim", weights, Q[movable])
            rhs += np.einsum("rsim,rm->rsi", on_u, u[step])
        each = on_x.shape[1] * on_x.shape[2]
        on_x, on_u = (coeffs.reshape(-1, coeffs.shape[-1]) for coeffs in (on_x, on_u))
        return HalfSpaces(np.repeat(step, each), on_x, on_u, rhs.flatten())


def _join(first: Array, last: Array, length: Float[Array, " pieces"], d: int) -> Array:
    """Return the control points of pieces between two states."""
    third = (length / 3)[:, None]
    p, v = slice(d), slice(d, 2 * d)
    inner = first[..., p] + third * first[..., v], last[..., p] - third * last[..., v]
    return np.stack([first[..., p], *inner, last[..., p]], axis=-2)


def _list_runs(encounters: Encounters, step: Int[Array, " drifts"]) -> list[Int[Array, " rows"]]:
    """Group encounters that follow each other along one drift."""
    other, row = encounters
    if not len(other):
        return []
    order = np.lexsort((row, other))
    same = (np.diff(other[order]) == 0) & (np.diff(row[order]) == 1)
    same &= np.diff(step[row[order]]) == 0
    return np.split(order, 1 + np.flatnonzero(~same))
