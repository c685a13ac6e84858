"""Errata of [Bernard2023]: printed form, correct form, and size of the difference.

Printed and corrected forms are compared with central differences, for six robots at random
positions and yaws; properties of flights are simulated. The second table, of
`bernard2023_equations`, lists the equations that are printed correctly.
"""

from math import acos, degrees
from typing import NamedTuple

import numpy as np
import typer
from bernard2023_equations import (
    AXIS,
    SIGHT,
    N,
    Pairs,
    draw_poses,
    equation_table,
    make_pairs,
    matvec,
    rotation,
)
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from repeated_eigenvalue import BASES_PER_RING, measure_rings
from rich.console import Console
from rich.table import Table

from problems.interaction_graph import (
    algebraic_connectivity,
    edge_weights,
    interaction_graph,
    lambda2_gradient,
)
from sato.check.common import find_closest_approach
from sato.connectivity.controller import evaluate_potential, negative_slope
from sato.connectivity.loop import simulate
from sato.connectivity.record import ConnectivityFrame
from sato.connectivity.settings import Potential, YawTracking
from sato.connectivity.yaw_estimator import update_velocity_observer, wrap_angle, yaw_from_motion
from sato.scenario.file import read

POTENTIAL = Potential()
YAW_ERROR = 0.1  # of a relative yaw that is estimated [rad]
RUN_COUNT = 2
STICK_SPEED = 2.0  # [m/s]
SHORT_FLIGHT = (
    "obstacles.count=0", "stick.count=4", "stick.spacing_m=6", f"stick.speed_m_s={STICK_SPEED}",
    "stick.start_s=0", "stick.on_s=9", "stick.off_s=3", "duration_s=60",
)  # fmt: skip


class Erratum(NamedTuple):
    """Row of the table."""

    paper: str
    correction: str
    evidence: str


def norms(vectors: Float[Array, "m d"]) -> Float[Array, " m"]:
    """Return the length of each vector."""
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def mutual_visibility(pairs: Pairs) -> tuple[Bool[Array, " m"], Bool[Array, " m"]]:
    """Return the masks of pairs in which i sees j, and j sees i."""
    near = (pairs.d > SIGHT.d_min) & (pairs.d < SIGHT.d_max)
    sees, seen = (facing @ AXIS > SIGHT.a_min for facing in (pairs.bearing_ij, pairs.bearing_ji))
    return near & sees, near & seen


def estimate_weights(
    pairs: Pairs, own: Array, other: Array, yaw: Array, sees: bool = True
) -> tuple[Float[Array, " m"], Float[Array, "m 3"]]:
    """Return A_ij and R_iᵀ ∂A_ij/∂p_i, from the bearings and the yaw that i assumes."""
    found = edge_weights(pairs.d, own, other, yaw, SIGHT, sees)
    return found.weights, found.gradients[:, :3]


def describe_gradient_error(
    found: Float[Array, "m 3"], pairs: Pairs, mask: Bool[Array, " m"]
) -> str:
    """Describe the largest and the median error of a gradient."""
    error, state = norms(found - pairs.weight_gradient)[mask], pairs.state[mask]
    each = [error[state == k].max() for k in np.unique(state)]
    return f"up to {max(each):.2f}/m, {np.median(each):.2f}/m in the median state"


def bearing_erratum(pairs: Pairs) -> Erratum:
    """Compare the forms of β_ji, which robot i computes from β_ij."""
    sees, seen = mutual_visibility(pairs)
    printed = -matvec(pairs.rotation_ij, pairs.bearing_ij)
    weight, first = estimate_weights(pairs, pairs.bearing_ij, printed, pairs.relative_yaw)
    wrong = np.abs(weight - pairs.weights[:, 3])[sees].max()
    back = -matvec(pairs.rotation_ij.swapaxes(1, 2), pairs.bearing_ji)  # β_ij from β_ji, likewise
    _, second = estimate_weights(pairs, back, pairs.bearing_ji, pairs.relative_yaw, sees=False)
    return Erratum(
        "Sec. III-C: β_ji = −ⁱR_j β_ij",
        "β_ji = −(ⁱR_j)ᵀ β_ij",
        f"β_ji off by up to {norms(printed - pairs.bearing_ji).max():.2f}. Case 1, who sees: "
        f"∂A_ij/∂p_i off by {describe_gradient_error(first, pairs, sees)}, A_ij by {wrong:.2f}. "
        f"Case 2, who is only seen: {describe_gradient_error(second, pairs, seen & ~sees)}",
    )


def frame_erratum(pairs: Pairs) -> Erratum:
    """Compare R_j, as printed, with ⁱR_j: the yaw enters nowhere else."""
    everyone = np.ones(len(pairs.d), dtype=bool)
    _, printed = estimate_weights(pairs, pairs.bearing_ij, pairs.bearing_ji, pairs.yaw[:, 1])
    _, ours = estimate_weights(pairs, pairs.bearing_ij, pairs.bearing_ji, pairs.relative_yaw)
    return Erratum(
        "(12), (29): R_j P_ji o_C",
        "ⁱR_j P_ji o_C, as the line below says",
        f"∂A_ij/∂p_i off by {describe_gradient_error(printed, pairs, everyone)}; ours by "
        f"{norms(ours - pairs.weight_gradient).max():.0e}/m",
    )


