"""Models: equations of motion that planning and plants share."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial, wraps
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.callbacks import Callback, CallbackError, as_kind, as_shape, call, guard
from dynamics.doors import MAY_BE_NAN, check_methods, checked
from dynamics.inputs import InputError
from dynamics.symbols import Number, Numbers, is_symbolic, make_function, to_array, to_casadi, trace

# One instant, or many: the leading axes of times, states and controls broadcast.
Times = Number | Numbers[Array, "*#k"]
States = Annotated[Numbers[Array, "*#k n"], MAY_BE_NAN]  # of absent agents
Controls = Annotated[Numbers[Array, "*#k m"], MAY_BE_NAN]
Rates = Numbers[Array, "... n"]
Jacobian = tuple[Numbers[Array, "... n n"], Numbers[Array, "... n m"]]
# Samples of a trajectory of one agent or of many.
StateSamples = Float[Array, "*agents instants n"]
ControlSamples = Float[Array, "*agents T m"]
# The same, with rows of NaN for absent agents.
FlownStates = Annotated[StateSamples, MAY_BE_NAN]
FlownControls = Annotated[ControlSamples, MAY_BE_NAN]
Matrices = tuple[Numbers[Array, "k n n"], Numbers[Array, "k n m"], Numbers[Array, "k n"]]


class Model(ABC):
    """Equations of motion ẋ = f(t, x, u) with the state x = (position, velocity)."""

    axes: int  # dimension d of space: the state has 2d entries, the control d

    @property
    def array_sizes(self) -> dict[str, int]:
        """Sizes of the axes of states and controls."""
        return {"n": 2 * self.axes, "m": self.axes}

    def __init_subclass__(cls) -> None:
        """Let the rate of every model take CasADi symbols, and check methods of the user's own."""
        if "rate" in cls.__dict__:
            # A decorator for all subclasses, which none can forget.
            cls.rate = _take_symbols(cls.rate)  # type: ignore[method-assign]
        guard(cls, MODEL_CALLBACKS)

    @abstractmethod
    def rate(self, t: Times, x: States, u: Controls) -> Rates:
        """Return the rate of change of one state or of many, in SI units.

        Where t, x or u is an expression of CasADi (SX or MX; x and u columns), the rate is one.

        Args:
            t: Time [s].
            x: Position [m] and velocity [m/s].
            u: Acceleration [m/s²].

        Raises:
            TypeError: The rate of a model of the user's own takes no symbols.
        """

    def casadi(self) -> Any:
        """Return the rate as a `casadi.Function` of t, x and u, with the output rate.

        About a chief under J2, or on an ellipse, the function integrates the orbit in Python. With
        a number for t, `rate(t, x, u)` has the orbit as constants, and is faster.

        Raises:
            TypeError: The rate of a model of the user's own takes no symbols.
        """
        return make_function(self.rate, self.axes)


