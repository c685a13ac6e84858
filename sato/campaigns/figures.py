"""Figures of a campaign: rates and means, distributions, pairs of columns, and grids."""

from collections.abc import Sequence
from io import BytesIO
from math import ceil
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sato.campaigns.selection import (
    GroupTable,
    Term,
    Texts,
    column_terms,
    group_runs,
    name_group,
    parse_term,
    select,
)
from sato.campaigns.table import CampaignTable
from sato.figures.axes import as_label, styled
from sato.figures.style import BLUE, marker_style
from sato.scenario.errors import InputError

MAX_CURVES = 8  # of more groups, curves and marks cannot be told apart: all runs are one then
COLUMNS = 3  # panels side by side
HEIGHT, WIDTH = 2.6, 3.0  # of a panel [in]
GROUP_HEIGHT = 0.22  # of a group among intervals [in]


def draw_campaign(
    table: CampaignTable,
    by: Texts | None = None,
    show: Texts = (),
    where: Texts = (),
    scatter: Texts = (),
) -> dict[str, Figure]:
    """Draw the runs of a campaign, at least one; arguments and errors are as of `group_runs`.

    The scatter plot is of the terms of two axes, or else of the first two numbers that are shown.
    Figures are by name: "rates" and "distributions" by group, "grid" over two columns, "scatter".
    """
    grouped = group_runs(table, by, show, where)
    if not grouped.groups:
        raise InputError("", f"{table.folder}: has no such runs; there is nothing to draw")
    means = [n for n, term in enumerate(grouped.terms) if term.statistic in ("rate", "mean")]
    numbers = [n for n, term in enumerate(grouped.terms) if not term.is_rate]
    has_few = len(grouped.groups) <= MAX_CURVES
    few = grouped if has_few else group_runs(table, (), show, where)
    pair = [parse_term(text, table) for text in scatter] or [grouped.terms[n] for n in numbers[:2]]
    figures = {}
    with styled():
        if means:
            figures["rates"] = draw_intervals(grouped.of(means))
        if numbers:
            figures["distributions"] = draw_distributions(few.of(numbers))
        if len(grouped.by) == 2:
            figures["grid"] = draw_heat_maps(grouped)
        if len(pair) == 2:
            rows = select(table, [*column_terms(table, few.by), *pair], where)
            figures["scatter"] = draw_scatter(few.by, pair, rows)
    return figures


def as_png(figure: Figure) -> bytes:
    """Return a figure as the contents of a PNG file."""
    with styled(), BytesIO() as file:
        figure.savefig(file, format="png")
        return file.getvalue()


def draw_intervals(table: GroupTable) -> Figure:
    """Draw the rate or mean of each group with its 95 % interval, a panel a term."""
    by, terms, groups = table
    figure, axes = _make_panels(len(terms), GROUP_HEIGHT * len(groups) + 0.9)
    rows, names = np.arange(len(groups)), [_name(group.key) for group in groups]
    axes[0].set_title(as_label(", ".join(by)), loc="left")
    for column, (ax, term) in enumerate(zip(axes, terms, strict=True)):
        cells, scale = [group.cells[column] for group in groups], 100 if term.is_rate else 1
        low, high = scale * np.array([cell.interval for cell in cells]).T
        ax.hlines(rows, low, high, color=BLUE, lw=1.2)
        ax.plot([scale * cell.mean for cell in cells], rows, "o", ms=3.5, color=BLUE)
        label = as_label(term.label)
        ax.set(xlabel=f"{label} [%]" if term.is_rate else f"{label}, mean")
        if term.is_rate:
            ax.set_xlim(-3, 103)
        ax.set_yticks(rows, names if column % COLUMNS == 0 else [])
        ax.set_ylim(len(groups) - 0.5, -0.5)
        ax.grid(axis="x")
    return figure


def draw_distributions(table: GroupTable) -> Figure:
    """Draw the empirical distribution of each term, a curve a group, a panel a term."""
    by, terms, groups = table
    figure, axes = _make_panels(len(terms), HEIGHT)
    for column, (ax, term) in enumerate(zip(axes, terms, strict=True)):
        for rank, group in enumerate(groups):
            if len(values := group.cells[column].values):
                ax.ecdf(values, label=_name(group.key), markevery=0.2, **_style(rank))
        ax.set(xlabel=as_label(term.label), ylim=(-0.02, 1.02))
        ax.set_ylabel("share of runs, at most" if column % COLUMNS == 0 else "")
    if len(groups) > 1:
        _add_legend(figure, axes[0], by)
    return figure


