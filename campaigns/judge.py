"""Judge a run of a reconfiguration without this library: python campaigns/judge.py DIR/run.nc.

The recorded states, controls and events, and the scenario in the file, are all that is used; the
equations of motion are written here again, in `motion.py`. From each recorded state the motion to
the next instant is computed anew, as cubics in time: one a step for double integrators, which is
exact, and enough for an error of 1e-7 m in orbit. The least distance of two cubics is found by the
roots of its derivative.

Two vehicles keep (R_i + R_j)/2. A pair is excused where no control could have kept them apart from
the moment when both are there: p and v apart, for some t,

    |p + v t| + ½ (U_i + U_j) t² < R,    U the largest Euclidean accelerations,

in orbit with the transition matrix of Clohessy and Wiltshire. A collision is silent where no slack,
braking or infeasibility of one of the two is recorded by then.

Of obstacles, which are spheres and boxes here, vehicles keep R_i; the same excuse counts, with
U = 0 for the obstacle. Lost vehicles that coast are avoided as others are, and excused from the
instant of the loss, with U = 0. Where two keep an ellipsoid, space is scaled so that it is a ball.
"""

import json
import sys
import tomllib
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from motion import Motion, transition_matrices
from numpy import ndarray as Array

ROUNDING = 1e-6  # relative: of distances, limits, and what states differ from the equations by
ARRIVED = 0.1, 0.5  # of R, within which a target counts as reached; without noise and with it
RECORDS = "slack", "braked", "infeasible"
NOISE = "acceleration_m_s2", "position_m", "velocity_m_s", "thrust", "pointing_rad"
INSTANTS = 400  # at which excuses are looked for


class Flight(NamedTuple):
    """Mission and record of a flight; in three axes, the last 0 in the plane."""

    scenario: dict[str, Any]
    time: Array
    state: Array  # instants, vehicles, 6
    alive: Array
    control: Array  # commanded
    applied: Array
    radii: Array
    axes: int

    @classmethod
    def from_dataset(cls, data: xr.Dataset) -> "Flight":
        """Read a run file."""
        scenario = tomllib.loads(data.attrs["scenario"])
        position, velocity, control, applied = (
            _in_space(data[name].values)
            for name in ("position", "velocity", "control", "applied_control")
        )
        radii = np.broadcast_to(scenario["swarm"]["collision_radius_m"], position.shape[1])
        state = np.concatenate([position, velocity], axis=2)
        alive, behind = data["alive"].values.astype(bool), _read_clocks(data)
        return cls(
            scenario,
            data["time"].values,
            _delay(state, behind),
            _delay(alive, behind),
            _delay(np.nan_to_num(control[:-1]), behind, 0.0),
            _delay(np.nan_to_num(applied[:-1]), behind, 0.0),
            radii.astype(float),
            data.sizes["axis"],
        )

    def noise(self, *keys: str) -> bool:
        """Tell whether there are disturbances under one of these keys."""
        return any(self.scenario.get("disturbance", {}).get(key) for key in keys)

    def usage(self, name: str, unit: str, default: Any, values: Array) -> Array:
        """Return values over their limit, in the norm of the limit."""
        model = self.scenario["model"]
        norm = model.get(f"{name.removeprefix('max_')}_norm", default)
        most = np.asarray(model.get(f"{name}_axes_{unit}", model.get(f"{name}_{unit}", np.inf)))
        values = values[..., : self.axes]
        if f"{name}_axes_{unit}" in model:
            return np.abs(values / most).max(axis=-1)
        return np.linalg.norm(values, ord=np.inf if norm == "inf" else norm, axis=-1) / most

    @property
    def scale(self) -> Array:
        """Factors of a state that make a ball of the ellipsoid that two keep."""
        axes = np.array(self.scenario["model"].get("separation_axes", [1.0] * self.axes))
        if "separation_axes_m" in self.scenario["model"]:
            axes = np.array(self.scenario["model"]["separation_axes_m"]) / self.radii[0]
        each = 1 / np.array([*axes, 1.0][:3])
        return np.concatenate([each, each])

    @property
    def strength(self) -> Array:
        """Largest Euclidean acceleration of each vehicle."""
        model, count = self.scenario["model"], self.alive.shape[1]
        if "max_control_axes_m_s2" in model:
            return np.full(count, np.linalg.norm(model["max_control_axes_m_s2"]))
        most = np.broadcast_to(model["max_control_m_s2"], count)
        return most * (self.axes**0.5 if model.get("control_norm", "inf") == "inf" else 1.0)


