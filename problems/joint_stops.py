"""Stops of several vehicles at once, clear of each other and of bodies in motion.

Sequential convex programming [Morgan2016, Sec. IV], with the controls of all in one program: where
hardly any room is left, one can give way only if others do.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.sparse import block_array, csc_array, csr_array, diags_array, eye_array

from problems.conic import ConicProgram
from problems.convexify import SEPARATION_TOLERANCE, AvoidanceHorizon, choose_normals
from problems.limit import Limit
from problems.obstacle_paths import ObstaclePaths, measure_gaps, support_obstacles
from problems.path_separation import enclosing_balls
from problems.solvers.verified import solve_program
from problems.sparse_rows import stack_diagonally

CHANGE_WEIGHT = 1e-2  # of the square of a change at the limit, for a step
SLACK_WEIGHT = 30.0  # of a lack of the whole distance
NEAR = 3.0  # of the distance: pieces that are farther apart have no half-spaces
ACTIVE = 0.1  # of the distance: half-spaces with less room are in the first program
VIOLATED = 1e-7  # of the distance: half-spaces that lack more are added
FAST = 0.5  # of the speed limit, from which on it is in the program
MAX_PROGRAMS = 5  # in which half-spaces are added
FULL_BLOCKS, GROWTH = 5, 1.25  # steps with a control of their own; length of each later block

States = Float[Array, "vehicles instants n"]
Controls = Float[Array, "vehicles T m"]
Paths = Float[Array, "vehicles pieces 4 d"]  # control points
Limits = list[tuple[Any, Array]]  # rows, and right-hand sides, of each kind
Rooms = Float[Array, "rows 4"]  # of the control points of pieces, over the distance


class StoppingVehicle(NamedTuple):
    """Vehicle that stops, with its limits, and what it has to avoid."""

    state: Float[Array, " n"]
    u: Float[Array, "T m"]  # from which controls should differ by little
    control_limit: Limit
    speed_limit: Limit
    steps: int  # until it rests
    obstacles: ObstaclePaths | None


class NearPieces(NamedTuple):
    """Pieces of trajectories, and the half-spaces that their control points have to keep."""

    first: Int[Array, " rows"]  # vehicle
    second: Int[Array, " rows"]  # another vehicle; −1 for an obstacle
    group: Int[Array, " rows"]  # of pieces of the same two
    piece: Int[Array, " rows"]
    normal: Float[Array, "rows d"]
    point: Float[Array, "rows 4 d"]  # of the obstacle, 0 for a vehicle [m]
    required: Float[Array, " rows"]  # distance [m]


@dataclass(frozen=True, eq=False)
class JointStopProblem:
    """Stops of double integrators that change their controls by little.

        minimize    ½ μ Σ ‖(u_i − û_i) / U‖² + λ Σ s
        subject to  x[k+1] = A x[k] + B u[k],  v[T_i] = 0     (10)
                    ‖u_i[k] / U‖_r ≤ 1,  ‖v_i[k] / V‖_s ≤ 1   (12), (66)
                    n · (c_i − c_j) ≥ R_ij (1 − s_ij)         (38), (64)
                    n · (c_i − o)   ≥ R_i (1 − s_io),  s ≥ 0

    for control points c near each other and obstacles o, with normals n about the nominal
    trajectories, added as they are violated; (66) where the nominal is fast. Changes of the
    controls are constant over each of the first steps, then over longer and longer blocks. Vehicles
    that keep what they have are fixed; their speeds and controls may be beyond the limits. As all
    agents have to find the same, they use the same solver.
    """

    horizon: AvoidanceHorizon
    vehicles: tuple[StoppingVehicle, ...]
    required: Float[Array, "vehicles vehicles"]  # distances of two [m]
    is_free: Bool[Array, " vehicles"]  # those that change; all others keep their controls

    def fly(self, u: Controls) -> tuple[States, Paths]:
        """Return states and control points of all."""
        x = self.horizon.discrete_model.simulate(np.stack([v.state for v in self.vehicles]), u)
        return x, self.horizon.control_points(x, u)

    def improve(self, u: Controls) -> tuple[Controls, float]:
        """Solve the program about nominal controls, with half-spaces added as they are violated.

        Return the controls, and the sum of the slack s of these half-spaces.
        """
        u = u.copy()
        for a in np.flatnonzero(self.is_free).tolist():
            u[a, self.vehicles[a].steps :] = 0.0
        x, paths = self.fly(u)
        near = self._convexify(paths)
        room = self._room(near, paths)
        rows = self._worst_per_step(near, room, ACTIVE)
        limits = self._limits(u, x)
        for _ in range(MAX_PROGRAMS):
            after, slack = self._solve(u, near, room, rows, limits)
            left = self._room(near, self.fly(after)[1]) + slack[near.group, None]
            more = self._worst_per_step(near, left, -VIOLATED, rows)
            if not len(more[0]):
                break
            rows = np.append(rows[0], more[0]), np.append(rows[1], more[1])
        return after, float(slack.sum())

    @cached_property
    def _blocks(self) -> list[Float[Array, "T blocks"]]:
        """Controls of each vehicle by its unknowns; without columns where it is not free.

        Unknowns are changes of the control over a block, in units of its limit.
        """
        T, each = self.horizon.steps, zip(self.vehicles, self.is_free.tolist(), strict=True)
        return [v.control_limit.most * _make_blocks(v.steps if free else 0, T) for v, free in each]

    @cached_property
    def _first(self) -> Int[Array, " vehicles"]:
        """First unknown of each vehicle, and the number of all."""
        d = self.horizon.discrete_model.axes
        return np.cumsum([0, *(d * E.shape[1] for E in self._blocks)])

    @cached_property
    def _on_axis(self) -> tuple[Array, Array]:
        """Velocities, and unscaled control points, by the controls along the first axis."""
        T, d = self.horizon.steps, self.horizon.discrete_model.axes
        u = np.zeros((T, T, d))
        u[range(T), range(T), 0] = 1.0
        x = self.horizon.discrete_model.simulate(np.zeros((T, 2 * d)), u)
        points = self.horizon.unscale_points(self.horizon.control_points(x, u))
        return x[:, :, d].T, points[..., 0].reshape(T, -1).T

    @cached_property
    def _on_points(self) -> list[Float[Array, "points blocks"]]:
        """Control points of each vehicle along an axis, by its blocks."""
        return [self._on_axis[1] @ E for E in self._blocks]

    def _convexify(self, paths: Paths) -> NearPieces:
        """Choose half-spaces for all that are near each other, about nominal trajectories."""
        i, j = np.triu_indices(len(paths), 1)
        some = self.is_free[i] | self.is_free[j]
        middle, extent = enclosing_balls(paths)
        required = self.required * (1 + SEPARATION_TOLERANCE)
        apart = np.linalg.norm(middle[i] - middle[j], axis=1) - extent[i] - extent[j]
        some &= apart < NEAR * required[i, j]
        i, j = i[some], j[some]
        relative, kept = paths[i] - paths[j], required[i, j]
        normal = choose_normals(relative, kept)
        is_near = np.linalg.norm(relative, axis=-1).min(axis=2) < NEAR * kept[:, None]
        pair, piece = np.nonzero(is_near)
        none = np.zeros((len(piece), *paths.shape[2:]))
        planes = normal[pair, piece], none, kept[pair]
        found, groups = [NearPieces(i[pair], j[pair], pair, piece, *planes)], len(i)
        for a in np.flatnonzero(self.is_free).tolist():
            obstacles = self.vehicles[a].obstacles
            if obstacles is None:
                continue
            support, across = support_obstacles(paths[a], obstacles)
            gap, _ = measure_gaps(paths[a] - obstacles.paths, obstacles)
            kept = obstacles.clearance * (1 + SEPARATION_TOLERANCE)
            one, piece = np.nonzero(gap < NEAR * kept[:, None])
            own, other = np.full(len(one), a), np.full(len(one), -1)
            planes = across[one, piece], support[one, piece], kept[one]
            found.append(NearPieces(own, other, groups + one, piece, *planes))
            groups += len(kept)
        return NearPieces(*(np.concatenate(part) for part in zip(*found, strict=True)))

    def _room(self, near: NearPieces, paths: Paths) -> Rooms:
        """Compute by how much control points keep their half-spaces, over the distance.

        Infinite for those that no control can move.
        """
        own, is_vehicle = paths[near.first, near.piece], (near.second >= 0)[:, None, None]
        other = np.where(is_vehicle, paths[near.second, near.piece], near.point)
        along = np.einsum("pd,pid->pi", near.normal, own - other)
        is_movable = self._on_axis[1].any(axis=1).reshape(-1, 4)[near.piece]
        return np.where(is_movable, along / near.required[:, None] - 1, np.inf)

    def _worst_per_step(
        self, near: NearPieces, room: Rooms, most: float, known: tuple[Array, ...] = ()
    ) -> tuple[Array, Array]:
        """Select rows and points with the least room, of each group and step, if below a bound."""
        least, point = room.min(axis=1), room.argmin(axis=1)
        order = np.argsort(least, kind="stable")
        step = near.piece // self.horizon.pieces_per_step
        key = near.group * self.horizon.steps + step
        rows = order[np.unique(key[order], return_index=True)[1]]
        rows = rows[least[rows] < most]
        if known:
            rows = rows[~np.isin(4 * rows + point[rows], 4 * known[0] + known[1])]
        return rows, point[rows]

    def _limits(self, u: Controls, x: States) -> Limits:
        """Return rows and rhs: rhs − rows · unknowns are zero, nonnegative, or in cones."""
        d, free = self.horizon.discrete_model.axes, np.flatnonzero(self.is_free).tolist()
        eye, found = np.eye(d), list[Any]()
        for a in free:
            vehicle, E = self.vehicles[a], self._blocks[a]
            on_v, T = self._on_axis[0] @ E, vehicle.steps
            none = np.zeros((0, d * E.shape[1])), np.zeros(0)
            kinds = [none, (np.kron(on_v[T : T + 1], eye), -x[a, T, d:])], [none], [none]
            speed = vehicle.speed_limit
            fast = 1 + np.flatnonzero(speed.measure(x[a, 1:T, d:]) > FAST * speed.most)
            bounds = ((vehicle.control_limit, E[:T], u[a, :T]), (speed, on_v[fast], x[a, fast, d:]))
            for limit, response, drift in (bound for bound in bounds if len(bound[1])):
                each = np.kron(response, eye).reshape(len(response), d, d * E.shape[1])
                rows, rhs = limit.constrain(each, drift)
                kinds[1 if limit.faces is not None else 2].append((-rows, rhs))
            found.append([map(np.concatenate, zip(*kind, strict=True)) for kind in kinds])
        each_kind = [zip(*kind, strict=True) for kind in zip(*found, strict=True)]
        return [(stack_diagonally(rows), np.concatenate(rhs)) for rows, rhs in each_kind]

    def _solve(
        self, u: Controls, near: NearPieces, room: Rooms, rows: tuple[Array, Array], limits: Limits
    ) -> tuple[Controls, Float[Array, " groups"]]:
        """Solve with some of the half-spaces; the slack of each group of pieces is returned too."""
        at, point = rows
        groups, slack_of = np.unique(near.group[at], return_inverse=True)
        count, slacks = int(self._first[-1]), len(groups)
        coeffs = self._coefficients(near, at, point)
        one = csr_array((np.ones(len(at)), (np.arange(len(at)), slack_of)), (len(at), slacks))
        zero, nonnegative, cones = limits
        A = block_array([
            [zero[0], None],
            [nonnegative[0], None],
            [-coeffs, -one],
            [None, -eye_array(slacks)],
            [cones[0], None],
        ])  # fmt: skip
        b = np.concatenate([zero[1], nonnegative[1], room[at, point], np.zeros(slacks), cones[1]])
        quadratic, linear = self._cost(u)
        q = np.append(linear, np.full(slacks, SLACK_WEIGHT))
        P = csc_array(diags_array(np.append(quadratic, np.zeros(slacks))))
        inequalities, d = len(nonnegative[1]) + len(at) + slacks, u.shape[2]
        sizes = (d + 1,) * (len(cones[1]) // (d + 1))
        program = ConicProgram(q, csc_array(A), b, len(zero[1]), inequalities, sizes, P=P)
        unknowns = solve_program(program).x
        slack = np.zeros(int(near.group.max(initial=-1)) + 1)
        slack[groups] = unknowns[count:]
        return self._fly_blocks(u, unknowns), slack

    def _coefficients(self, near: NearPieces, at: Array, point: Array) -> csr_array:
        """Return the change of the room of control points, over the distance, by the unknowns."""
        scale = np.array(self.horizon.scale or np.ones(self.horizon.discrete_model.axes))
        coeffs = np.zeros((len(at), self._first[-1]))
        for vehicle, sign in ((near.first[at], 1.0), (near.second[at], -1.0)):
            for a in np.flatnonzero(self.is_free).tolist():
                rows = np.flatnonzero(vehicle == a)
                response = self._on_points[a][4 * near.piece[at[rows]] + point[rows]]
                along = sign * scale * near.normal[at[rows]] / near.required[at[rows], None]
                columns = slice(self._first[a], self._first[a + 1])
                moved = response[:, :, None] * along[:, None]
                coeffs[rows, columns] = moved.reshape(coeffs[rows, columns].shape)
        return csr_array(coeffs)

    def _cost(self, u: Controls) -> tuple[Array, Array]:
        """Return the diagonal of the quadratic cost, and the linear cost."""
        quadratic, linear = [], []
        for vehicle, E, own in zip(self.vehicles, self._blocks, u, strict=True):
            weight = CHANGE_WEIGHT / vehicle.control_limit.most**2
            quadratic.append(weight * np.repeat((E**2).sum(axis=0), own.shape[1]))
            linear.append(weight * (E.T @ (own - vehicle.u)).ravel())
        return np.concatenate(quadratic), np.concatenate(linear)

    def _fly_blocks(self, u: Controls, unknowns: Float[Array, " unknowns"]) -> Controls:
        """Return controls within their limits, and a last one that takes what speed is left."""
        after, d, h = u.copy(), u.shape[2], self.horizon.discrete_model.dt
        for a in np.flatnonzero(self.is_free).tolist():
            vehicle = self.vehicles[a]
            own = unknowns[self._first[a] : self._first[a + 1]].reshape(-1, d)
            after[a] = vehicle.control_limit.cut(u[a] + self._blocks[a] @ own)
            after[a, vehicle.steps :] = 0.0
            after[a, vehicle.steps] = -(vehicle.state[d:] / h + after[a].sum(axis=0))
        return after


def _make_blocks(steps: int, T: int) -> Float[Array, "T blocks"]:
    """Divide steps into blocks; column j is 1 at the steps of block j."""
    ends, length = list(range(1, min(FULL_BLOCKS, steps) + 1)), 1.0
    while ends and ends[-1] < steps:
        length *= GROWTH
        ends.append(min(ends[-1] + int(length), steps))
    k = np.arange(T)[:, None]
    begins, until = np.array([0, *ends[:-1]][: len(ends)], dtype=int), np.array(ends, dtype=int)
    return ((begins <= k) & (k < until)).astype(float)
