"""Time refusals of random missions out of reach: python scripts/time_refusals.py --count 300.

Missions in the plane, in space and in orbit ask for up to ten times less, or several times more,
than their vehicles can do. Each is drawn or refused. What a refusal says would do is tried, and
must be accepted. Prints processor times; exit code 1 where one is longer than the limit, or where
the advice is refused.
"""

import argparse
import re
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator

import sato
from sato.reconfiguration.draw import draw
from sato.scenario.errors import InputError

LIMIT_S = 10.0  # of processor time, for each mission
STOP_S = 60.0  # after which a mission is given up
KINDS = ("plane", "space", "orbit", "J2")
EARTH_TO_CHIEF = 6878e3  # [m]


class TooSlow(Exception):
    """A mission took so long that it was given up."""


def draw_mission(rng: Generator) -> sato.Reconfiguration:
    """Draw a mission whose targets may be far out of reach."""
    kind = str(rng.choice(KINDS))
    in_orbit, axes = kind in ("orbit", "J2"), 2 if kind == "plane" else 3
    n, steps = int(rng.integers(1, 13)), int(rng.integers(10, 61))
    step, radius = (60.0, 50.0) if in_orbit else (float(rng.choice([0.5, 1.0, 2.0])), 0.5)
    norm, fuel_norm = [(2, 2), (2, 1), ("inf", 1), ("inf", 1), (1, 1)][rng.integers(5)]
    objective = "energy" if rng.random() < 0.15 else "fuel"
    time_s = steps * step
    control = 0.002 if in_orbit else 0.2
    # A control of U moves U t²/4 from rest to rest.
    away = control * time_s**2 / 4 * 10.0 ** rng.uniform(-1.0, 1.5)
    away = min(away, 60e3 if in_orbit else 1e6)
    grid = 3.0 * radius * np.arange(n)
    offset = np.zeros(axes)
    if in_orbit and rng.random() < 0.5:
        offset[1] = rng.uniform(-60e3, 60e3)
    turn = np.linalg.qr(rng.normal(size=(axes, axes)))[0]
    start = offset + np.c_[np.zeros(n), grid, np.zeros((n, axes - 2))]
    goal = start @ turn if not offset.any() else start.copy()
    direction = rng.normal(size=axes)
    goal = goal + away * direction / np.linalg.norm(direction)
    speed = float(rng.choice([np.inf, 1.5 * away / time_s, 4 * away / time_s]))
    model: Any = sato.DoubleIntegrator(axes)
    if in_orbit:
        orbit = sato.Orbit.from_elements(EARTH_TO_CHIEF, inclination=np.radians(45))
        model = sato.J2(orbit) if kind == "J2" else sato.ClohessyWiltshire.from_orbit(orbit)
        speed = np.inf if kind == "J2" or offset.any() else speed
    elif rng.random() < 0.3 and speed < np.inf:
        start = np.c_[start, rng.uniform(-0.2, 0.2, (n, axes)) * min(speed, control * time_s / 8)]
    limits: dict[str, Any] = {"max_control": control}
    if rng.random() < 0.15:
        limits = {"max_control": tuple(control * rng.uniform(0.5, 1.5, n).round(3))}
        limits = {"max_control": tuple(np.maximum(limits["max_control"], control / 2))}
    return sato.Reconfiguration(
        model=model,
        start=start,
        legs=[sato.Leg(goal, steps=steps)],
        step=step,
        comm_radius=max(3 * away, 1e3),
        collision_radius=radius,
        max_speed=speed,
        control_norm=norm,
        fuel_norm=fuel_norm,
        objective=objective,
        assignment=str(rng.choice(["auction", "auction", "given"])),
        allow_undetectable=True,
        **limits,
    )


def follow_advice(
    mission: sato.Reconfiguration, reason: str
) -> Iterator[tuple[str, sato.Reconfiguration]]:
    """Return the missions that a refusal says would do, each with its advice."""
    if found := re.search(r"steps = (\d+)", reason):
        legs = [replace(mission.legs[0], steps=int(found[1]))]
        yield found[0], replace(mission, legs=tuple(legs))
    if found := re.search(r"max_control_m_s2 = ([\d.e+-]+\d)", reason):
        yield found[0], replace(mission, max_control=float(found[1]))
    if found := re.search(r"([\d.e+-]+) times the limits", reason):
        more = np.multiply(mission.max_control, float(found[1])).tolist()
        yield found[0], replace(mission, max_control=tuple(more))


def time_draw(mission: sato.Reconfiguration) -> tuple[float, InputError | None]:
    """Return the processor time of a draw, and its refusal.

    Raises:
        TooSlow: It took longer than `STOP_S`.
    """

    def stop(*_: object) -> None:
        raise TooSlow

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, STOP_S)
    begin = time.process_time()
    try:
        draw(mission, np.random.default_rng(0))
        refusal = None
    except InputError as error:
        refusal = error
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return time.process_time() - begin, refusal


def main() -> int:
    """Time the missions, and print what is slow or wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=300, help="missions")
    parser.add_argument("--seed", type=int, default=0, help="random seed")
    parser.add_argument("--first", type=int, default=0, help="number of the first mission")
    parser.add_argument("--verbose", action="store_true", help="print each refusal")
    args = parser.parse_args()
    times, wrong, advised, accepted = list[float](), 0, 0, 0
    warm = draw_mission(np.random.default_rng([args.seed, 0]))
    time_draw(warm)
    for number in range(args.first, args.first + args.count):
        mission = draw_mission(np.random.default_rng([args.seed, number]))
        try:
            seconds, refusal = time_draw(mission)
        except TooSlow:
            seconds, refusal = STOP_S, None
        times.append(seconds)
        accepted += refusal is None and seconds < STOP_S
        if args.verbose or seconds > LIMIT_S:
            print(f"{number}: {seconds:.2f} s, {refusal}", flush=True)
        if refusal is None:
            continue
        for advice, better in follow_advice(mission, str(refusal)):
            advised += 1
            try:
                seconds, again = time_draw(better)
            except TooSlow:
                seconds, again = STOP_S, None
            if seconds > LIMIT_S:
                print(f"{number}: {advice} takes {seconds:.2f} s", flush=True)
            times.append(seconds)
            if again is not None:
                wrong += 1
                print(f"{number}: {refusal}\n    {advice} is refused: {again}", flush=True)
    slow = sum(seconds > LIMIT_S for seconds in times)
    print(
        f"{args.count} missions, {accepted} accepted; {advised} times advised, {wrong} wrong; "
        f"processor time: median {np.median(times):.2f} s, worst {max(times):.2f} s, "
        f"{slow} above {LIMIT_S:g} s"
    )
    return int(bool(wrong or slow))


if __name__ == "__main__":
    sys.exit(main())
