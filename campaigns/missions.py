"""Random missions, a function a family: what a planner has to be safe on, whatever is drawn.

Values are drawn from these ranges, which were written down before the planner was made to fly them;
a family changes those of its row. "log" is log-uniform, everything else uniform.

    vehicles N          2–60, log                     axes                2 or 3
    radius R            0.2–2 m, log                  step Δt             0.2–2 s, log
    speed V             0.4–1.2 R/Δt: 0.04–12 m/s     control U           V in 2–8 steps
    room                2–4 R N^(1/d): side of the box in which starts are drawn
    start gap           1.2–1.5 R, the least          target gap          1.2–2 R, the least
    shift               targets are up to half the side away along each axis
    reach               1.05–3, R_comm over 2 V T_H Δt + R
    time                1.2–2, steps over the least for each alone

Targets are points drawn as the starts are, a lattice or a ring, by auction or, one in three, given.

    default             time 1.5, targets by auction; no key of the plan is set but the step
    dense               room 1.6–2.5, start gap 1.02–1.1; targets on a lattice, 1.02–1.1 R apart
    short               horizons of 2 to 4 steps, planned again each 1 to as many
    low_thrust          V takes 10–40 steps
    low_speed           V 0.05–0.15 R/Δt, room 1.5–2.5
    at_limit            reach 1–1.05, room 3–8: networks in parts
    moving              starts at up to 0.7 V any way, room 3–6
    inward              on a circle or sphere, inward at 0.2–0.8 V, with 1.2 times the way to stop
                        before they touch; to the opposite places, given or by auction
    events              a second leg, one in three; up to N/2 join and N/2 are lost, at steps 0–30
                        of a leg; joins outermost in 1.5 times the box, apart from all starts
    noise               R 0.5 m, Δt 0.5–2 s; measured positions err by 5–20 mm, velocities by 2–5
                        mm/s; margin "auto", target gap 1.5–2
    disturbed           the same, and accelerations err by 2–5 mm/s² in each step
    in_place            targets are the starts: given in order, or by auction in another
    unequal             radii, speeds and controls of 1–3 times the least each
    circles, spheres    1.2–2 R apart, to the opposite places, given; circles in space too
    corridors           two blocks of 1–5 lanes, 1.05–2 R apart and 4–10 R between, exchanged
    clohessy_wiltshire  orbits of 0.9–1.2 mrad/s, R 20–60 m, Δt 30–60 s, U 5–20 mm/s² (log), gaps
                        1.3–2 R over a whole orbit, room 2–4; half of them up to 150 m off the plane
    j2                  the same about chiefs with perigees 300–900 km up, eccentricities to 0.1
                        (half of them 0), and inclinations of 10–100 degrees; off the plane one in
                        three; the plan as in the scenario `orbit`
"""

from functools import partial
from typing import Any

import numpy as np
from judge import judge_run
from numpy import ndarray as Array
from swarms import Draw, Range, place, spread

import sato

RATIO = 3.0  # of the largest radius or limit to the smallest
EARTH = 6378e3  # [m]


def _fly(family: str, rng: np.random.Generator, **ranges: Range) -> sato.Reconfiguration:
    drawn = Draw(family, rng, **ranges)
    return drawn.mission(drawn.points(drawn.start_gap), drawn.targets())


low_thrust = partial(_fly, "low_thrust", braking=(10.0, 40.0))
low_speed = partial(_fly, "low_speed", travel=(0.05, 0.15), room=(1.5, 2.5))
at_limit = partial(_fly, "at_limit", reach=(1.0, 1.05), room=(3.0, 8.0))


