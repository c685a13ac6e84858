# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Lesson 1: Relative motion and zero-order hold
#
# SATO plans with one equation of motion per agent,
#
# $$\mathbf x_j[k+1] = A_j[k]\,\mathbf x_j[k] + B_j[k]\,\mathbf u_j[k] + z_j[k]
#   \qquad\text{[Morgan2016, eq. 10]}$$
#
# with $\mathbf x = (\ell, \dot\ell)$, position and velocity, and $\mathbf u$ an acceleration. This
# lesson derives $A$ and $B$ for spacecraft in orbit, checks them against integration, and finds the
# initial velocity with which a spacecraft stays near its neighbors for free. The page on
# [spacecraft in orbit](../orbit.md) has the numbers of the toolkit.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from dynamics import (
    J2,
    ClohessyWiltshire,
    InertialPlant,
    NonlinearPlant,
    Orbit,
    SchweighartSedwick,
    discretize_zoh,
    invariant_velocity,
)
from dynamics.model import LinearizedModel

small = os.environ.get("SATO_LESSON_SIZE") == "small"  # shorter runs, for tests

orbit = Orbit.from_elements(6_878e3, inclination=np.radians(45))  # that of Sec. VI.B
n, period = orbit.mean_motion, orbit.period
print(f"n = {n:.6e} rad/s, one orbit takes {period / 60:.1f} min")

# %% [markdown]
# ## Motion relative to a circular orbit
#
# Put the axes at a reference point on the orbit, the *chief*: $x$ radial and outward, $y$ along the
# track, $z$ normal to the plane (LVLH: local vertical, local horizontal). The spacecraft about it
# are *deputies*, at $\ell = (x, y, z)$. The chief falls with gravity $\mathbf g(\mathbf r)$ at
# $\mathbf r = (r, 0, 0)$. The axes turn at $\boldsymbol\omega = (0, 0, n)$, $n = \sqrt{\mu/r^3}$
# with $\mu$ the Earth's gravitational parameter, and add a centrifugal and a Coriolis term:
#
# $$\ddot\ell = \mathbf g(\mathbf r + \ell) - \mathbf g(\mathbf r)
#   - \boldsymbol\omega\times(\boldsymbol\omega\times\ell) - 2\,\boldsymbol\omega\times\dot\ell
#   + \mathbf u .$$
#
# The equation is of the form $\dot{\mathbf x} = \mathbf f(\mathbf x) + B\mathbf u$ (eq. 2). Eqs. 7
# and 8 linearize it about a nominal $\mathbf x^0$:
#
# $$A = \left.\frac{\partial\mathbf f}{\partial\mathbf x}\right|_{\mathbf x^0},\qquad
#   z = \mathbf f(\mathbf x^0) - A\,\mathbf x^0 .$$
#
# This $z$ is a vector, not the coordinate. At the chief itself, $\mathbf x^0 = 0$, the gradient of
# $\mathbf g = -\mu\mathbf r/r^3$ is $\mu/r^3\,(3\,\hat{\mathbf r}\hat{\mathbf r}^T - I) =
# n^2\,\mathrm{diag}(2, -1, -1)$, and $z = 0$. Three lines of code give the Clohessy–Wiltshire
# equations.

# %%
W = np.array([[0, -n, 0], [n, 0, 0], [0, 0, 0]])  # ω ×
gradient = n**2 * np.diag([2, -1, -1])
A = np.block([[np.zeros((3, 3)), np.eye(3)], [gradient - W @ W, -2 * W]])
B = np.vstack([np.zeros((3, 3)), np.eye(3)])

cw = ClohessyWiltshire.from_orbit(orbit)
kepler = J2(Orbit.from_elements(6_878e3, inclination=np.radians(45), k_J2=0.0))
numerical, _ = kepler.jacobian(0.0, np.zeros(6), np.zeros(3))  # of the exact equations
assert np.allclose(A, cw.A(0.0), rtol=0, atol=1e-18)
assert np.allclose(A, numerical, rtol=0, atol=1e-15)
print("Row of ẍ, in units of n² and n:", A[3] / [n**2, n**2, n**2, n, n, n] + 0.0)

