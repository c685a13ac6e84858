"""The systems there are, a line each; a system is loaded when it is asked for."""

from importlib import import_module
from typing import Any

from sato.system import System

HOME = {
    "reconfiguration": "sato.reconfiguration.system",
    "formation": "sato.formation.system",
    "connectivity": "sato.connectivity.system",
}


class UnknownSystem(ValueError):
    """A name that no system has."""

    def __init__(self, name: str) -> None:
        """Name it, and those there are."""
        known = ", ".join(f'"{known}"' for known in HOME)
        super().__init__(f'there is no system "{name}", only {known}')


def system(name: str) -> System[Any, Any]:
    """The system of a name.

    Raises:
        UnknownSystem: There is none.
    """
    if name not in HOME:
        raise UnknownSystem(name)
    found: System[Any, Any] = import_module(HOME[name]).SYSTEM
    return found
