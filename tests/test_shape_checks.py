"""Array shapes are checked, and again in every test."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from dynamics.coordinate_frames import orbit_axes


@pytest.mark.parametrize("test", ["one", "the next one"])
def test_every_test_begins_with_shapes_that_are_checked(test):
    seven = np.arange(1.0, 8.0)  # with one number too many for a state, and axes all the same
    with pytest.raises(TypeCheckError, match="state"):
        orbit_axes(seven)
    for _ in range(200):  # after so many the shapes are believed
        orbit_axes(seven[:6])