# %% [markdown]
# Written out:
#
# $$\ddot x = 3n^2x + 2n\dot y + u_x,\qquad \ddot y = -2n\dot x + u_y,\qquad
#   \ddot z = -n^2z + u_z .$$
#
# ## Zero-order hold
#
# A computer holds each control for a step, $\mathbf u(t) = \mathbf u[k]$ for $t_k \le t < t_{k+1}$
# (eq. 9). Then
#
# $$A[k] = e^{A\Delta t},\qquad B[k] = \int_0^{\Delta t} e^{A\tau}\,d\tau\;B
#   \qquad\text{(eq. 11)},$$
#
# and $z[k]$ has $z$ in place of $B$. Both are blocks of one matrix exponential, since the pair
# $(\mathbf x, \mathbf u)$ with $\dot{\mathbf u} = 0$ is itself a linear system [VanLoan1978]:
#
# $$\exp\left(\begin{bmatrix}A & B\\0 & 0\end{bmatrix}\Delta t\right)
#   = \begin{bmatrix}A[k] & B[k]\\0 & I\end{bmatrix}.$$

# %%
dt = 60.0  # s, the step of Sec. VI.B
E = expm(dt * np.block([[A, B], [np.zeros((3, 9))]]))
Ad, Bd = E[:6, :6], E[:6, 6:]

steps = discretize_zoh(cw, dt, count=10)  # the same by the toolkit
assert np.allclose(Ad, steps.A[0], rtol=0, atol=1e-12)
assert np.allclose(Bd, steps.B[0], rtol=0, atol=1e-12)

# %% [markdown]
# A matrix exponential could still be the wrong one. Integrate the differential equation over ten
# steps with random controls and compare.

# %%
rng = np.random.default_rng(1)
x0, u = rng.normal(0, [500] * 3 + [0.5] * 3), rng.normal(0, 1e-3, (10, 3))
x = x0
for control in u:
    solution = solve_ivp(
        lambda t, y, control=control: A @ y + B @ control, (0, dt), x, "DOP853", rtol=1e-12
    )
    x = solution.y[:, -1]
error = np.abs(steps.simulate(x0, u)[-1] - x)
print(f"after 10 steps: {error[:3].max():.1e} m and {error[3:].max():.1e} m/s apart")
assert error[:3].max() < 1e-6

# %% [markdown]
# ## J2: matrices that change with time
#
# The Earth is oblate. Its J2 term makes $A$ depend on the chief's latitude, so on time. The class
# `J2` holds the exact equations, `LinearizedModel` their linearization at the chief (eqs. 7, 8),
# and `SchweighartSedwick` a model with constant matrices, in which J2 is averaged over the orbit.
#
# As printed, eq. 11 freezes $A(t_k)$ over the step. sato integrates $\dot\Phi = A(t)\,\Phi$
# instead. How much does that matter? Compare both with SciPy's integrator.

# %%
j2 = LinearizedModel(J2(orbit))
lengths = np.array([15.0, 30.0, 60.0, 120.0, 240.0])  # s
span = 960.0


def product(matrices):
    """Multiply the matrices of all steps, the first on the right."""
    total = np.eye(6)
    for step in matrices:
        total = step @ total
    return total


above = np.array([0.0, 0.0, 1000.0, 0.0, 0.0, 0.0])  # m, the state to carry forward
solution = solve_ivp(lambda t, y: j2.A(t) @ y, (0, span), above, "DOP853", rtol=1e-13, atol=1e-12)
exact = solution.y[:, -1]
errors = {"Euler, I + A Δt": [], "A frozen (eq. 11)": [], "integrated": []}
for h in lengths:
    times = np.arange(0, span, h)
    euler = [np.eye(6) + h * j2.A(t) for t in times]
    frozen = [expm(j2.A(t) * h) for t in times]
    integrated = discretize_zoh(j2, h, len(times)).A
    for error, matrices in zip(errors.values(), (euler, frozen, integrated), strict=True):
        error.append(np.linalg.norm((product(matrices) @ above - exact)[:3]))

figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
for (name, error), mark in zip(errors.items(), "os^", strict=True):
    axes.loglog(lengths, error, marker=mark, label=name)
axes.set_xticks(lengths, [f"{h:g}" for h in lengths], minor=False)
axes.minorticks_off()
axes.set(xlabel="step Δt [s]", ylabel="error after 16 min [m]")
axes.set_title("A deputy that starts 1 km above the plane")
axes.legend()
axes.grid(alpha=0.3)
plt.show()
at_60 = {name: error[2] for name, error in errors.items()}
for name, error in at_60.items():
    print(f"{name:26} {error:.1e} m at 60 s")
assert at_60["integrated"] < 1e-6 < at_60["A frozen (eq. 11)"] < 1

# %% [markdown]
# Euler loses meters at any useful step. Freezing $A$ costs a decimeter at the paper's 60 s, less
# than the collision radius of 50 m, but a target is to be met better than that. The error is of
# first order in $\Delta t$ for both; integration costs little: there is no reason to freeze.
#
# ## Which model for how long?
#
# Fly twenty random deputies within ±1 km for an orbit, each model with its own drift, and the truth
# in inertial space (`InertialPlant`, no linearization).

