"""Size and speed of the player: 1,000 vehicles at 500 instants, drawn by software.

A swarm in space flies five legs, each to another order of the places of a lattice, by
accelerations that are held. The page is opened from its file in headless Chromium without a GPU,
at 1280 × 720, and plays for ten seconds: with bodies alone, and with the links of vehicles within
reach. Frame rates are medians.
"""

import shutil
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Annotated, NamedTuple

import numpy as np
import typer
from playwright.sync_api import Page, sync_playwright
from rich.console import Console
from rich.table import Table

from sato.network.graph import CommunicationGraph
from sato.player import write_player
from sato.scene import (
    ALIVE,
    Coloring,
    Links,
    Series,
    SwarmScene,
    Targets,
    color_by_component,
    color_by_speed,
    color_by_target,
    least_over_agents,
    nearest_distances,
)

LEGS, SPACING, RADIUS = 5, 2.0, 2.6  # of the lattice, and of communication [m]
LEG_TIME = 100.0  # [s]
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE, FIRST_FRAME = 6e6, 3.0  # to reach [byte, s]
BODIES, LINKED = 20.0, 8.0  # to reach [frames a second]

MEASURE = """seconds => new Promise(done => {
  const times = [];
  const note = now => {
    times.push(now);
    if (now - times[0] < 1000 * seconds) return requestAnimationFrame(note);
    const steps = times.slice(1).map((time, i) => time - times[i]).sort((a, b) => a - b);
    done(1000 / steps[Math.floor(steps.length / 2)]);
  };
  requestAnimationFrame(note);
})"""


class Row(NamedTuple):
    """Quantity as measured, and what is to be reached."""

    name: str
    value: float
    limit: float
    is_least: bool
    unit: str

    @property
    def is_reached(self) -> bool:
        """True where the value is as good as the limit, or better."""
        return self.value >= self.limit if self.is_least else self.value <= self.limit


def make_swarm(agents: int, instants: int, rng: np.random.Generator) -> SwarmScene:
    """Make the scene of a swarm that changes places on a lattice."""
    side = int(np.ceil(agents ** (1 / 3)))
    axes = [np.arange(side) * SPACING] * 3
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)[:agents]
    order = [rng.permutation(agents) for _ in range(LEGS + 1)]
    places = np.array([lattice[each] for each in order])
    time = np.linspace(0, LEGS * LEG_TIME, instants)
    leg = np.minimum((time / LEG_TIME).astype(int), LEGS - 1)
    share = (time / LEG_TIME - leg)[:, None, None]
    way = places[leg + 1] - places[leg]
    bend = rng.normal(0, SPACING, (LEGS, agents, 3))[leg]  # off the straight line, at half time
    position = places[leg] + way * (3 * share**2 - 2 * share**3)
    position += bend * 16 * (share * (1 - share)) ** 2
    velocity = way * 6 * share * (1 - share) + bend * 32 * share * (1 - share) * (1 - 2 * share)
    velocity /= LEG_TIME
    alive = np.ones((instants, agents), dtype=bool)
    component = [CommunicationGraph.from_positions(p, RADIUS, alive[0]).component for p in position]
    targets = Targets("target", np.repeat(lattice[None], LEGS, 0), leg, np.array(order)[leg + 1])
    nearest = nearest_distances(position, alive)
    change = np.linalg.norm(np.diff(velocity, axis=0, prepend=velocity[:1]), axis=2)
    return SwarmScene(
        time=time,
        position=position,
        velocity=velocity,
        status=np.full(alive.shape, ALIVE),
        diameter=np.full(agents, 0.5),
        links=Links("within communication radius", RADIUS),
        targets=targets,
        colorings=(
            color_by_component(np.array(component)),
            color_by_target(targets),
            Coloring("fuel so far", np.cumsum(change, axis=0), "m/s"),
            Coloring("separation", nearest, "m"),
            color_by_speed(velocity, alive),
        ),
        series=(Series("least separation", "m", least_over_agents(nearest), 0.5, "required"),),
        stages=tuple((k * LEG_TIME, f"leg {k + 1}") for k in range(LEGS)),
        events=[{"kind": "replan", "time": t, "agents": range(agents)} for t in time.tolist()],
    )


def measure_rate(page: Page, seconds: float, **options: bool) -> float:
    """Play from the start; return the median frame rate [1/s]."""
    page.evaluate("options => Object.assign(player.options, options)", options)
    page.evaluate("() => (player.seek(0), player.isPlaying || player.toggle())")
    return float(page.evaluate(MEASURE, seconds))


def main(
    agents: Annotated[int, typer.Option(help="Vehicles.")] = 1000,
    instants: Annotated[int, typer.Option(help="Instants.")] = 500,
    seconds: Annotated[float, typer.Option(help="Time of each measurement [s].")] = 10.0,
) -> None:
    """Measure, print a table, and exit with 1 where a number is not reached."""
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("there is no Chromium; `apt-get install chromium` installs one")
    scene = make_swarm(agents, instants, np.random.default_rng(0))
    attributes = {"name": "swarm", "seed": 0, "system": "reconfiguration", "version": "0"}
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        began = perf_counter()
        path = write_player(scene, attributes, Path(folder, "swarm.html"))
        written, size = perf_counter() - began, path.stat().st_size
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        began = perf_counter()
        page.goto(path.as_uri())
        page.wait_for_function("window.player && player.now")
        first = perf_counter() - began
        bodies = measure_rate(page, seconds, links=False)
        linked = measure_rate(page, seconds, links=True)
        pairs = page.evaluate("player.view.pairs.length / 2")
        browser.close()
    rows = [
        Row("file", size / 1e6, SIZE / 1e6, False, "MB"),
        Row("first frame", first, FIRST_FRAME, False, "s"),
        Row("bodies and targets", bodies, BODIES, True, "frames a second"),
        Row(f"with {pairs:.0f} links", linked, LINKED, True, "frames a second"),
    ]
    table = Table("", "measured", "to reach", "", title=f"{agents} vehicles, {instants} instants")
    for row in rows:
        limit = f"{'≥' if row.is_least else '≤'} {row.limit:g} {row.unit}"
        table.add_row(row.name, f"{row.value:.2f}", limit, "" if row.is_reached else "missed")
    Console().print(table, f"written in {written:.1f} s")
    sys.exit(not all(row.is_reached for row in rows))


if __name__ == "__main__":
    typer.run(main)
