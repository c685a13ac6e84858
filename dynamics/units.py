"""Units of physical quantities, as annotations of fields and as suffixes of keys.

    length: Annotated[float, Unit("m")]

Values are in SI units everywhere; other units exist only in the keys of scenario files.
"""

from math import pi
from typing import Annotated, NamedTuple

from dynamics.doors import checked
from dynamics.inputs import InputError, join_names


@checked
class Unit(NamedTuple):
    """SI unit of a field, as a key of a scenario file spells it: "m_s2" for m/s²."""

    suffix: str

    @property
    def quantity(self) -> str:
        """Physical quantity that the unit measures."""
        return self._entry.quantity

    def __str__(self) -> str:
        """Spell the unit as in a formula."""
        return self._entry.symbol

    @property
    def _entry(self) -> "Suffix":
        if self.suffix not in SUFFIXES:
            raise InputError("suffix", f"must be {join_names(SUFFIXES)}, got {self.suffix!r}")
        return SUFFIXES[self.suffix]


class Key(NamedTuple):
    """Key of a field in a scenario file, where it is not the name of the field."""

    name: str


class Suffix(NamedTuple):
    """Suffix of a key: the quantity, the size in SI units, and the symbol of the unit."""

    quantity: str
    factor: float
    symbol: str


# Longer suffixes stand before those that end alike: the first that fits is taken.
SUFFIXES = {
    "mm_s2": Suffix("acceleration", 1e-3, "mm/s²"),
    "m_s2": Suffix("acceleration", 1.0, "m/s²"),
    "kg_m3": Suffix("density", 1.0, "kg/m³"),
    "m2_kg": Suffix("area per mass", 1.0, "m²/kg"),
    "m2_s": Suffix("specific angular momentum", 1.0, "m²/s"),
    "mm_s": Suffix("speed", 1e-3, "mm/s"),
    "m_s": Suffix("speed", 1.0, "m/s"),
    "rad_s": Suffix("angular rate", 1.0, "rad/s"),
    "deg_s": Suffix("angular rate", pi / 180, "deg/s"),
    "km": Suffix("length", 1e3, "km"),
    "m": Suffix("length", 1.0, "m"),
    "min": Suffix("time", 60.0, "min"),
    "s": Suffix("time", 1.0, "s"),
    "deg": Suffix("angle", pi / 180, "deg"),
    "rad": Suffix("angle", 1.0, "rad"),
    "hz": Suffix("frequency", 1.0, "Hz"),
}

Length = Annotated[float, Unit("m")]
Time = Annotated[float, Unit("s")]
Speed = Annotated[float, Unit("m_s")]
Acceleration = Annotated[float, Unit("m_s2")]
Angle = Annotated[float, Unit("rad")]
AngularRate = Annotated[float, Unit("rad_s")]
