"""Models in CasADi: rates as functions and as expressions, and what takes no symbols."""

import math
import subprocess
import sys
from dataclasses import replace

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import (
    J2,
    ClohessyWiltshire,
    DoubleIntegrator,
    LinearizedModel,
    LinearModel,
    NonlinearModel,
    Orbit,
    SchweighartSedwick,
    SymbolicModel,
    TschaunerHempel,
)
from dynamics.symbols import Symbol

ORBIT = Orbit.from_elements(7500e3, 0.1, 0.8, 0.3, 0.2, 0.1)


class Wind(LinearModel):
    """Matrices that all depend on time."""

    axes = 2

    def A(self, t):
        zero, one = np.zeros((2, 2)), np.eye(2)
        return np.block([[zero, one], [-np.cos(t) * one, np.array([[0, t], [-t, 0]])]])

    def B(self, t):
        return np.vstack([np.zeros((2, 2)), np.sqrt(1 + t) * np.eye(2)])

    def z(self, t):
        return np.array([0.0, 0.0, np.exp(-t), t**2])


class Drag(NonlinearModel):
    """Quadratic drag in a rotating wind, and a soft attraction, in NumPy."""

    axes = 2

    def rate(self, t, x, u):
        p, v = x[..., :2], x[..., 2:] - np.stack([np.cos(t), np.sin(t)], axis=-1)
        distance = np.linalg.norm(p, axis=-1, keepdims=True)
        a = u - 0.1 * np.linalg.norm(v, axis=-1)[..., None] * v - p / (1 + distance**3)
        return np.concatenate([np.broadcast_to(x[..., 2:], a.shape), a], axis=-1)

    def jacobian(self, t, x, u):
        raise NotImplementedError


class Own(NonlinearModel):
    """Rate of a user's."""

    axes = 2

    def __init__(self, compute):
        self.compute = compute

    def rate(self, t, x, u):
        return self.compute(t, x, u)

    def jacobian(self, t, x, u):
        raise NotImplementedError


def pendulum(t, x, u):
    return casadi.vertcat(x[1], -9.81 * casadi.sin(x[0]) + u * casadi.cos(x[0]) + 0.3 * t**2)


ORBITAL = (5000.0, 1000.0, 1.0, 1e-3)  # scales of times, positions, velocities and controls
PLAIN = (2.0, 1.0, 1.0, 1.0)
MODELS = {
    "double integrator": (DoubleIntegrator(2), PLAIN),
    "Clohessy-Wiltshire": (ClohessyWiltshire(1.1e-3), ORBITAL),
    "Schweighart-Sedwick": (SchweighartSedwick.from_orbit(ORBIT), ORBITAL),
    "Tschauner-Hempel": (TschaunerHempel(ORBIT), ORBITAL),
    "J2": (J2(ORBIT), ORBITAL),
    "linearized J2": (LinearizedModel(J2(ORBIT)), ORBITAL),
    "symbolic": (SymbolicModel(1, pendulum), PLAIN),
    "linearized symbolic": (LinearizedModel(SymbolicModel(1, pendulum)), PLAIN),
    "own linear": (Wind(), PLAIN),
    "own nonlinear": (Drag(), PLAIN),
}
every_model = pytest.mark.parametrize("name", MODELS)


def draw(name, rng, count):
    """Draw times, states and controls, as rows of (t, x, u); return their scales too."""
    model, (time, *others) = MODELS[name]
    scales = np.array([time, *np.repeat(others, model.axes)])
    points = scales * rng.normal(size=(count, len(scales)))
    points[:, 0] = time * rng.uniform(0.1, 1.0, count)
    return model, points, scales


def split(points, axes):
    return points[..., 0], points[..., 1 : 1 + 2 * axes], points[..., 1 + 2 * axes :]


@every_model
def test_functions_give_the_rates_of_models(name, rng):
    model, points, _ = draw(name, rng, 1000)
    t, x, u = split(points, model.axes)
    function = model.casadi()
    assert function.name_in() == ["t", "x", "u"] and function.name_out() == ["rate"]
    found = np.array(function.map(len(t))(t=t[None], x=x.T, u=u.T)["rate"]).T
    expected = model.rate(t, x, u).reshape(-1, 2, model.axes)
    error = np.abs(found.reshape(expected.shape) - expected).max(axis=-1)
    assert (error <= 1e-12 * np.linalg.norm(expected, axis=-1)).all()


