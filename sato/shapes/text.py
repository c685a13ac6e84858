"""Text in any installed font."""

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Unit
from sato.shapes.region import fill_outlines
from sato.shapes.shape import Drawing, Shape, Size

if TYPE_CHECKING:
    from matplotlib.font_manager import FontProperties

# Both come with matplotlib, so every machine has them. The broad strokes of a single bold letter
# keep a swarm connected where some targets stay empty; in a word they would fill the letters.
LETTER_FONT, WORD_FONT = "DejaVu Sans:bold", "DejaVu Sans"
CURVE_RESOLUTION = 10.0  # curves become chords this many times finer than matplotlib's own


@dataclass(frozen=True, eq=False, repr=False)
class Text(Shape):
    """A line of text.

    The font is a family and style ("DejaVu Serif:bold") or a font file; without it DejaVu Sans,
    bold for a single letter. The height is that from the lowest to the highest point.
    """

    kind: ClassVar[str] = "text"
    text: Annotated[str, "text, in one line"]
    font: Annotated[str | None, "name or file of a font"] = None
    height: Annotated[Size | None, Unit("m"), "height of the text"] = None

    def draw(self, count: int, axes: int) -> Drawing:
        """Spread targets over the strokes of all letters."""
        text = self.text
        if not text.strip():
            raise ValueError(f"the text {text!r} is blank: there is nothing to draw")
        font = self.font or (LETTER_FONT if len(text.strip()) == 1 else WORD_FONT)
        return fill_outlines(f"the text {text!r}", _outlines(text, font), count)


def _outlines(text: str, font: str) -> list[Float[Array, "_ 2"]]:
    # Importing matplotlib is slow, and no other shape needs it.
    from matplotlib.path import Path as Curves
    from matplotlib.textpath import TextToPath
    from matplotlib.transforms import Affine2D

    style = _find_font(font)
    _check_characters(text, font, style)
    vertices, codes = TextToPath().get_text_path(style, text)
    if len(vertices) == 0:
        raise ValueError(f"the text {text!r} has nothing to draw in the font {font!r}")
    chords = Curves(vertices, codes).to_polygons(Affine2D().scale(CURVE_RESOLUTION))
    return [np.asarray(outline, dtype=float)[:-1] for outline in chords]


def _find_font(font: str) -> "FontProperties":
    from matplotlib import font_manager

    if Path(font).suffix.lower() in (".ttf", ".otf", ".ttc"):
        if not Path(font).is_file():
            raise ValueError(f"there is no font file {font}")
        return font_manager.FontProperties(fname=font)
    try:
        # An unescaped dash begins a size.
        style = font_manager.FontProperties(font.replace("-", r"\-"))
        path = font_manager.findfont(style, fallback_to_default=False)
        return font_manager.FontProperties(fname=path)
    except ValueError as error:
        installed = sorted({entry.name for entry in font_manager.fontManager.ttflist})
        family = font.split(":")[0]
        suggestions = get_close_matches(family, installed, n=3, cutoff=0.5) + installed
        names = ", ".join(dict.fromkeys(suggestions[:8]))
        raise ValueError(
            f"no font {font!r} is installed; among those that are: {names} "
            '(a style goes after a colon, as in "DejaVu Serif:bold")'
        ) from error


def _check_characters(text: str, font: str, style: "FontProperties") -> None:
    from matplotlib.ft2font import FT2Font

    path = str(style.get_file())
    try:
        known = FT2Font(path).get_charmap()
    except (RuntimeError, OSError) as error:
        raise ValueError(f"the font file {path} cannot be read: {error}") from error
    if missing := sorted({character for character in text if ord(character) not in known}):
        raise ValueError(
            f"the font {font!r} has no character {', '.join(map(repr, missing))}: "
            "leave it out or choose another font"
        )