def symmetry_erratum(pairs: Pairs, rng: np.random.Generator) -> Erratum:
    """Measure the asymmetry of f*_ji computed from an estimated yaw."""
    yaw = pairs.relative_yaw + rng.uniform(-YAW_ERROR, YAW_ERROR, len(pairs.d))
    estimated = -matvec(rotation(yaw).swapaxes(1, 2), pairs.bearing_ij)
    weight, _ = estimate_weights(pairs, pairs.bearing_ij, estimated, yaw)
    sees, _ = mutual_visibility(pairs)
    return Erratum(
        "Sec. III-C, case 1: p_ij and ψ̃_ij are all that i needs; f_ij = f_ji by construction",
        "by construction only if j sends what it sees of i",
        f"ψ̃_ij wrong by up to {YAW_ERROR:g} rad: A_ij as i has it off by up to "
        f"{np.abs(weight - pairs.weights[:, 3])[sees].max():.2f}",
    )


def field_of_view_erratum(states: int, pairs: Pairs) -> Erratum:
    """Compare a_max with a_min as the limit of the field of view."""
    weight = pairs.weights[:, 3]
    facing = np.maximum(pairs.bearing_ij @ AXIS, pairs.bearing_ji @ AXIS)
    kept = (weight > 0) & (facing > SIGHT.a_max)

    def connected(weight: Array) -> int:
        square = np.zeros((states, N, N))
        square[:, ~np.eye(N, dtype=bool)] = weight.reshape(states, -1)
        return int((algebraic_connectivity(square).lambda2 > POTENTIAL.lambda2_min).sum())

    lost, edges = int((weight > 0).sum() - kept.sum()) // 2, int((weight > 0).sum()) // 2
    return Erratum(
        "Sec. III-A: a_max is the cosine of the field of view's limit",
        "a_min is; within a_max all is seen",
        f"f* is 0 beyond {degrees(acos(SIGHT.a_min)):.1f}° and 1 within "
        f"{degrees(acos(SIGHT.a_max)):.1f}°; were that the limit, {lost} of {edges} edges would be "
        f"lost, and of {connected(weight)} connected states {connected(weight * kept)} be left",
    )


def potential_erratum(lambda2: Float[Array, " states"]) -> Erratum:
    """Evaluate the potential at λ₂^max."""
    largest = POTENTIAL.lambda2_max
    return Erratum(
        "Sec. III, Fig. 2: V^λ decreases towards 0; λ₂^max stands in the caption alone",
        "V^λ is 0 from λ₂^max on; ours is 0 there in value and slope",
        f"V({largest:g}) = {evaluate_potential(largest, POTENTIAL):g}, "
        f"V′ = {abs(negative_slope(largest, POTENTIAL)):g}; "
        f"V(0.05) = {evaluate_potential(0.05, POTENTIAL):.0f}; "
        f"states above: {(lambda2 > largest).mean():.1%}",
    )


def repeated_eigenvalue_erratum(rings: int, rng: np.random.Generator) -> Erratum:
    """Compare gradients where λ₂ = λ₃, and the eigenvector is not unique."""
    seen = measure_rings(rings, rng)
    return Erratum(
        "(3)–(5): the gradient of λ₂, always",
        "there is none where λ₂ = λ₃; ours is the mean over the eigenvectors of λ₂",
        f"{seen.rings} rings, {BASES_PER_RING} bases each: printed and mean differ by up to "
        f"{seen.spread:.2f} of the mean in the median ring; λ₂ changes at {min(seen.printed):.2f} "
        f"to {max(seen.printed):.2f} of the rate expected along the printed one, at "
        f"{min(seen.mean):.2f} to {max(seen.mean):.2f} along the mean, which the basis alters by "
        f"{seen.basis_dependence:.0e}",
    )


def simulate_run(seed: int, *settings: str) -> list[ConnectivityFrame]:
    """Simulate a short flight without obstacles."""
    rng = np.random.default_rng(seed)
    return list(simulate(read("connectivity", [*SHORT_FLIGHT, *settings]).draw(rng), rng))


def least_distance(frames: list[ConnectivityFrame]) -> float:
    """Return the least distance of two robots in a flight [m]."""
    position = np.array([frame.position for frame in frames])
    alive = np.array([frame.alive for frame in frames])
    return find_closest_approach(position, alive).distance


