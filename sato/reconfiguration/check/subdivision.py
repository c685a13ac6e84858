"""Least value of a function along cubic pieces, by subdivision."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import divide_pieces


def minimize_along(
    pieces: Float[Array, "pieces 4 d"],
    measure: Callable[[Array, Array], tuple[Array, Array]],
    precision: float,
    enough: float = np.inf,
) -> tuple[float, int, float]:
    """Find the least value of a function along pieces, if it is less than enough.

    The function takes control points of some parts, and the numbers of their pieces. It returns
    its values at the middles of the parts, and lower bounds of its values along them. Found are the
    value, the number of its piece, −1 where there is none, and the fraction of the piece.
    """
    found, number = (enough, -1, 0.0), np.arange(len(pieces))
    middle, width = np.full(len(pieces), 0.5), 1.0
    while len(pieces):
        value, lower = measure(pieces, number)
        k = int(value.argmin())
        if value[k] < found[0]:
            found = float(value[k]), int(number[k]), float(middle[k])
        left = lower < found[0] - precision
        pieces = divide_pieces(pieces[left], 2).reshape(-1, *pieces.shape[1:])
        number, width = np.repeat(number[left], 2), width / 2
        middle = (middle[left, None] + width / 2 * np.array([-1.0, 1.0])).ravel()
    return found
