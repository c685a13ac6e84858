"""CasADi symbols in NumPy code: one definition of a rate gives values and expressions.

NumPy computes with an array of objects by the operations of these objects, so that code for
arrays of floats builds expressions from an array of `Symbol`s. CasADi is imported when needed.
"""
# mypy: implicit-reexport

import operator
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy import ndarray as Array

FUNCTIONS = (
    "sin cos tan arcsin arccos arctan arctan2 sinh cosh tanh arcsinh arccosh arctanh exp expm1 "
    "log log1p log10 sqrt hypot fabs"
)


def _lift(compute: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function of expressions one of symbols and numbers."""

    def apply(*operands: Any) -> Any:
        if any(isinstance(operand, Array) for operand in operands):
            return NotImplemented  # NumPy computes entry by entry
        return Symbol(compute(*map(_expression, operands)))

    return apply


def _reflect(compute: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    return _lift(lambda right, left: compute(left, right))


def _casadi_function(name: str) -> Callable[..., Any]:
    def compute(*expressions: Any) -> Any:
        import casadi

        return getattr(casadi, name)(*expressions)

    return compute


def _refuse(*values: object) -> NoReturn:
    raise TypeError("a CasADi symbol has no value yet, so that nothing can depend on it")


class Symbol:
    """Scalar CasADi expression, as an entry of an array of NumPy.

    It has the methods that NumPy calls for an entry, such as `sin` (`FUNCTIONS`).
    """

    __slots__ = ("expression",)

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    def conjugate(self) -> "Symbol":
        """Return the symbol itself, for it is real."""
        return self

    __neg__, __abs__ = _lift(operator.neg), _lift(operator.abs)
    __add__, __radd__ = _lift(operator.add), _reflect(operator.add)
    __sub__, __rsub__ = _lift(operator.sub), _reflect(operator.sub)
    __mul__, __rmul__ = _lift(operator.mul), _reflect(operator.mul)
    __truediv__, __rtruediv__ = _lift(operator.truediv), _reflect(operator.truediv)
    __pow__, __rpow__ = _lift(operator.pow), _reflect(operator.pow)
    __bool__ = __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = _refuse
    __hash__ = object.__hash__


for _name in FUNCTIONS.split():
    setattr(Symbol, _name, _lift(_casadi_function(_name)))


if TYPE_CHECKING:  # for type checkers, symbols are floats
    from typing import Annotated as Numbers

    Number = float
else:
    from jaxtyping import AbstractDtype

    Number = float | Symbol

    class Numbers(AbstractDtype):
        """Shape of an array of floats or of symbols."""

        dtypes = ("float32", "float64", "object_")


def _expression(value: Any) -> Any:
    return value.expression if isinstance(value, Symbol) else float(value)


def is_symbolic(*values: object) -> bool:
    """Return True where a value is of CasADi: SX, MX, or numbers as DM."""
    casadi = sys.modules.get("casadi")
    kinds = () if casadi is None else (casadi.SX, casadi.MX, casadi.DM)
    return any(isinstance(v, kinds) for v in values)


def has_symbols(value: object) -> bool:
    """Return True for a symbol, an expression of CasADi, and an array with one of them."""
    if isinstance(value, Array) and value.dtype == object:
        return any(map(has_symbols, value.ravel().tolist()))
    return isinstance(value, Symbol) or is_symbolic(value)


def to_array(matrix: Any) -> Array:
    """Return a matrix of CasADi as an array of floats, or of symbols if it is an expression."""
    import casadi

    if not isinstance(matrix, casadi.SX):
        return np.asarray(matrix, dtype=float)
    entries = [Symbol(entry) for entry in casadi.vertsplit(casadi.vec(casadi.densify(matrix)))]
    return np.array(entries, dtype=object).reshape(matrix.shape, order="F")


def to_casadi(values: Array) -> Any:
    """Return an array of symbols as a matrix of CasADi, and other arrays as they are."""
    import casadi

    if values.dtype != object:
        return values
    rows = values.reshape(len(values), -1).tolist()
    return casadi.vertcat(*(casadi.horzcat(*map(_expression, row)) for row in rows))


def make_function(rate: Callable[[Any, Any, Any], Any], axes: int) -> Any:
    """Return a rate that takes symbols as a `casadi.Function` of t, x and u."""
    import casadi

    names = ["t", "x", "u"]
    symbols = list(map(casadi.SX.sym, names, (1, 2 * axes, axes)))
    return casadi.Function("rate", symbols, [rate(*symbols)], names, ["rate"])


def trace(rate: Callable[..., Any], model: Any, *values: Any) -> Any:
    """Return the rate of a model, which is written for arrays, as an expression of CasADi.

    Args:
        rate: (model, t, x, u) ↦ ẋ.
        model: Object with the attribute `axes`.
        values: t, x and u, at least one of them an expression.

    Raises:
        ValueError: The size of t, x or u is wrong, or SX and MX are mixed.
        TypeError: The rate uses what symbols do not have.
    """
    import casadi

    kinds = [type(v).__name__ for v in values]
    if {"SX", "MX"} <= set(kinds):
        raise ValueError(f"t, x and u must be all SX or all MX, got {', '.join(kinds)}")
    arrays, symbols, expressions = [], [], []
    for name, value, size in zip("txu", values, (1, 2 * model.axes, model.axes), strict=True):
        if is_symbolic(value):
            symbols.append(casadi.SX.sym(name, *value.shape))
            expressions.append(value)
            value = symbols[-1]
        entries = to_array(value).reshape(-1)
        if entries.size != size:
            raise ValueError(f"{name}: {size} entries are needed, got {entries.size}")
        arrays.append(entries if name == "t" else entries[None])  # one instant, stacked
    try:
        found = rate(model, *arrays)
    except Exception as error:  # whatever NumPy or the user's model raises for symbols
        if isinstance(error, ValueError):
            raise
        raise TypeError(
            f"{type(model).__name__} takes no CasADi symbols: {error}. NumPy's operations on "
            "stacks of states take them (x[..., 0], np.sin, @, np.stack); comparisons, functions "
            "of math, and entries written into arrays of floats do not (np.zeros(x.shape, x.dtype) "
            "takes them). A SymbolicModel, written with casadi.if_else, would do too"
        ) from error
    if np.shape(found) != (shape := arrays[1].shape):
        reason = f"states of shape {shape} have rates of the same shape, got {np.shape(found)}"
        raise ValueError(f"{type(model).__name__}: {reason}")
    return casadi.Function("rate", symbols, [to_casadi(found[0])])(*expressions)