def judge_run(run: Any) -> dict[str, Any]:
    """Judge a run of a campaign."""
    return {"judged": judge(run.data)}


def judge(data: xr.Dataset) -> dict[str, Any]:
    """Return what the data itself says about safety, motion, limits and arrival."""
    flight = Flight.from_dataset(data)
    motion = Motion.from_dataset(data, flight.scenario)
    path = motion.sample(flight.state[:-1], flight.applied) * flight.scale
    piece = motion.step / (path.shape[1] - 1)
    excused, alive = find_excused(flight, motion.rate), flight.alive
    found = closest_approaches(path, piece, alive, alive, flight.radii, ~excused)
    plea = closest_approaches(path, piece, alive, alive, flight.radii, excused)
    close = {pair: k for pair, (ratio, k) in found.items() if ratio < 1 - ROUNDING}
    events = [json.loads(str(text)) for text in data["event"].values]
    residual = _residual(flight, motion, path / flight.scale)
    usage = flight.usage("max_control", "m_s2", "inf", flight.control)
    speed = flight.usage("max_speed", "m_s", 2, flight.state[..., 3:])
    is_noisy = flight.noise("acceleration_m_s2", "velocity_m_s", "thrust", "pointing_rad")
    return {
        "axes": flight.axes,
        "separation_ratio": min((ratio for ratio, _ in found.values()), default=None),
        "collisions": len(close),
        "silent": sum(_is_silent(pair, flight.time[k + 1], events) for pair, k in close.items()),
        "excused": sum(ratio < 1 - ROUNDING for ratio, _ in plea.values()),
        **judge_wrecks(flight, motion, events),
        **judge_obstacles(flight, path, piece),
        "box_excess": _box_excess(flight),
        "residual": residual,
        "follows": residual <= ROUNDING,
        "control_usage": float((usage * alive[:-1]).max(initial=0.0)),
        "speed_usage": float((speed * alive).max(initial=0.0)),
        "within_limits": bool(
            (usage * alive[:-1]).max(initial=0.0) <= 1 + ROUNDING
            and (is_noisy or (speed * alive).max(initial=0.0) <= 1 + ROUNDING)
        ),
        **judge_arrival(data, flight),
        "deadlock": len({i for e in events if e["kind"] == "deadlock" for i in e["agents"]}),
    }


def find_excused(flight: Flight, rate: float) -> Array:
    """Find the pairs that no control could keep apart; rate of the orbit [rad/s], or 0."""
    count = flight.alive.shape[1]
    excused = np.zeros((count, count), dtype=bool)
    first, second = np.triu_indices(count, 1)
    together = flight.alive[:, first] & flight.alive[:, second]
    met, begin = together.any(axis=0), together.argmax(axis=0)
    for k in np.unique(begin[met]):
        i, j = (part[met & (begin == k)] for part in (first, second))
        apart, control = flight.state[k, i] - flight.state[k, j], flight.strength
        needed = (flight.radii[i] + flight.radii[j]) / 2
        excused[i, j] = are_unavoidable(apart * flight.scale, control[i] + control[j], needed, rate)
    return excused


def are_unavoidable(apart: Array, control: Array, needed: Array, rate: float) -> Array:
    """Tell which pairs no control could keep apart, by their states from each other."""
    latest = float((np.linalg.norm(apart[:, 3:], axis=1) / control).max(initial=0.0))
    times = np.linspace(0.0, latest, INSTANTS)
    change = transition_matrices(rate, times)
    push = np.linalg.norm(change[:, :3, 3:], ord=2, axis=(1, 2))
    push = np.append(0.0, np.cumsum((push[1:] + push[:-1]) / 2 * np.diff(times)))
    free = np.linalg.norm(np.einsum("tab,pb->tpa", change[:, :3], apart), axis=2)
    return (free + push[:, None] * control < needed).any(axis=0)


Approaches = dict[tuple[int, int], tuple[float, int]]  # by pair: over its distance, at a step


