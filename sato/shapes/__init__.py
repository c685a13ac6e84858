"""Shapes: target positions in an order in which every prefix keeps the shape [Morgan2016].

A swarm that has fewer agents than targets fills the first ones, so the order matters (Remark 4 of
the paper): any first m targets are spread over the whole shape, and no target of the list is
farther from the nearest of them than they are from each other.
"""

from sato.shapes.areas import Picture, Polygon, Text
from sato.shapes.regular import Lattice, Ring
from sato.shapes.shape import Points, Shape

AnyShape = Points | Text | Ring | Lattice | Polygon | Picture

__all__ = ["AnyShape", "Lattice", "Picture", "Points", "Polygon", "Ring", "Shape", "Text"]
