"""Motion of vehicles between recorded instants, for the judge: written apart from the library.

Double integrators are the equations of Clohessy and Wiltshire with a rate of 0,

    ẍ = 3n²x + 2nẏ + u_x,    ÿ = −2nẋ + u_y,    z̈ = −n²z + u_z,

and both are propagated by matrix exponentials. About a chief, two-body gravity and J2 [Xu2008]

    l̈ = −2 ω × l̇ − ω̇ × l − ω × (ω × l) + g(R) − g(r x̂) + u,    R = r x̂ + l,

are integrated together with the chief's osculating orbit (r, v_x, h, node, inclination, latitude),
from all recorded instants at once.
"""

from math import ceil
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy import ndarray as Array
from scipy.integrate import solve_ivp
from scipy.linalg import expm

ANGLE = 0.005  # of the orbit between two samples [rad]: cubics through them err by 1e-7 m
TOLERANCE = 1e-12  # of the integration, relative and absolute


class Motion(NamedTuple):
    """Equations of motion of a run."""

    step: float  # [s]
    rate: float  # of the orbit, 0 of double integrators [rad/s]
    chief: Array | None = None  # osculating orbit at each instant
    gravity: tuple[float, float] = (0.0, 0.0)  # μ and 3/2 J₂ μ R²

    @classmethod
    def from_dataset(cls, data: xr.Dataset, scenario: dict[str, Any]) -> "Motion":
        """Read which motion was flown.

        Raises:
            ValueError: It is none of these.
        """
        step, model = scenario["plan"]["step_s"], scenario["model"]
        plant = scenario.get("plant", {})
        if model["kind"] == "double_integrator":
            return cls(step, 0.0)
        if plant.get("drag"):
            raise ValueError("drag is not judged")
        if "chief" not in data:
            return cls(step, model["mean_motion_rad_s"])
        chief, mu, k = data["chief"].values, data.attrs["mu_m3_s2"], data.attrs["k_j2_m5_s2"]
        r, speed, h = chief[0, :3]
        if plant.get("kind") != "model":
            return cls(step, h / r**2, chief, (mu, k))
        if model["kind"] != "clohessy_wiltshire":
            raise ValueError(f"motion by the model {model['kind']} is not judged")
        axis = 1 / (2 / r - (speed**2 + (h / r) ** 2) / mu)
        return cls(step, (mu / axis**3) ** 0.5)

    def sample(self, state: Array, applied: Array, first: int = 0) -> Array:
        """Propagate each recorded state over its step.

        Args:
            state: Steps, vehicles, 6.
            applied: Accelerations that are held: steps, vehicles, 3.
            first: Number of the first step.

        Returns:
            States at equal times from the beginning of each step to its end: steps, samples,
            vehicles, 6.
        """
        times = np.linspace(0.0, self.step, 1 + max(1, ceil(self.rate * self.step / ANGLE)))
        if self.chief is not None:
            return self._integrate(state, applied, times, first)[0]
        free = transition_matrices(self.rate, times)
        held = np.stack([expm(_held(self.rate) * t)[:6, 6:] for t in times])
        moved = np.einsum("sab,kvb->ksva", free, state)
        return moved + np.einsum("sab,kvb->ksva", held, applied)

    def drift(self, state: Array, times: Array, first: int = 0) -> Array:
        """Return free motion from recorded states at some times: steps, times, vehicles, 6.

        Args:
            state: Steps, vehicles, 6.
            times: After each instant, from 0 on [s].
            first: Number of the first step.
        """
        if self.chief is not None:
            return self._integrate(state, np.zeros_like(state[..., :3]), times, first)[0]
        return np.einsum("sab,kvb->ksva", transition_matrices(self.rate, times), state)

    def chief_error(self) -> float:
        """Return the largest error of the chief's recorded orbit from instant to instant [m]."""
        if self.chief is None:
            return 0.0
        count = len(self.chief) - 1
        none, times = np.zeros((count, 0, 6)), np.array([0.0, self.step])
        after = self._integrate(none, none[..., :3], times, 0)[1]
        error = after - self.chief[1:]
        r = self.chief[:1, 0]
        turned = np.abs((error[:, 3:] + np.pi) % (2 * np.pi) - np.pi).max(axis=1, initial=0.0)
        return float(np.maximum(np.abs(error[:, 0]), r * turned).max(initial=0.0))

    def _integrate(
        self, state: Array, applied: Array, times: Array, first: int
    ) -> tuple[Array, Array]:
        assert self.chief is not None
        steps, vehicles = state.shape[:2]
        begin = np.concatenate([self.chief[first : first + steps, None], state], axis=1)

        def rates(_: float, y: Array) -> Array:
            now = y.reshape(begin.shape)
            return np.concatenate(
                [
                    orbit_rates(now[:, 0], *self.gravity)[:, None],
                    relative_rates(now[:, 0], now[:, 1:], applied, *self.gravity),
                ],
                axis=1,
            ).ravel()

        span, options = (0.0, float(times[-1])), {"rtol": TOLERANCE, "atol": TOLERANCE}
        found = solve_ivp(rates, span, begin.ravel(), "DOP853", t_eval=times, **options)
        if not found.success:
            raise ValueError(f"motion cannot be integrated: {found.message}")
        flown = found.y.T.reshape(len(times), steps, 1 + vehicles, 6).swapaxes(0, 1)
        return flown[:, :, 1:], flown[:, -1, 0]


