"""Definitions: frozen values whose annotated fields are the keys of a scenario file.

    @dataclass(frozen=True, eq=False, repr=False)
    class Random(Definition):
        kind: ClassVar[str] = "random"
        separation: Annotated[Length, Positive, "least distance of two agents"]

From the annotations come the check at construction, the keys with their units, the tables
of keys in the documentation, the messages of errors, and equality by value.
"""

import inspect
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass, replace
from functools import cache, cached_property, partial
from os import PathLike, fspath
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy import ndarray as Array
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    TypeAdapter,
    ValidationError,
    WrapValidator,
)

from dynamics.callbacks import Callback, guard
from dynamics.doors import check_methods, checked
from dynamics.inputs import LARGEST, read_array, shorten
from dynamics.inputs import as_array as as_array
from dynamics.labels import check_axis_labels, check_vehicle_labels, to_plain
from dynamics.model import Model
from dynamics.plant import Plant
from dynamics.quantities import to_si, within_turns
from dynamics.units import Key as Key
from dynamics.units import Unit
from sato.scenario.errors import InputError, explain, format_value, join_names
from sato.scenario.ranges import check_range

Positive, NotNegative = Gt(0), Ge(0)
TURNS = AfterValidator(within_turns)  # mark of an angle of at most two turns
HALF_TURN = AfterValidator(partial(within_turns, turns=0.5))  # the same of a difference
Seed = Annotated[int, Ge(0), Lt(2**64)]
Amount = Annotated[int, Positive]
Count = Annotated[int, NotNegative]
Axes = Annotated[int, Ge(2), Le(3)]
LONGEST_TEXT = 4096  # characters
UNWRITABLE = re.compile(
    "[\\0-\\x08\\x0b\\x0c\\x0e-\\x1f\\x7f\ud800-\udfff]"
)  # controls, and halves of characters
LATER: Any = None  # default of a field that follows from others, or is drawn
_STRICT = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)


@checked
class In(NamedTuple):
    """Table of the scenario file that holds a field."""

    table: str


@checked
class Convert(NamedTuple):
    """Conversion of what Python users may give for a field: an array for a list of points."""

    function: Callable[[Any], Any]


class Inline(NamedTuple):
    """Mark of a field whose own keys stand in the same table, as those of a model do."""


class Words(str):
    """Annotation that a signature shows as it is."""

    __repr__ = str.__str__


class ShortSignature:
    """Signature of a definition as `help` shows it: names, short types and defaults."""

    def __get__(self, instance: Any, owner: Any) -> inspect.Signature:
        """Shorten the signature of a class, and of its constructor, which stands below."""
        if "__dataclass_fields__" not in vars(owner):
            raise AttributeError("a class without fields has no signature of its own")
        long = inspect.signature(owner.__init__)
        short = {field.name: Words(_type_words(field.hint)) for field in fields_of(owner)}
        parameters = [
            p.replace(annotation=short.get(p.name, p.empty)) for p in long.parameters.values()
        ]
        owner.__init__.__signature__ = long.replace(parameters=parameters)
        return long.replace(parameters=parameters[1:], return_annotation=long.empty)


def _type_words(hint: Any) -> str:
    origin, parts = get_origin(hint), [part for part in get_args(hint) if part is not Ellipsis]
    if origin is Literal:
        return " | ".join(map(repr, parts))
    words = list(dict.fromkeys(map(_type_words, parts[:1] if origin is Annotated else parts)))
    if origin is tuple:
        return f"tuple[{', '.join(words)}, ...]"
    return " | ".join(words) or ("None" if hint is type(None) else hint.__name__)


