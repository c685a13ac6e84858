"""Shapes: target positions in an order in which every prefix keeps the shape [Morgan2016].

Every shape is a function that returns `(count, d)` positions in meters. A swarm that has fewer
agents than targets fills the first ones, so the order matters (Remark 4 of the paper): any first
m targets are spread over the whole shape, and no target of the list is farther from the nearest
of them than they are from each other.
"""

from sato.shapes.areas import picture, polygon
from sato.shapes.ordering import farthest_point_order
from sato.shapes.point_files import points
from sato.shapes.regular import lattice, ring
from sato.shapes.text import text

__all__ = ["farthest_point_order", "lattice", "picture", "points", "polygon", "ring", "text"]
