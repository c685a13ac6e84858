"""What tests of figures ask of every one of them."""

from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox


def words_inside(figure: Figure, powers: bool = True) -> list[tuple[str, Bbox]]:
    """All that is written in a figure that is drawn, and where; none of it runs out of the picture.

    Args:
        figure: It.
        powers: Whether some axes have powers of ten as ticks, which are looked over like others.
    """
    renderer, inside = figure.canvas.get_renderer(), figure.bbox.padded(1.0)
    words = [t for t in figure.findobj(Text) if t.get_visible() and t.get_text().strip()]
    boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in words]
    assert len(boxes) > 3
    for text, box in boxes:
        # Ticks beyond the limits are not drawn.
        if text.lstrip("−").replace(".", "").isdigit():
            continue
        if powers and text.startswith("$\\mathdefault"):
            continue
        assert inside.x0 <= box.x0 and box.x1 <= inside.x1, text
        assert inside.y0 <= box.y0 and box.y1 <= inside.y1, text
    return boxes