def draw_scatter(by: Texts, terms: Sequence[Term], rows: Sequence[tuple[Any, ...]]) -> Figure:
    """Draw runs, rows of columns and then of two terms, as points over these, marked by group."""
    figure, [ax] = _make_panels(1, 1.3 * HEIGHT, 1.4 * WIDTH)
    points: dict[Any, list[tuple[float, float]]] = {}
    for *key, x, y in rows:
        if x is not None and y is not None:
            points.setdefault(tuple(key), []).append((x, y))
    for rank, (key, pairs) in enumerate(points.items()):
        style = _style(rank) | {"ls": "", "alpha": 0.6, "mew": 0, "rasterized": True}
        ax.plot(*zip(*pairs, strict=True), label=_name(key), **style)
    ax.set(xlabel=as_label(terms[0].label), ylabel=as_label(terms[1].label))
    if len(points) > 1:
        _add_legend(figure, ax, by)
    return figure


def draw_heat_maps(table: GroupTable) -> Figure:
    """Draw the statistics of a grid of two columns as colors and numbers, a panel a term."""
    by, terms, groups = table
    ys, xs = (list(dict.fromkeys(key)) for key in zip(*(g.key for g in groups), strict=True))
    size = max(WIDTH, 0.6 * len(xs) + 1.2), max(1.6, 0.32 * len(ys) + 1.0)
    figure, axes = _make_panels(len(terms), size[1], size[0])
    for column, (ax, term) in enumerate(zip(axes, terms, strict=True)):
        values = np.full((len(ys), len(xs)), np.nan)
        for group in groups:
            y, x = ys.index(group.key[0]), xs.index(group.key[1])
            scale = 100 if term.statistic == "rate" else 1
            values[y, x] = scale * group.cells[column].number(term.statistic)
        limits = {"vmin": 0, "vmax": 100} if term.statistic == "rate" else {}
        drawn = ax.imshow(np.ma.masked_invalid(values), cmap="cividis", aspect="auto", **limits)
        for (y, x), value in np.ndenumerate(values):
            if not np.isnan(value):
                color = "white" if np.isfinite(value) and drawn.norm(value) < 0.5 else "black"
                ax.text(x, y, f"{value:.3g}", color=color, ha="center", va="center", fontsize=7)
        ax.set_xticks(range(len(xs)), [_name([x]) for x in xs])
        ax.set_yticks(range(len(ys)), [_name([y]) for y in ys] if column % COLUMNS == 0 else [])
        ax.set(xlabel=as_label(by[1]), ylabel=as_label(by[0]) if column % COLUMNS == 0 else "")
        ax.set_title(as_label(term.title.replace("\n", ", ")) + " [%]" * (term.statistic == "rate"))
        ax.spines[:].set_visible(False)
        figure.colorbar(drawn, ax=ax, shrink=0.8)
    return figure


def _make_panels(count: int, height: float, width: float = WIDTH) -> tuple[Figure, list[Any]]:
    columns, rows = min(count, COLUMNS), ceil(count / COLUMNS)
    size = max(width * columns, 4.0) + 0.6, height * rows
    figure = Figure(figsize=size, layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for ax in axes[count:]:
        ax.remove()
    return figure, axes[:count]


def _add_legend(figure: Figure, ax: Any, by: Texts) -> None:
    handles, names = ax.get_legend_handles_labels()
    width = 0.5 + 0.075 * max(map(len, names), default=0)  # of an entry [in]
    columns = max(1, min(len(names), int(figure.get_figwidth() / width)))
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": columns}
    figure.legend(handles, names, title=as_label(", ".join(by)), **place)


def _name(key: Sequence[Any]) -> str:
    return as_label(name_group(key))


def _style(rank: int) -> dict[str, Any]:
    return marker_style(rank) | {"ms": 3.5, "lw": 1.0}
