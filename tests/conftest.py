"""Shared fixtures. Shape annotations are checked at run time, in tests only."""

import functools
import os
from collections import Counter
from collections.abc import Callable
from types import CodeType, FunctionType
from typing import Any

# Before NumPy is loaded: on two cores, two workers with threads of their own only wait.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import jaxtyping  # noqa: E402

OFTEN = 30  # calls of one function in one test, after which its shapes are believed
FEW = 3  # functions that a function has made of one code in one test, with the same effect

_calls: Counter[FunctionType] = Counter()
_made: Counter[CodeType] = Counter()
_jaxtyped = jaxtyping.jaxtyped


def _at_first(typechecker: Callable[..., Any]) -> Callable[[Any], Any]:
    # An integrator asks for the same shapes a hundred thousand times, and to check them
    # takes longer than to integrate.
    def decorate(function: Any) -> Any:
        if any(base.__name__ == "Definition" for base in getattr(function, "__mro__", ())):
            return function  # definitions convert what they are given, and check it themselves
        if getattr(function, "__module__", "").startswith("dynamics.door"):
            return function  # doors ask from which module they are called
        if isinstance(function, FunctionType) and not function.__annotations__:
            return function  # compiled code has nothing to check
        if function.__module__.startswith("dynamics.door"):
            return function  # checks all others, also in strategies, where beartype may draw none
        if "<locals>" in function.__qualname__ and isinstance(function, FunctionType):
            _made[function.__code__] += 1
            if _made[function.__code__] > FEW:
                return function  # to compile its checks takes longer than to call it
        if hasattr(vars(function).get("__init__"), "__wrapped__"):
            return function  # a door, which converts what it is given
        checked = _jaxtyped(function, typechecker=typechecker)
        if not isinstance(function, FunctionType):
            return checked

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            _calls[function] += 1
            return (checked if _calls[function] <= OFTEN else function)(*args, **kwargs)

        return call

    return decorate


jaxtyping.jaxtyped = _at_first  # the name that the hook looks up
jaxtyping.install_import_hook(
    ["dynamics", "problems", "sato"],
    "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))",
)

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

# The same examples every time, and no clock: a test that passed here passes elsewhere.
settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")


def pytest_runtest_setup() -> None:
    _calls.clear()
    _made.clear()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(2016)
