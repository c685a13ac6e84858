"""Units of physical quantities, as annotations of fields and as suffixes of keys.

    length: Annotated[float, Unit("m")]

Values are in SI units everywhere; other units exist only in the keys of scenario files.
"""

from dataclasses import dataclass
from math import pi
from typing import Annotated, NamedTuple

from dynamics.inputs import InputError, format_value, join_names


@dataclass(frozen=True)
class Unit:
    """SI unit of a field, as a key of a scenario file spells it: "m_s2" for m/s²."""

    suffix: str

    def __post_init__(self) -> None:
        """Check the suffix."""
        if self.suffix not in SUFFIXES:
            reason = f"must be {join_names(SUFFIXES)}, got {format_value(self.suffix)}"
            raise InputError("suffix", reason)

    def __str__(self) -> str:
        """Spell the unit as in a formula."""
        return SUFFIXES[self.suffix].symbol


class Allow(NamedTuple):
    """Mark of an annotation: numbers that need not be finite, NaN for what is absent or ∞."""

    nan: bool = False
    infinite: bool = False


MAY_BE_NAN, MAY_BE_INFINITE = Allow(nan=True), Allow(infinite=True)
ANY_NUMBER = Allow(nan=True, infinite=True)


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
    "cm_s2": Suffix("acceleration", 1e-2, "cm/s²"),
    "m_s2": Suffix("acceleration", 1.0, "m/s²"),
    "kg_m3": Suffix("density", 1.0, "kg/m³"),
    "m2_kg": Suffix("area per mass", 1.0, "m²/kg"),
    "km3_s2": Suffix("gravitational parameter", 1e9, "km³/s²"),
    "m3_s2": Suffix("gravitational parameter", 1.0, "m³/s²"),
    "m5_s2": Suffix("strength of the oblateness", 1.0, "m⁵/s²"),
    "m2_s": Suffix("specific angular momentum", 1.0, "m²/s"),
    "km_s": Suffix("speed", 1e3, "km/s"),
    "km_h": Suffix("speed", 1 / 3.6, "km/h"),
    "cm_s": Suffix("speed", 1e-2, "cm/s"),
    "mm_s": Suffix("speed", 1e-3, "mm/s"),
    "m_s": Suffix("speed", 1.0, "m/s"),
    "rad_s": Suffix("angular rate", 1.0, "rad/s"),
    "deg_s": Suffix("angular rate", pi / 180, "deg/s"),
    "km": Suffix("length", 1e3, "km"),
    "cm": Suffix("length", 1e-2, "cm"),
    "mm": Suffix("length", 1e-3, "mm"),
    "m": Suffix("length", 1.0, "m"),
    "h": Suffix("time", 3600.0, "h"),
    "min": Suffix("time", 60.0, "min"),
    "ms": Suffix("time", 1e-3, "ms"),
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


def split_unit(key: str) -> tuple[str, str | None]:
    """Split a key from the suffix of its unit."""
    for suffix in SUFFIXES:
        if key.endswith(f"_{suffix}"):
            return key.removesuffix(f"_{suffix}"), suffix
    return key, None
