"""Quantities of astropy and pint, converted to plain numbers in SI units.

Neither package is imported: an object is known by the package of its class.
"""

from datetime import date, timedelta
from math import pi
from typing import Any

import numpy as np
from numpy import ndarray as Array

from dynamics.inputs import PLAIN, InputError
from dynamics.units import SUFFIXES

PINT_ROOTS = {"meter": "m", "gram": "kg", "second": "s", "radian": "rad"}
Powers = dict[str, float]  # exponents of m, kg, s and rad; those that are 0 left out


def to_si(value: Any, unit: str) -> Any:
    """Convert a quantity, or a list that has some, to numbers in the SI unit of a suffix.

    A value without units is returned as it is; the suffix "" takes numbers without a unit.
    """
    if type(value) in PLAIN:
        return value
    if isinstance(value, list | tuple):
        if set(map(type, value)) <= PLAIN:
            return value
        parts = [to_si(part, unit) for part in value]
        kept = [part for part, given in zip(parts, value, strict=True) if part is given]
        if kept and len(kept) < len(parts) and np.any(kept):
            raise InputError("", "has numbers with a unit and numbers without; give all a unit")
        return parts if len(kept) < len(parts) else value
    if isinstance(value, Array) and value.dtype == object and value.ndim:
        listed = value.tolist()
        parts = to_si(listed, unit)
        return value if parts is listed else parts
    split = _split(value)
    if split is None:
        return value
    numbers, powers = split
    if {name: power for name, power in powers.items() if power} != _powers(unit):
        noun = SUFFIXES[unit].quantity if unit else "plain number, in SI units"
        wanted = f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"
        raise InputError("", f"must be {wanted}, got {_format(value)}")
    return numbers if np.ndim(numbers) else numbers.item()


def within_turns(angle: Any, name: str = "", turns: float = 2.0) -> Any:
    """Return an angle, or an array of angles, within two turns; refuse larger ones, in degrees."""
    if isinstance(angle, int | float | Array) and np.abs(angle).max(initial=0.0) > 2 * pi * turns:
        worst = float(np.ravel(angle)[np.abs(np.ravel(angle)).argmax()])
        within = "two turns" if turns == 2 else f"{turns:g} turns"
        meant = f"{worst:.6g} degrees are np.radians({worst:.6g}) = {np.radians(worst):.6g}"
        raise InputError(name, f"must be within {within}, got {worst:.6g} rad; {meant}")
    return angle


def _split(value: Any) -> tuple[Any, Powers] | None:
    """Split a quantity into numbers in SI base units and their exponents; None for others."""
    if isinstance(value, timedelta) or getattr(getattr(value, "dtype", 0), "kind", "") == "m":
        return np.asarray(value, "m8[ns]") / np.timedelta64(1, "s"), {"s": 1.0}
    packages = {kind.__module__.split(".")[0] for kind in type(value).__mro__}
    if hasattr(value, "unit_items") and "pint" in packages:
        root = value.to_root_units()
        powers = {PINT_ROOTS.get(name, name): float(p) for name, p in root.unit_items()}
        return np.asarray(root.magnitude) * 1e-3 ** powers.get("kg", 0.0), powers
    if hasattr(value, "unit") and "astropy" in packages:
        if hasattr(value, "mask"):
            raise InputError("", "must not be masked; its filled(...) is a plain quantity")
        base = value.unit.decompose()
        if not hasattr(base, "bases"):  # of a logarithm
            return np.asarray(value.value), {str(base): 1.0}
        powers = {b.name: float(p) for b, p in zip(base.bases, base.powers, strict=True)}
        return np.asarray(value.value) * base.scale, powers
    if not isinstance(value, date) and (hasattr(value, "units") or hasattr(value, "unit")):
        cure = "a quantity of astropy or pint, or plain numbers in SI units, would do"
        raise InputError("", f"has units of a package that is not known, {_format(value)}; {cure}")
    return None


def _powers(unit: str) -> Powers:
    if unit == "hz":
        return {"s": -1.0}
    powers = {}
    for place, part in enumerate(filter(None, unit.split("_"))):
        name = part.rstrip("0123456789")
        powers[name] = float(part[len(name) :] or 1) * (-1 if place else 1)
    return powers


def _format(value: Any) -> str:
    is_scalar = np.ndim(getattr(value, "magnitude", getattr(value, "value", value))) == 0
    unit = getattr(value, "units", getattr(value, "unit", ""))
    return str(value) if is_scalar else f"an array in {str(unit) or 'no unit'}"
