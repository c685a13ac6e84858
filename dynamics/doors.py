"""Doors: public functions and classes check their arguments by the annotations.

    @checked
    def simulate(x: Float[Array, "agents n"], dt: Annotated[float, Gt(0)]) -> ...

A caller outside these packages may give lists for arrays and NumPy's numbers for numbers;
anything else is refused with an `InputError` that names the argument, what it must be, and what
it is. Axes of one name have one size in all arguments of a call. Calls within the packages are not
checked again, and cost nothing.
"""

import inspect
import sys
from collections.abc import Callable
from functools import cache, wraps
from types import FrameType
from typing import Any, TypeVar, cast

from dynamics.inputs import short_repr
from dynamics.units import ANY_NUMBER as ANY_NUMBER
from dynamics.units import MAY_BE_INFINITE as MAY_BE_INFINITE
from dynamics.units import MAY_BE_NAN as MAY_BE_NAN
from dynamics.units import Unit

Target = TypeVar("Target", bound=Callable[..., Any])
INSIDE = "dynamics.", "problems.", "sato."
_signature = cache(inspect.signature)


def checked(target: Target) -> Target:
    """Check the arguments of a function, or of a class and its public methods.

    An object with a property `array_sizes` gives the sizes of axes by name, to its own methods
    and to functions that take it.
    """
    if not isinstance(target, type):
        return cast(Target, _wrap(target))
    owner: Any = target
    if getattr(vars(owner).get("__dataclass_params__"), "repr", hasattr(owner, "_fields")):
        owner.__repr__ = short_repr
    if hasattr(owner, "_fields"):  # a named tuple
        owner.__new__ = staticmethod(_wrap(owner.__new__, is_constructor=True))
    elif "__init__" in vars(owner):
        owner.__init__ = _wrap(owner.__init__, is_constructor=True)
    check_methods(owner)
    return target


def check_methods(owner: type) -> type:
    """Check the arguments of the public methods of a class, but not of its constructor."""
    for name, member in list(vars(owner).items()):
        if name.startswith("_") and name not in ("__call__", "__getitem__"):
            continue
        if inspect.isfunction(member):
            setattr(owner, name, _wrap(member, is_method=True))
        elif isinstance(member, classmethod | staticmethod):
            inner = _wrap(member.__func__, is_method=isinstance(member, classmethod))
            setattr(owner, name, type(member)(inner))
    return owner


def _wrap(function: Any, is_method: bool = False, is_constructor: bool = False) -> Any:
    @wraps(function)
    def enter(*args: Any, **kwargs: Any) -> Any:
        frame = sys._getframe(1)
        if _module_of(frame).startswith(INSIDE):
            return function(*args, **kwargs)
        # `super()` of a user's own method is called by these packages, which check the result.
        is_super = is_method and frame.f_code.co_name == function.__name__
        caller = frame.f_back if is_super else frame
        while caller and _module_of(caller) == "dataclasses":  # `replace`, of one frame or two
            caller = caller.f_back
        if caller and _module_of(caller).startswith(INSIDE):
            return function(*args, **kwargs)
        try:
            given = _signature(function).bind(*args, **kwargs)
        except TypeError:
            return function(*args, **kwargs)  # Python says which argument is missing
        _check_call(function, given, int(is_method or is_constructor), is_constructor)
        return function(*given.args, **given.kwargs)

    return enter


def _module_of(frame: FrameType) -> str:
    return frame.f_globals.get("__name__") or ""


def _check_call(
    function: Any, given: inspect.BoundArguments, skipped: int, keeps_arrays: bool
) -> None:
    # Imported where a check is needed, which a command and a flight do not.
    from dynamics.door_checks import Sizes, check_entry, checks_of

    owner = next(iter(given.arguments.values())) if skipped else None
    is_instance = skipped and not keeps_arrays and not isinstance(owner, type)
    sizes = Sizes(getattr(owner, "array_sizes", {}) if is_instance else {}, keeps_arrays)
    checks, parameters = checks_of(function), given.signature.parameters
    for name, value in list(given.arguments.items())[skipped:]:
        if (check := checks.get(name)) is None or value is parameters[name].default:
            continue
        many, entries = parameters[name].kind, given.arguments
        if many is inspect.Parameter.VAR_POSITIONAL:
            entries[name] = tuple(check_entry(name, check, entry, sizes) for entry in value)
        elif many is inspect.Parameter.VAR_KEYWORD:
            pairs = value.items()
            entries[name] = {key: check_entry(key, check, entry, sizes) for key, entry in pairs}
        else:
            entries[name] = check_entry(name, check, value, sizes)


checked(Unit)  # here, since checks are made of units