def closest_approaches(
    path: Array, piece: float, one: Array, other: Array, radii: Array, wanted: Array
) -> Approaches:
    """Find the least distance of each pair over (R_i + R_j)/2, and the first step below 1.

    Exact for the least of all and for those below 1; others are taken at the samples.

    Args:
        path: Samples of each step: steps, samples, vehicles, 6.
        piece: Time between samples [s].
        one: True for vehicles that are there, at each instant.
        other: The same, of those that each is compared with.
        radii: R of each vehicle.
        wanted: True in row i and column j > i for the pairs that are looked at.
    """
    first, second = np.nonzero(np.triu(wanted, 1))
    needed = (radii[first] + radii[second]) / 2
    least, when = np.full(len(first), np.inf), np.full(len(first), len(path))
    near: list[tuple[Array, Array, Array]] = []  # pairs, steps and cubics
    for k, samples in enumerate(path):
        there = one[k, first] & other[k, second] | other[k, first] & one[k, second]
        pairs = np.flatnonzero(there)
        apart = samples[:, second[pairs]] - samples[:, first[pairs]]
        ratio = np.linalg.norm(apart[..., :3], axis=2) / needed[pairs]
        _note(least, when, pairs, ratio.min(axis=0), np.full(len(pairs), k))
        cubics = hermite(apart, piece)
        size = np.linalg.norm(cubics, axis=3)
        below = size[..., 0] - size[..., 1:].sum(axis=2)
        piece_of, row = np.nonzero(below < needed[pairs] * max(1.0, least.min(initial=np.inf)))
        near.append((pairs[row], np.full(len(row), k), cubics[piece_of, row]))
    if near:
        pairs, steps, cubics = (np.concatenate(each) for each in zip(*near, strict=True))
        size = np.linalg.norm(cubics, axis=2)
        below = (size[:, 0] - size[:, 1:].sum(axis=1)) / needed[pairs]
        keep = below < max(1.0, least.min(initial=np.inf))
        pairs, steps, cubics = pairs[keep], steps[keep], cubics[keep]
        _note(least, when, pairs, least_lengths(cubics) / needed[pairs], steps)
    met = zip(first, second, least, when, strict=True)
    return {(int(i), int(j)): (float(r), int(k)) for i, j, r, k in met if r < np.inf}


def hermite(apart: Array, piece: float) -> Array:
    """Return the cubics through samples, in time over a piece: pieces, pairs, 4, 3."""
    p, v = apart[..., :3], piece * apart[..., 3:]
    move = p[1:] - p[:-1]
    parts = [p[:-1], v[:-1], 3 * move - 2 * v[:-1] - v[1:], v[:-1] + v[1:] - 2 * move]
    return np.stack(parts, axis=2)


def least_lengths(cubics: Array) -> Array:
    """Return min |c₀ + c₁ s + c₂ s² + c₃ s³| over 0 ≤ s ≤ 1 of rows of coefficients, (q, 4, 3)."""
    square = np.zeros((len(cubics), 7))
    for a in range(4):
        for b in range(4):
            square[:, a + b] += (cubics[:, a] * cubics[:, b]).sum(axis=1)
    times = np.zeros((len(cubics), 7))  # those of the roots; 0; and 1
    times[:, 6] = 1.0
    slope = square[:, 1:] * np.arange(1, 7)
    size = np.abs(slope) > 1e-10 * np.abs(slope).max(axis=1, keepdims=True)
    degree = 5 - size[:, ::-1].argmax(axis=1)
    for n in range(1, 6):
        rows = np.flatnonzero((degree == n) & size.any(axis=1))
        companion = np.zeros((len(rows), n, n))
        companion[:, 0] = -slope[rows, :n][:, ::-1] / slope[rows, n][:, None]
        companion[:, range(1, n), range(n - 1)] = 1.0
        # Where a root is not real, its real part is no minimum, and does no harm.
        times[rows, :n] = np.clip(np.linalg.eigvals(companion).real, 0.0, 1.0)
    powers = times[..., None] ** np.arange(4)
    return np.linalg.norm(powers @ cubics, axis=2).min(axis=1)


