"""Targets for a swarm, in an order in which every prefix keeps the shape [Morgan2016, Remark 4].

Every shape is a function that returns `(count, d)` positions in metres. A swarm that has fewer
agents than targets fills the first ones, so the order matters: any first m of the list are
spread over the whole shape, and no target of the list is farther from the nearest of them than
they are from each other.
"""

from sato.shapes.areas import picture, polygon
from sato.shapes.ordering import farthest_point_order, prefix_gaps
from sato.shapes.point_files import points
from sato.shapes.regular import embed_in_plane, lattice, ring
from sato.shapes.text import LETTER_FONT, WORD_FONT, text

__all__ = [
    "LETTER_FONT",
    "WORD_FONT",
    "embed_in_plane",
    "farthest_point_order",
    "lattice",
    "picture",
    "points",
    "polygon",
    "prefix_gaps",
    "ring",
    "text",
]
