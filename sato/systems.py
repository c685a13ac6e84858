"""Registry of the systems, a line each."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sato.scenario.errors import InputError, format_value, join_names

if TYPE_CHECKING:
    from sato.interfaces import System

# Each module offers MISSION, its definition, and SYSTEM, the rest, which is slow to import.
SYSTEMS = {
    "reconfiguration": "sato.reconfiguration",
    "formation": "sato.formation",
    "connectivity": "sato.connectivity",
}


def load_system(name: object) -> "System[Any, Any]":
    """Load a system by its name.

    Raises:
        InputError: There is no such system.
    """
    found: System[Any, Any] = _module(name).SYSTEM
    return found


def definition_of(name: object) -> Any:
    """Load the definition of a system's missions by its name.

    Raises:
        InputError: There is no such system.
    """
    return _module(name).MISSION


def _module(name: object) -> Any:
    if not isinstance(name, str) or name not in SYSTEMS:
        known = join_names((f'"{known}"' for known in SYSTEMS), "and")
        raise InputError("system", f"there is no system {format_value(name)}, only {known}")
    return import_module(SYSTEMS[name])