# %%
count = 3 if small else 20
start = np.zeros((count, 6))
start[:, :2] = rng.uniform(-1000, 1000, (count, 2))  # in the plane, as in Sec. VI.B
start[:, 3:] = invariant_velocity(orbit, start[:, :3])
instants = 24
times = np.linspace(0, period, instants + 1)
no_control = np.zeros((count, 3))
truth = InertialPlant(orbit).propagate(start, no_control, 0.0, period, instants)

models = {
    "Clohessy–Wiltshire": cw,
    "Schweighart–Sedwick": SchweighartSedwick.from_orbit(orbit),
    "J2, linearized at the chief": j2,
}
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
worst = {}
for (name, model), mark in zip(models.items(), "os^", strict=True):
    free = discretize_zoh(model, period / instants, instants)
    found = free.simulate(start, np.zeros((count, instants, 3)))
    error = np.linalg.norm(np.moveaxis(found, 1, 0) - truth, axis=2).max(axis=1)
    worst[name] = error[-1]
    axes.semilogy(times[1:] / 60, error[1:], marker=mark, ms=3, label=name)
axes.axvline(24, color="gray", lw=0.8)
label = "24 min: the paper's\nreconfiguration"
axes.text(25, axes.get_ylim()[0] * 1.5, label, color="gray")
axes.set(xlabel="time [min]", ylabel="largest error of position [m]")
axes.legend()
axes.grid(alpha=0.3)
plt.show()
for name, error in worst.items():
    print(f"{name:28} {error:5.1f} m after an orbit")
assert worst["J2, linearized at the chief"] < worst["Clohessy–Wiltshire"] / 5

# %% [markdown]
# Over an orbit an averaged J2 is hardly better than none: what it leaves out, the part of J2 that
# changes with the latitude, is as large as the average. The linearization about the chief has both.
# The rest of its error is the curvature of gravity, of second order in the distance.
#
# ## The drift-free condition
#
# From $\ddot y = -2n\dot x + u_y$ it follows that without control
#
# $$D = \dot y + 2nx$$
#
# is constant. Substitute $\dot y = D - 2nx$ into the first equation: $\ddot x = -n^2x + 2nD$, an
# oscillation about $x = 2D/n$. So $\dot y = D - 2nx$ is on average $D - 4D = -3D$, and each orbit,
# in the time $2\pi/n$, the motion drifts by
#
# $$\Delta y = -3D\,\frac{2\pi}{n} = -\frac{6\pi}{n}\,(\dot y + 2nx)
#   \qquad\text{[m per orbit]} .$$
#
# The orbit closes if and only if $\dot y = -2nx$. With $\dot x = ny/2$ as well it is an ellipse,
# twice as long as high, about the chief.

# %%
position = np.array([[500.0, 0.0, 0.0]])
centered = np.hstack([position, cw.centered_velocity(position)])
drifting = centered + np.array([0, 0, 0, 0, 0.05, 0])  # 5 cm/s too fast
turns, each = 3, 120
figure, axes = plt.subplots(figsize=(7, 2.8), layout="constrained")
for state, label in ((centered, "$D = 0$"), (drifting, "$D = 5$ cm/s")):
    free = discretize_zoh(cw, period / each, turns * each)
    path = free.simulate(state, np.zeros((1, turns * each, 3)))[0]
    axes.plot(path[:, 1] / 1e3, path[:, 0] / 1e3, label=label)
    D = state[0, 4] + 2 * n * state[0, 0]
    assert np.isclose(path[-1, 1] - path[0, 1], -turns * 6 * np.pi / n * D, atol=1e-6)
axes.plot(0, 0, "k+", ms=10)
axes.annotate("chief", (0, 0), xytext=(6, 4), textcoords="offset points")
axes.set(xlabel="y, along-track [km]", ylabel="x, radial [km]", aspect="equal")
axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncol=2, frameon=False)
plt.show()

# %% [markdown]
# Five centimeters a second too fast along the track, and the spacecraft falls back by 850 m an
# orbit: a push forward raises the orbit, and a higher orbit takes longer.
#
# This condition belongs to the linear model. Under J2 the spacecraft drifts all the same. There the
# energy is conserved: choose $\dot y$ such that the deputy has exactly the chief's energy, J2
# included, and it stays. `invariant_velocity` does so, and gives $\dot z$ for equal inclinations,
# so that the nodes turn alike. Sec. VI.B uses such velocities.

