"""Auctions: changes of assignment, and the messages that they took."""

import numpy as np
from matplotlib.figure import Figure

from sato.figures.style import BLUE
from sato.formation.check import FormationRecord
from sato.formation.figures.time_series import add_leg_names_and_legend, stack_panels


def plot_assignments(record: FormationRecord) -> Figure:
    """Plot the number of changed points over time, and the rounds and bits of every auction."""
    figure, (took, rounds) = stack_panels(record, (1.0, 1.0))
    changed = [(e["time"], len(e["agents"])) for _, e in record.events.of_kind("assignment")]
    played = [(e["time"], e["rounds"]) for _, e in record.events.of_kind("auction")]
    for ax, told in ((took, changed), (rounds, played)):
        when, height = np.array(told, dtype=float).reshape(-1, 2).T
        ax.vlines(when, 0, height, color=BLUE, lw=1.2)
        ax.plot(when, height, "o", ms=3.5, mew=0, color=BLUE)
        ax.set_ylim(0, 1.12 * max(float(height.max(initial=0)), 1))
    took.set_ylabel("take another\npoint")
    rounds.set_ylabel("rounds of\nmessages")
    each = (
        record.mission.radio.count_auction_bits(record.mission.agents, 1) / 1000
    )  # a round and neighbour
    bits = rounds.secondary_yaxis("right", functions=(lambda r: r * each, lambda b: b / each))
    bits.set_ylabel("kbit a neighbour")
    bits.spines["right"].set_visible(True)
    add_leg_names_and_legend(figure, record)
    return figure