def transition_matrices(rate: float, times: Array) -> Array:
    """Return the transition matrices of free motion over each of some times, (times, 6, 6)."""
    return expm(_held(rate)[:6, :6] * np.asarray(times)[:, None, None])


def orbit_rates(orbit: Array, mu: float, k: float) -> Array:
    """Return the rate of change of osculating orbits, a row each."""
    r, speed, h, _, i, u = orbit.T
    oblate = k / r**4
    return np.column_stack(
        [
            speed,
            -mu / r**2 + h**2 / r**3 - oblate * (1 - 3 * (np.sin(i) * np.sin(u)) ** 2),
            -k / r**3 * np.sin(i) ** 2 * np.sin(2 * u),
            -2 * k * np.cos(i) * np.sin(u) ** 2 / (h * r**3),
            -k * np.sin(2 * i) * np.sin(2 * u) / (2 * h * r**3),
            h / r**2 + 2 * k * np.cos(i) ** 2 * np.sin(u) ** 2 / (h * r**3),
        ]
    )


def relative_rates(orbit: Array, state: Array, applied: Array, mu: float, k: float) -> Array:
    """Return the rate of change of states relative to chiefs: chiefs, vehicles, 6."""
    r, h, i, u = orbit[:, 0], orbit[:, 2], orbit[:, 4], orbit[:, 5]
    r_, _, h_, _, i_, u_ = orbit_rates(orbit, mu, k).T
    none, tilt = np.zeros_like(r), -k * np.sin(2 * i) * np.sin(u) / (h * r**3)
    # The rate of ω by the chain rule, from the rates of the orbit.
    tilting = tilt * (-h_ / h - 3 * r_ / r)
    along = 2 * i_ * np.cos(2 * i) * np.sin(u) + u_ * np.sin(2 * i) * np.cos(u)
    tilting -= k / (h * r**3) * along
    turn = np.column_stack([tilt, none, h / r**2])[:, None]
    turning = np.column_stack([tilting, none, h_ / r**2 - 2 * h * r_ / r**3])[:, None]
    pole = np.column_stack([np.sin(i) * np.sin(u), np.sin(i) * np.cos(u), np.cos(i)])[:, None]
    chief = np.column_stack([r, none, none])[:, None]
    l, v = state[..., :3], state[..., 3:]  # noqa: E741
    change = applied + _gravity(chief + l, pole, mu, k) - _gravity(chief, pole, mu, k)
    change = change - 2 * np.cross(turn, v) - np.cross(turning, l)
    return np.concatenate([v, change - np.cross(turn, np.cross(turn, l))], axis=-1)


def _gravity(place: Array, pole: Array, mu: float, k: float) -> Array:
    rho = np.linalg.norm(place, axis=-1, keepdims=True)
    height = (place * pole).sum(axis=-1, keepdims=True)
    central = mu / rho**3 + k / rho**5 - 5 * k * height**2 / rho**7
    return -central * place - 2 * k * height / rho**5 * pole


def _held(n: float) -> Array:
    """Return the rates of a state and of a control that is held, (9, 9)."""
    rates = np.zeros((9, 9))
    rates[:3, 3:6] = rates[3:6, 6:] = np.eye(3)
    rates[3, 0], rates[3, 4], rates[4, 3], rates[5, 2] = 3 * n**2, 2 * n, -2 * n, -(n**2)
    return rates
