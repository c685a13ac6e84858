"""Formation flights as datasets, for tests of checks, records and figures."""

import numpy as np

from sato.formation.loop import simulate
from sato.formation.system import SYSTEM
from sato.record import collect_run_data
from sato.scenario.file import parse

FIVE = """
system = "formation"
name = "five"

[swarm]
agents = 5
start = { kind = "random", box_m = [7, 7], separation_m = 1.5 }

[protocol]
hover_s = 1.0
limit_s = 60.0

[[leg]]
formation = { kind = "library", name = "swarm5/Pentagon" }

[[leg]]
formation = { kind = "random", box_m = [6, 6, 2], separation_m = 2 }
graph = { kind = "thinned", removals = 1 }
"""


def fly(*settings, seed=2, text=FIVE):
    """Draw and fly a mission; return it with its frames."""
    rng = np.random.default_rng(seed)
    mission = parse(text, settings).draw(rng)
    return mission, list(simulate(mission, rng))


def dataset(mission, frames, stopped=""):
    """Return the data of a run."""
    return collect_run_data(
        SYSTEM, frames, mission, scenario="", name="test", seed=3, version="0", wall_s=1.0,
        peak_memory_mib=1.0, stopped=stopped,
    )  # fmt: skip
