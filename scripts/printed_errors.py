"""What is printed in [Bernard2023], what is right, and how much it matters.

Printed forms and ours are held against central differences, of six robots that stand and look
at random, many times over; what can only be seen in flight is flown. Which equations are right
is in the second table, of `printed_equations`.
"""

from math import acos, degrees
from typing import NamedTuple

import numpy as np
import typer
from double_eigenvalue import BASES, on_rings
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from printed_equations import AXIS, SIGHT, N, Pairs, equations, pair_up, rotation, stand, times
from rich.console import Console
from rich.table import Table

from problems.graph import connectivity, edge, gradient, graph
from sato.connectivity import Frame, fly
from sato.connectivity.potential import Potential, steepness, value
from sato.connectivity.yaw import Tracking, by_motion, observe, wrapped
from sato.scenario import read

POTENTIAL = Potential()
OFF = 0.1  # of a relative yaw that is estimated [rad]
FLIGHTS = 2
STICK = 2.0  # [m/s]


class Finding(NamedTuple):
    """One row."""

    printed: str
    right: str
    evidence: str


def size(vectors: Float[Array, "m d"]) -> Float[Array, " m"]:
    """Length of each."""
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def sights(pairs: Pairs) -> tuple[Bool[Array, " m"], Bool[Array, " m"]]:
    """Whether i sees j, and j sees i."""
    near = (pairs.d > SIGHT.d_min) & (pairs.d < SIGHT.d_max)
    sees, seen = (facing @ AXIS > SIGHT.a_min for facing in (pairs.mine, pairs.theirs))
    return near & sees, near & seen


def reckoned(
    pairs: Pairs, mine: Array, theirs: Array, turn: Array, sees: bool = True
) -> tuple[Float[Array, " m"], Float[Array, "m 3"]]:
    """A_ij and R_iᵀ ∂A_ij/∂p_i, as i has them from what it takes for bearings and yaw."""
    weight, motion = np.zeros(len(pairs.d)), np.zeros((len(pairs.d), 4))
    for m, d in enumerate(pairs.d):
        weight[m], _, _ = edge(d, mine[m], theirs[m], turn[m], sees, True, SIGHT, motion[m])
    return weight, motion[:, :3]


def off(found: Float[Array, "m 3"], pairs: Pairs, which: Bool[Array, " m"]) -> str:
    """How far a gradient is off at most, and in the median state."""
    error, state = size(found - pairs.truth)[which], pairs.state[which]
    each = [error[state == k].max() for k in np.unique(state)]
    return f"up to {max(each):.2f}/m, {np.median(each):.2f}/m in the median state"


def bearing(pairs: Pairs) -> Finding:
    """β_ji of who has to work it out."""
    sees, seen = sights(pairs)
    printed = -times(pairs.between, pairs.mine)
    weight, first = reckoned(pairs, pairs.mine, printed, pairs.turn)
    wrong = np.abs(weight - pairs.value[:, 3])[sees].max()
    back = -times(pairs.between.swapaxes(1, 2), pairs.theirs)  # β_ij from β_ji, likewise
    _, second = reckoned(pairs, back, pairs.theirs, pairs.turn, sees=False)
    return Finding(
        "Sec. III-C: β_ji = −ⁱR_j β_ij",
        "β_ji = −(ⁱR_j)ᵀ β_ij",
        f"β_ji off by up to {size(printed - pairs.theirs).max():.2f}. Case 1, who sees: ∂A_ij/∂p_i "
        f"off by {off(first, pairs, sees)}, A_ij by {wrong:.2f}. Case 2, who is only seen: "
        f"{off(second, pairs, seen & ~sees)}",
    )


def frames(pairs: Pairs) -> Finding:
    """R_j where ⁱR_j belongs: `edge` turns nothing else by the yaw that it is given."""
    everybody = np.ones(len(pairs.d), dtype=bool)
    _, printed = reckoned(pairs, pairs.mine, pairs.theirs, pairs.yaw[:, 1])
    _, ours = reckoned(pairs, pairs.mine, pairs.theirs, pairs.turn)
    return Finding(
        "(12), (29): R_j P_ji o_C",
        "ⁱR_j P_ji o_C, as the line below says",
        f"∂A_ij/∂p_i off by {off(printed, pairs, everybody)}; ours by "
        f"{size(ours - pairs.truth).max():.0e}/m",
    )