# %%
orbits, each = 2 if small else 15, 12  # samples an orbit
angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
position = 500 * np.stack([np.cos(angles), 2 * np.sin(angles), 0 * angles], axis=1)
recipes = {
    "Clohessy–Wiltshire": cw.centered_velocity(position),
    "Schweighart–Sedwick": models["Schweighart–Sedwick"].centered_velocity(position),
    "J2 energy": invariant_velocity(orbit, position),
}
state = np.vstack([np.hstack([position, velocity]) for velocity in recipes.values()])
plant = NonlinearPlant(J2(orbit))
path = plant.propagate(state, np.zeros((24, 3)), 0.0, orbits * period, orbits * each)
mean = path[:-1, :, 1].reshape(orbits, each, 3, 8).mean(axis=1)  # along-track, over each orbit
shift = np.abs(mean - mean[0]).max(axis=2).T
drift = dict(zip(recipes, shift[:, -1] / (orbits - 1), strict=True))
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
for name, moved, mark in zip(recipes, shift, "os^", strict=True):
    axes.semilogy(np.arange(1, orbits), moved[1:], marker=mark, ms=4, label=name)
axes.set(xlabel="orbits", ylabel="largest shift along track [m]")
axes.legend()
axes.grid(alpha=0.3)
plt.show()
for name, value in drift.items():
    print(f"{name:20} {value:7.3f} m an orbit")
assert drift["J2 energy"] < 0.1 < drift["Clohessy–Wiltshire"]

# %% [markdown]
# ## Exercises
#
# ### Exercise 1
#
# Draw 100 random states within 1 km and 1 m/s. Show that the Clohessy–Wiltshire drift over an orbit
# is $-6\pi D/n$ for each, and that all other entries of the state return to where they began.

# %% tags=["hide-cell"]
states = rng.uniform(-1, 1, (100, 6)) * [1000, 1000, 1000, 1, 1, 1]
after = discretize_zoh(cw, period, 1).simulate(states, np.zeros((100, 1, 3)))[:, -1]
D = states[:, 4] + 2 * n * states[:, 0]
assert np.allclose(after[:, 1] - states[:, 1], -6 * np.pi / n * D, rtol=0, atol=1e-6)
assert np.allclose(after[:, [0, 2, 3, 4, 5]], states[:, [0, 2, 3, 4, 5]], rtol=0, atol=1e-7)
print(f"largest drift {np.abs(6 * np.pi / n * D).max() / 1e3:.1f} km per orbit")

# %% [markdown]
# ### Exercise 2
#
# A spacecraft has $D \ne 0$ and a thruster along $y$. Which constant $u_y$, held for one step
# $\Delta t$, stops the drift? Does it matter when it burns?

# %% tags=["hide-cell"]
# Ḋ = ÿ + 2nẋ = u_y, so u_y = −D/Δt, held for Δt, makes D zero at any time. When it burns decides
# about which point the ellipse stays, not whether it closes.
for wait in (1, 7, 20):
    path = discretize_zoh(cw, dt, wait + 1)
    u = np.zeros((100, wait + 1, 3))
    u[:, wait, 1] = -D / dt
    end = path.simulate(states, u)[:, -1]
    assert np.abs(end[:, 4] + 2 * n * end[:, 0]).max() < 1e-12
print(f"Δv = |D|: {np.abs(D).mean():.2f} m/s on average")

# %% [markdown]
# ### Exercise 3
#
# Schweighart and Sedwick's averaged equations are
#
# $$\ddot x = (5c^2 - 2)\,n^2x + 2nc\,\dot y + u_x,\qquad \ddot y = -2nc\,\dot x + u_y,\qquad
#   \ddot z = -n^2\,(c + \kappa\cos^2 i)^2\,z + u_z$$
#
# with $c = \sqrt{1 + s}$, $s = \kappa\,(1 + 3\cos 2i)/4$, and $\kappa > 0$ the strength of J2. At
# which inclination $i$ does J2, on average, leave the in-plane equations as they are? Is the
# cross-track equation unchanged there too?

# %% tags=["hide-cell"]
# s = 0 where cos 2i = −1/3, so i = 54.74°.
inclination = np.arccos(-1 / 3) / 2
critical = SchweighartSedwick(6_878e3, inclination)
plain = ClohessyWiltshire(critical.n)
assert np.allclose(critical.A(0.0)[[3, 4]], plain.A(0.0)[[3, 4]], rtol=0, atol=1e-15)
# With c = 1 the cross-track rate is n (1 + κ cos² i) > n: the node moves back while the spacecraft
# goes round, so it meets the node again sooner. Over an orbit the phase gains this angle.
phase = 360 * (critical.cross_track_rate / critical.n - 1)
assert phase > 0
print(f"i = {np.degrees(inclination):.2f}°, cross-track phase gains {phase:.3f}° per orbit")