def _take_symbols(rate: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(rate)
    def take(self: Model, t: Any, x: Any, u: Any) -> Any:
        return trace(rate, self, t, x, u) if is_symbolic(t, x, u) else rate(self, t, x, u)

    return take


def _as_stacks(axes: tuple[str, ...], model: Model, given: dict[str, Any], values: Any) -> Any:
    """Convert results at all times, states and controls; several of them may lack these axes."""
    times: Any = given.get("times", given.get("t"))
    lead, count, sizes = np.shape(times), len(axes), model.array_sizes
    if "x" in given:
        lead = np.broadcast_shapes(lead, given["x"].shape[:-1], given["u"].shape[:-1])
    if len(as_kind(values, tuple | list, f"{count} arrays")) != count:
        raise InputError("", f"must be {count} arrays, got {len(values)}")
    shapes = [(*lead, *[sizes[name] for name in names]) for names in axes]
    try:
        pairs = zip(values, shapes, strict=True)
        return tuple(as_shape(value, shape, count > 1) for value, shape in pairs)
    except InputError as error:
        if "x" not in given or np.any(given["x"]) or np.any(given["u"]):
            raise
        why = "here at rest, x = 0 and u = 0, about which models are linearized"
        raise InputError("", f"{error}; {why}") from error


def _as_stack(axes: str, model: Model, given: dict[str, Any], value: Any) -> Any:
    return _as_stacks((axes,), model, given, [value])[0]


MODEL_CALLBACKS = {
    "A": Callback("t", partial(_as_stack, "nn")),
    "B": Callback("t", partial(_as_stack, "nm")),
    "z": Callback("t", partial(_as_stack, "n")),
    "rate": Callback("t x u", partial(_as_stack, "n")),
    "matrices": Callback("times", partial(_as_stacks, ("nn", "nm", "n"))),
    "jacobian": Callback("t x u", partial(_as_stacks, ("nn", "nm"))),
}


class NonlinearModel(Model):
    """A model that can be linearized about any of its states.

    To add a nonlinear model, write `axes`, `rate` and `jacobian`, or let `SymbolicModel`
    differentiate an expression. Times, states and controls may be stacked.
    """

    @abstractmethod
    def jacobian(self, t: Times, x: States, u: Controls) -> Jacobian:
        """Return ∂f/∂x and ∂f/∂u, in SI units.

        Args:
            t: Time [s].
            x: Position [m] and velocity [m/s].
            u: Acceleration [m/s²].
        """


@check_methods
class LinearModel(Model):
    """ẋ = A(t) x + B u + z(t), where by default the control u is an acceleration.

    To add a linear model, write `axes` and `A`, and `z` where the model is affine.
    Discretization, problems and plants then accept it as it is.
    """

    is_time_invariant: ClassVar[bool] = False  # True where A, B and z are the same at all times

    @abstractmethod
    def A(self, t: Number) -> Numbers[Array, "n n"]:
        """State matrix, in SI units.

        Args:
            t: Time [s].
        """

    def B(self, t: Number) -> Numbers[Array, "n m"]:
        """Control matrix, in SI units: an acceleration changes the velocity.

        Args:
            t: Time [s].
        """
        d = self.axes
        return np.vstack([np.zeros((d, d)), np.eye(d)])

    def z(self, t: Number) -> Numbers[Array, " n"]:
        """Affine term, in SI units.

        Args:
            t: Time [s].
        """
        return np.zeros(2 * self.axes)

    def matrices(self, times: Numbers[Array, " k"]) -> Matrices:
        """Stack A, B and z at many times; override it where this can be done faster.

        Args:
            times: Times [s].
        """
        if not len(times):
            n, d = 2 * self.axes, self.axes
            return np.zeros((0, n, n)), np.zeros((0, n, d)), np.zeros((0, n))
        each = [(self.A(t), self.B(t), self.z(t)) for t in times.tolist()]
        A, B, z = (np.array(part) for part in zip(*each, strict=True))
        return A, B, z

    def rate(self, t: Times, x: States, u: Controls) -> Rates:
        """Return the rate of change of one state or of many."""
        stacked = self.matrices(np.ravel(t))
        A, B, z = (part.reshape(*np.shape(t), *part.shape[1:]) for part in stacked)
        change = np.einsum("...ab,...b->...a", A, x) + np.einsum("...ab,...b->...a", B, u)
        return np.asarray(change + z)


@checked
@dataclass(frozen=True, eq=False)
class SymbolicModel(NonlinearModel):
    """A model written in CasADi symbols and differentiated automatically.

    `casadi()` is the expression as a function, which `rate` evaluates too. The expression is asked
    for once: with other numbers, make another model.

    Args:
        axes: Dimension of space.
        expression: (t, x, u) ↦ ẋ, written with operations that CasADi overloads.
    """

    axes: int
    expression: Callable[[Any, Any, Any], Any]

    def rate(self, t: Times, x: States, u: Controls) -> Rates:
        """Return the rate of change of one state or of many."""
        (change,) = self._map_batch(self.casadi(), ("n",), t, x, u)
        return change

    def jacobian(self, t: Times, x: States, u: Controls) -> Jacobian:
        """Return ∂f/∂x and ∂f/∂u by automatic differentiation."""
        A, B = self._map_batch(self._functions[1], ("nn", "nm"), t, x, u)
        return A, B

    def casadi(self) -> Any:
        """Return the expression as a `casadi.Function` of t, x and u, with the output rate."""
        return self._functions[0]

    @property
    def _name(self) -> str:
        name = getattr(self.expression, "__name__", type(self.expression).__name__)
        return f"SymbolicModel.expression {name}"

    def _trace(self, t: Any, x: Any, u: Any) -> Any:
        """Return the expression as a column of CasADi; an acceleration alone is none."""
        import casadi

        change, n = call(self._name, self.expression, t, x, u), 2 * self.axes
        if isinstance(change, list | tuple | Array):
            change = call(self._name, casadi.vertcat, *change)
        shape = getattr(change, "shape", None)
        if not is_symbolic(change) or shape != (n, 1):
            got = f"{type(change).__name__}" + (f" of shape {shape}" if shape else "")
            cure = "velocity, then acceleration: casadi.vertcat(x[d:], …), with d axes, would do"
            reason = f"the result must be a column of {n} entries, got {got}; {cure}"
            raise CallbackError("", f"{self._name}: {reason}")
        return change

    def _map_batch(
        self, function: Any, axes: tuple[str, ...], t: Times, x: Array, u: Array
    ) -> list[Array]:
        # CasADi maps a function over the columns of its arguments, and stacks results sidewise.
        lead = np.broadcast_shapes(np.shape(t), x.shape[:-1], u.shape[:-1])
        count, columns, results = int(np.prod(lead)), [], []
        for values in (np.asarray(t)[..., None], x, u):
            n = values.shape[-1]
            columns.append(np.broadcast_to(values, (*lead, n)).reshape(count, n).T)
        outputs = function.map(count).call(list(map(to_casadi, columns)))
        for names, matrix in zip(axes, map(to_array, outputs), strict=True):
            stacked = matrix.reshape(len(matrix), count, -1).swapaxes(0, 1)
            results.append(stacked.reshape(*lead, *stacked.shape[1 : 1 + len(names)]))
        if not all(np.isfinite(part).all() for part in results if part.dtype != object):
            check = partial(_as_stacks, axes, self, {"t": t, "x": x, "u": u})
            call(self._name, lambda: results, check=check)
        return results

    @cached_property
    def _functions(self) -> tuple[Any, Any]:
        import casadi

        try:
            rate = make_function(self._trace, self.axes)
        except RuntimeError as error:  # of CasADi
            what = "takes symbols that are none of t, x and u, or are not SX as these are"
            raise CallbackError("", f"{self._name} {what}") from error
        t, x, u = rate.sx_in()
        f = rate(t, x, u)
        derivatives = [casadi.jacobian(f, x), casadi.jacobian(f, u)]
        return rate, casadi.Function("jacobian", [t, x, u], derivatives)


@checked
@dataclass(frozen=True)
class LinearizedModel(LinearModel):
    """A nonlinear model linearized about rest at the origin, which in orbit is the chief.

        A(t) = ∂f/∂x,  B(t) = ∂f/∂u,  z(t) = f    at x = 0 and u = 0

    The error is of second order in the distance from the origin [Morgan2016, eqs. 7 and 8].
    """

    model: NonlinearModel

    def __post_init__(self) -> None:
        """Take the dimension of space from the nonlinear model."""
        object.__setattr__(self, "axes", self.model.axes)

    def A(self, t: float) -> Float[Array, "n n"]:
        """State matrix at the origin."""
        return np.asarray(self.matrices(np.array([t]))[0][0])

    def B(self, t: float) -> Float[Array, "n m"]:
        """Control matrix at the origin."""
        return np.asarray(self.matrices(np.array([t]))[1][0])

    def z(self, t: float) -> Float[Array, " n"]:
        """Rate of change at the origin."""
        return np.asarray(self.matrices(np.array([t]))[2][0])

    def matrices(self, times: Numbers[Array, " k"]) -> Matrices:
        """Stack A, B and z at many times."""
        x, u = np.zeros((len(times), 2 * self.axes)), np.zeros((len(times), self.axes))
        A, B = self.model.jacobian(times, x, u)
        return A, B, self.model.rate(times, x, u)
