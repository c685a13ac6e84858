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
from xdist.remote import Producer  # noqa: E402
from xdist.scheduler import LoadScopeScheduling  # noqa: E402

# The same examples every time, and no clock: a test that passed here passes elsewhere.
settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")


class Together(LoadScopeScheduling):
    """Keeps a file in one process, and all files that need the kernels of connectivity.

    They take a minute to compile, and two processes would both compile them.
    """

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        return "connectivity" if "connectivity" in file or "fiedler" in file else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Together:
    return Together(config, log)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(2016)
