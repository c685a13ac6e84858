"""Fly eight vehicles as processes, in both modes, and print a table of each.

    python scripts/fly_processes.py [--seeds 20] [--speed 1] [ROW …]

Rows: lock-step, lossy, free-running, killed.
"""

import argparse
from time import monotonic

import numpy as np

import sato
from sato.console import print_rows
from sato.processes.fleet import Fleet
from sato.processes.flight import as_processes
from sato.reconfiguration.check.promises import check_run
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import ReconfigurationFrame
from sato.reconfiguration.system import SYSTEM
from sato.record import collect_run_data

Frames = list[ReconfigurationFrame]

SWARM = "swarm.agents=8", "swarm.comm_radius_m=20"
SWARM += "plan.horizon_steps=8", "plan.replan_steps=4", "plan.auction_steps=8"
ROUNDS, LOSSY = "link.round_s=0.02", "link.loss=0.05"
ROWS = {
    "lock-step": (),
    "lossy": (ROUNDS, LOSSY),
    "free-running": (ROUNDS,),
    "killed": (ROUNDS, LOSSY),
}


def main() -> None:
    """Fly, and print a row for each mode."""
    parser = argparse.ArgumentParser(description="Fly eight vehicles as processes.")
    parser.add_argument("rows", nargs="*", choices=[[], *ROWS], metavar="ROW")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--speed", type=float, default=1.0, help="times as fast as by the clock")
    asked = parser.parse_args()
    for row in asked.rows or ROWS:
        mission = sato.read("random", [*SWARM, *ROWS[row]])
        measure = compare if row in ("lock-step", "lossy") else fly_freely
        print(f"\n{row}: {' '.join(ROWS[row])}", flush=True)
        measure(mission, row == "killed", asked.seeds, asked.speed)


def compare(mission: Reconfiguration, _: bool, seeds: int, __: float) -> None:
    """Compare flights in lock step with those of the simulation."""
    equal, worst, steps, kept, times = 0, 0.0, [], 0, []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        expected = list(simulate(mission.draw(rng), rng))
        began = monotonic()
        frames, is_kept, _ = fly(mission, seed, "lock-step", 1.0, None)
        times.append(monotonic() - began)
        pairs = list(zip(frames, expected, strict=True))
        equal += all((f.target_index == e.target_index).all() for f, e in pairs)
        differences = [np.abs(f.control - e.control) for f, e in pairs[:-1]]
        worst = max(worst, *(float(np.nanmax(d, initial=0.0)) for d in differences))
        steps.append(len(frames) - 1)
        kept += is_kept
    head = "runs", "targets equal", "controls off by, m/s²", "promises kept", "steps", "time, s"
    row = seeds, equal, f"{worst:.1g}", kept, f"{np.median(steps):g}", f"{np.median(times):.0f}"
    print_rows(head, [[str(each) for each in row]], markdown=True)


def fly_freely(mission: Reconfiguration, is_killed: bool, seeds: int, speed: float) -> None:
    """Fly by the clock; kill a vehicle in each run, each of the eight in turn."""
    rows = []
    for seed in range(seeds):
        victim = (seed % 8, 3 + int(np.random.default_rng(seed).integers(30)))
        flown = fly(mission, seed, "free-running", speed, victim if is_killed else None)
        frames, is_kept, summary = flown
        late = sum(event["kind"] == "unconfirmed" for f in frames for event in f.events)
        rows.append((summary["reached"], summary["min_separation_m"], len(frames) - 1, late))
        print(seed, *rows[-1], is_kept, flush=True)
    reached, apart, steps, late = (np.array(column) for column in zip(*rows, strict=True))
    hit = int((apart < mission.collision_radius).sum())
    head = "runs", "all arrive", "collisions", "least separation, m", "steps", "decisions late"
    row = seeds, reached.sum(), hit, f"{apart.min():.3g}", f"{np.median(steps):g}", late.sum()
    print_rows(head, [[str(each) for each in row]], markdown=True)


def fly(
    mission: Reconfiguration, seed: int, mode: str, speed: float, victim: tuple[int, int] | None
) -> tuple[Frames, bool, dict[str, object]]:
    """Fly once; return the frames, whether the record is in order, and the summary.

    Args:
        mission: Mission, not drawn.
        seed: Random seed.
        mode: In lock step, or free running.
        speed: Times as fast as by the clock.
        victim: Vehicle whose process is killed, and the step; None for none.
    """
    fleets: list[Fleet] = []
    system = as_processes(SYSTEM, mission, seed, mode, None, speed, fleets.append)
    rng, frames = np.random.default_rng(seed), []
    for frame in system.simulate(mission.draw(rng), rng):
        frames.append(frame)
        if victim is not None and len(frames) == victim[1]:
            fleets[0].processes[victim[0]].kill()
    rng = np.random.default_rng(seed)
    drawn = mission.draw(rng)
    names = {"name": mission.name, "seed": seed, "version": "", "scenario": mission.to_toml()}
    report = check_run(collect_run_data(SYSTEM, frames, drawn, **names), drawn, rng)
    return frames, report.kept, report.summary


if __name__ == "__main__":
    main()