def symmetry(pairs: Pairs, rng: np.random.Generator) -> Finding:
    """f*_ji worked out from an estimated yaw."""
    turn = pairs.turn + rng.uniform(-OFF, OFF, len(pairs.d))
    guessed = -times(rotation(turn).swapaxes(1, 2), pairs.mine)
    weight, _ = reckoned(pairs, pairs.mine, guessed, turn)
    sees, _ = sights(pairs)
    return Finding(
        "Sec. III-C, case 1: p_ij and ψ̃_ij are all that i needs; f_ij = f_ji by construction",
        "by construction only if j sends what it sees of i",
        f"ψ̃_ij wrong by up to {OFF:g} rad: A_ij as i has it off by up to "
        f"{np.abs(weight - pairs.value[:, 3])[sees].max():.2f}",
    )


def field_of_view(states: int, pairs: Pairs) -> Finding:
    """a_max as the limit, rather than a_min."""
    weight = pairs.value[:, 3]
    facing = np.maximum(pairs.mine @ AXIS, pairs.theirs @ AXIS)
    kept = (weight > 0) & (facing > SIGHT.a_max)

    def connected(weight: Array) -> int:
        square = np.zeros((states, N, N))
        square[:, ~np.eye(N, dtype=bool)] = weight.reshape(states, -1)
        return int((connectivity(square).lambda2 > POTENTIAL.least).sum())

    lost, edges = int((weight > 0).sum() - kept.sum()) // 2, int((weight > 0).sum()) // 2
    return Finding(
        "Sec. III-A: a_max is the cosine of the field of view's limit",
        "a_min is; within a_max all is seen",
        f"f* is 0 beyond {degrees(acos(SIGHT.a_min)):.1f}° and 1 within "
        f"{degrees(acos(SIGHT.a_max)):.1f}°; were that the limit, {lost} of {edges} edges would be "
        f"lost, and of {connected(weight)} connected states {connected(weight * kept)} be left",
    )


def picture(lambda2: Float[Array, " states"]) -> Finding:
    """What the potential does at λ₂^max."""
    most = POTENTIAL.most
    return Finding(
        "Sec. III, Fig. 2: V^λ decreases towards 0; λ₂^max stands in the caption alone",
        "V^λ is 0 from λ₂^max on; ours is 0 there in value and slope",
        f"V({most:g}) = {value(most, POTENTIAL):g}, V′ = {abs(steepness(most, POTENTIAL)):g}; "
        f"V(0.05) = {value(0.05, POTENTIAL):.0f}; states above: {(lambda2 > most).mean():.1%}",
    )


def double(rings: int, rng: np.random.Generator) -> Finding:
    """λ₂ = λ₃, where an eigenvector is whichever was found."""
    seen = on_rings(rings, rng)
    return Finding(
        "(3)–(5): the gradient of λ₂, always",
        "there is none where λ₂ = λ₃; ours is the mean over the eigenvectors of λ₂",
        f"{seen.rings} rings, {BASES} bases each: printed and mean differ by up to "
        f"{seen.spread:.2f} of the mean in the median ring; λ₂ changes at {min(seen.printed):.2f} "
        f"to {max(seen.printed):.2f} of the rate expected along the printed one, at "
        f"{min(seen.mean):.2f} to {max(seen.mean):.2f} along the mean, which the basis alters by "
        f"{seen.altered:.0e}",
    )


def flown(seed: int, *settings: str) -> list[Frame]:
    """A flight without obstacles."""
    rng = np.random.default_rng(seed)
    return list(fly(read("connectivity", ["obstacles.count=0", *settings]).build(rng), rng))


def drag(pull: Float[Array, "states 6 3"]) -> Finding:
    """What holds the robots together moves nobody on the whole."""
    speeds = []
    for frames in map(flown, range(FLIGHTS)):
        asked = np.array([f.stick for f in frames[:-1]])
        gone = np.diff([f.position.mean(axis=0) for f in frames], axis=0)
        held = size(asked) > 0.999 * STICK
        took = np.diff([f.time for f in frames])
        speeds.append(((gone * asked).sum(axis=1) / (STICK * took))[held])
    return Finding(
        "Sec. V: the team follows the leader",
        "Σᵢ ∂λ₂/∂pᵢ = 0: short of saturation and obstacles its centre goes at v/N",
        f"|Σ| ≤ {size(pull.sum(axis=1)).max():.0e}/m; a stick of {STICK:g} m/s should make "
        f"{STICK / N:.2f} m/s, and made {np.concatenate(speeds).mean():.2f} in {FLIGHTS} flights",
    )