def judge_wrecks(flight: Flight, motion: Motion, events: list[dict[str, Any]]) -> dict[str, Any]:
    """Judge the distances of survivors to lost vehicles as these coast, over (R_i + R_j)/2.

    What comes too near is counted where the mission lets them coast.
    """
    lost = np.logical_or.accumulate(~flight.alive[1:] & flight.alive[:-1], axis=0)
    if not lost.any():
        return {"wreck_ratio": None, "wreck_collisions": 0, "wreck_excused": 0, "wreck_pairs": 0}
    state, applied, wreck = flight.state[:-1].copy(), flight.applied.copy(), lost[:-1]
    for k, gone in enumerate(wreck, start=1):
        applied[k, gone] = 0.0
        before = motion.sample(state[k - 1 : k], applied[k - 1 : k], k - 1)[0, -1]
        state[k] = np.where(gone[:, None], before, state[k])
    path = motion.sample(state, applied) * flight.scale
    wreck = np.concatenate([np.zeros_like(wreck[:1]), wreck])
    wanted = np.ones((len(flight.radii), len(flight.radii)), dtype=bool)
    piece = motion.step / (path.shape[1] - 1)
    found = closest_approaches(path, piece, flight.alive, wreck, flight.radii, wanted)
    coasting = {i for e in events if e.get("body") == "coast" for i in e["agents"]}
    excused = 0
    close = [
        pair
        for pair, (ratio, _) in found.items()
        if ratio < 1 - ROUNDING and any(i in coasting and wreck[-1, i] for i in pair)
    ]
    for pair in close:
        gone, live = pair if wreck[-1, pair[0]] else pair[::-1]
        begin = max(int(wreck[:, gone].argmax()), int(flight.alive[:, live].argmax()))
        apart = (state[begin, live] - state[begin, gone])[None] * flight.scale
        needed = np.array([(flight.radii[live] + flight.radii[gone]) / 2])
        control = flight.strength[live : live + 1]
        excused += bool(are_unavoidable(apart, control, needed, motion.rate)[0])
    both = closest_approaches(path, piece, wreck, wreck, flight.radii, wanted)
    pairs = [
        pair
        for pair, (ratio, _) in both.items()
        if ratio < 1 - ROUNDING and all(i in coasting for i in pair)
    ]
    return {
        "wreck_ratio": min((ratio for ratio, _ in found.values()), default=None),
        "wreck_collisions": len(close) - excused,
        "wreck_excused": excused,
        "wreck_pairs": len(pairs),
    }


def judge_obstacles(flight: Flight, path: Array, piece: float) -> dict[str, Any]:
    """Judge the distances of live vehicles from obstacles, less R_i, over R_i."""
    least, close, excused, rate = np.inf, 0, 0, 0.0
    steps, samples, vehicles, _ = path.shape
    time = np.arange(steps)[:, None] * piece * (samples - 1) + np.arange(samples) * piece
    for one in flight.scenario.get("obstacle", []):
        low, high, radius = _read_obstacle(one)
        middle = (low + high) / 2
        drift = np.pad(np.array(one.get("velocity_m_s", [0.0, 0.0])), (0, 3))[:3]
        begin = np.concatenate([middle, drift]) * flight.scale
        if flight.scale.min() < 1:
            raise ValueError("obstacles beside ellipsoids are not judged")
        for i in range(vehicles):
            there = np.flatnonzero(flight.alive[:-1, i])
            apart = (
                path[there, :, i]
                - begin
                - np.pad(time[there, :, None] * drift, [(0, 0)] * 2 + [(0, 3)])
            )
            cubics = hermite(np.moveaxis(apart, 1, 0), piece).reshape(-1, 4, 3)
            away = _distances(cubics, (high - low) / 2) - radius
            ratio = float(away.min(initial=np.inf)) / flight.radii[i]
            least = min(least, ratio)
            if ratio < 1 - ROUNDING:
                first, needed = apart[:1, 0], np.array([flight.radii[i] + radius])
                control = flight.strength[i : i + 1]
                is_ball = not (high > low).any()
                plea = is_ball and bool(are_unavoidable(first, control, needed, rate)[0])
                close, excused = close + (not plea), excused + plea
    found = {"obstacle_collisions": close, "obstacle_excused": excused}
    return {"obstacle_ratio": least if np.isfinite(least) else None, **found}


def _box_excess(flight: Flight) -> float | None:
    """Return by how much live vehicles leave the allowed positions at instants, over R."""
    if "box_m" not in flight.scenario["model"]:
        return None
    low, high = np.array(flight.scenario["model"]["box_m"])
    place = flight.state[..., : flight.axes]
    beyond = np.maximum(low - place, place - high).max(axis=2) / flight.radii
    return float(np.max(beyond, where=flight.alive, initial=-np.inf))


def _read_obstacle(one: dict[str, Any]) -> tuple[Array, Array, float]:
    if one["kind"] == "sphere":
        center = np.array(one["center_m"])
        center = np.pad(center, (0, 3 - len(center)))
        return center, center, float(one["radius_m"])
    if one["kind"] == "box":
        low, high = np.array(one["low_m"]), np.array(one["high_m"])
        flat = (0, 3 - len(low))
        return np.pad(low, flat), np.pad(high, flat), 0.0
    raise ValueError(f"an obstacle of the kind {one['kind']} is not judged")


