"""Definitions: frozen values whose annotated fields are the keys of a scenario file.

    @dataclass(frozen=True, eq=False, repr=False)
    class Random(Definition):
        kind: ClassVar[str] = "random"
        separation: Annotated[Length, Positive, "least distance of two agents"]

From the annotations come the check at construction, the keys with their units, the tables
of keys in the documentation, the messages of errors, and equality by value.
"""

from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, cached_property
from types import UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from annotated_types import Ge, Gt
from numpy import ndarray as Array
from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError

from dynamics.units import Key as Key
from dynamics.units import Unit
from sato.scenario.errors import InputError, errors_in, format_value, join_names
from sato.scenario.messages import explain

Positive, NotNegative = Gt(0), Ge(0)
_STRICT = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)


class In(NamedTuple):
    """Table of the scenario file that holds a field."""

    table: str


class Convert(NamedTuple):
    """Conversion of what Python users may give for a field: an array for a list of points."""

    function: Callable[[Any], Any]


class Inline(NamedTuple):
    """Mark of a field whose own keys stand in the same table, as those of a model do."""


class Definition:
    """Base of frozen dataclasses that check their fields and compare by value.

    Raises:
        InputError: A field has a value that it cannot have, or two contradict each other.
    """

    def __post_init__(self) -> None:
        """Convert and check every field, then all of them together."""
        for field in fields_of(type(self)):
            object.__setattr__(self, field.name, field.checked(getattr(self, field.name)))
        for name, value in self.completed().items():
            object.__setattr__(self, name, value)
        self.check()

    def completed(self) -> dict[str, Any]:
        """Return values of fields that follow from the others where they are not given."""
        return {}

    def check(self) -> None:
        """Refuse fields that contradict each other.

        Raises:
            InputError: They do.
        """

    @classmethod
    def check_table(cls, data: dict[str, Any]) -> None:
        """Refuse a table of a file before its keys are read.

        Raises:
            InputError: Its keys cannot be those of this definition.
        """

    def __eq__(self, other: object) -> bool:
        """Compare all fields by value."""
        if type(other) is not type(self):
            return NotImplemented
        names = [field.name for field in fields_of(type(self))]
        return all(_equal(getattr(self, name), getattr(other, name)) for name in names)

    def __hash__(self) -> int:
        """Hash the fields that are numbers or text."""
        values = (getattr(self, field.name) for field in fields_of(type(self)))
        return hash((type(self), *(v for v in values if isinstance(v, int | float | str))))

    def __repr__(self) -> str:
        """Show the fields that are not at their defaults."""
        shown = [
            f"{field.name}={_short(value)}"
            for field in fields_of(type(self))
            if not _equal(value := getattr(self, field.name), field.default)
        ]
        return f"{type(self).__name__}({', '.join(shown)})"


class Field(NamedTuple):
    """Field of a definition, with all that its annotation says."""

    name: str
    hint: Any  # type, without the annotations below
    table: str | None
    key: str  # without its unit
    unit: Unit | None
    default: Any  # MISSING where a value is required
    meaning: str
    convert: Callable[[Any], Any] | None
    is_inline: bool
    adapter: "_Adapter"

    @property
    def full_key(self) -> str:
        """Key with its SI unit, as it stands in the file."""
        return self.key if self.unit is None else f"{self.key}_{self.unit.suffix}"

    @property
    def address(self) -> str:
        """Key with its table."""
        if self.is_inline:
            return str(self.table)
        return f"{self.table}.{self.full_key}" if self.table else self.full_key

    @property
    def variants(self) -> tuple[type, ...]:
        """Definitions that the field may hold; empty for numbers, text and arrays."""
        return _records(self.hint)

    @property
    def is_list(self) -> bool:
        """True where the field holds any number of definitions."""
        return get_origin(self.hint) is tuple and bool(self.variants)

    @property
    def is_nested(self) -> bool:
        """True where the field is a table of its own: one definition without a choice."""
        return len(self.variants) == 1 and not self.is_list and not self.is_inline

    def checked(self, value: Any) -> Any:
        """Convert and check a value.

        Raises:
            InputError: The field cannot have it.
        """
        if value is self.default and (value is None or self.variants):
            return value
        try:
            return self._checked(value if self.convert is None else self.convert(value))
        except InputError as error:
            found = error.inside(self.address)
            raise InputError(found.key, found.reason, self.table is not None) from error

    def _checked(self, value: Any) -> Any:
        if not self.variants:
            return self.adapter.check(value)
        if not self.is_list:
            return self._record(value, "")
        is_one = not isinstance(value, list | tuple) or is_named_tuple(type(value))
        given = [value] if is_one else value
        return tuple(self._record(one, str(i)) for i, one in enumerate(given))

    def _record(self, value: Any, address: str) -> Any:
        allowed = self.variants + _others(self.hint)
        if not isinstance(value, allowed):
            names = join_names(kind.__name__ for kind in allowed)
            raise InputError(address, f"must be {names}, got {type(value).__name__}")
        if not is_named_tuple(type(value)):
            return value
        with errors_in(address):
            values = [own.checked(getattr(value, own.name)) for own in fields_of(type(value))]
        return type(value)(*values)