def apart(pairs: Pairs) -> Finding:
    """Whom the weights push away."""
    sees, seen = sights(pairs)
    blind = (pairs.d < SIGHT.d_near) & ~sees & ~seen

    def least(strength: float) -> float:
        dense = ("box_m=[5, 5, 2.5]", f"repulsion.strength={strength}")
        return min(flown(seed, *dense)[-1].robot_distance for seed in range(FLIGHTS))

    return Finding(
        "Sec. III-A: γ_ij falls to 0 towards d_min, so that robots keep their distance",
        "those that are out of each other's view do not; only Sec. III-D keeps them apart",
        f"{blind.sum() // 2} such pairs within D₁, gradient {np.abs(pairs.by[blind, 3]).max():g}; "
        f"{FLIGHTS} flights from a dense start come to {least(0.0):.2f} m without the range "
        f"sensor's push, {least(0.5):.2f} m with it",
    )


def guess(spin: float, swing: float, printed: bool) -> float:
    """How far ψ̂_ij is off after 1 s, by the printed observer or ours [rad].

    Robot i turns on the spot at `spin` [rad/s]; j goes at 1 m/s, and its velocity turns in its
    frame, which rests, at `swing` [rad/s].
    """
    track, dt, watch, still = Tracking(printed=printed), 1e-3, np.zeros(7), np.zeros(4)
    place = before = np.array([1.0, 0, 0])
    observe(before, before, True, still[:3], spin, still, watch, track, dt)
    for k in range(1000):
        v = np.array([np.cos(swing * k * dt), np.sin(swing * k * dt), 0, 0])
        place = place + dt * v[:3]
        now = rotation(np.array([-spin * (k + 1) * dt]))[0] @ place
        observe(now, before, False, still[:3], spin, v, watch, track, dt)
        before = now
    return float(abs(wrapped(by_motion(watch, v, track)[0] + spin)))


def lag() -> Finding:
    """What the observer lags behind."""
    swings, ours = guess(0, 1, True), guess(0, 1, False)
    spins, both = guess(1.5, 0, True), guess(1.5, 0, False)
    return Finding(
        "(16)–(18), (21): ψ̂_ij is the angle from v_j to e",
        "both lag by 1/k₁ in space: v_j through the same filter, turned with its frame",
        f"v_j turns at 1 rad/s: off by {swings:.2f} rad, ours {ours:.2f}; i turns at 1.5 rad/s: "
        f"{spins:.2f}, ours {both:.2f}",
    )


def climb() -> Finding:
    """What motion along the vertical tells of yaw."""
    watch, up = np.array([*[0.0] * 6, 1]), np.array([0.0, 0, 1, 0])
    printed, ours = (by_motion(watch, up, Tracking(printed=p))[1] for p in (True, False))
    return Finding(
        "(19): k₂ by |v_j|",
        "by its horizontal part, which alone tells of yaw",
        f"j climbs at 1 m/s: ψ̂_ij is trusted to {printed:.0%}, ours to {ours:.0%}",
    )


def main(states: int = 200, seed: int = 2023) -> None:
    """Print what is wrong or unsaid, then how far each equation is off."""
    out, rng = Console(markup=False), np.random.default_rng(seed)
    position, yaw = stand(states, rng)
    pairs = pair_up(position, yaw)
    lambda2 = connectivity(graph(position, yaw, SIGHT).weight).lambda2
    pull = gradient(position, yaw, SIGHT).position
    table = Table(*Finding._fields, show_lines=True, title=f"{states} states of {N} robots")
    for finding in (
        bearing(pairs),
        frames(pairs),
        symmetry(pairs, rng),
        field_of_view(states, pairs),
        picture(lambda2),
        double(states, rng),
        lag(),
        climb(),
        drag(pull),
        apart(pairs),
    ):
        table.add_row(*finding)
    out.print(table)
    out.print(equations(position, yaw, pairs, rng))


if __name__ == "__main__":
    typer.run(main)
