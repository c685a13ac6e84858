"""Draw the figures of the pages on methods, from runs and from the functions that they explain."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.figure import Figure
from matplotlib.patches import Circle

import dynamics
import sato
from problems import Camera, align, design_gains
from problems.interaction_graph import edge_weights
from sato.auctions.bidder import VsdaaBidder, WinningBids
from sato.auctions.direct import assign_centrally
from sato.auctions.vsdaa import VsdaaAuction
from sato.connectivity.controller import evaluate_potential, repulsion_gain
from sato.connectivity.settings import Potential, Repulsion
from sato.figures.axes import add_titles, styled
from sato.figures.style import BLUE, DARK_GRAY, GRAY, GREEN, LIGHT_GRAY, ORANGE, RED
from sato.formation.settings import AssignmentSettings, FrameSettings
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.stopping import end_at_rest
from sato.shapes.formation_library import load_formation

FOLDER = Path(__file__).parents[1] / "docs/concepts"


def panels(count: int, height: float = 3.2) -> tuple[Figure, Any]:
    """Return a figure with panels side by side."""
    figure = Figure(figsize=(9.0, height), layout="constrained")
    return figure, figure.subplots(1, count)


def draw_auction() -> Figure:
    """Draw prices and total cost of an auction of 12 agents in a row, round by round."""
    rng, count = np.random.default_rng(4), 12
    start = np.c_[np.arange(count), rng.uniform(-1, 1, count)]
    target = np.c_[rng.uniform(0, count, count), np.full(count, 6.0)]
    cost = np.linalg.norm(start[:, None] - target, axis=2)
    graph = CommunicationGraph.from_positions(start, 2.4, np.ones(count, bool))
    auction = VsdaaAuction(cost, graph, np.full(count, count), 0.02)
    patience = 2 * (count - 1)
    agents = [
        VsdaaBidder(i, cost[i], auction.epsilon, True, patience, count, WinningBids.empty(count))
        for i in range(count)
    ]
    prices, totals, shared = [], [], []
    while not all(agent.is_finished for agent in agents):
        sent = [agent.bids for agent in agents]
        agents = [
            agent
            if agent.is_finished
            else agent.update([sent[j] for j in np.flatnonzero(graph.adjacency[i])])
            for i, agent in enumerate(agents)
        ]
        held = [agent.target_index for agent in agents]
        prices.append(np.abs(agents[0].bids.price))
        totals.append(cost[np.arange(count), held].sum())
        shared.append(count - len(set(held)))
    best = assign_centrally(auction).target_index
    optimum = cost[np.arange(count), best].sum()
    figure, (left, right) = panels(2)
    rounds = 1 + np.arange(len(prices))
    left.plot(rounds, prices, color=BLUE, lw=0.9, drawstyle="steps-post")
    left.set(xlabel="round of messages", ylabel="|price| of each target [m]")
    right.plot(rounds, totals, color=BLUE, drawstyle="steps-post", label="targets held")
    last = 1 + int(np.flatnonzero(shared).max())
    right.axvspan(0, last, color=LIGHT_GRAY, alpha=0.4, lw=0, label="two agents hold one")
    right.axhline(optimum, color=DARK_GRAY, lw=0.8, label="optimum")
    within = optimum + count * auction.epsilon
    right.axhline(within, color=RED, lw=0.8, ls="--", label=r"optimum + $N\epsilon$")
    right.set(xlabel="round of messages", ylabel="total cost [m]", xlim=left.get_xlim())
    right.legend()
    add_titles((left, right), ["prices that agent 0 knows", "total cost"])
    return figure


def draw_tie_break() -> Figure:
    """Draw who takes which target, by fuel alone and with the tie-break."""
    figure, axes = panels(2, 2.5)
    titles = []
    for ax, weight in zip(axes, (0.0, 0.2), strict=True):
        changes = ["agents=60", "text=HELLO", f"plan.tie_break={weight}"]
        run = sato.run("letters", seed=1, overrides=changes)
        first, held = run.data.position.values[0], run.data.target_index.values[0]
        ends = run.data.target_position.values[0][held]
        ax.plot(*np.stack([first, ends], axis=1).T, color=BLUE, lw=0.9)
        ax.plot(*first.T, "o", color=GRAY, ms=3)
        ax.plot(*ends.T, "x", color=DARK_GRAY, ms=4)
        ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        crossings, solves = count_crossings(first, ends), run.summary["solves"]
        fuel = f"{run.summary['fuel_m_s']:.2f} m/s"
        titles.append(f"w = {weight:g}: {crossings} crossings, {solves} programs, {fuel}")
    add_titles(axes, titles)
    return figure


def count_crossings(start: np.ndarray, end: np.ndarray) -> int:
    """Count the pairs of straight ways that cross."""

    def side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
        ab, ac = b - a, c - a
        return np.asarray(np.sign(ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]))

    i, j = np.triu_indices(len(start), 1)
    parts = side(start[i], end[i], start[j]) != side(start[i], end[i], end[j])
    return int((parts & (side(start[j], end[j], start[i]) != side(start[j], end[j], end[i]))).sum())


def draw_half_spaces() -> Figure:
    """Draw the closest encounter of a head-on crossing, as `sato plot` does."""
    return sato.run("crossing", seed=0).figures()["half-space"]


def draw_reach() -> Figure:
    """Draw Proposition 9, and the reach of commitments, to the scale of `uiuc`."""
    mission = sato.read("uiuc")
    R, hears = mission.collision_radius, mission.comm_radius
    flown = mission.max_speed * mission.horizon_steps * mission.step
    figure, axes = panels(2, 3.4)
    for ax, reach in zip(axes, (flown, (hears - R) / 2), strict=True):
        for x, sign in ((0.0, 1), (hears, -1)):
            ax.add_patch(Circle((x, 0), hears, fc="none", ec=LIGHT_GRAY, ls=":"))
            ax.add_patch(Circle((x, 0), reach, fc=BLUE, alpha=0.15, lw=0))
            ax.plot(x, 0, "o", color=BLUE, ms=4)
            ax.annotate(
                "", (x + sign * reach, 0), (x, 0), arrowprops={"arrowstyle": "->", "color": BLUE}
            )
        gap = hears - 2 * reach
        ax.plot([reach, hears - reach], [0, 0], color=RED, lw=2)
        ax.text(hears / 2, 0.12, f"{gap:.2f} m", color=RED, ha="center")
        ax.plot([0, hears], [-1.45, -1.45], "|-", color=DARK_GRAY, lw=0.8)
        ax.text(hears / 2, -1.75, f"$R_{{comm}}$ = {hears:g} m", ha="center")
        ax.set(aspect="equal", xlim=(-1.6, hears + 1.6), ylim=(-2.0, 1.6))
        ax.set_axis_off()
    axes[0].text(0.1, -0.35, rf"$V T_H \Delta t$ = {flown:g} m", color=BLUE)
    axes[1].text(0.1, -0.35, f"r = {(hears - R) / 2:g} m", color=BLUE)
    add_titles(
        axes,
        [
            f"until they look again, at least R = {R:g} m is left",
            f"where all is within reach r, R = {R:g} m is left for ever",
        ],
    )
    return figure


def draw_commitment() -> Figure:
    """Draw two that meet head-on, and the stops with which their plans may end."""
    start = np.array([[-9.0, 0.0, 0.8, 0.0], [9.0, 0.5, -0.8, 0.0]])
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        start=start,
        legs=[sato.Leg(np.array([[9.0, 0.0], [-9.0, 0.5]]), steps=34)],
        assignment="given",
        step=1.0,
        comm_radius=24.0,
        collision_radius=3.0,
        max_control=0.1,
        max_speed=1.0,
    )
    run = sato.run(mission)
    p, v, u = (run.data[name].values for name in ("position", "velocity", "control"))
    plant, figure, ax = sato.LinearPlant(sato.DoubleIntegrator(2)), *panels(1, 3.0)
    for i, color in enumerate((BLUE, ORANGE)):
        ax.plot(*p[:, i].T, color=color, label=f"flown by vehicle {i}")
        for k in range(0, 24, 4):
            stop, _ = end_at_rest(
                mission, np.array([i]), v[k, i][None], u[k:, i][None], np.array([2])
            )
            state, path = np.r_[p[k, i], v[k, i]][None], [p[k, i]]
            for control in stop[0]:
                state = plant.propagate(state, control[None], 0.0, mission.step)[-1]
                path.append(state[0, :2])
            ax.plot(*np.array(path).T, color=color, lw=0.8, ls="--")
            ax.plot(*path[-1], "s", color=color, ms=4, mew=0)
    ax.plot([], [], "s--", color=GRAY, ms=4, lw=0.8, label="two steps of it, then a stop")
    near = int(np.linalg.norm(p[:, 0] - p[:, 1], axis=1).argmin())
    ax.add_patch(Circle(p[near, 0], 3.0, fc=RED, alpha=0.15, lw=0))
    ax.plot([], [], "o", color=RED, alpha=0.3, ms=8, mew=0, label="R about vehicle 0, when nearest")
    ax.plot(*p[near].T, "o", color=DARK_GRAY, ms=4)
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    figure.legend(loc="outside lower center", ncols=4)
    return figure


def draw_drift() -> Figure:
    """Draw ten orbits of free motion, with velocities of two kinds."""
    orbit = sato.Orbit.from_elements(6878e3, inclination=np.radians(45))
    angle = np.pi / 3 * np.arange(6)
    position = 1000 * np.c_[np.cos(angle), np.sin(angle), np.zeros(6)]
    model = sato.ClohessyWiltshire.from_orbit(orbit)
    kinds = {
        "linear: ẏ = −2 n x": np.c_[np.zeros(6), -2 * model.n * position[:, 0], np.zeros(6)],
        "J2-invariant": dynamics.invariant_velocity(orbit, position),
    }
    figure, axes = panels(2, 3.4)
    for ax, velocity in zip(axes, kinds.values(), strict=True):
        state, steps = np.hstack([position, velocity]), 600
        path = sato.InertialPlant(orbit).propagate(
            state, np.zeros((6, 3)), 0.0, 10 * orbit.period, steps
        )
        for i in range(6):
            ax.plot(*path[:, i, 1::-1].T / 1000, lw=0.6, color=BLUE)
        ax.plot(*position[:, 1::-1].T / 1000, "o", color=DARK_GRAY, ms=3)
        ax.set(aspect="equal", xlabel="y, along-track [km]", ylabel="x, radial [km]")
        ax.set(xlim=(-3.2, 3.2), ylim=(-1.8, 1.8))
    add_titles(axes, list(kinds))
    return figure


def draw_alignment() -> Figure:
    """Draw a shape aligned with what one vehicle measures, and the decay under gains."""
    figure, (left, right) = panels(2, 3.4)
    formation = load_formation("Pentagonal Pyramid")
    shape, rng = formation.points, np.random.default_rng(3)
    turn = np.array([[np.cos(0.9), -np.sin(0.9)], [np.sin(0.9), np.cos(0.9)]])
    measured = shape + np.array([2.0, 1.0, 0.0])
    measured[:, :2] = measured[:, :2] @ turn.T + 0.25 * rng.standard_normal((len(shape), 2))
    placed = align(shape, measured).transform(shape)
    left.plot(*shape[:, :2].T, "x", color=GRAY, label="shape")
    left.plot(*measured[:, :2].T, "o", color=BLUE, ms=4, label="measured")
    left.plot(*placed[:, :2].T, "D", color=GREEN, ms=4, mew=0, label="shape, aligned")
    left.plot(*np.stack([measured, placed])[..., :2].transpose(2, 0, 1), color=RED, lw=0.9)
    left.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", xlim=(-3, 7))
    left.legend(loc="lower right")
    time = np.linspace(0, 15, 300)
    for method, color in (("projection", ORANGE), ("auto", BLUE)):
        gains = design_gains(formation, method)
        value, vector = np.linalg.eigh(gains.xy)
        moving = value < -1e-9
        start = vector[:, moving].sum(axis=1)  # an equal share of each way to be out of shape
        share = vector[:, moving].conj().T @ start
        error = np.linalg.norm(np.exp(np.outer(time, value[moving])) * share, axis=1)
        right.semilogy(time, error, color=color, label=f"{method}, rate {gains.rate_xy:.3f} /s")
        right.semilogy(time, np.exp(-gains.rate_xy * time), color=color, lw=0.8, ls="--")
    right.set(xlabel="time [s]", ylabel="error of the shape [m]")
    right.legend()
    add_titles(
        (left, right), ["alignment of least squares", "decay, and $e^{-t \\cdot rate}$ dashed"]
    )
    return figure


def draw_avoidance() -> Figure:
    """Draw ten vehicles on a ring that change places, and the distances of all pairs."""
    turn = np.exp(2j * np.pi * np.arange(10) / 10)
    ring = 2.4 * 10 / (2 * np.pi) * np.c_[turn.real, turn.imag, np.zeros(10)]
    order = np.random.default_rng(1).permutation(10)
    mission = sato.Formation(
        start=ring,
        legs=[sato.FormationLeg(ring[order])],
        assignment=AssignmentSettings("none"),
        frames=FrameSettings(noise=0.0, drift=0.0),
    )
    run = sato.run(mission, seed=1)
    time, p = run.data.time.values, run.data.position.values
    figure, (left, right) = panels(2, 3.4)
    left.plot(*np.moveaxis(p[..., :2], -1, 0), color=BLUE, lw=0.7)
    left.plot(*p[0, :, :2].T, "o", color=GRAY, ms=3, label="start")
    left.plot(*p[-1, :, :2].T, "D", color=GREEN, ms=4, mew=0, label="end")
    left.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    left.legend(loc="upper right")
    i, j = np.triu_indices(10, 1)
    distance = np.linalg.norm(p[:, i, :2] - p[:, j, :2], axis=2)
    right.plot(time, distance, color=LIGHT_GRAY, lw=0.4)
    right.plot(time, distance.min(axis=1), color=BLUE, label="least of all pairs")
    right.axhline(mission.keep_out, color=RED, lw=0.8, ls="--", label="keep-out")
    right.set(xlabel="time [s]", ylabel="distance of two [m]", ylim=(0, None))
    right.legend(loc="upper right")
    add_titles((left, right), ["ten change places, from above", "distances"])
    return figure


def draw_visibility() -> Figure:
    """Draw the weight of an edge by the place of the other robot, and both potentials."""
    camera, side = Camera(), np.linspace(-10, 10, 401)
    place = np.stack([*np.meshgrid(side, side), np.zeros((401, 401))], axis=-1)
    distance = np.linalg.norm(place, axis=-1)
    own = place / np.where(distance, distance, 1.0)[..., None]
    weight = edge_weights(distance, own, -own, np.zeros_like(distance), camera, is_seen=False)
    figure = Figure(figsize=(9.0, 3.1), layout="constrained")
    axes = figure.subplots(1, 3)
    shown = axes[0].pcolormesh(side, side, weight.weights, cmap="Blues", vmin=0, vmax=1)
    figure.colorbar(shown, ax=axes[0], label="$A_{ij}$")
    axes[0].annotate(
        "", 4 * np.array(camera.optical_axis[:2]), (0, 0), arrowprops={"arrowstyle": "->"}
    )
    axes[0].plot(0, 0, "o", color=DARK_GRAY, ms=4)
    axes[0].set(aspect="equal", xlabel="x of j [m]", ylabel="y of j [m]")
    potential, repulsion = Potential(), Repulsion()
    value = np.linspace(potential.lambda2_min + 0.01, 3.5, 400)
    axes[1].plot(value, evaluate_potential(value, potential), color=BLUE)
    axes[1].axvline(potential.lambda2_min, color=RED, lw=0.8, ls="--")
    axes[1].set(xlabel="λ", ylabel="V(λ)", ylim=(0, 5))
    gap = np.linspace(repulsion.min_distance + 0.01, 4.0, 400)
    axes[2].plot(gap, repulsion_gain(gap, repulsion), color=BLUE)
    axes[2].axvline(repulsion.min_distance, color=RED, lw=0.8, ls="--")
    axes[2].set(xlabel="distance of an obstacle [m]", ylabel="$k_{obs}$ [1/s]", ylim=(0, 5))
    add_titles(axes, ["weight where i alone sees j", "potential", "repulsion"])
    return figure


def draw_first_run() -> Figure:
    """Draw the run of the page `first-run`."""
    return sato.run("letters", overrides=["text=HELLO"]).figures()["stages"]


def draw_tutorial() -> Figure:
    """Draw the first run of the page `tutorial`."""
    figure = first_run_of("tutorial.md", blocks=2).figures()["trajectories"]
    figure.set_size_inches(3.4, 4.4)
    return figure


def draw_routes() -> Figure:
    """Draw the first run of the page `howto-obstacles`."""
    figure = first_run_of("howto-obstacles.md", blocks=1).figures()["trajectories"]
    figure.set_size_inches(4.6, 4.4)
    return figure


def first_run_of(page: str, blocks: int) -> sato.Run:
    """Return the run that the first blocks of a page fly."""
    text, names = (FOLDER.parent / page).read_text("utf-8"), dict[str, Any]()
    for code in text.split("```python\n")[1 : 1 + blocks]:
        exec(compile(code.partition("```")[0], page, "exec"), names)
    run: sato.Run = names["run"]
    return run


FIGURES: dict[str, Callable[[], Figure]] = {
    "auction": draw_auction,
    "tie-break": draw_tie_break,
    "half-spaces": draw_half_spaces,
    "reach": draw_reach,
    "commitment": draw_commitment,
    "drift": draw_drift,
    "alignment": draw_alignment,
    "avoidance": draw_avoidance,
    "visibility": draw_visibility,
    "routes": draw_routes,
    "first-run": draw_first_run,
    "tutorial": draw_tutorial,
}


def main(
    names: Annotated[list[str] | None, typer.Argument(help="Figures; all without.")] = None,
) -> None:
    """Draw figures of the pages on methods into docs/concepts."""
    FOLDER.mkdir(exist_ok=True)
    with styled():
        for name in names or FIGURES:
            FIGURES[name]().savefig(FOLDER / f"{name}.png", dpi=110)


if __name__ == "__main__":
    typer.run(main)
