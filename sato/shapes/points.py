"""Points one by one."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.units import Unit
from sato.scenario.definition import Matrix, as_array
from sato.scenario.errors import InputError
from sato.shapes.ordering import farthest_point_order
from sato.shapes.point_files import read_points
from sato.shapes.shape import Drawing, Shape


@dataclass(frozen=True, eq=False, repr=False)
class Points(Shape):
    """Positions one by one, with velocities or without, as an array or in a file.

    They stay where they are unless a center is given, and as far apart unless a spacing is.
    """

    kind: ClassVar[str] = "points"
    positions: Annotated[Matrix | None, Unit("m"), "one row a point"] = None
    velocities: Annotated[Matrix | None, Unit("m_s"), "one row a point; at rest if absent"] = None
    keep_order: Annotated[bool, "keep the order; else every prefix is made to keep the shape"] = (
        False
    )
    file: Annotated[str | None, "CSV file with one point a line"] = None

    def check(self) -> None:
        """Refuse other than one source of positions, and velocities of another shape."""
        p, v = self.positions, self.velocities
        if (self.file is None) == (p is None):
            raise InputError("positions_m", "or a file is needed, and not both")
        if p is not None and p.shape[1] not in (2, 3):
            raise InputError("positions_m", f"needs rows of 2 or 3 coordinates, got {p.shape[1]}")
        if p is not None and v is not None and v.shape != p.shape:
            raise InputError(
                "velocities_m_s", f"needs the shape of the positions, {p.shape}, got {v.shape}"
            )

    def draw(self, count: int, axes: int) -> Drawing:
        """Take the first points of the order."""
        if self.file is not None:
            label, listed = f"the list {self.file}", read_points(Path(self.file))
        else:
            label, listed = "the list of points", np.asarray(self.positions)
        middle = (listed.min(axis=0) + listed.max(axis=0)) / 2
        if self.file is None and not self.spacing and not self.center:
            middle = np.zeros_like(middle)  # the points stay what they are to the last bit
        return Drawing(label, listed[self._order(listed, count)], middle, is_absolute=True)

    def place_velocities(self, count: int, axes: int) -> Float[Array, "count axes"] | None:
        """Return the velocity at each position, where they are given."""
        if self.velocities is None:
            return None
        if self.positions is None and (len(self.velocities) < count or not self.keep_order):
            raise InputError("velocities_m_s", f"needs {count} rows in the order of the file")
        order = self._order(self.velocities if self.positions is None else self.positions, count)
        placed = np.zeros((count, axes))
        placed[:, : self.velocities.shape[1]] = self.velocities[order]
        return placed

    def _order(self, listed: Float[Array, "k d"], count: int) -> Int[Array, " count"]:
        if len(listed) < count:
            key, path = ("positions_m", "") if self.file is None else ("file", f"{self.file} ")
            raise InputError(
                key, f"{path}lists {len(listed)} points, fewer than the {count} asked for"
            )
        return np.arange(count) if self.keep_order else farthest_point_order(listed)[:count]


def as_points(value: Any) -> Any:
    """Convert an array of positions or states to `Points`; leave anything else as it is.

    Args:
        value: Rows of 2 or 3 coordinates, or of 4 or 6: positions, then velocities.

    Raises:
        InputError: It is an array of another shape.
    """
    if not isinstance(value, Array | list | tuple):
        return value
    array = as_array(value, 2)
    columns = array.shape[1]
    if columns not in (2, 3, 4, 6):
        raise InputError(
            "",
            "must have rows of 2 or 3 coordinates, or of 4 or 6 with velocities, got shape "
            f"{array.shape}",
        )
    d = columns if columns < 4 else columns // 2
    return Points(array[:, :d], array[:, d:] if columns > 3 else None)