def _distances(cubics: Array, half: Array) -> Array:
    """Return the least distances of cubics from a box about the origin, 0 inside."""
    if not half.any():
        return least_lengths(cubics)
    low, high = np.zeros(len(cubics)), np.ones(len(cubics))
    for _ in range(6):  # the least of many samples, and then between its neighbors
        times = np.linspace(low, high, 33)
        at = np.einsum("sqp,qpa->sqa", times[..., None] ** np.arange(4), cubics)
        away = np.linalg.norm(np.maximum(np.abs(at) - half, 0.0), axis=2)
        k, rows = away.argmin(axis=0), np.arange(len(cubics))
        low, high = times[np.maximum(k - 1, 0), rows], times[np.minimum(k + 1, 32), rows]
    return away.min(axis=0)


def judge_arrival(data: xr.Dataset, flight: Flight) -> dict[str, Any]:
    """Tell whether all that live are at targets of their own at the end of every leg."""
    leg, target = data["leg_index"].values, data["target_index"].values
    place, share = _in_space(data["target_position"].values), ARRIVED[flight.noise(*NOISE)]
    ends = [*(np.flatnonzero(np.diff(leg)) + 1), len(leg) - 1]
    worst, duplicates = 0.0, 0
    for end in ends:
        live = np.flatnonzero(flight.alive[end] & flight.alive[end - 1])
        held = target[end - 1, live]
        miss = np.linalg.norm(flight.state[end, live, :3] - place[leg[end - 1]][held], axis=1)
        miss = np.where(held < 0, np.inf, miss) / flight.radii[live]
        worst, duplicates = max(worst, float(miss.max(initial=0.0))), duplicates + len(held)
        duplicates -= len(np.unique(held))
    is_whole = len(ends) == len(place) and bool(data.attrs.get("complete", 1))
    is_there = worst <= share and not duplicates and bool(flight.alive[-1].any())
    return {"miss_ratio": worst, "duplicates": duplicates, "arrived": is_whole and is_there}


def _residual(flight: Flight, motion: Motion, path: Array) -> float:
    """Return by how much states, controls and times are not what follows, over R."""
    both = flight.alive[1:] & flight.alive[:-1]
    error = (path[:, -1] - flight.state[1:]) * np.repeat([1.0, motion.step], 3)
    rows = np.linalg.norm(error, axis=2) / flight.radii
    if not flight.noise("acceleration_m_s2", "thrust", "pointing_rad"):
        wrong = np.linalg.norm(flight.applied - flight.control, axis=2)
        rows = np.maximum(rows, wrong * motion.step**2 / flight.radii)
    late = np.abs(np.diff(flight.time) / motion.step - 1)
    chief = motion.chief_error() / flight.radii.min()
    return float(max(np.where(both, rows, 0.0).max(initial=0.0), late.max(initial=0.0), chief))


def _note(least: Array, when: Array, pairs: Array, ratio: Array, steps: Array) -> None:
    """Keep the least ratio of each pair, and the first step below 1."""
    np.minimum.at(least, pairs, ratio)
    below = ratio < 1 - ROUNDING
    np.minimum.at(when, pairs[below], steps[below])


def _is_silent(pair: tuple[int, int], time: float, events: list[dict[str, Any]]) -> bool:
    named = (e for e in events if e["kind"] in RECORDS and e["time"] <= time * (1 + ROUNDING))
    return not any(set(pair) & set(event["agents"]) for event in named)


def _read_clocks(data: xr.Dataset) -> Array:
    """Return by how many steps the clock of each vehicle is behind, by which it is recorded."""
    events = [json.loads(str(text)) for text in data["event"].values]
    each = [event["steps"] for event in events if event["kind"] == "clocks"]
    return np.array(each[0] if each else [0] * data.sizes["agent"])


def _delay(recorded: Array, steps: Array, before: float | None = None) -> Array:
    """Delay what each vehicle does; before that it is at rest where it starts."""
    row, vehicle = np.arange(len(recorded))[:, None] - steps, np.arange(len(steps))
    found = recorded[np.maximum(row, 0), vehicle]
    if before is not None:
        found[row < 0] = before
    return np.asarray(found)


def _in_space(values: Array) -> Array:
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, 3 - values.shape[-1])])


if __name__ == "__main__":
    print(json.dumps(judge(xr.load_dataset(sys.argv[1])), indent=1))
