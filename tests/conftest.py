"""Shared fixtures. Every shape annotation is checked at run time, in tests only."""

import os

# Before NumPy is loaded: on two cores, two workers with threads of their own only wait.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

from jaxtyping import install_import_hook  # noqa: E402

install_import_hook(
    ["dynamics", "problems", "sato"],
    "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))",
)

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

# The same examples every time, and no clock: a test that passed here passes elsewhere.
settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(2016)
