"""Exchange vehicles in symmetric traffic, with targets given: python swap.py [--largest 16].

The auction is replaced by "agent i goes to target i", so that the planner alone is tried.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from judge import judge

import sato
from sato.auctions import VsdaaAuction, VsdaaResult
from sato.reconfiguration import assignment

RADIUS, SPEED = 0.5, 0.5
PLANS: dict[str, dict[str, int]] = {
    "one order": {},
    "foresight": {"foresight_steps": 80},
    "negotiated": {"foresight_steps": 80, "orders": 4, "bargains": 2},
}


def given_targets(auction: VsdaaAuction) -> VsdaaResult:
    """Return the assignment of agent i to target i as the result of an auction."""
    cost, alive = auction.cost, auction.graph.alive
    agents = np.arange(len(cost))
    return VsdaaResult(
        target_index=np.where(alive, agents, -1),
        target_count=np.where(alive, cost.shape[1], auction.target_count),
        bidder_count=np.where(alive, alive.sum(), 0),
        round_count=1,
        bid_count=len(cost),
        last_bid_round=1,
        price=np.zeros(cost.shape),
    )


def circle(agents: int, radius: float) -> np.ndarray:
    """Return positions on a circle."""
    angle = 2 * np.pi * np.arange(agents) / agents
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def columns(agents: int, spacing: float) -> np.ndarray:
    """Return positions in two columns that face each other."""
    y = spacing * (np.arange(agents) - (agents - 1) / 2)
    return np.vstack([np.column_stack([np.full(agents, x), y]) for x in (-5.0, 5.0)])


def swap(start: np.ndarray, target: np.ndarray, steps: int, **plan: int) -> sato.Reconfiguration:
    """Return the mission in which agent i goes to target i."""
    return sato.Reconfiguration(
        name="swap",
        model=sato.DoubleIntegrator(start.shape[1]),
        start=start,
        legs=[sato.Leg(sato.Points(target, keep_order=True), steps=steps)],
        step=1.0,
        comm_radius=2 * SPEED * 10 + RADIUS + 100,
        collision_radius=RADIUS,
        max_control=0.1,
        max_speed=SPEED,
        horizon_steps=10,
        replan_steps=2,
        auction_steps=4,
        **plan,
    )


def main() -> None:
    """Fly every exchange with every plan and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--largest", type=int, default=16, help="agents on the largest circle")
    args = parser.parse_args()
    assignment.run_vsdaa = given_targets  # type: ignore[assignment]
    cases: dict[str, tuple[np.ndarray, np.ndarray, int]] = {}
    for agents in (n for n in (4, 8, 16, 32) if n <= args.largest):
        radius = max(4.0, 1.2 * agents * RADIUS / np.pi)
        start = circle(agents, radius)
        cases[f"circle {agents}"] = start, -start, max(40, int(6 * radius / SPEED))
    for spacing in (0.6, 1.05):
        start = columns(5, spacing)
        cases[f"columns {spacing:g}"] = start, start * [-1, 1], 50
    for name, (start, target, steps) in cases.items():
        for plan, settings in PLANS.items():
            began = time.perf_counter()
            run = sato.run(swap(start, target, steps, **settings))
            folder = run.save(Path("runs/swap", f"{name} {plan}".replace(" ", "-")))
            separation = judge(folder / "run.nc")["separation_m"] / RADIUS
            row = {"case": name, "plan": plan, "separation": separation}
            row |= {key: run.summary[key] for key in ("reached", "slack_used", "braked")}
            print(json.dumps(row | {"wall_s": round(time.perf_counter() - began, 1)}), flush=True)


if __name__ == "__main__":
    main()