class Definition:
    """Base of frozen dataclasses that check their fields and compare by value.

    Raises:
        InputError: A field has a value that it cannot have, or two contradict each other.
    """

    callbacks: ClassVar[dict[str, Callback]] = {}  # methods that users write

    __signature__ = ShortSignature()

    def __init_subclass__(cls) -> None:
        """Let public methods check their arguments, or, of a user's own, be checked themselves."""
        if cls.__module__.startswith("sato."):
            check_methods(cls)
        guard(cls, cls.callbacks)

    def __post_init__(self) -> None:
        """Convert and check every field, then all of them together."""
        for field in fields_of(type(self)):
            object.__setattr__(self, field.name, field.check(getattr(self, field.name)))
        for name, value in self.completed().items():
            object.__setattr__(self, name, value)
        flown: Any = self
        if chosen := self.choices():
            flown = replace(flown, **chosen)
        flown.check()

    def completed(self) -> dict[str, Any]:
        """Return values of fields that follow from the others where they are not given."""
        return {}

    def choices(self) -> dict[str, Any]:
        """Return values of fields that stay automatic until the definition is drawn."""
        return {}

    def check(self) -> None:
        """Refuse fields that contradict each other, with an `InputError`."""

    def __eq__(self, other: object) -> bool:
        """Compare all fields by value."""
        if type(other) is not type(self):
            return NotImplemented
        names = [field.name for field in fields_of(type(self))]
        return all(_equal(getattr(self, name), getattr(other, name)) for name in names)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy or a pickle; arrays of its fields cannot be written to there either."""
        self.__dict__.update(state)
        for field in fields_of(type(self)):
            if isinstance(value := getattr(self, field.name), Array):
                value.setflags(write=False)

    def __hash__(self) -> int:
        """Hash the fields that are numbers or text."""
        values = (getattr(self, field.name) for field in fields_of(type(self)))
        return hash((type(self), *(v for v in values if isinstance(v, int | float | str))))

    def __repr__(self) -> str:
        """Show the fields that are not at their defaults."""
        shown = [
            f"{field.name}={shorten(value)}"
            for field in fields_of(type(self))
            if not _equal(value := getattr(self, field.name), field.default)
        ]
        return f"{type(self).__name__}({', '.join(shown)})"


class Field:
    """Field of a definition, with all that its annotation says; MISSING marks no default."""

    def __init__(self, name: str, hint: Any, default: Any) -> None:
        self.name, self.default, self.annotation = name, default, hint
        self.hint, *self.marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        marks: dict[type, Any] = {type(mark): mark for mark in self.marks}
        self.meaning: str = marks.get(str, "")
        self.table: str = marks[In].table if In in marks else ""
        self.convert: Callable[[Any], Any] | None = getattr(marks.get(Convert), "function", None)
        self.key: str = marks[Key].name if Key in marks else name
        self.unit: str = marks[Unit].suffix if Unit in marks else ""  # an SI unit
        self.key += f"_{self.unit}" if self.unit else ""
        classes = _classes(self.hint)
        self.variants = tuple(kind for kind in classes if is_definition(kind))
        self.others = tuple(kind for kind in classes if not is_definition(kind))
        self.is_inline = Inline in marks
        self.may_be_huge = getattr(marks.get(Le), "le", 0) > LARGEST
        self.is_list = get_origin(self.hint) is tuple and bool(self.variants)
        self.is_of_axes = name.endswith("_axes") or COORDINATES in self.marks
        # A table of its own: one definition without a choice.
        self.is_nested = len(self.variants) == 1 and not (self.is_list or self.is_inline)

    @property
    def address(self) -> str:
        """Key with its table."""
        if self.is_inline:
            return self.table
        return f"{self.table}.{self.key}" if self.table else self.key

    @cached_property
    def kinds(self) -> dict[str, type]:
        """Definitions that the field may hold, by the name that chooses one in a file."""
        return {kind: variant for variant in self.variants for kind in kinds_of(variant)}

    @cached_property
    def _adapter(self) -> Any:
        return TypeAdapter(self.annotation, config=_STRICT)  # slow, so made where it is needed

    def check(self, value: Any) -> Any:
        """Convert and check a value; refuse it with an `InputError` if the field cannot have it."""
        if value is self.default and (value is None or self.variants):
            return value
        with errors_in(self.address):
            if self.convert is not None:
                value = self.convert(value)
            if not self.variants:
                return self._check_plain(value)
            if not self.is_list:
                return self._check_definition(value)
            is_one = not isinstance(value, list | tuple) or is_named_tuple(type(value))
            return map_numbered(self._check_definition, [value] if is_one else value)

    def _check_plain(self, value: Any) -> Any:
        is_list = get_origin(self.hint) is tuple or Array in self.others
        is_column = hasattr(value, "to_numpy") and hasattr(value, "__len__")  # and no timestamp
        is_labeled = self.unit or is_list or is_column
        if EACH in self.marks:
            check_vehicle_labels(value)
        elif self.is_of_axes:
            check_axis_labels(value)
        value = (to_plain if is_labeled else to_si)(value, self.unit)
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, PathLike) and self.name == "file":
            value = fspath(value)
        is_list = type(value) is list or (type(value) is Array and value.ndim > 0)
        if is_list and get_origin(self.hint) is tuple:
            value = tuple(value if isinstance(value, list) else value.tolist())
        if isinstance(value, str) and (len(value) > LONGEST_TEXT or UNWRITABLE.search(value)):
            reason = f"must be text without controls, of at most {LONGEST_TEXT} characters"
            raise InputError("", f"{reason}, got {format_value(value)}")
        try:
            found = self._adapter.validate_python(value)
            return found if self.may_be_huge else check_range(found)
        except ValidationError as error:
            raise explain(error) from error

    def _check_definition(self, value: Any) -> Any:
        allowed = self.variants + self.others
        if not isinstance(value, allowed):
            names = join_names(kind.__name__ for kind in allowed)
            modules = join_names(sorted({kind.__module__ for kind in allowed}), "and")
            got = f"the class {value.__name__}" if isinstance(value, type) else type(value).__name__
            raise InputError("", f"must be {names} of {modules}, got {got}")
        if not is_named_tuple(type(value)):
            return value
        return type(value)(*[f.check(getattr(value, f.name)) for f in fields_of(type(value))])


@checked
def fields_of(definition: type) -> tuple[Field, ...]:
    """Collect the fields of a definition, a frozen dataclass or a named tuple."""
    return _fields_of(definition)


@cache
def _fields_of(definition: Any) -> tuple[Field, ...]:
    hints = get_type_hints(definition, include_extras=True)
    if is_named_tuple(definition):
        named = definition._field_defaults
        defaults = {name: named.get(name, MISSING) for name in definition._fields}
    else:
        defaults = {field.name: field.default for field in fields(definition) if field.init}
    return tuple(Field(name, hints[name], default) for name, default in defaults.items())


def is_named_tuple(kind: Any) -> bool:
    """Tell whether a class is a named tuple."""
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def is_definition(kind: Any) -> bool:
    """Tell whether a table of a scenario file can stand for values of a class."""
    return is_named_tuple(kind) or issubclass(kind, Definition)


@cache
def kinds_of(definition: Any) -> tuple[str, ...]:
    """List the names by which a scenario file chooses a definition."""
    hint = get_type_hints(definition).get("kind")
    if get_origin(hint) is Literal:
        return get_args(hint)
    kind = getattr(definition, "kind", None)
    return getattr(definition, "kinds", (kind,) if isinstance(kind, str) else ())


@contextmanager
def errors_in(table: str) -> Iterator[None]:
    """Prefix the key of every `InputError` with a table; make one of any other `ValueError`."""
    try:
        yield
    except InputError as error:
        raise error.inside(table) from error
    except ValueError as error:
        raise InputError(table, str(error)) from error


def map_numbered(function: Callable[[Any], Any], values: Iterable[Any]) -> tuple[Any, ...]:
    """Apply a function to each value of a list; its errors name the number of the value."""
    found = []
    for number, value in enumerate(values):
        with errors_in(str(number)):
            found.append(function(value))
    return tuple(found)


def _check_each(value: Any, check: Callable[[Any], Any]) -> Any:
    # pydantic takes an error of its own only where it has made it itself.
    if not isinstance(value, list | tuple | Array):
        return check(value)

    def check_one(one: Any) -> Any:
        try:
            return check(one.item() if isinstance(one, np.generic) else one)
        except ValidationError as error:
            raise explain(error) from error

    entries = read_array(value).tolist() if isinstance(value, Array) else value
    if not isinstance(entries, list | tuple) or not entries:
        raise InputError("", "must be a number, or a list with an entry for each vehicle")
    return map_numbered(check_one, entries)


EACH = WrapValidator(_check_each)  # last mark of a field that takes a list of values as well


def is_auto(value: Any) -> bool:
    """Tell whether a value is still to be computed."""
    return bool(value == "auto")


def _as_coordinates(value: Any) -> tuple[float, ...]:
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        is_huge = isinstance(value, int) and abs(value) > LARGEST
        one = format_value(value) if is_huge else f"{value:g}"
        raise InputError("", f"must be a list of numbers such as [{one}, {one}], got {one}")
    return tuple(as_array(value, 1).tolist())


COORDINATES = BeforeValidator(_as_coordinates)
Coordinates = Annotated[tuple[float, ...], COORDINATES]
Vector = Annotated[Array, BeforeValidator(lambda value: as_array(value, 1))]
Matrix = Annotated[Array, BeforeValidator(lambda value: as_array(value, 2))]


def _classes(hint: Any) -> list[type]:
    parts = get_args(hint)
    if not parts:
        return [hint] if isinstance(hint, type) else []
    return [found for part in parts for found in _classes(part)]


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, Array) or isinstance(other, Array):
        return isinstance(one, Array) and isinstance(other, Array) and np.array_equal(one, other)
    if isinstance(one, tuple | list) and type(one) is type(other):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(one[key], other[key]) for key in one)
    if isinstance(one, Model | Plant) and type(one) is type(other) and one is not other:
        has_rule = type(one).__eq__ is not object.__eq__ and not is_dataclass(one)
        return bool(one == other) if has_rule else _equal(_state_of(one), _state_of(other))
    if isinstance(one, tuple) and isinstance(other, tuple):
        return False
    return bool(one == other)


def _state_of(value: Model | Plant) -> dict[str, Any]:
    # What it was made of, without what was computed from that; two without attributes are equal.
    cached = [n for n in vars(value) if isinstance(getattr(type(value), n, None), cached_property)]
    return {name: part for name, part in vars(value).items() if name not in cached}
