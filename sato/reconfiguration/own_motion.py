"""Models and plants of the user's own: checked before anything is flown."""

from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

from dynamics.callbacks import CallbackError, guard_attributes, is_own
from dynamics.discretize import DiscreteModel
from dynamics.model import (
    MODEL_CALLBACKS,
    LinearizedModel,
    LinearModel,
    Model,
    NonlinearModel,
    SymbolicModel,
)
from dynamics.orbit import Orbit
from dynamics.plant import PLANT_CALLBACKS, LinearPlant, NonlinearPlant, Plant
from sato.scenario.errors import InputError, round_down

ROUNDING = 1e-9  # of entries of A, B and z that are fixed, in SI units
DIFFERENCE = 1e-5  # step of central differences, over the size of an entry or 1
OFF_START = 1.37e-3  # as DIFFERENCE, from the starts to where a Jacobian is tried
BETWEEN = np.sqrt([0.013, 0.047, 0.11, 0.19, 0.31, 0.43, 0.57, 0.71, 0.87])  # of a flight
MOST_INSTANTS = 200  # evenly spaced over a flight, at which matrices are compared
SAME_MOTION = 1e-6  # relative difference of accelerations, or their matrices
SAME = 1e-2  # relative difference of a block of the Jacobian that is no fault
MAX_TRIED = 8  # agents from whose states a Jacobian is tried
LEAST_REACH = 1e-9  # of the direction that controls move least, over that they move most


def is_own_model(model: Any) -> bool:
    """Tell whether equations of motion are the user's own."""
    if isinstance(model, LinearizedModel):
        return is_own_model(model.model)
    return isinstance(model, Model) and (is_own(type(model)) or isinstance(model, SymbolicModel))


def is_own_plant(plant: Any) -> bool:
    """Tell whether a plant, or the model that it flies, is the user's own."""
    return is_own(type(plant)) or is_own_model(getattr(plant, "model", None))


def check_axes(model: Any) -> None:
    """Refuse a model that is neither of the plane nor of space."""
    axes = getattr(model, "axes", None)
    if isinstance(model, Model) and not (isinstance(axes, int | np.integer) and axes in (2, 3)):
        raise InputError("", f"{type(model).__name__}.axes must be 2 or 3, got {axes!r}")


def check_own_motion(model: Any, plant: Any, step: float, steps: int) -> None:
    """Refuse equations of motion of the user's own that cannot be planned or flown.

    The error has the name of the method. The steps [s] are those of all legs, as far as known.
    """
    inner = plant.model if isinstance(plant, LinearPlant | NonlinearPlant) else None
    if isinstance(plant, Plant):
        guard_attributes(plant, PLANT_CALLBACKS)
    for key, part in (("model", model), ("plant", inner)):
        if is_own_model(part):
            try:
                instants = np.linspace(0.0, step * steps, min(2 * steps, MOST_INSTANTS) + 1)
                _check_model(part, step, np.unique([step, *instants, *(step * steps * BETWEEN)]))
            except InputError as error:
                raise error.inside(key) from error
    orbit = plant.chief_orbit if isinstance(plant, Plant) else None
    if orbit is not None and not isinstance(orbit, Orbit):
        name = f"{type(plant).__name__}.chief_orbit"
        raise InputError("plant", f"{name} must be a dynamics.Orbit, got {type(orbit).__name__}")


def _check_model(model: Any, step: float, times: Any) -> None:
    check_axes(model)
    guard_attributes(model.model if isinstance(model, LinearizedModel) else model, MODEL_CALLBACKS)
    linear = LinearizedModel(model) if isinstance(model, NonlinearModel) else model
    assert isinstance(linear, LinearModel)
    d, name = model.axes, type(model).__name__
    (A, B, z), here = linear.matrices(times), (linear.A(0.0), linear.B(0.0), linear.z(0.0))
    is_velocity = np.allclose(A[:, :d], np.eye(d, 2 * d, d), 0, ROUNDING)
    if not is_velocity or max(np.abs(B[:, :d]).max(), np.abs(z[:, :d]).max()) > ROUNDING:
        reason = "the rate of the position must be the velocity, without control; a model with"
        cure = "position alone is none; v̇ = (u − v)/τ, with τ of a step or more, would do"
        raise InputError("", f"{name}: {reason} {cure}")
    if not all(map(np.array_equal, (A, B, z), linear.matrices(times))):
        reason = "returns other matrices for the same times; a model without state and chance"
        raise CallbackError("", f"{name} {reason} would do")
    if isinstance(model, LinearModel) and (differing := _compare_motion(model, times, (A, B, z))):
        raise InputError("", f"{name}.{differing} is of another motion than its matrices")
    for part, first, all_ in zip("ABz", here, (A, B, z), strict=True):
        if linear.is_time_invariant and not np.allclose(all_, first, ROUNDING, ROUNDING):
            reason = f"{part} changes with time; is_time_invariant = False would do"
            raise InputError("", f"{name}.is_time_invariant is True, and {reason}")
    fastest, h = float(np.abs(np.linalg.eigvals(A)).max()), step / ceil(step)
    if fastest * h > 1:
        reason = f"changes at {fastest:.3g} 1/s, in a time of {1 / fastest:.3g} s, and a control"
        cure = f"plan.step_s = {round_down(1 / fastest)} would do"
        raise InputError("", f"{name} {reason} is held for {step:g} s; {cure}")