@every_model
def test_derivatives_of_functions_agree_with_differences(name, rng):
    model, points, scales = draw(name, rng, 50)
    z = casadi.MX.sym("z", len(scales))
    rate = model.casadi()(z[0], z[1 : 1 + 2 * model.axes], z[1 + 2 * model.axes :])
    jacobian = casadi.Function("jacobian", [z], [casadi.densify(casadi.jacobian(rate, z))])
    found = np.array([jacobian(point) for point in points]) * scales
    h = 1e-3
    moved = [points[:, None] + k * h * np.diag(scales) for k in (1, -1, 2, -2)]
    plus, minus, plus2, minus2 = (model.rate(*split(m, model.axes)) for m in moved)
    differences = (8 * (plus - minus) - (plus2 - minus2)).swapaxes(1, 2) / (12 * h)
    size = np.abs(found).max(axis=-1, keepdims=True)
    assert_allclose((found - differences) / size, 0, atol=1e-6)


@every_model
@pytest.mark.parametrize("kind", [casadi.SX, casadi.MX])
def test_rates_of_symbols_are_expressions(name, kind, rng):
    model, points, _ = draw(name, rng, 1)
    values = split(points[0], model.axes)
    symbols = [kind.sym(name, np.size(value)) for name, value in zip("txu", values, strict=True)]
    expected = model.rate(*values)
    for chosen in ([0, 1, 2], [1, 2], [2], [0]):  # the others are numbers
        mixed = [symbols[i] if i in chosen else value for i, value in enumerate(values)]
        rate = model.rate(*mixed)
        assert isinstance(rate, kind) and rate.shape == (2 * model.axes, 1)
        function = casadi.Function("rate", [symbols[i] for i in chosen], [rate])
        found = np.array(function(*(values[i] for i in chosen)))[:, 0]
        assert_allclose(found, expected, rtol=1e-12, atol=1e-15 * np.abs(expected).max())


def test_functions_outlive_their_models():
    rate = J2(replace(ORBIT, raan=0.123)).casadi()  # an orbit of its own
    expected = J2(replace(ORBIT, raan=0.123)).rate(10.0, np.ones(6), np.zeros(3))
    assert_allclose(np.array(rate(10.0, np.ones(6), np.zeros(3)))[:, 0], expected, rtol=1e-12)


def fill(t, x, u):
    rate = np.zeros(x.shape)
    rate[..., 0] = x[..., 1]
    return rate


@pytest.mark.parametrize(
    "rate",
    [
        lambda t, x, u: np.where(x > 0, x, -x),
        lambda t, x, u: x if t > 0 else -x,
        lambda t, x, u: x * (x != 0),
        lambda t, x, u: np.maximum(x, 0),
        lambda t, x, u: x * math.sin(t),
        lambda t, x, u: x * np.interp(t, [0, 1], [1, 2]),
        fill,
    ],
)
def test_rates_without_symbols_are_refused_with_a_cure(rate):
    with pytest.raises(TypeError, match=r"Own takes no CasADi symbols: .*SymbolicModel"):
        Own(rate).casadi()


def test_symbols_and_rates_of_the_wrong_size_are_refused():
    x, u = casadi.SX.sym("x", 4), casadi.SX.sym("u", 2)
    with pytest.raises(ValueError, match="x: 6 entries are needed, got 4"):
        ClohessyWiltshire(1e-3).rate(0.0, x, u)
    with pytest.raises(ValueError, match=r"Own: states of shape \(1, 4\).* got \(4,\)"):
        Own(lambda t, x, u: x.sum(axis=0)).rate(0.0, x, u)


def test_symbols_compute_as_casadi_does():
    a, b = casadi.SX.sym("a"), casadi.SX.sym("b")
    x, y = Symbol(a), np.array([Symbol(b)], dtype=object)
    found = (2 - x) ** 2 / np.hypot(x, y) + 2**x - np.arctan2(-y, 3) * abs(1 / x) - np.float64(1)
    value = casadi.Function("value", [a, b], [found[0].expression])(0.7, -1.2)
    expected = 1.3**2 / math.hypot(0.7, 1.2) + 2**0.7 - math.atan2(1.2, 3) / 0.7 - 1
    assert float(value) == pytest.approx(expected, rel=1e-14)


def test_models_do_not_load_casadi_before_it_is_needed():
    code = "import sys, dynamics; print(dynamics.J2, 'casadi' in sys.modules)"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.endswith("J2'> False\n")


def test_mixed_symbols_are_refused_and_numbers_of_casadi_are_taken(rng):
    model, x, u = J2(ORBIT), 1e3 * rng.normal(size=6), rng.normal(size=3)
    with pytest.raises(ValueError, match="all SX or all MX, got float, SX, MX"):
        model.rate(0.0, casadi.SX.sym("x", 6), casadi.MX.sym("u", 3))
    found = model.rate(0.0, casadi.DM(x), casadi.DM(u))
    assert_allclose(found.full().ravel(), model.rate(0.0, x, u), rtol=1e-12)