def leader_erratum(pull: Float[Array, "states 6 3"]) -> Erratum:
    """Show that the connectivity forces add up to zero and do not move the centroid."""
    speeds = []
    for frames in map(simulate_run, range(RUN_COUNT)):
        stick = np.array([f.stick for f in frames[:-1]])
        displacement = np.diff([f.position.mean(axis=0) for f in frames], axis=0)
        is_full = norms(stick) > 0.999 * STICK_SPEED
        duration = np.diff([f.time for f in frames])
        speeds.append(((displacement * stick).sum(axis=1) / (STICK_SPEED * duration))[is_full])
    return Erratum(
        "Sec. V: the team follows the leader",
        "Σᵢ ∂λ₂/∂pᵢ = 0: short of saturation and obstacles its center goes at v/N",
        f"|Σ| ≤ {norms(pull.sum(axis=1)).max():.0e}/m; a stick of {STICK_SPEED:g} m/s should make "
        f"{STICK_SPEED / N:.2f} m/s, and made {np.concatenate(speeds).mean():.2f} "
        f"in {RUN_COUNT} flights",
    )


def repulsion_erratum(pairs: Pairs) -> Erratum:
    """Show which pairs the weights repel."""
    sees, seen = mutual_visibility(pairs)
    blind = (pairs.d < SIGHT.d_near) & ~sees & ~seen

    def least(strength: float) -> float:
        dense = ("box_m=[5, 5, 2.5]", f"repulsion.strength={strength}")
        return min(least_distance(simulate_run(seed, *dense)) for seed in range(RUN_COUNT))

    return Erratum(
        "Sec. III-A: γ_ij falls to 0 towards d_min, so that robots keep their distance",
        "those that are out of each other's view do not; only Sec. III-D keeps them apart",
        f"{blind.sum() // 2} such pairs within D₁, "
        f"gradient {np.abs(pairs.weight_derivatives[blind, 3]).max():g}; "
        f"{RUN_COUNT} flights from a dense start come to {least(0.0):.2f} m without the range "
        f"sensor's push, {least(0.5):.2f} m with it",
    )


def observer_yaw_error(spin: float, swing: float, printed: bool) -> float:
    """Return the error of ψ̂_ij after 1 s, by the printed observer or ours [rad].

    Robot i turns on the spot at `spin` [rad/s]; j goes at 1 m/s, and its velocity turns in its
    frame, which rests, at `swing` [rad/s].
    """
    track, dt, observer, zero = YawTracking(as_printed=printed), 1e-3, np.zeros(7), np.zeros(3)
    position = previous = np.array([1.0, 0, 0])
    rate = np.array(spin)
    for k in range(1000):
        v = np.array([np.cos(swing * k * dt), np.sin(swing * k * dt), 0, 0])
        position = position + dt * v[:3]
        current = rotation(np.array([-spin * (k + 1) * dt]))[0] @ position
        observer = update_velocity_observer(current, previous, zero, rate, v, observer, track, dt)
        previous = current
    return float(abs(wrap_angle(yaw_from_motion(observer, v, track)[0] + spin)))


def observer_lag_erratum() -> Erratum:
    """Compare the lags of the printed observer and ours."""
    swings, ours = observer_yaw_error(0, 1, True), observer_yaw_error(0, 1, False)
    spins, both = observer_yaw_error(1.5, 0, True), observer_yaw_error(1.5, 0, False)
    return Erratum(
        "(16)–(18), (21): ψ̂_ij is the angle from v_j to e",
        "both lag by 1/k₁ in space: v_j through the same filter, turned with its frame",
        f"v_j turns at 1 rad/s: off by {swings:.2f} rad, ours {ours:.2f}; i turns at 1.5 rad/s: "
        f"{spins:.2f}, ours {both:.2f}",
    )


def vertical_motion_erratum() -> Erratum:
    """Compare the gains of the yaw estimate in vertical motion, which does not reveal yaw."""
    observer, up = np.array([*[0.0] * 6, 1]), np.array([0.0, 0, 1, 0])
    printed, ours = (
        yaw_from_motion(observer, up, YawTracking(as_printed=p))[1] for p in (True, False)
    )
    return Erratum(
        "(19): k₂ by |v_j|",
        "by its horizontal part, which alone tells of yaw",
        f"j climbs at 1 m/s: ψ̂_ij is trusted to {printed:.0%}, ours to {ours:.0%}",
    )


def main(states: int = 200, seed: int = 2023) -> None:
    """Print the errata, then the largest error of each equation."""
    console, rng = Console(markup=False), np.random.default_rng(seed)
    position, yaw = draw_poses(states, rng)
    pairs = make_pairs(position, yaw)
    lambda2 = algebraic_connectivity(interaction_graph(position, yaw, SIGHT).weights).lambda2
    pull = lambda2_gradient(position, yaw, SIGHT).position
    table = Table(*Erratum._fields, show_lines=True, title=f"{states} states of {N} robots")
    for finding in (
        bearing_erratum(pairs),
        frame_erratum(pairs),
        symmetry_erratum(pairs, rng),
        field_of_view_erratum(states, pairs),
        potential_erratum(lambda2),
        repeated_eigenvalue_erratum(states, rng),
        observer_lag_erratum(),
        vertical_motion_erratum(),
        leader_erratum(pull),
        repulsion_erratum(pairs),
    ):
        table.add_row(*finding)
    console.print(table)
    console.print(equation_table(position, yaw, pairs, rng))


if __name__ == "__main__":
    typer.run(main)
