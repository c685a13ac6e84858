"""Figures as tests draw and read them."""

from itertools import combinations

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from sato.figures.style import STYLE


def draw(plot, record):
    """Draw a figure in the style of all."""
    with matplotlib.rc_context(STYLE):
        figure = plot(record)
        FigureCanvasAgg(figure).draw()
    return figure


def line(ax, label):
    """Find the coordinates of the line with a label."""
    [found] = [one for one in ax.lines if one.get_label() == label]
    return found.get_xydata().T


def check_layout(figure):
    """Find texts in the figure, titles and names of legs apart, and legends off the panels."""
    renderer, inside = figure.canvas.get_renderer(), figure.bbox.padded(1.0)
    words = [t for t in figure.findobj(Text) if t.get_visible() and t.get_text().strip()]
    boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in words]
    assert len(boxes) > 3
    for text, box in boxes:
        # Ticks beyond the limits are not drawn.
        if text.lstrip("−").replace(".", "").isdigit() or text.startswith("$\\mathdefault"):
            continue
        assert inside.x0 <= box.x0 and box.x1 <= inside.x1, text
        assert inside.y0 <= box.y0 and box.y1 <= inside.y1, text
    titles = [ax.title.get_window_extent(renderer) for ax in figure.axes if ax.get_title()]
    legs = [box for text, box in boxes if text.startswith("leg ")]
    for one, other in [*combinations(titles, 2), *combinations(legs, 2)]:
        assert not one.overlaps(other)
    for legend in figure.legends:
        key = legend.get_window_extent(renderer)
        for ax in figure.axes:
            assert not key.overlaps(ax.get_window_extent(renderer).shrunk(0.95, 0.95))
            assert not key.overlaps(ax.xaxis.label.get_window_extent(renderer))