def _compare_motion(model: LinearModel, times: Any, stacks: Any) -> str:
    """Name a method of a linear model that is of another motion than its matrices; "" if none."""
    d, rng = model.axes, np.random.default_rng(0)
    x, u = rng.normal(size=2 * d), rng.normal(size=d)
    for time, A, B, z in zip(times, *stacks, strict=True):
        expected = {"A": A, "B": B, "z": z, "rate": A @ x + B @ u + z}
        given = {"A": model.A(time), "B": model.B(time), "z": model.z(time)}
        for name, value in (given | {"rate": model.rate(time, x, u)}).items():
            below = np.abs(value - expected[name])[d:]
            if below.max() > SAME_MOTION * max(np.abs(expected[name][d:]).max(), ROUNDING):
                return name
    return ""


def check_authority(name: str, model: DiscreteModel) -> None:
    """Refuse a model whose controls do not reach every state."""
    n = model.A.shape[-1]
    # Of a model that is unstable, the first of many steps hide what the last ones move.
    count = max(_count_reached(model[-steps:]) for steps in (len(model), n))
    if count < n:
        reason = f"controls move {count} of {n} directions of the state in {len(model)} steps"
        raise InputError("model", f"{name}.B: {reason}; a B that is an acceleration would do")


def _count_reached(model: DiscreteModel) -> int:
    """Count the directions of the state that the controls move in all steps."""
    time, n = len(model) * model.dt, model.A.shape[-1]
    with np.errstate(over="ignore", invalid="ignore"):
        moved = model.respond()[-1] * np.repeat([1.0, time], n // 2)[:, None]
    if not np.isfinite(moved).all():
        reason = "is so unstable that states grow beyond numbers in a leg"
        raise InputError("model", f"{reason}; fewer steps, or shorter ones, would do")
    sizes = np.linalg.svd(moved, compute_uv=False)
    return int((sizes > LEAST_REACH * sizes.max(initial=0.0)).sum())


def try_motion(model: Any, plant: Any, x: Any, step: float) -> None:
    """Refuse a wrong Jacobian, and a plant that does not repeat itself, of the user's own."""
    if isinstance(model, SymbolicModel):
        some = x[:MAX_TRIED], np.ones((len(x[:MAX_TRIED]), model.axes))
        once, other = (part.rate(step / 2, *some) for part in (model, replace(model)))
        if not np.array_equal(once, other):
            reason = "is another each time that it is called; an expression without chance would do"
            raise CallbackError("model", f"SymbolicModel.expression {reason}")
    elif isinstance(model, NonlinearModel) and is_own(type(model)):
        _check_jacobian(model, x[:MAX_TRIED], step)
    if not (isinstance(plant, Plant) and is_own(type(plant))):
        return
    u = np.zeros((len(x), x.shape[1] // 2))
    plant.propagate(x, u, 0.0, step, 2)
    # Pushes after zeros and after pushes show a memory, also where it begins anew at 0 s.
    pushes = u, u, *[u + 1e-3] * 4
    _, _, first, *again = [plant.propagate(x, push, step / 2, step / 2) for push in pushes]
    if not all(np.array_equal(first, states) for states in again):
        name = f"{type(plant).__name__}.propagate"
        reason = "returns other states for the same arguments; a plant without state and chance"
        raise CallbackError("", f"{name} {reason} would do")


def _check_jacobian(model: NonlinearModel, x: Any, step: float) -> None:
    """Compare a Jacobian with central differences, block by block of position and velocity."""
    count, d, name = len(x), model.axes, type(model).__name__
    # Not at rest, where friction, say, has no effect, nor on a kink, as a row of a table may be.
    points = np.hstack([x, np.zeros((count, d))])
    points[:, :d] += OFF_START * np.maximum(np.abs(x[:, :d]), 1.0)
    points[:, d:] += np.random.default_rng(0).normal(0, 0.1, 2 * d)
    times, sizes = step * np.arange(count), np.maximum(np.abs(points), 1.0)

    def differentiate(h: float) -> Any:
        moves = h * sizes[..., None] * np.eye(3 * d)
        ends = (points[:, None] + sign * moves for sign in (1, -1))
        stacks = [np.split(end.reshape(-1, 3 * d), [2 * d], axis=1) for end in ends]
        above, below = (model.rate(times.repeat(3 * d), *stack) for stack in stacks)
        change = (above - below).reshape(count, 3 * d, 2 * d).swapaxes(1, 2)
        return change / (2 * h * sizes[:, None])

    def largest(entries: Any) -> Any:
        blocks = np.abs(entries).reshape(count, 2, d, 3, d).max(axis=(0, 2, 4))
        return blocks.repeat(d, axis=0).repeat(d, axis=1)

    parts = model.jacobian(times, *np.split(points, [2 * d], axis=1))
    given, expected = np.concatenate(parts, axis=2), differentiate(DIFFERENCE)
    rounding = largest(differentiate(2 * DIFFERENCE) - expected)
    tolerance = SAME * np.maximum(largest(given), largest(expected)) + 4 * rounding
    excess = np.abs(given - expected) - tolerance
    k, i, j = np.unravel_index(excess.argmax(), excess.shape)
    if excess[k, i, j] > 0:
        entry = f"∂f/∂x[{i}, {j}]" if j < 2 * d else f"∂f/∂u[{i}, {j - 2 * d}]"
        reason = f"{entry} must be {expected[k, i, j]:.6g}, by differences of {name}.rate"
        cure = "a SymbolicModel, which is differentiated automatically, would do"
        got = f"got {given[k, i, j]:.6g} (t={times[k]:.6g})"
        raise InputError("model", f"{name}.jacobian: {reason}, {got}; {cure}")
