"""Functions of the user's, by the names by which worker processes import them."""

import re
import sys
from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any

from sato.scenario.errors import InputError

OURS = "dynamics", "problems", "sato"
FUNCTION = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")  # "module:function"


def add_modules(folder: str) -> None:
    """Let functions be imported from a folder."""
    if folder and folder not in sys.path:
        sys.path.insert(0, folder)


def find_function(name: str) -> Callable[..., Any]:
    """Import "module:function"; an `InputError` refuses what is not there."""
    if (top := re.split("[.:]", name)[0]) in OURS:
        reason = f"{top} is a package of this library; another name of the file would do"
        raise InputError("", f'"{name}": {reason}')
    try:
        found: Callable[..., Any] = resolve_name(name)
    except Exception as error:  # whatever a module of the user's raises
        reason = f"{error}; the module must be beside the campaign's file, or installed"
        raise InputError("", f'"{name}" cannot be imported: {reason}') from error
    if not callable(found):
        raise InputError("", f'"{name}" is no function')
    return found


def name_of_function(function: object) -> str:
    """Return "module:function", by which a worker imports it; refuse what it could not import."""
    module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", "")
    is_typed_in = module == "__main__" and not hasattr(sys.modules["__main__"], "__file__")
    known = None if is_typed_in else sys.modules.get(str(module))
    if not callable(function) or getattr(known, name, None) is not function:
        reason = 'must be "module:function", or a function at the top of a module or a script'
        raise InputError("", f"{reason}, which workers can import, got {function!r}")
    return f"{module}:{name}"
