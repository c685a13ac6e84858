"""Errors of [Morgan2016]: what is printed, what goes wrong, and what works, in numbers."""

from math import floor, pi, sqrt

import numpy as np
import scipy
import typer
from morgan2016_method1 import Finding, method_1
from morgan2016_trajectories import (
    CONTROL,
    MAX_ITERATIONS,
    RADIUS,
    STEP,
    STEPS,
    TOLERANCE,
    Encounter,
    as_printed,
    draw_encounter,
    fly,
    with_tolerance,
)
from rich.console import Console
from rich.table import Table

import sato
from dynamics.discretize import linearize_along
from dynamics.j2 import J2, invariant_velocity
from dynamics.orbit import EARTH_MU, Orbit


def crossings(trials: int) -> list[Finding]:
    """Fly crossing vehicles by Method 2 as printed, by another end, and by the toolkit."""
    rng = np.random.default_rng(7)
    encounters = [draw_encounter(rng) for _ in range(trials)]
    printed = [fly(each, as_printed) for each in encounters]
    ended = [fly(each, with_tolerance) for each in encounters]
    flown = [each for each in ended if np.isfinite(each.separation)]
    ours = [_fly_ours(each) for each in encounters]
    head_on = Encounter(np.array([[-3.0, 0], [3, 0]]), np.array([[3.0, 0], [-3, 0]]))
    through, around = fly(head_on, with_tolerance), _fly_ours(head_on)
    never = sum(each.iterations == MAX_ITERATIONS for each in printed)
    last = sum(each.iterations == MAX_ITERATIONS for each in flown)
    rounds = sorted(each.iterations for each in flown)
    reached = sum(is_reached for is_reached, _ in ours)
    least = min(separation for _, separation in ours)
    return [
        Finding(
            "Method 2, line 14: farther than R_col, and from all neighbors",
            f"of {len(flown)} crossings that have a solution {never} never end: where (38) is "
            "active the distance is R_col, and those of higher priority wait for the lower",
            f"R_col less {TOLERANCE:g} m, from those of higher priority: {last} never end, median "
            f"{rounds[len(rounds) // 2]} iterations",
        ),
        Finding(
            "(38) about nominals that cross",
            f"{trials - len(flown)} of {trials} crossings have an infeasible program, which "
            "Theorem 7 excludes by assumption",
            f"the toolkit flies {reached} of {trials}, at {least:.4f} m or more",
        ),
        Finding(
            "(13), (38): at samples",
            f"the other {len(flown)}: {min(e.separation for e in flown):.3f} m at samples, down to "
            f"{min(e.between for e in flown):.3f} m between; R_col = {RADIUS:g} m",
            f"hulls of Bézier points: {least:.4f} m in continuous time",
        ),
        Finding(
            "(38), (40): division by the distance of the nominals",
            f"it is 0 where they coincide, and (38) reads 0 ≥ 0: two that meet head-on pass at "
            f"{through.between:.3f} m",
            f"the nominal is pushed aside: {around[1]:.3f} m",
        ),
    ]


def _fly_ours(encounter: Encounter) -> tuple[bool, float]:
    start, target = encounter
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2), start=start, legs=[sato.Leg(target, steps=STEPS)],
        step=STEP, comm_radius=20.0, collision_radius=RADIUS, max_control=CONTROL, max_speed=2.0,
        assignment="given", horizon_steps=4,
    )  # fmt: skip
    summary = sato.run(mission).summary
    return bool(summary["reached"]), float(summary["min_separation_m"])


def pairs_left_out() -> Finding:
    """Count the pairs that (4) and (13) do not constrain."""
    n = 123
    return Finding(
        "(4), (13): i < j, j = 1, …, N − 1",
        f"agent N is in no pair: N = {n}, {n - 1} of {n * (n - 1) // 2} pairs without a constraint",
        "j = 2, …, N",
    )


def frozen_matrices() -> Finding:
    """Freeze A and z over a step, as (11) does, on the free motion of spacecraft."""
    rng, step, steps = np.random.default_rng(8), 60.0, 24
    model = J2(Orbit.from_elements(6878e3, inclination=pi / 4))
    position = np.c_[rng.uniform(-1500, 1500, (48, 2)), np.zeros(48)]
    x = np.hstack([position, invariant_velocity(model.orbit, position)])
    frozen, rest = x.copy(), np.zeros((48, 1, 3))
    for k in range(steps):
        A, _ = model.jacobian(np.array([k * step]), x[:, None], rest)
        z = model.rate(k * step, x, rest[:, 0]) - np.einsum("nij,nj->ni", A[:, 0], x)
        rates = np.zeros((48, 7, 7))
        rates[:, :6, :6], rates[:, :6, 6] = A[:, 0], z
        moved = scipy.linalg.expm(rates * step)
        frozen = np.einsum("nij,nj->ni", moved[:, :6, :6], frozen) + moved[:, :6, 6]
        true = linearize_along(model, x[:, None], rest, step, k * step)
        x = np.einsum("nij,nj->ni", true.A[:, 0], x) + true.z[:, 0]
    off = np.linalg.norm((frozen - x)[:, :3], axis=1).max()
    return Finding(
        "(11): A and z as at the start of the step",
        f"48 spacecraft within 1.5 km, J2, 24 steps of 60 s without control: up to {off:.1f} m off",
        "integrated over the step (`linearize_along`): exact along the nominal",
    )


def neighbors_by_state() -> Finding:
    """Evaluate (65), which takes the norm of positions and velocities together."""
    radius, speed, separation = 3.0, 0.2, 0.5  # of the toolkit's `uiuc` [m, m/s]
    reach = sqrt(radius**2 - (2 * speed) ** 2)
    slow = (reach - separation) / (2 * speed)
    return Finding(
        "(65): ‖x_j − x_i‖ of states",
        f"adds m² to (m/s)². `uiuc`: two at full speed are neighbors from {reach:.3f} m, not "
        f"{radius:g}, and T_H of Proposition 9 is {slow:.2f} s, not "
        f"{(radius - separation) / (2 * speed):.2f}; j itself is in N_j",
        "‖G (x_j − x_i)‖, j ≠ i in (64)",
    )


def proposition_9() -> Finding:
    """Evaluate Proposition 9 with the numbers of Sec. VI-B."""
    radius, separation, step, axis, circle = 2000.0, 50.0, 60.0, 6_878_000.0, 1000.0
    most = (radius - separation) / (2 * step)
    speed = 2 * sqrt(EARTH_MU / axis**3) * circle
    return Finding(
        "Sec. VI-B: neither V_max, U_max, T_H, ε, ε_SCP nor the circle's radius",
        f"(69): V_max T_H ≤ {most:.2f} m/s × steps. Rest on a circle of 1 km alone takes "
        f"{speed:.2f} m/s, so T_H ≤ {floor(most / speed)} of 24 steps; between two samples two "
        f"can move {2 * speed * step:.0f} m toward each other, R_col = {separation:g} m",
        "T_H for those out of hearing alone; those in hearing look to the end of the leg",
    )


def main(trials: int = 60) -> None:
    """Print the table."""
    table = Table(*Finding._fields, show_lines=True, title=f"{trials} trials each")
    findings = [
        *method_1(trials),
        *crossings(trials),
        pairs_left_out(),
        neighbors_by_state(),
        proposition_9(),
        frozen_matrices(),
    ]
    for finding in findings:
        table.add_row(*finding)
    Console(markup=False).print(table)


if __name__ == "__main__":
    typer.run(main)
