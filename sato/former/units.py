"""Tables whose keys end in a unit. The only place where units other than SI exist."""

from collections.abc import Mapping
from math import pi
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, model_validator

from sato.former.refusal import Refusal, nearest


class Unit(NamedTuple):
    """What a suffix measures, and how much of the SI unit it is."""

    kind: str
    factor: float


# The first suffix that fits counts, so the longer stand before those that end like them.
UNITS = {
    "_mm_s2": Unit("acceleration", 1e-3),
    "_m_s2": Unit("acceleration", 1.0),
    "_kg_m3": Unit("density", 1.0),
    "_m2_kg": Unit("area for a mass", 1.0),
    "_mm_s": Unit("speed", 1e-3),
    "_m_s": Unit("speed", 1.0),
    "_rad_s": Unit("rotation", 1.0),
    "_deg_s": Unit("rotation", pi / 180),
    "_m2": Unit("area", 1.0),
    "_km": Unit("length", 1e3),
    "_m": Unit("length", 1.0),
    "_min": Unit("time", 60.0),
    "_s": Unit("time", 1.0),
    "_deg": Unit("angle", pi / 180),
    "_rad": Unit("angle", 1.0),
    "_hz": Unit("frequency", 1.0),
}
SI = {unit.kind: suffix for suffix, unit in UNITS.items() if unit.factor == 1.0}


class Table(BaseModel):
    """A table of a scenario file.

    Its fields are the file's keys, with the SI unit at the end of those that have one. Any
    unit of the same kind is accepted and turned into SI; a key without its unit, or with one
    of another kind, is refused with the key that was meant.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _in_si(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        si: dict[str, Any] = {}
        for key, value in data.items():
            field, factor = meaning(key, cls.model_fields)
            if field in si:
                raise Refusal(key, f"is said twice; one of it and {field} is enough")
            si[field] = value if factor == 1.0 else _scaled(value, factor)
        return si


def meaning(key: str, fields: Mapping[str, object]) -> tuple[str, float]:
    """The field that a key of the file stands for, and the factor that turns it into SI.

    Raises:
        Refusal: There is no such field, or its unit is missing, superfluous or of another kind.
    """
    if key in fields:
        return key, 1.0
    base, unit = _split(key)
    if unit is not None and base + SI[unit.kind] in fields:
        return base + SI[unit.kind], unit.factor
    measured = {name: field for field in fields for name, of in [_split(field)] if of is not None}
    if unit is None and base in measured:
        raise Refusal(key, f"has no unit; write {measured[base]}")
    if unit is not None and base in measured:
        right = _split(measured[base])[1]
        assert right is not None
        raise Refusal(
            key, f"is in a unit of {unit.kind}, not of {right.kind}; write {measured[base]}"
        )
    if unit is not None and base in fields:
        raise Refusal(key, f"is a number without a unit; write {base}")
    meant = nearest(key, fields)
    hint = f"did you mean {meant}?" if meant else f"the keys here are {', '.join(fields)}"
    raise Refusal(key, f"there is no such key; {hint}")


def _split(key: str) -> tuple[str, Unit | None]:
    for suffix, unit in UNITS.items():
        if key.endswith(suffix) and key != suffix:
            return key.removesuffix(suffix), unit
    return key, None


def _scaled(value: Any, factor: float) -> Any:
    # What is no number is left as it is: the field will refuse it.
    if isinstance(value, list):
        return [_scaled(part, factor) for part in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return value * factor
