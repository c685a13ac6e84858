"""Registry of the systems, a line each."""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from sato.scenario.errors import InputError, format_value, join_names

if TYPE_CHECKING:
    from sato.interfaces import System

# Definition of the missions of each system, and the rest, which is slow to import.
SYSTEMS = {
    "reconfiguration": (
        "sato.reconfiguration.mission:Reconfiguration",
        "sato.reconfiguration.system:SYSTEM",
    ),
    "formation": ("sato.formation.mission:Formation", "sato.formation.system:SYSTEM"),
    "connectivity": ("sato.connectivity.mission:Connectivity", "sato.connectivity.system:SYSTEM"),
}


def load_system(name: object) -> "System[Any, Any]":
    """Load a system by its name; refuse one that is not there."""
    found: System[Any, Any] = _load(name, 1)
    return found


def definition_of(name: object) -> Any:
    """Load the definition of a system's missions by its name; refuse one that is not there."""
    return _load(name, 0)


def _load(name: object, part: int) -> Any:
    if not isinstance(name, str) or name not in SYSTEMS:
        known = join_names((f'"{known}"' for known in SYSTEMS), "and")
        is_empty = isinstance(name, str) and not name
        fault = "is missing" if is_empty else f"there is no system {format_value(name)}"
        raise InputError("system", f"{fault}; {known} would do")
    return resolve_name(SYSTEMS[name][part])