def default(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw a swarm, its limits and its targets; everything else is as it is without a key."""
    drawn = Draw("default", rng, time=(1.5, 1.5))
    return drawn.mission(drawn.points(drawn.start_gap), drawn.targets(), assignment="auction")


def dense(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw starts and targets with hardly any room between them."""
    tight = (1.02, 1.1)
    drawn = Draw("dense", rng, room=(1.6, 2.5), start_gap=tight, target_gap=tight)
    center = tuple(drawn.rng.uniform(-drawn.side / 2, drawn.side / 2, drawn.axes))
    lattice = sato.Lattice(center=center, spacing=drawn.target_gap * drawn.radius)
    return drawn.mission(drawn.points(drawn.start_gap), lattice, assignment="auction")


def short(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw short horizons and periods of planning."""
    drawn = Draw("short", rng)
    horizon = int(drawn.rng.integers(2, 5))
    plan = {"horizon_steps": horizon, "replan_steps": int(drawn.rng.integers(1, horizon + 1))}
    return drawn.mission(drawn.points(drawn.start_gap), drawn.targets(), **plan)


def moving(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw starts with velocities of any direction."""
    drawn = Draw("moving", rng, room=(3.0, 6.0))
    way = drawn.rng.normal(size=(drawn.count, drawn.axes))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    way *= drawn.rng.uniform(0, 0.7 * drawn.speed, (drawn.count, 1))
    return drawn.mission(np.hstack([drawn.points(drawn.start_gap), way]), drawn.targets())


def inward(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw vehicles on a circle or a sphere that fly at its center, and on to the other side."""
    drawn = Draw("inward", rng)
    unit, radius = spread(drawn.count, drawn.axes, drawn.start_gap * drawn.radius)
    speed = drawn.rng.uniform(0.2, 0.8) * drawn.speed
    radius += 1.2 * speed**2 / (2 * drawn.control)
    return drawn.mission(np.hstack([radius * unit, -speed * unit]), -radius * unit)


def events(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw joins and losses at any step, in one leg or two."""
    drawn = Draw("events", rng)
    more, count = int(drawn.rng.integers(0, drawn.count // 2 + 1)), drawn.count
    start = drawn.points(drawn.start_gap, count + more, 1.5 * drawn.side)
    start = start[np.argsort(np.abs(start).max(axis=1), kind="stable")]
    lost = drawn.rng.choice(count, drawn.rng.integers(0, count // 2 + 1), replace=False)
    number = 2 if drawn.rng.random() < 1 / 3 else 1
    joining, losing = drawn.rng.integers(number, size=2)
    legs = []
    for leg in range(number):
        happens: dict[str, Any] = {}
        if more and leg == joining:
            join = sato.Join(more, start[count:], at_step=int(drawn.rng.integers(0, 31)))
            happens["joins"], drawn.count = (join,), count + more
        if len(lost) and leg == losing:
            loss = {"agents": tuple(lost.tolist()), "at_step": int(drawn.rng.integers(0, 31))}
            happens["losses"] = (sato.Loss("agents", **loss),)
        legs.append(drawn.leg(drawn.targets(), **happens))
    return drawn.mission(start[:count], None, legs=legs)


def _disturb(is_measured: bool, is_pushed: bool, rng: np.random.Generator) -> sato.Reconfiguration:
    drawn = Draw("noise", rng, radius=(0.5, 0.5), step=(0.5, 2.0), target_gap=(1.5, 2.0))
    start, targets = drawn.points(drawn.start_gap), drawn.targets()
    position, velocity = drawn.rng.uniform(0.005, 0.02), drawn.rng.uniform(0.002, 0.005)
    push = drawn.rng.uniform(0.002, 0.005)
    return drawn.mission(
        start,
        targets,
        margin="auto",
        position_noise=is_measured * position,
        velocity_noise=is_measured * velocity,
        disturbance=is_pushed * push,
    )


noise, disturbed = partial(_disturb, True, False), partial(_disturb, True, True)


def price_noise(rng: np.random.Generator, is_pushed: bool) -> dict[str, Any]:
    """Fly a mission of the family `noise`, or of `disturbed`, and the same one without either."""
    seed = int(rng.integers(2**32))
    loud, quiet = (
        sato.run(_disturb(is_loud, is_loud and is_pushed, np.random.default_rng(seed)), seed=seed)
        for is_loud in (True, False)
    )
    fuel, without = (run.summary["fuel_m_s"] for run in (loud, quiet))
    columns = {"fuel_ratio": fuel / without, "reached": loud.summary["reached"]}
    return columns | {"quiet_reached": quiet.summary["reached"]} | judge_run(loud)


def in_place(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw vehicles that are at their targets, or together at those of all."""
    drawn = Draw("in_place", rng)
    start = drawn.points(drawn.start_gap)
    return drawn.mission(start, start if drawn.is_given else drawn.rng.permutation(start))


def unequal(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw vehicles with radii and limits of their own."""
    drawn = Draw("unequal", rng)
    radii, speed, control = (
        least * drawn.rng.uniform(1, RATIO, drawn.count)
        for least in (drawn.radius, drawn.speed, drawn.control)
    )
    drawn.side *= float(radii.mean()) / drawn.radius
    start = place(rng, drawn.start_gap * radii, drawn.side, drawn.axes)
    drawn.radius = float(np.sort(radii)[-2:].mean())  # any may stand at any target
    return drawn.mission(
        start,
        drawn.targets(),
        collision_radius=tuple(radii.tolist()),
        max_speed=tuple(speed.tolist()),
        max_control=tuple(control.tolist()),
    )


def circles(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw a circle, in the plane or in space, that is crossed."""
    drawn = Draw("circles", rng)
    unit, radius = spread(drawn.count, 2, drawn.target_gap * drawn.radius)
    return _cross(drawn, radius * unit)


def spheres(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw a sphere that is crossed."""
    drawn = Draw("spheres", rng)
    drawn.axes = 3
    unit, radius = spread(drawn.count, 3, drawn.target_gap * drawn.radius)
    return _cross(drawn, radius * unit)


def corridors(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw two blocks of lanes that pass through each other."""
    drawn = Draw("corridors", rng)
    lanes = int(drawn.rng.integers(1, 6))
    each = max(1, drawn.count // 2)
    row, lane = np.divmod(np.arange(each), lanes)
    spacing, between = drawn.rng.uniform(1.05, 2.0), drawn.rng.uniform(4, 10)
    block = np.column_stack([spacing * row + between / 2, spacing * lane]) * drawn.radius
    return _cross(drawn, np.vstack([block, block * [-1, 1]]), mirror=np.array([-1, 1]))


def _cross(drawn: Draw, start: Array, mirror: Any = -1) -> sato.Reconfiguration:
    """Exchange places that mirror each other."""
    flat = [(0, 0), (0, drawn.axes - start.shape[1])]
    start, targets = np.pad(start, flat), np.pad(start * mirror, flat)
    return drawn.mission(start, targets, assignment="given")


def clohessy_wiltshire(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw spacecraft about a circular orbit on bounded orbits, to bounded orbits."""
    drawn = Draw("clohessy_wiltshire", rng, **ORBITS)
    rate = drawn.rng.uniform(0.9e-3, 1.2e-3)
    depth = 150.0 if drawn.rng.random() < 0.5 else 0.0
    start, targets = (_orbits(drawn, gap, depth) for gap in (drawn.start_gap, drawn.target_gap))
    drawn.axes = 3
    states = [np.hstack([p, rate * p[:, [1, 0, 2]] * [0.5, -2, 0]]) for p in (start, targets)]
    limits = _orbital_limits(drawn, rate, np.vstack(states)[:, :3])
    return drawn.mission(*states, model=sato.ClohessyWiltshire(rate), tie_break=5e-4, **limits)


def j2(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw spacecraft about an orbit under J2, without drift at the start and at the end."""
    drawn = Draw("j2", rng, **ORBITS)
    is_deep = drawn.rng.random() < 1 / 3
    perigee = EARTH + drawn.rng.uniform(300e3, 900e3)
    eccentricity = drawn.rng.uniform(0, 0.1) * (drawn.rng.random() < 0.5)
    chief = sato.Chief(
        semi_major_axis=perigee / (1 - eccentricity),
        eccentricity=eccentricity,
        inclination=np.radians(drawn.rng.uniform(10, 100)),
        # Velocities off the plane are large where the latitude is.
        anomaly=np.radians(drawn.rng.uniform(*((-60, -30) if is_deep else (-180, 180)))),
    )
    depth = 150.0 if is_deep else 0.0
    start, targets = (_orbits(drawn, gap, depth) for gap in (drawn.start_gap, drawn.target_gap))
    drawn.axes = 3
    fastest = (chief.orbit.mu / perigee**3 * (1 + eccentricity)) ** 0.5
    limits = _orbital_limits(drawn, fastest, np.vstack([start, targets]))
    return drawn.mission(
        start,
        targets,
        model=sato.J2(chief.orbit),
        tie_break=5e-4,
        reset="need",
        freeze_steps=3,
        position_tolerance=0.1,
        velocity_tolerance=1e-3,
        **limits,
    )


ORBITS: dict[str, Range] = {
    "radius": (20.0, 60.0),
    "step": (30.0, 60.0),
    "start_gap": (1.3, 2.0),
    "target_gap": (1.3, 2.0),
}


def _orbits(drawn: Draw, gap: float, depth: float) -> Array:
    """Draw places from which ellipses of 2:1 about the chief stay a gap apart [R]."""
    side = drawn.room * drawn.radius * drawn.count**0.5
    flat = place(drawn.rng, np.full(drawn.count, gap * drawn.radius), side, 2)
    return np.column_stack([flat * [1, 2], drawn.rng.uniform(-depth, depth, drawn.count)])


def _orbital_limits(drawn: Draw, rate: float, places: Array) -> dict[str, float]:
    """Return limits that leave half a meter per second, and more than the ellipses need."""
    size = np.linalg.norm(places * [2, 1, 1], axis=1).max()
    speed = rate * size * drawn.rng.uniform(1.3, 2.0) + 0.5
    control = float(np.exp(drawn.rng.uniform(np.log(5e-3), np.log(20e-3))))
    return {"max_speed": float(speed), "max_control": control}
