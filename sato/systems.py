"""The systems there are, a line each; a system is loaded when it is asked for."""

from importlib import import_module
from typing import Any

from sato.interfaces import System

SYSTEM_MODULES = {
    "reconfiguration": "sato.reconfiguration.system",
    "formation": "sato.formation.system",
    "connectivity": "sato.connectivity.system",
}

SYSTEMS = tuple(SYSTEM_MODULES)


class UnknownSystemError(ValueError):
    """A name that no system has."""

    def __init__(self, name: str) -> None:
        """Name it, and those there are."""
        known = ", ".join(f'"{known}"' for known in SYSTEM_MODULES)
        super().__init__(f'there is no system "{name}", only {known}')


def load_system(name: str) -> System[Any, Any]:
    """The system of a name.

    Raises:
        UnknownSystem: There is none.
    """
    if name not in SYSTEM_MODULES:
        raise UnknownSystemError(name)
    found: System[Any, Any] = import_module(SYSTEM_MODULES[name]).SYSTEM
    return found


def definition_of(name: str) -> Any:
    """Return the class of missions of a system."""
    from sato.reconfiguration.mission import Reconfiguration

    if name != "reconfiguration":
        raise UnknownSystemError(name)
    return Reconfiguration