class _Adapter:
    """Check of a value that is no definition, by pydantic; built when it is first needed."""

    def __init__(self, hint: Any) -> None:
        self.hint = hint

    @cached_property
    def _adapter(self) -> Any:
        return TypeAdapter(self.hint, config=_STRICT)

    def check(self, value: Any) -> Any:
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, list | Array) and get_origin(self.hint) is tuple:
            value = tuple(value.tolist() if isinstance(value, Array) else value)
        try:
            return self._adapter.validate_python(value)
        except ValidationError as error:
            raise explain(error) from error


def fields_of(definition: Any) -> tuple[Field, ...]:
    """Collect the fields of a definition, a frozen dataclass or a named tuple."""
    return _fields_of(definition)


@cache
def _fields_of(definition: Any) -> tuple[Field, ...]:
    hints = get_type_hints(definition, include_extras=True)
    if is_named_tuple(definition):
        defaults = definition._field_defaults
        names = [(name, defaults.get(name, MISSING)) for name in definition._fields]
    elif is_dataclass(definition):
        names = [(f.name, _default(f)) for f in fields(definition) if f.init]
    else:
        raise TypeError(f"{definition.__name__} is neither a dataclass nor a named tuple")
    return tuple(_field(name, hints[name], default) for name, default in names)


def is_named_tuple(kind: Any) -> bool:
    """Tell whether a class is a named tuple."""
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def kinds_of(definition: Any) -> tuple[str, ...]:
    """List the names by which a scenario file chooses a definition."""
    hint = get_type_hints(definition).get("kind")
    if get_origin(hint) is Literal:
        return get_args(hint)
    if hasattr(definition, "kinds"):
        return tuple(definition.kinds)
    return (definition.kind,) if hasattr(definition, "kind") else ()


def number_or_auto(value: Any) -> Any:
    """Accept a number that is not negative, or "auto"."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if value == "auto" or (number and 0 <= value < np.inf):
        return value if value == "auto" else float(value)
    raise InputError(
        "", f'must be a number that is not negative, or "auto", got {format_value(value)}'
    )


def is_auto(value: Any) -> bool:
    """Tell whether a value is still to be computed."""
    return bool(value == "auto")


def as_array(value: Any, ndim: int) -> Array:
    """Convert to a read-only array of finite doubles.

    Raises:
        InputError: It is masked, complex or not numeric, has other axes, or is not finite.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise InputError("", "must not be a masked array; value.filled(...) is a plain one")
    try:
        array = np.array(value, order="C")
    except ValueError as error:
        raise InputError("", "must have rows of one length") from error
    if array.dtype.kind not in "iuf":
        raise InputError("", f"must be an array of real numbers, got dtype {array.dtype}")
    if array.ndim != ndim or array.size == 0:
        raise InputError("", f"must be an array with {ndim} axes, got shape {array.shape}")
    array = array.astype(float)
    if not np.isfinite(array).all():
        where = ", ".join(map(str, np.argwhere(~np.isfinite(array))[0]))
        raise InputError("", f"must be finite, got {array[~np.isfinite(array)][0]} at [{where}]")
    array.flags.writeable = False
    return array


Coordinates = Annotated[
    tuple[float, ...], BeforeValidator(lambda value: tuple(as_array(value, 1).tolist()))
]
Vector = Annotated[Array, BeforeValidator(lambda value: as_array(value, 1))]
Matrix = Annotated[Array, BeforeValidator(lambda value: as_array(value, 2))]


def _field(name: str, hint: Any, default: Any) -> Field:
    base, *said = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    marks: dict[Any, Any] = {
        type(mark): mark for mark in said if isinstance(mark, In | Key | Convert | Inline)
    }
    unit = next((mark for mark in said if isinstance(mark, Unit)), None)
    meaning = next((mark for mark in said if isinstance(mark, str)), "")
    ours = (In, Key, Convert, Inline, Unit, str)
    checks = tuple(mark for mark in said if not isinstance(mark, ours))
    return Field(
        name=name,
        hint=base,
        table=marks[In].table if In in marks else None,
        key=marks[Key].name if Key in marks else name,
        unit=unit,
        default=default,
        meaning=meaning,
        convert=marks[Convert].function if Convert in marks else None,
        is_inline=Inline in marks,
        adapter=_Adapter(Annotated[base, *checks] if checks else base),
    )


def _default(field: Any) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _parts(hint: Any) -> Iterator[Any]:
    if get_origin(hint) in (Union, UnionType, tuple, Annotated):
        for part in get_args(hint):
            yield from _parts(part)
    else:
        yield hint


def _records(hint: Any) -> tuple[type, ...]:
    # Other classes in a union are accepted from Python, but no scenario file can name them.
    return tuple(
        part
        for part in _parts(hint)
        if isinstance(part, type)
        and (issubclass(part, Definition) or is_named_tuple(part) or hasattr(part, "kind"))
    )


def _others(hint: Any) -> tuple[type, ...]:
    found = (part for part in _parts(hint) if isinstance(part, type))
    return tuple(part for part in found if part not in _records(hint))


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, Array) or isinstance(other, Array):
        return isinstance(one, Array) and isinstance(other, Array) and np.array_equal(one, other)
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_equal, one, other))
    return bool(one == other)


def _short(value: Any) -> str:
    if isinstance(value, Array):
        return f"<array of shape {value.shape}>"
    if isinstance(value, tuple) and len(value) > 3 and not is_named_tuple(type(value)):
        return f"<{len(value)} values>"
    return repr(value)
