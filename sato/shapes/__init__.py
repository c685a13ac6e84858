"""Targets for a swarm, in an order in which every prefix keeps the shape [Morgan2016, Remark 4].

Every shape is a function that returns `(count, d)` positions in metres. A swarm that has fewer
agents than targets fills the first ones, so the order matters: any first m of the list are
spread over the whole shape, and no target of the list is farther from the nearest of them than
they are from each other.
"""

from sato.shapes.drawn import picture, polygon
from sato.shapes.letters import LETTER_FONT, WORD_FONT, text
from sato.shapes.listed import points
from sato.shapes.order import gap_of_prefixes, in_order
from sato.shapes.regular import in_plane, lattice, ring

__all__ = [
    "LETTER_FONT",
    "WORD_FONT",
    "gap_of_prefixes",
    "in_order",
    "in_plane",
    "lattice",
    "picture",
    "points",
    "polygon",
    "ring",
    "text",
]
